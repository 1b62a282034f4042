// Viewer of an object's mesh: turns, zooms and lights it, in its own color or colored by measured values.
(async () => {
  const root = document.getElementById('object');
  if (!canShowMesh(root)) return;
  const control = name => root.querySelector(`[name=${name}]`);

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
  const content = await new THREE.GLTFLoader().parseAsync(unpack.bytes(data.glb).buffer, '');
  const {geometry, material: {map: texture, normalMap}} = content.scene.getObjectByProperty('isMesh', true);
  geometry.computeBoundingBox();
  geometry.translate(...geometry.boundingBox.getCenter(new THREE.Vector3()).negate().toArray());
  const paints = {
    stations: await attribute(data.stations, Uint16Array, 3, linear), sigma: await attribute(data.sigma, Uint16Array, 3, linear)
  };
  // What each station sees is blue, all else light gray. Made when it is first wanted: a large mesh of many stations would take much memory.
  const seen = await unpack.words(data.seen, Uint8Array), blue = [33, 102, 172].map(linear), gray = [205, 205, 205].map(linear);
  function seenBy(station) {
    const values = new Float32Array(3 * count);
    for (let i = 0; i < count; ++i) values.set(seen[station * count + i] ? blue : gray, 3 * i);
    return new THREE.BufferAttribute(values, 3);
  }
  if (data.reference) paints.reference = await attribute(data.reference, Uint16Array, 3, linear);
  const textures = {color: texture};
  if (data.albedo) textures.albedo = colorTexture(await unpack.picture(data.albedo));
  for (const one of [texture, normalMap]) one.anisotropy = 4;

  const material = new THREE.MeshStandardMaterial({roughness: 0.85, metalness: 0, side: THREE.DoubleSide, normalMap});
  const {scene, camera, lamp, radius, axis, redraw, lookFrom} = meshStage(root, {
    extent: data.extent, meters: data.meters, up: data.up, light, turn, home,
    halfHeight: (w, h) => 1.1 * radius * Math.max(1, h / w)
  });
  scene.add(new THREE.Mesh(geometry, material));

  function home() {
    lookFrom(new THREE.Vector3(...data.eye).multiplyScalar(4 * radius));
    redraw();
  }
  // The lamp moves with the viewer, turned to the side and upwards.
  function light() {
    const side = Number(control('side').value), height = Number(control('height').value);
    lamp.position.copy(axis(2)).multiplyScalar(Math.cos(side) * Math.cos(height))
        .addScaledVector(axis(0), Math.sin(side) * Math.cos(height)).addScaledVector(axis(1), Math.sin(height));
  }
  function turn(sideways, upwards) {
    camera.position.applyAxisAngle(camera.up, sideways).applyAxisAngle(axis(0), -upwards);
  }
  function paint() {
    const chosen = control('paint').value;
    if (chosen.startsWith('seen-')) paints[chosen] ??= seenBy(Number(chosen.slice(5)));
    material.map = textures[chosen] ?? null;
    material.normalMap = control('fine').checked ? normalMap : null;
    material.vertexColors = chosen in paints;
    if (chosen in paints) geometry.setAttribute('color', paints[chosen]);
    material.color.set(chosen === 'plain' ? 0x9a958c : 0xffffff);
    material.needsUpdate = true;
    redraw();
  }
  root.addEventListener('input', paint);
  home();
  paint();
  root.classList.add('ready');
})();
