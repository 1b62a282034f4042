// Unpacks numbers that malus/viewer.py has packed: differences of neighbors, split into byte planes, compressed with Deflate.
const unpack = (() => {
  async function inflate(base64) {
    const bytes = Uint8Array.from(atob(base64), c => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // 16-bit whole numbers; Type is Int16Array or Uint16Array.
  async function words(base64, Type) {
    const planes = await inflate(base64), count = planes.length / 2, values = new Type(count);
    for (let i = 0, value = 0; i < count; ++i) {
      value = (value + planes[i] + (planes[count + i] << 8)) & 0xffff;
      values[i] = value;
    }
    return values;
  }

  async function indices(base64) {
    const planes = await inflate(base64), count = planes.length / 4, values = new Uint32Array(count);
    for (let i = 0, value = 0; i < count; ++i) {
      const step = planes[i] + planes[count + i] * 256 + planes[2 * count + i] * 65536 + planes[3 * count + i] * 16777216;
      value = (value + step) % 4294967296;
      values[i] = value;
    }
    return values;
  }

  // Normals of a surface of the relighting data, decoded once: two planes, x and y, times `scale`.
  const decoded = {};
  function normals(data, surface) {
    return decoded[surface] ??= words(data[surface], Int16Array);
  }

  async function picture(base64, type) {
    const image = new Image();
    image.src = `data:${type};base64,${base64}`;
    await image.decode();
    return image;
  }

  // The JSON block with this id in the page.
  const block = id => JSON.parse(document.getElementById(id).textContent);
  return {words, indices, normals, picture, block};
})();
