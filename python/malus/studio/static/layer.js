// A painted layer over an image: mask or labels, in the image's own pixels, with undo and redo.
export const LABELS = { mask: [{ value: 255, name: 'object', color: [53, 167, 160] }],
  labels: [{ value: 1, name: 'diffuse', color: [58, 124, 165] }, { value: 2, name: 'specular', color: [224, 161, 59] }] };
// Largest total number of pixels in the undo history.
const REMEMBERED = 8e7;

const canvasOf = (width, height) => Object.assign(document.createElement('canvas'), { width, height });

export class Layer {
  constructor(width, height, kind) {
    this.kinds = LABELS[kind];
    this.canvas = canvasOf(width, height);
    this.context = this.canvas.getContext('2d', { willReadFrequently: true });
    this.past = [];
    this.future = [];
    this.edits = 0;
    this.saved = 0;
  }

  // Whether there is something to save. A saver sets `saved` to the value that `edits` had when it sent the layer, because the user may
  // go on drawing meanwhile.
  get changed() { return this.edits !== this.saved; }

  // Changes the layer with a function that draws within a box [x0, y0, x1, y1]. The change can be undone.
  edit(box, draw) {
    const x = Math.max(0, Math.floor(box[0])), y = Math.max(0, Math.floor(box[1]));
    const width = Math.min(this.canvas.width, Math.ceil(box[2])) - x, height = Math.min(this.canvas.height, Math.ceil(box[3])) - y;
    if (width <= 0 || height <= 0) return;
    const before = this.context.getImageData(x, y, width, height);
    this.context.save();
    draw(this.context);
    this.context.restore();
    this.#sharpen(x, y, width, height);
    this.past.push({ x, y, before, after: this.context.getImageData(x, y, width, height) });
    this.future = [];
    this.edits += 1;
    const size = () => this.past.reduce((sum, { before: { width: w, height: h } }) => sum + 2 * w * h, 0);
    while (this.past.length > 1 && size() > REMEMBERED) this.past.shift();
  }

  // Canvas drawing smooths edges. Each pixel must be fully in or out and have exactly one label.
  #sharpen(x, y, width, height) {
    const pixels = this.context.getImageData(x, y, width, height);
    const data = pixels.data;
    for (let i = 0; i < data.length; i += 4) {
      const color = data[i + 3] < 128 ? [0, 0, 0] : this.#nearest(data[i], data[i + 1], data[i + 2]).color;
      data[i] = color[0];
      data[i + 1] = color[1];
      data[i + 2] = color[2];
      data[i + 3] = data[i + 3] < 128 ? 0 : 255;
    }
    this.context.putImageData(pixels, x, y);
  }

  #nearest(r, g, b) {
    if (this.kinds.length === 1) return this.kinds[0];
    const distance = ({ color }) => (color[0] - r) ** 2 + (color[1] - g) ** 2 + (color[2] - b) ** 2;
    return distance(this.kinds[0]) <= distance(this.kinds[1]) ? this.kinds[0] : this.kinds[1];
  }

  #step(from, to, which) {
    const entry = from.pop();
    if (!entry) return false;
    this.context.putImageData(entry[which], entry.x, entry.y);
    to.push(entry);
    this.edits += 1;
    return true;
  }

  undo() { return this.#step(this.past, this.future, 'before'); }

  redo() { return this.#step(this.future, this.past, 'after'); }

  get whole() { return [0, 0, this.canvas.width, this.canvas.height]; }

  // Loads the values of a gray picture. They replace the layer, or are added to it.
  async load(blob, { add = false, as = null, remember = true } = {}) {
    const bitmap = await createImageBitmap(blob);
    const gray = canvasOf(this.canvas.width, this.canvas.height);
    const reader = gray.getContext('2d', { willReadFrequently: true });
    reader.imageSmoothingEnabled = false;
    reader.drawImage(bitmap, 0, 0, gray.width, gray.height);
    const pixels = reader.getImageData(0, 0, gray.width, gray.height);
    const data = pixels.data;
    for (let i = 0; i < data.length; i += 4) {
      const kind = data[i] === 0 ? null : as ?? this.kinds.find(({ value }) => value === data[i]) ?? this.kinds[0];
      data[i + 3] = kind ? 255 : 0;
      if (kind) [data[i], data[i + 1], data[i + 2]] = kind.color;
    }
    reader.putImageData(pixels, 0, 0);
    this.edit(this.whole, (context) => {
      if (!add) context.clearRect(0, 0, gray.width, gray.height);
      context.drawImage(gray, 0, 0);
    });
    if (!remember) {
      this.past = [];
      this.saved = this.edits;
    }
  }

  // A gray PNG with the value `valueOf(kind or null, x, y)` for each pixel; by default the layer's own values.
  png(valueOf = (kind) => kind?.value ?? 0) {
    const { width, height } = this.canvas;
    const pixels = this.context.getImageData(0, 0, width, height);
    const data = pixels.data;
    for (let i = 0, p = 0; i < data.length; i += 4, p += 1) {
      const kind = data[i + 3] < 128 ? null : this.#nearest(data[i], data[i + 1], data[i + 2]);
      const value = valueOf(kind, p % width, Math.floor(p / width));
      data[i] = data[i + 1] = data[i + 2] = value;
      data[i + 3] = 255;
    }
    const out = canvasOf(width, height);
    out.getContext('2d').putImageData(pixels, 0, 0);
    return new Promise((resolve) => out.toBlob(resolve, 'image/png'));
  }

  // Bounding box of the painted pixels, enlarged on each side by `margin` times its size; null if nothing is painted.
  box(margin) {
    const { width, height } = this.canvas;
    const data = this.context.getImageData(0, 0, width, height).data;
    let [x0, y0, x1, y1] = [width, height, -1, -1];
    for (let i = 3, p = 0; i < data.length; i += 4, p += 1) {
      if (!data[i]) continue;
      const x = p % width, y = Math.floor(p / width);
      x0 = Math.min(x0, x); x1 = Math.max(x1, x); y0 = Math.min(y0, y); y1 = Math.max(y1, y);
    }
    if (x1 < 0) return null;
    const dx = margin * (x1 - x0), dy = margin * (y1 - y0);
    return [x0 - dx, y0 - dy, x1 + dx, y1 + dy];
  }
}
