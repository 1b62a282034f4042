// Draws a scale bar of 1, 2 or 5 times a power of ten. `size`: size of a CSS pixel on the object, in meters.
function drawScaleBar(element, size) {
  const most = 140 * size, power = 10 ** Math.floor(Math.log10(most));
  const length = [5, 2, 1].find(n => n * power <= most * 1.000001) * power;
  const [factor, name] = [[1e6, 'µm'], [1e3, 'mm']].find(([one]) => length * one < 999) ?? [1, 'm'];
  element.style.width = `${length / size}px`;
  element.textContent = `${Number((length * factor).toPrecision(2))} ${name}`;
}
