// Viewer of an object's mesh: turns, zooms and lights it, in its own color or colored by measured values.
(async () => {
  const root = document.getElementById('object');
  const canvas = root.querySelector('canvas'), control = name => root.querySelector(`[name=${name}]`);
  const probe = document.createElement('canvas').getContext('webgl2');
  if (!probe || typeof DecompressionStream === 'undefined') {
    root.classList.add('unavailable');
    return;
  }
  probe.getExtension('WEBGL_lose_context')?.loseContext();

  const data = unpack.block('object-data'), count = data.vertices;
  // Vertices from planes of 16-bit numbers, one plane for each component.
  async function attribute(packed, Type, size, value) {
    const planes = await unpack.words(packed, Type), values = new Float32Array(size * count);
    for (let i = 0; i < count; ++i) {
      for (let c = 0; c < size; ++c) values[size * i + c] = value(planes[c * count + i], c);
    }
    return new THREE.BufferAttribute(values, size);
  }
  // 8-bit sRGB as linear colors, which three.js expects.
  const linear = value => Math.pow(value / 255, 2.2);
  const bytes = text => Uint8Array.from(atob(text), character => character.charCodeAt(0));
  const content = await new THREE.GLTFLoader().parseAsync(bytes(data.glb).buffer, '');
  const {geometry, material: {map: texture, normalMap}} = content.scene.getObjectByProperty('isMesh', true);
  geometry.computeBoundingBox();
  geometry.translate(...geometry.boundingBox.getCenter(new THREE.Vector3()).negate().toArray());
  const paints = {
    stations: await attribute(data.stations, Uint16Array, 3, linear), sigma: await attribute(data.sigma, Uint16Array, 3, linear)
  };
  if (data.reference) paints.reference = await attribute(data.reference, Uint16Array, 3, linear);
  const textures = {color: texture};
  if (data.albedo) {
    const albedo = new THREE.Texture(await createImageBitmap(new Blob([bytes(data.albedo)], {type: 'image/webp'})));
    // As glTF defines textures: not flipped, colors in sRGB.
    albedo.flipY = false;
    albedo.colorSpace = THREE.SRGBColorSpace;
    albedo.needsUpdate = true;
    textures.albedo = albedo;
  }
  for (const one of [...Object.values(textures), normalMap]) one.anisotropy = 4;

  const material = new THREE.MeshStandardMaterial({roughness: 0.85, metalness: 0, side: THREE.DoubleSide, normalMap});
  const scene = new THREE.Scene(), lamp = new THREE.DirectionalLight(0xffffff, 2.6);
  scene.add(new THREE.Mesh(geometry, material), new THREE.AmbientLight(0xffffff, 0.7), lamp, lamp.target);
  const renderer = new THREE.WebGLRenderer({canvas, antialias: true, alpha: true, preserveDrawingBuffer: true});
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  const radius = Math.hypot(...data.extent) / 2;
  // Orthographic projection: the scale bar is valid at every depth.
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -20 * radius, 20 * radius);
  camera.up.set(...data.up);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = false;
  [controls.minZoom, controls.maxZoom] = [0.2, 100];
  function home() {
    camera.position.set(...data.eye).multiplyScalar(4 * radius);
    camera.zoom = 1;
    camera.updateProjectionMatrix();
    controls.target.set(0, 0, 0);
    controls.update();
    redraw();
  }

  let waiting = false;
  function draw() {
    waiting = false;
    const {clientWidth: w, clientHeight: h} = canvas, size = renderer.getPixelRatio();
    if (canvas.width !== Math.floor(w * size) || canvas.height !== Math.floor(h * size)) {
      renderer.setSize(w, h, false);
      [camera.right, camera.top] = [1.1 * radius * Math.max(1, w / h), 1.1 * radius * Math.max(1, h / w)];
      [camera.left, camera.bottom] = [-camera.right, -camera.top];
      camera.updateProjectionMatrix();
    }
    // The lamp moves with the viewer, turned to the side and upwards.
    const side = Number(control('side').value), height = Number(control('height').value);
    const axis = k => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, k);
    lamp.position.copy(axis(2)).multiplyScalar(Math.cos(side) * Math.cos(height))
        .addScaledVector(axis(0), Math.sin(side) * Math.cos(height)).addScaledVector(axis(1), Math.sin(height));
    renderer.render(scene, camera);
    drawScaleBar(root.querySelector('.scale'), 2 * camera.top / camera.zoom / h * data.meters);
  }
  function redraw() {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  }
  function paint() {
    const chosen = control('paint').value;
    material.map = textures[chosen] ?? null;
    material.normalMap = control('fine').checked ? normalMap : null;
    material.vertexColors = chosen in paints;
    if (chosen in paints) geometry.setAttribute('color', paints[chosen]);
    material.color.set(chosen === 'plain' ? 0x9a958c : 0xffffff);
    material.needsUpdate = true;
    redraw();
  }
  // Turns the viewer about the object, angles in radians.
  function turn(sideways, upwards) {
    const axis = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 0);
    camera.position.applyAxisAngle(camera.up, sideways).applyAxisAngle(axis, -upwards);
    controls.update();
    redraw();
  }
  function zoom(factor) {
    camera.zoom = Math.min(controls.maxZoom, Math.max(controls.minZoom, camera.zoom * factor));
    camera.updateProjectionMatrix();
    redraw();
  }
  canvas.addEventListener('keydown', event => {
    const act = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1),
      ArrowDown: () => turn(0, -0.1), '+': () => zoom(1.25), '=': () => zoom(1.25), '-': () => zoom(0.8), 0: home
    }[event.key];
    if (!act) return;
    act();
    event.preventDefault();
  });
  root.querySelector('[data-act=in]').addEventListener('click', () => zoom(1.5));
  root.querySelector('[data-act=out]').addEventListener('click', () => zoom(1 / 1.5));
  root.querySelector('[data-act=reset]').addEventListener('click', home);
  // The wheel scrolls the page until the view has the focus.
  canvas.addEventListener('pointerdown', () => canvas.focus({preventScroll: true}));
  canvas.addEventListener('wheel', event => {
    if (document.activeElement !== canvas && !event.ctrlKey) event.stopImmediatePropagation();
  }, {capture: true});
  controls.addEventListener('change', redraw);
  root.addEventListener('input', paint);
  new ResizeObserver(redraw).observe(canvas);
  home();
  paint();
  root.classList.add('ready');
})();
