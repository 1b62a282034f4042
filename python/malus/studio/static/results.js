// Finished results: their figures, comparison of two results or of two dates, profiles picked on a surface, and the report.
import { addressOf, ask, byId, doing, length, make, picture, tell } from './api.js';
import { keepProfile, state } from './open_station.js';
import { showPage } from './pages.js';

let all = [];
const place = byId('result-view');
// Updates whether the shown profile can be kept in the open station, since another station may have been opened.
let offer = () => {};

export async function showResults() {
  all = await ask('results');
  offer();
  const compared = await ask('comparisons');
  if (!all.length) {
    byId('result-list').replaceChildren(make('p', { class: 'note' }, 'There are no results in this folder yet.'));
    return;
  }
  const chosen = new Set();
  const compare = make('button', { type: 'button', class: 'compare', disabled: true, click: doing(() => showBoth([...chosen])) }, 'Compare the two that are ticked');
  const tick = (path) => (event) => { if (event.target.checked) chosen.add(path); else chosen.delete(path); compare.disabled = chosen.size !== 2; };
  byId('result-list').replaceChildren(make('div', { class: 'scroll', tabindex: 0, role: 'group', 'aria-label': 'Results' }, make('table', {}, make('caption', {}, 'Results in the opened folder'),
    make('thead', {}, make('tr', {}, ...['compare', 'folder', 'object', 'confidence', 'accuracy', 'coverage', 'warnings', 'show'].map((text) => make('th', { scope: 'col' }, text)))),
    make('tbody', {}, ...all.map((result) => line(result, tick))))), compare,
    ...(compared.length ? [make('h3', {}, 'Comparisons of two dates'), make('ul', {}, ...compared.map(({ path, report }) => make('li', {}, make('button', { type: 'button', class: 'link', click: () => showReport(path, report) }, path))))] : []));
}

function line(result, tick) {
  const cells = result.problem ? [make('td', { colspan: 6 }, result.problem)] : [
    make('td', {}, result.name), make('td', { class: 'trust' }, make('b', { class: result.confidence.level }, result.confidence.level), ...(result.confidence.reasons.length ? [make('details', {}, make('summary', {}, 'why'), ...result.confidence.reasons.map((reason) => make('p', {}, reason)))] : [])),
    make('td', {}, result.sigma_gsd === null ? 'not known' : `${result.confidence.level === 'low' ? 'at best ' : ''}${length(result.sigma_gsd * result.gsd, result.unit)}`),
    make('td', {}, `${(100 * result.coverage).toFixed(1)} %`), make('td', {}, String(result.warnings.length)),
    make('td', {}, result.report ? make('button', { type: 'button', click: () => showReport(result.path, result.report) }, 'Report') : null, ' ',
      make('button', { type: 'button', click: doing(() => showProfile(result)) }, 'Profile'))];
  return make('tr', {}, make('td', {}, result.problem ? null : make('input', { type: 'checkbox', 'aria-label': `Compare ${result.path}`, change: tick(result.path) })), make('th', { scope: 'row' }, result.path), ...cells);
}

// Shows `parts` below the table of results and scrolls to them, because they may lie below the visible part of the page.
function present(title, ...parts) {
  const heading = make('h3', { tabindex: -1 }, title);
  place.replaceChildren(heading, ...parts);
  heading.focus({ preventScroll: true });
  heading.scrollIntoView();
}

export function showReport(work, address) {
  present(`Report of ${work}`, make('p', {}, make('a', { href: address, target: '_blank', rel: 'noopener' }, 'Open in a new tab')),
    make('iframe', { src: address, title: `Report of ${work}` }));
}

