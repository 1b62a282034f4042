// Unpacks numbers that malus/viewer.py has packed: differences of neighbors, split into byte planes, compressed with Deflate.
const unpack = (() => {
  const bytes = base64 => Uint8Array.from(atob(base64), c => c.charCodeAt(0));

  async function inflate(base64) {
    const stream = new Blob([bytes(base64)]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // Whole numbers; Type is Uint8Array, Int16Array, Uint16Array or Uint32Array, which keeps the lowest bits of a number
  // that is too large for it.
  async function words(base64, Type) {
    const planes = await inflate(base64), size = Type.BYTES_PER_ELEMENT, count = planes.length / size, values = new Type(count);
    for (let i = 0; i < count; ++i) {
      values[i] = i ? values[i - 1] : 0;
      for (let k = 0; k < size; ++k) values[i] += planes[k * count + i] * 256 ** k;
    }
    return values;
  }

  // Normals of a surface of the relighting data, decoded once: two planes, x and y, times `scale`.
  const decoded = {};
  function normals(data, surface) {
    return decoded[surface] ??= words(data[surface], Int16Array);
  }

  // An image of WebP.
  async function picture(base64) {
    const image = new Image();
    image.src = `data:image/webp;base64,${base64}`;
    await image.decode();
    return image;
  }

  // The JSON block with this id in the page.
  const block = id => JSON.parse(document.getElementById(id).textContent);
  return {bytes, words, normals, picture, block};
})();
