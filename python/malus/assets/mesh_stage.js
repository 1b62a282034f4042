// What the views of a mesh share: a scene of three.js that pointer, keyboard and buttons turn, move and zoom.

// Whether the browser can show such a view; if not, a note takes its place.
function canShowMesh(root) {
  const probe = document.createElement('canvas').getContext('webgl2');
  const can = Boolean(probe) && typeof DecompressionStream !== 'undefined';
  root.classList.toggle('unavailable', !can);
  probe?.getExtension('WEBGL_lose_context')?.loseContext();
  return can;
}

// A texture of colors as glTF defines it: not flipped, in sRGB.
function colorTexture(image) {
  const texture = new THREE.Texture(image);
  texture.flipY = false;
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 4;
  texture.needsUpdate = true;
  return texture;
}

// The scene in the canvas of `root`. extent: sides of the object in its unit, which is so many `meters`; up: what is up. The view's own functions:
// halfHeight(w, h): of the part that a canvas of this size shows without zoom; light(): places the lamp, before every drawing;
// turn(sideways, upwards): moves the camera about the object, angles in radians; home(): shows the first view again.
function meshStage(root, {extent, meters, up = [0, 1, 0], halfHeight, light, turn, home}) {
  const canvas = root.querySelector('canvas');
  const renderer = new THREE.WebGLRenderer({canvas, antialias: true, alpha: true, preserveDrawingBuffer: true});
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  const radius = Math.hypot(...extent) / 2;
  // Orthographic projection: the scale bar is valid at every depth.
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -100 * radius, 100 * radius);
  camera.up.set(...up);  // before the controls are made, which turn about it
  const scene = new THREE.Scene(), lamp = new THREE.DirectionalLight(0xffffff, 2.6);
  scene.add(new THREE.AmbientLight(0xffffff, 0.7), lamp, lamp.target);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = false;
  [controls.minZoom, controls.maxZoom] = [0.2, 100];
  // Directions of the camera in the scene: 0 to the right, 1 up, 2 towards the viewer.
  const axis = k => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, k);

  let waiting = false;
  function draw() {
    waiting = false;
    const {clientWidth: w, clientHeight: h} = canvas, density = renderer.getPixelRatio();
    if (canvas.width !== Math.floor(w * density) || canvas.height !== Math.floor(h * density)) {
      renderer.setSize(w, h, false);
      camera.top = halfHeight(w, h);
      camera.right = camera.top * w / h;
      [camera.left, camera.bottom] = [-camera.right, -camera.top];
      camera.updateProjectionMatrix();
    }
    light();
    renderer.render(scene, camera);
    drawScaleBar(root.querySelector('.scale'), 2 * camera.top / camera.zoom / h * meters);
  }
  function redraw() {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  }
  function lookFrom(position) {
    camera.position.copy(position);
    camera.zoom = 1;
    camera.updateProjectionMatrix();
    controls.target.set(0, 0, 0);
    controls.update();
  }
  function zoom(factor) {
    camera.zoom = Math.min(controls.maxZoom, Math.max(controls.minZoom, camera.zoom * factor));
    camera.updateProjectionMatrix();
    redraw();
  }
  function turnBy(sideways, upwards) {
    turn(sideways, upwards);
    controls.update();
    redraw();
  }

  canvas.addEventListener('pointerdown', () => canvas.focus({preventScroll: true}));
  // The wheel scrolls the page until the view has the focus.
  canvas.addEventListener('wheel', event => {
    if (document.activeElement !== canvas && !event.ctrlKey) event.stopImmediatePropagation();
  }, {capture: true});
  canvas.addEventListener('keydown', event => {
    const act = {
      ArrowLeft: () => turnBy(-0.1, 0), ArrowRight: () => turnBy(0.1, 0), ArrowUp: () => turnBy(0, 0.1),
      ArrowDown: () => turnBy(0, -0.1), '+': () => zoom(1.25), '=': () => zoom(1.25), '-': () => zoom(0.8), 0: home
    }[event.key];
    if (!act) return;
    act();
    event.preventDefault();
  });
  root.querySelector('[data-act=in]').addEventListener('click', () => zoom(1.5));
  root.querySelector('[data-act=out]').addEventListener('click', () => zoom(1 / 1.5));
  root.querySelector('[data-act=reset]').addEventListener('click', home);
  controls.addEventListener('change', redraw);
  new ResizeObserver(redraw).observe(canvas);
  return {scene, camera, lamp, controls, radius, axis, draw, redraw, lookFrom};
}