async function showBoth([a, b]) {
  const relief = (path) => picture(addressOf('relief', { path }), `Relief shading of the surface in ${path}`, path);
  const shown = make('div', {}, make('div', { class: 'pair' }, relief(a), relief(b)));
  present(`${a} and ${b}`, shown);
  try {
    const said = await ask('difference', { a, b });
    const told = (value) => length(value, said.unit);
    shown.append(make('figure', {}, make('img', { src: said.picture, alt: `Difference of the two surfaces; blue where ${b} is nearer to the camera, red where it is farther`, style: 'max-width:100%' })),
      make('div', { class: 'legend' }), make('p', {}, make('span', {}, `${told(said.limit)} farther`), make('span', {}, 'alike'), make('span', {}, `${told(said.limit)} nearer`)),
      make('p', {}, `${b} against ${a}: nearer to the camera by ${told(said.mean)} on average (median ${told(said.median)}); RMS ${told(said.rms)}.`));
  } catch (error) {
    shown.append(make('p', { class: 'warning' }, error.message));
  }
  shown.append(twoDates(a, b));
}

// Comparison of two dates whose cameras may stand anywhere: the later surface is first registered to the earlier one.
function twoDates(a, b) {
  const earlier = make('select', {}, ...[a, b].map((path) => make('option', { value: path }, path)));
  const still = make('input', { type: 'checkbox' });
  const find = doing(async () => {
    await tell('compare', { before: earlier.value, after: earlier.value === a ? b : a, same_frame: still.checked });
    await showPage('runs');
  });
  return make('fieldset', {}, make('legend', {}, 'Two dates of one object'),
    make('p', { class: 'note' }, 'The later surface is registered to the earlier one on the parts that did not change. A page then shows the changes and the smallest change that could be detected.'),
    make('p', { class: 'row' }, make('label', {}, 'The earlier one is ', earlier), make('label', {}, still, ' Both stand in one frame already: do not register them'),
      make('button', { type: 'button', click: find }, 'Find what changed')));
}

async function showProfile(result) {
  const start = [0.2 * result.width, 0.5 * result.height].map(Math.round), stop = [0.8 * result.width, 0.5 * result.height].map(Math.round);
  const inputs = [...start, ...stop].map((value, at) => make('input', { type: 'number', value, min: 0, 'aria-label': ['from x', 'from y', 'to x', 'to y'][at] }));
  const shading = make('img', { src: addressOf('relief', { path: result.path }), alt: `Relief shading of ${result.path}; click two places to draw a profile between them, or type their pixel coordinates`, draggable: 'false' });
  const line = drawn('svg', { viewBox: `-0.5 -0.5 ${result.width} ${result.height}`, preserveAspectRatio: 'none', 'aria-hidden': 'true' });
  const picked = make('div', { class: 'picked' }, shading, line);
  const chart = make('div');
  const ends = () => { const values = inputs.map((input) => Number(input.value)); return { from: values.slice(0, 2), to: values.slice(2) }; };
  const marked = (toSecond) => {
    const { from: [x1, y1], to: [x2, y2] } = ends();
    const strokes = [['#fff', 5], ['#c22f43', 2.5]].map(([stroke, thick]) => ({ stroke, 'stroke-width': thick, 'vector-effect': 'non-scaling-stroke', fill: 'none' }));
    const dot = (x, y) => strokes.map((look) => drawn('circle', { cx: x, cy: y, r: result.width / 120, ...look }));
    line.replaceChildren(...(toSecond ? strokes.map((look) => drawn('path', { d: `M${x1} ${y1}L${x2} ${y2}`, ...look })) : []), ...dot(x1, y1), ...(toSecond ? dot(x2, y2) : []));
  };
  let asked = 0;
  const draw = doing(async () => {
    marked(true);
    const number = ++asked;
    const section = await tell('profile', { path: result.path, ...ends() });
    if (number === asked) chart.replaceChildren(...plots(section));
  });
  let second = false;
  shading.addEventListener('click', (event) => {
    const box = shading.getBoundingClientRect();
    const pixel = (share, count) => Math.min(Math.max(Math.floor(share * count), 0), count - 1);
    inputs[second ? 2 : 0].value = pixel((event.clientX - box.left) / box.width, result.width);
    inputs[second ? 3 : 1].value = pixel((event.clientY - box.top) / box.height, result.height);
    second = !second;
    if (second) marked(false);
    else draw();
  });
  const said = make('p', { class: 'note', role: 'status' });
  const keep = make('button', { type: 'button', click: doing(async () => {
    await keepProfile(result.path, ends());
    said.textContent = `Kept in ${state.station.path}; the next run reports it.`;
  }) }, 'Keep it in the open station');
  // In the images of another station, the same pixels show another place.
  offer = () => {
    keep.disabled = !result.station || result.station !== state.station?.path;
    said.textContent = !keep.disabled ? '' : result.station ? `To keep it for the next run, open ${result.station} first: this result belongs to it.`
      : 'The profile cannot be kept: the station of this result is not in the opened folder.';
  };
  offer();
  present(`Profile on ${result.path}`, make('div', { class: 'pair' }, picked, make('div', {}, make('p', { class: 'note' }, 'Click two places in the picture, or type their pixel coordinates.'),
    make('p', { class: 'row' }, ...inputs.map((input) => make('label', {}, input.getAttribute('aria-label'), input)), make('button', { type: 'button', click: draw }, 'Draw'), keep), said, chart)));
  await draw();
}

