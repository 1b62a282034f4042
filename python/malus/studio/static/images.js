// Folders with thumbnails, and the table that makes a new station from chosen images.
import { addressOf, ask, byId, doing, make, numberIn, once, picture, tell } from './api.js';
import { createStation, openStation } from './open_station.js';
import { showPage } from './pages.js';
import { redraw } from './redraw.js';

let folder = null;
let shots = [];
let opened = 0;
const form = byId('new-station');

export async function showFolder(path = folder?.path ?? '') {
  const mine = ++opened;
  const found = await ask('folder', { path });
  const home = found.parent ?? '';
  const beside = await ask('folder', { path: home });
  if (mine !== opened) return;  // Another folder has been chosen meanwhile.
  const again = folder?.path === found.path && shots.length === found.images.length && shots.every((shot, at) => shot.path === found.images[at].path);
  folder = found;
  byId('crumbs').replaceChildren(...crumbs(folder.path, folder.opened));
  byId('folder-list').replaceChildren(...[cards(folder.stations.map(stationCard), 'Stations'), cards(folder.folders.map(folderCard), 'Folders'), imageCards(), hiddenNote()].flat());
  const taken = (path) => beside.stations.includes(path);
  if (again && !taken(form.elements.path.value)) return;  // On return from another page, typed values and the preview are kept.
  shots = folder.images.map((image) => ({ ...image, use: image.path !== folder.mask, angle: null, exposure: null }));
  form.hidden = shots.length < 3;
  asked += 1;  // Discards a pending preview of the folder shown before.
  if (form.hidden) return;
  form.elements.name.value = folder.home;
  // JPEGs have eight bits and, unless somebody made them otherwise, the encoding of a display.
  form.elements.response.value = shots.every((shot) => !shot.use || /\.jpe?g$/i.test(shot.name)) ? 'srgb' : 'linear';
  form.elements.source.value = 'names';
  byId('taken-fields').hidden = true;
  const free = ['station', folder.name, ...Array.from({ length: 99 }, (_, at) => `station_${at + 2}`)].map((name) => `${home && home !== '.' ? `${home}/` : ''}${name}.toml`);
  form.elements.path.value = free.find((name) => !taken(name));
  byId('preview').replaceChildren();
  drawTable();
  fill();  // Not awaited, because reading the files may be slow. It reports its errors itself.
}

function crumbs(path, opened) {
  const parts = path === '.' ? [] : path.split('/');
  const all = [[`opened folder: ${opened}`, '.'], ...parts.map((part, index) => [part, parts.slice(0, index + 1).join('/')])];
  return all.map(([text, to]) => make('button', { type: 'button', class: 'link', click: doing(() => showFolder(to)) }, text));
}

const cards = (items, title) => items.length ? [make('h3', {}, title), make('ul', { class: 'cards' }, ...items)] : [];
const stationCard = (path) => make('li', { class: 'card' }, make('button', { type: 'button', class: 'main', click: doing(() => openStation(path)) }, `Open ${path.split('/').pop()}`));
const folderCard = (entry) => make('li', { class: 'card' }, make('button', { type: 'button', click: doing(() => entry.is_work ? showPage('results') : showFolder(entry.path)) },
  `${entry.name}${entry.is_work ? ' (results)' : entry.images ? ` (${entry.images} images)` : ''}`));

function imageCards() {
  return cards(folder.images.map((image) => make('li', { class: 'card' },
    make('img', { src: addressOf('thumbnail', { path: image.path }), alt: `Thumbnail of ${image.name}`, loading: 'lazy' }),
    make('span', {}, image.name))), 'Images');
}

const hiddenNote = () => folder.hidden.length ? [make('p', { class: 'warning' }, `Not shown, because their names are not in UTF-8; rename them first: ${folder.hidden.join(', ')}`)] : [];

function drawTable() {
  const dated = shots.some((shot) => shot.taken);
  byId('angles').tHead.rows[0].cells[3].hidden = !dated;
  redraw(byId('angles').tBodies[0], ...shots.map((shot) => make('tr', {},
    make('td', {}, make('input', { type: 'checkbox', checked: shot.use, 'aria-label': `${shot.name} is polarized`, change: (event) => { shot.use = event.target.checked; preview(); } })),
    make('td', {}, shot.path === folder.mask ? `${shot.name}, which becomes the mask` : shot.name),
    make('td', {}, make('input', { type: 'number', step: 'any', value: shot.angle ?? '', 'aria-label': `Angle of ${shot.name}`, change: doing((event) => { shot.angle = numberIn(event.target, true); return preview(); }) })),
    make('td', { hidden: !dated }, shot.taken?.replace(/^(\d+):(\d+):/, '$1-$2-') ?? 'not said'))));
}

const used = () => shots.filter((shot) => shot.use && shot.angle !== null);

