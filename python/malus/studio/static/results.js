// Finished results: their figures, two beside each other, profiles picked on a surface, and the report.
import { addressOf, ask, byId, doing, make, tell } from './api.js';
import { change, state } from './studio.js';

const number = (value, digits = 3) => value === null || value === undefined ? '–' : Number(value).toPrecision(digits);
let all = [];
const place = byId('result-view');

export async function showResults() {
  all = await ask('results');
  if (!all.length) {
    byId('result-list').replaceChildren(make('p', { class: 'note' }, 'There are no results in this folder yet.'));
    return;
  }
  const chosen = new Set();
  const compare = make('button', { type: 'button', disabled: true, click: doing(() => showBoth([...chosen])) }, 'Compare the two that are ticked');
  const tick = (path) => (event) => { if (event.target.checked) chosen.add(path); else chosen.delete(path); compare.disabled = chosen.size !== 2; };
  byId('result-list').replaceChildren(make('div', { class: 'scroll' }, make('table', {}, make('caption', {}, 'Results in the opened folder'),
    make('thead', {}, make('tr', {}, ...['compare', 'folder', 'object', 'confidence', 'accuracy', 'coverage', 'warnings', 'show'].map((text) => make('th', { scope: 'col' }, text)))),
    make('tbody', {}, ...all.map((result) => line(result, tick))))), compare);
}

function line(result, tick) {
  const cells = result.problem ? [make('td', { colspan: 6 }, result.problem)] : [
    make('td', {}, result.name), make('td', {}, result.confidence.level), make('td', {}, result.sigma_gsd === null ? '–' : `${number(result.sigma_gsd * result.gsd)} ${result.unit}`),
    make('td', {}, `${(100 * result.coverage).toFixed(1)} %`), make('td', {}, String(result.warnings.length)),
    make('td', {}, result.report ? make('button', { type: 'button', click: () => showReport(result.path, result.report) }, 'Report') : null, ' ',
      make('button', { type: 'button', click: doing(() => showProfile(result)) }, 'Profile'))];
  return make('tr', {}, make('td', {}, result.problem ? null : make('input', { type: 'checkbox', 'aria-label': `Compare ${result.path}`, change: tick(result.path) })), make('th', { scope: 'row' }, result.path), ...cells);
}

export function showReport(work, address) {
  place.replaceChildren(make('h3', {}, `Report of ${work}`), make('p', {}, make('a', { href: address, target: '_blank', rel: 'noopener' }, 'Open it in a tab of its own')),
    make('iframe', { src: address, title: `Report of ${work}` }));
}

async function showBoth([a, b]) {
  const figure = (path) => make('figure', {}, make('img', { src: addressOf('relief', { path }), alt: `Relief shading of the surface in ${path}` }), make('figcaption', {}, path));
  place.replaceChildren(make('h3', {}, `${a} and ${b}`), make('div', { class: 'pair' }, figure(a), figure(b)));
  try {
    const said = await ask('difference', { a, b });
    place.append(make('figure', {}, make('img', { src: said.picture, alt: `Difference of the two surfaces; blue where ${b} is nearer to the camera, red where it is farther`, style: 'max-width:100%' }),
      make('figcaption', {}, `Blue: ${b} lies nearer to the camera than ${a}, up to ${number(said.limit)} ${said.unit}; red: farther. Mean ${number(said.mean)}, median ${number(said.median)}, RMS ${number(said.rms)} ${said.unit}.`)));
  } catch (error) {
    place.append(make('p', { class: 'warning' }, error.message));
  }
}

async function showProfile(result) {
  const start = [0.2 * result.width, 0.5 * result.height].map(Math.round), stop = [0.8 * result.width, 0.5 * result.height].map(Math.round);
  const inputs = [...start, ...stop].map((value, at) => make('input', { type: 'number', value, min: 0, 'aria-label': ['from x', 'from y', 'to x', 'to y'][at] }));
  const picture = make('img', { src: addressOf('relief', { path: result.path }), alt: `Relief shading of ${result.path}; press two places to take a profile between them, or type their pixels below`, draggable: 'false' });
  const chart = make('div');
  const ends = () => { const values = inputs.map((input) => Number(input.value)); return { from: values.slice(0, 2), to: values.slice(2) }; };
  const draw = doing(async () => { chart.replaceChildren(...plots(await tell('profile', { path: result.path, ...ends() }))); });
  let second = false;
  picture.addEventListener('click', (event) => {
    const box = picture.getBoundingClientRect();
    inputs[second ? 2 : 0].value = Math.round((event.clientX - box.left) / box.width * result.width - 0.5);
    inputs[second ? 3 : 1].value = Math.round((event.clientY - box.top) / box.height * result.height - 0.5);
    if (second) draw();
    second = !second;
  });
  const keep = make('button', { type: 'button', disabled: !state.station, click: doing(async () => {
    const profiles = structuredClone(state.station.values.profile ?? []);
    await change([{ list: 'profile', entries: [...profiles, { name: `picked ${profiles.length + 1}`, ...ends() }] }]);
    keep.textContent = `Kept in ${state.station.path}; the next run reports it`;
  }) }, 'Keep it in the open station');
  place.replaceChildren(make('h3', {}, `Profile on ${result.path}`), make('div', { class: 'pair' }, picture, make('div', {}, make('p', { class: 'note' }, 'Press two places of the picture, or type their pixels.'),
    make('p', { class: 'row' }, ...inputs, make('button', { type: 'button', click: draw }, 'Draw'), keep), chart)));
  await draw();
}

// Two charts: heights of both surfaces, and what fusion changed, which is far too small to be seen in the first one.
function plots(section) {
  const changed = section.fused.map((value, at) => value === null || section.prior[at] === null ? null : value - section.prior[at]);
  return [chartOf(section, [[section.prior, 'var(--warn)', '5 3'], [section.fused, 'currentColor', '']], 'Height above the chord; dashed: prior, solid: fused'),
    chartOf(section, [[changed, 'currentColor', '']], 'What fusion changed: fused minus prior')];
}

const SVG = 'http://www.w3.org/2000/svg';
function drawn(tag, attributes, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

function chartOf(section, lines, title) {
  const [width, height, left, low] = [640, 220, 84, 34];
  const known = lines.flatMap(([values]) => values).filter((value) => value !== null);
  const [bottom, top, far] = [Math.min(...known), Math.max(...known), section.along.at(-1)];
  const x = (value) => left + value / far * (width - left - 10), y = (value) => height - low - (value - bottom) / (top - bottom || 1) * (height - low - 14);
  const path = (values) => values.map((value, at) => value === null ? '' : `${at && values[at - 1] !== null ? 'L' : 'M'}${x(section.along[at]).toFixed(1)} ${y(value).toFixed(1)}`).join('');
  const text = (attributes, words) => drawn('text', attributes, words);
  return make('figure', {}, make('figcaption', {}, title), drawn('svg', { class: 'profile', viewBox: `0 0 ${width} ${height}`, role: 'img', 'aria-label': `${title}, from ${number(bottom)} to ${number(top)} ${section.unit} along ${number(far)} ${section.unit}` },
    ...lines.map(([values, stroke, dashes]) => drawn('path', { d: path(values), fill: 'none', stroke, 'stroke-width': 1.6, 'stroke-dasharray': dashes })),
    text({ x: 4, y: 22 }, `${number(top)} ${section.unit}`), text({ x: 4, y: height - low }, `${number(bottom)} ${section.unit}`),
    text({ x: left, y: height - 8 }, '0'), text({ x: width - 10, y: height - 8, 'text-anchor': 'end' }, `${number(far)} ${section.unit}`)));
}