// Two charts: the heights of both surfaces, and their difference, which is too small to be seen in the first chart.
function plots(section) {
  const changed = section.fused.map((value, at) => value === null || section.prior[at] === null ? null : value - section.prior[at]);
  return [chartOf(section, [[section.prior, 'var(--warn)', '5 3'], [section.fused, 'currentColor', '']], 'Height above the chord; dashed: coarse surface, solid: fused'),
    chartOf(section, [[changed, 'currentColor', '']], 'What fusion changed: fused minus coarse surface')];
}

const SVG = 'http://www.w3.org/2000/svg';
function drawn(tag, attributes, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

// Ticks at round values of an axis, 1, 2 or 5 times a power of ten apart.
function ticks(low, high, most) {
  const power = 10 ** Math.floor(Math.log10((high - low) / most));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => (high - low) / one <= most);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, at) => (first + at) * step);
}

function chartOf(section, lines, title) {
  const [width, height, left, low] = [640, 230, 74, 34];
  const known = lines.flatMap(([values]) => values).filter((value) => value !== null);
  const far = section.along.at(-1);
  const [bottom, top] = [Math.min(...known), Math.max(...known)];
  const x = (value) => left + value / far * (width - left - 14), y = (value) => height - low - (value - bottom) / (top - bottom || 1) * (height - low - 14);
  const path = (values) => values.map((value, at) => value === null ? '' : `${at && values[at - 1] !== null ? 'L' : 'M'}${x(section.along[at]).toFixed(1)} ${y(value).toFixed(1)}`).join('');
  const text = (attributes, words) => drawn('text', attributes, words);
  const shown = (value) => value === 0 ? '0' : length(value, section.unit, 3);
  return make('figure', {}, make('figcaption', {}, title), drawn('svg', { class: 'profile', viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': `${title}, from ${shown(bottom)} to ${shown(top)} along ${shown(far)}` },
    ...(top > bottom ? ticks(bottom, top, 5) : []).flatMap((value) => [drawn('line', { x1: left, x2: width - 14, y1: y(value), y2: y(value) }), text({ x: left - 6, y: y(value) + 4, 'text-anchor': 'end' }, shown(value))]),
    ...ticks(0, far, 6).map((value) => text({ x: x(value), y: height - 10, 'text-anchor': 'middle' }, shown(value))),
    ...lines.map(([values, stroke, dashes]) => drawn('path', { d: path(values), fill: 'none', stroke, 'stroke-width': 1.6, 'stroke-dasharray': dashes }))));
}
