// An image that OpenSeadragon zooms and moves, with a canvas over it for drawing in image pixels.
/* global OpenSeadragon */
import { addressOf, ask } from './api.js';

// Side of the square tiles in pixels, as in pictures.py.
const TILE = 512;

export class ImageView {
  constructor(stage) {
    this.stage = stage;
    const holder = document.createElement('div');
    holder.style.cssText = 'position:absolute;inset:0';
    this.canvas = document.createElement('canvas');
    this.canvas.className = 'over';
    stage.replaceChildren(holder, this.canvas);
    const still = matchMedia('(prefers-reduced-motion: reduce)').matches;
    this.viewer = OpenSeadragon({ element: holder, showNavigationControl: false, showNavigator: false, maxZoomPixelRatio: 24, imageSmoothingEnabled: true, drawer: 'canvas',
      animationTime: still ? 0 : 0.35, gestureSettingsMouse: { clickToZoom: false, dblClickToZoom: false }, gestureSettingsTouch: { clickToZoom: false }, keyboardNavEnabled: false });
    for (const element of holder.querySelectorAll('[tabindex]')) element.tabIndex = -1;  // Only the stage takes the keyboard focus.
    this.paint = () => {};
    this.viewer.addHandler('update-viewport', () => this.redraw());
    new ResizeObserver(() => this.redraw()).observe(stage);
  }

  // Shows an image of the opened folder, in tiles whose resolution fits the screen; with `station`, without the distortion of the
  // station's lens.
  async open(path, station = null) {
    const { width, height } = await ask('size', { path });
    const maxLevel = Math.max(0, Math.ceil(Math.log2(Math.max(width, height) / TILE)));
    const getTileUrl = (level, column, row) => addressOf('tile', { path, halvings: maxLevel - level, column, row, ...(station === null ? {} : { station }) });
    return new Promise((resolve, reject) => {
      this.viewer.addOnceHandler('open', () => { this.size = { x: width, y: height }; resolve(); });
      this.viewer.addOnceHandler('open-failed', () => reject(new Error('The image cannot be shown.')));
      // The tiles are JPEGs. OpenSeadragon would take addresses with .png in them for transparent images and leave lines between tiles.
      this.viewer.open({ width, height, tileSize: TILE, minLevel: 0, maxLevel, getTileUrl, hasTransparency: () => false });
    });
  }

  // From a position on the stage to image pixels, and back. (0, 0) is the center of the first pixel here, its corner in OpenSeadragon.
  toImage(point) {
    const at = this.viewer.world.getItemAt(0).viewerElementToImageCoordinates(point);
    return [at.x - 0.5, at.y - 0.5];
  }

  toStage([u, v]) {
    const at = this.viewer.world.getItemAt(0).imageToViewerElementCoordinates(new OpenSeadragon.Point(u + 0.5, v + 0.5));
    return [at.x, at.y];
  }

  // Calls `draw` with a context whose coordinates are image pixels, with (0, 0) at the image's corner.
  inImage(context, draw) {
    const [x0, y0] = this.toStage([-0.5, -0.5]);
    const [x1] = this.toStage([this.size.x - 0.5, -0.5]);
    const scale = (x1 - x0) / this.size.x;
    context.save();
    context.translate(x0, y0);
    context.scale(scale, scale);
    draw(scale);
    context.restore();
  }

  zoom(factor) {
    this.viewer.viewport.zoomBy(factor);
    this.viewer.viewport.applyConstraints();
  }

  redraw() {
    if (!this.size || !this.viewer.world.getItemCount()) return;
    const { clientWidth: width, clientHeight: height } = this.stage;
    const dense = window.devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * dense) || this.canvas.height !== Math.round(height * dense)) {
      this.canvas.width = Math.round(width * dense);
      this.canvas.height = Math.round(height * dense);
    }
    const context = this.canvas.getContext('2d');
    context.setTransform(dense, 0, 0, dense, 0, 0);
    context.clearRect(0, 0, width, height);
    context.save();
    this.paint(context);
    context.restore();
  }
}
