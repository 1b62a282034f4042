// The mesh viewer: turns, moves and zooms the surface, with the same colors as the relighting view.
(async () => {
  const root = document.getElementById('mesh');
  if (!root || !canShowMesh(root)) return;
  const control = name => root.querySelector(`[name=${name}]`);

  const data = unpack.block('mesh-data'), count = data.vertices;
  const planes = await unpack.words(data.positions, Uint16Array), uv = await unpack.words(data.uv, Uint16Array);
  const positions = new Float32Array(3 * count), coordinates = new Float32Array(2 * count);
  for (let i = 0; i < count; ++i) {
    for (let c = 0; c < 3; ++c) positions[3 * i + c] = planes[c * count + i] / 65535 * data.size - data.extent[c] / 2;
    coordinates[2 * i] = uv[i] / 65535;
    coordinates[2 * i + 1] = uv[count + i] / 65535;
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.BufferAttribute(positions, 3));
  geometry.setAttribute('uv', new THREE.BufferAttribute(coordinates, 2));
  geometry.setIndex(new THREE.BufferAttribute(await unpack.words(data.indices, Uint32Array), 1));
  geometry.computeVertexNormals();

  const relight = unpack.block('relight-data');
  const texture = colorTexture(await unpack.picture(relight.color));

  // The fused normals of all pixels shade the mesh, so that it shows detail finer than its triangles.
  async function normalMap() {
    const planes = await unpack.normals(relight, 'fused'), pixels = relight.width * relight.height;
    const half = THREE.DataUtils.toHalfFloat, values = new Uint16Array(4 * pixels);
    for (let i = 0; i < pixels; ++i) {
      const x = planes[i] / relight.scale, y = planes[pixels + i] / relight.scale;
      values.set([half(0.5 + x / 2), half(0.5 + y / 2), half(0.5 + Math.sqrt(Math.max(0, 1 - x * x - y * y)) / 2), half(1)], 4 * i);
    }
    const map = new THREE.DataTexture(values, relight.width, relight.height, THREE.RGBAFormat, THREE.HalfFloatType);
    map.minFilter = map.magFilter = THREE.LinearFilter;
    map.needsUpdate = true;
    return map;
  }
  const material = new THREE.MeshStandardMaterial({
    map: texture, normalMap: await normalMap(), normalMapType: THREE.ObjectSpaceNormalMap, roughness: 0.85, metalness: 0,
    side: THREE.DoubleSide
  });
  const surface = new THREE.Mesh(geometry, material);
  const {scene, camera, lamp, controls, radius, axis, draw, redraw, lookFrom} = meshStage(root, {
    extent: data.extent, meters: data.meters, light, turn, home: () => {
      root.querySelector('form').reset();
      home();
      apply();
    },
    // The surface fills the view as the station sees it, with room for its depth when it is turned.
    halfHeight: (w, h) => 0.56 * Math.max(data.extent[1], data.extent[0] * h / w) + 0.2 * data.extent[2]
  });
  scene.add(surface);
  controls.zoomToCursor = true;

  function home() {
    const eye = new THREE.Vector3(...data.eye).normalize();
    // Seen slightly from the side, so that the relief is visible.
    eye.x += 0.35;
    eye.y += 0.22;
    lookFrom(eye.normalize().multiplyScalar(4 * radius));
  }
  // The light stands to the upper left of the viewer.
  function light() {
    const far = camera.position.distanceTo(controls.target);
    lamp.position.copy(camera.position).addScaledVector(axis(0), -0.9 * far).addScaledVector(axis(1), 0.9 * far);
    lamp.target.position.copy(controls.target);
  }
  function turn(sideways, upwards) {
    const offset = camera.position.clone().sub(controls.target), length = offset.length();
    const azimuth = Math.atan2(offset.x, offset.z) + sideways;
    const polar = Math.min(Math.PI - 0.05, Math.max(0.05, Math.acos(offset.y / length) - upwards));
    camera.position.set(Math.sin(polar) * Math.sin(azimuth), Math.cos(polar), Math.sin(polar) * Math.cos(azimuth))
        .multiplyScalar(length).add(controls.target);
  }
  function apply() {
    const paint = control('paint').value;
    material.map = paint === 'plain' ? null : texture;
    if (paint === 'plain') material.color.set(0x9a958c);
    else material.color.setScalar(Math.min(1, relight.brightness));
    material.wireframe = paint === 'wires';
    material.needsUpdate = true;
    surface.scale.z = Number(control('depth').value);
    root.querySelector('output').textContent = surface.scale.z.toFixed(2);
    redraw();
  }
  root.addEventListener('input', apply);
  apply();
  draw();
  home();
  draw();
  root.classList.add('ready');
})();