// Exposure times as a table or sidecars say them; null if all are alike or unknown.
function exposuresOf(chosen) {
  const known = chosen.filter((shot) => shot.exposure !== null);
  if (new Set(known.map((shot) => shot.exposure)).size < 2) return null;
  const without = chosen.filter((shot) => shot.exposure === null);
  if (without.length) throw new Error(`${without.map((shot) => shot.name).join(', ')}: no exposure time, but other images have different ones`);
  return known.map((shot) => shot.exposure);
}

// Fills in the angles from the chosen source. Angles that the source does not give are left to be typed, and angles typed before its
// answer are kept.
async function fill() {
  const source = form.elements.source.value;
  if (source === 'typed') return preview();
  const images = shots.filter((shot) => shot.use).map((shot) => shot.path);
  const mine = opened;
  const before = new Map(shots.map(({ path, angle }) => [path, angle]));
  try {
    const found = await tell('angles', { folder: folder.path, source, images, first: Number(form.elements.first.value), step: Number(form.elements.step.value) });
    if (mine !== opened) return undefined;
    for (const { image, angle, exposure } of found) {
      const shot = shots.find(({ path }) => path === image);
      if (shot?.angle === before.get(image)) Object.assign(shot, { angle, exposure: exposure ?? null });
    }
  } catch (error) {
    if (mine !== opened) return undefined;
    byId('preview').replaceChildren(make('p', { class: 'warning' }, error.message));
    if (source === 'names' && shots.every((shot) => shot.taken)) {
      form.elements.source.value = 'taken';
      byId('taken-fields').hidden = false;
      byId('preview').replaceChildren(make('p', { class: 'warning' }, 'Neither the names nor a file beside the images say the angles. If the filter was turned by the same step from image to image, set the first angle and the step above and press “Fill in”; else type the angles into the table.'));
    }
    return undefined;
  }
  drawTable();
  return preview();
}

let asked = 0;
async function preview() {
  const chosen = used();
  const place = byId('preview');
  const number = ++asked;
  if (new Set(chosen.map((shot) => ((shot.angle % 180) + 180) % 180)).size < 3) {
    place.replaceChildren(make('p', { class: 'note' }, 'Three different angles give a preview of intensity, degree and phase.'));
    return;
  }
  place.replaceChildren(make('p', { class: 'note' }, 'Computing a preview …'));
  try {
    const maps = await tell('preview', { ...scale(), images: chosen.map((shot) => shot.path), angles_deg: chosen.map((shot) => shot.angle), exposure_s: exposuresOf(chosen) });
    if (number === asked) place.replaceChildren(...previewParts(maps));
  } catch (error) {
    if (number === asked) place.replaceChildren(make('p', { class: 'error' }, error.message));
  }
}

function previewParts(maps) {
  return [make('div', { class: 'maps' },
    picture(maps.intensity, 'Unpolarized intensity of the object', 'Intensity without polarization'),
    picture(maps.degree, 'Degree of polarization in colors', `Degree of polarization, 0 to ${maps.degree_top.toFixed(2)} (yellow); half of the image below ${maps.degree_median.toFixed(3)}`),
    picture(maps.phase, 'Phase in a circle of colors', 'Phase, 0° to 180° in a circle of colors: on a round object the colors run once around and back')),
  ...maps.findings.map((finding) => make('p', { class: finding.severity }, `${finding.message[0].toUpperCase()}${finding.message.slice(1)}. ${finding.suggestion}`)),
  make('p', { class: 'note' }, `Preview made in ${maps.seconds.toFixed(1)} s. Direction and zero of the scale are checked against the coarse surface when the station runs.`)];
}

const scale = () => ({ angle_direction: form.elements.angle_direction.value, angle_zero_deg: Number(form.elements.angle_zero_deg.value), response: form.elements.response.value });

form.elements.source.addEventListener('change', () => { byId('taken-fields').hidden = form.elements.source.value !== 'taken'; });
byId('fill-angles').addEventListener('click', doing(fill));
for (const name of ['angle_direction', 'angle_zero_deg', 'response']) form.elements[name].addEventListener('change', preview);

form.addEventListener('submit', doing(once(async () => {
  const chosen = used();
  const without = shots.filter((shot) => shot.use && shot.angle === null);
  if (without.length) throw new Error(`${without.map((shot) => shot.name).join(', ')}: no angle; type it, or do not use the image`);
  await createStation({ ...scale(), ...(chosen.some((shot) => shot.raw) ? { response: null } : {}), path: form.elements.path.value, name: form.elements.name.value, unit: form.elements.unit.value,
    images: chosen.map((shot) => shot.path), mask: chosen.some((shot) => shot.path === folder.mask) ? null : folder.mask, angles_deg: chosen.map((shot) => shot.angle), exposure_s: exposuresOf(chosen) });
})));
