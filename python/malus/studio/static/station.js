// The station's fields with what the checks say beside each, the prior over the image, and the file itself.
import { addressOf, ask, byId, doing, duration, make, tell } from './api.js';
import { change, state, take } from './studio.js';
import { ImageView } from './view.js';

let candidates = { clouds: [], models: [], images: [] };
let modelImages = [];

export async function showStation() {
  candidates = await ask('candidates');
  await draw();
}

const under = (table, key) => state.station.values[table]?.[key];

// A path of the station file as the page names it.
function named(value) {
  if (!value) return '';
  const parts = state.station.path.split('/').slice(0, -1).concat(String(value).split('/'));
  const result = [];
  for (const part of parts) if (part === '..') result.pop(); else if (part !== '.') result.push(part);
  return result.join('/') || '.';
}

async function draw() {
  byId('station-text').value = state.station.text;
  const model = under('camera', 'colmap_model');
  try {
    modelImages = model ? (await ask('model', { path: named(model) })).images : [];
  } catch {
    modelImages = [];  // The check below says what is wrong with it.
  }
  const controls = () => [...byId('fields').querySelectorAll('input, select')];
  const focused = controls().indexOf(document.activeElement);
  byId('fields').replaceChildren(...fields());
  if (focused >= 0) controls()[focused]?.focus();
  await check();
}

const says = (field) => make('div', { class: 'says', 'data-says': field });
let serial = 0;
const row = (field, title, control) => {
  control.id ||= `field-${++serial}`;
  return make('div', { class: 'field' }, make('label', { for: control.id }, title), control, says(field));
};

const set = (changes) => {
  byId('plan').textContent = 'Saving …';
  return doing(async () => { await change(changes); await draw(); })();
};
const text = (field, title, table, key, kind = 'text') => row(field, title, make('input', { type: kind, step: 'any', value: under(table, key) ?? '',
  change: (event) => set([{ table, key, value: event.target.value === '' ? null : kind === 'number' ? Number(event.target.value) : event.target.value }]) }));

// A choice; the present value stays choosable even if it is not among the options.
function choice(field, title, present, options, onChange) {
  const values = options.map(([value]) => value);
  const all = values.includes(present) ? options : [[present, present], ...options];
  return row(field, title, make('select', { change: (event) => onChange(event.target.value) },
    ...all.map(([value, shown]) => make('option', { value, selected: value === present }, shown))));
}

function fields() {
  const images = (under('polarized', 'images') ?? []);
  const path = (table, key) => (value) => set([{ table, key, value: value || null, is_path: true }]);
  const paths = (list) => [['', 'none'], ...list.map((name) => [name, name])];
  const index = under('optics', 'refractive_index');
  return [
    text('station', 'Name of the object', 'station', 'name'),
    choice('scale', 'Unit of lengths', under('station', 'unit') ?? 'mm', ['mm', 'um', 'cm', 'm', 'in', 'ft'].map((unit) => [unit, unit]), (value) => set([{ table: 'station', key: 'unit', value }])),
    row('images', 'Polarized images', make('output', {}, Array.isArray(images) ? images.join(', ') : String(images))),
    row('angles', 'Angles [°]', make('input', { value: [under('polarized', 'angles_deg') ?? []].flat().join(', '), placeholder: 'from the names', change: (event) => set([{ table: 'polarized', key: 'angles_deg', value: anglesOf(event.target.value) }]) })),
    choice('angles', 'Scale counts', under('polarized', 'angle_direction') ?? 'ccw', [['ccw', 'counter-clockwise, as the camera sees it'], ['cw', 'clockwise']], (value) => set([{ table: 'polarized', key: 'angle_direction', value }])),
    text('angles', 'Zero of the scale [°]', 'polarized', 'angle_zero_deg', 'number'),
    text('response', 'Response', 'polarized', 'response'),
    text('response', 'White level [DN]', 'polarized', 'white_level', 'number'),
    row('mask', 'Mask', make('output', {}, under('polarized', 'mask') ?? 'none: the whole image is the object; draw one under Draw')),
    text('optics', 'Refractive index', 'optics', 'refractive_index', typeof index === 'string' ? 'text' : 'number'),
    choice('optics', 'Reflection', under('optics', 'reflection') ?? 'auto', [['auto', 'decided by region'], ['diffuse', 'diffuse'], ['specular', 'specular']], (value) => set([{ table: 'optics', key: 'reflection', value }])),
    choice('camera', 'Camera: COLMAP model', named(under('camera', 'colmap_model')), paths(candidates.models), path('camera', 'colmap_model')),
    modelImages.length ? choice('camera', "This station's name in the model", under('camera', 'image') ?? '', [['', 'choose'], ...modelImages.map((name) => [name, name])], (value) => set([{ table: 'camera', key: 'image', value: value || null }])) : null,
    choice('prior', 'Coarse surface (cloud)', named(under('prior', 'cloud')), paths(candidates.clouds), path('prior', 'cloud')),
    choice('photos', 'Photographs from all around', named(under('photos', 'folder')), paths(candidates.images), path('photos', 'folder')),
    row('patch', 'Flat patches', make('output', {}, namesOf('patch'))),
    row('profile', 'Profiles', make('output', {}, namesOf('profile'))),
    row('scale', 'Known distances', make('output', {}, String((state.station.values.scale ?? []).length))),
  ].filter(Boolean);
}

const namesOf = (list) => (state.station.values[list] ?? []).map((entry, at) => entry.name ?? at + 1).join(', ') || 'none';

function anglesOf(typed) {
  if (typed.trim() === '') return null;
  if (typed.trim() === 'auto') return 'auto';
  const angles = typed.split(/[,;\s]+/).filter(Boolean).map(Number);
  if (angles.some(Number.isNaN)) throw new Error(`${typed}, expected angles in degrees: 0, 45, 90`);
  return angles;
}

let asked = 0;
export async function check() {
  const number = ++asked;
  byId('plan').textContent = 'Checking …';
  const said = await ask('check', { path: state.station.path });
  if (number !== asked) return;
  for (const place of document.querySelectorAll('[data-says]')) place.replaceChildren();
  for (const line of said.lines) {
    const place = document.querySelector(`[data-says="${line.field}"]`) ?? document.querySelector('[data-says="station"]');
    place.append(make('p', { class: line.severity }, `${line.severity === 'error' ? 'Wrong' : 'Please look'}: ${line.message}`));
  }
  const wrong = said.lines.filter((line) => line.severity === 'error').length;
  byId('plan').textContent = wrong ? 'The station cannot run yet; see below.'
    : `Ready: ${said.plan.width} × ${said.plan.height} px, about ${duration(said.plan.seconds)} and ${(said.plan.memory_mb / 1000).toFixed(1)} GB expected${said.lines.length ? `; ${said.lines.length} to look at` : ''}. ${said.plan.does.join('; ')}.`;
  byId('plan').className = wrong ? 'error' : said.lines.length ? 'warning' : 'good';
}

let view = null;
byId('show-overlay').addEventListener('click', doing(async () => {
  const note = byId('overlay-note');
  note.textContent = 'Projecting the prior …';
  try {
    const picture = await createImageBitmap(await ask('overlay', { path: state.station.path }));
    byId('overlay-stage').hidden = false;
    view ??= new ImageView(byId('overlay-stage'));
    await view.open(addressOf('picture', { path: state.station.images[0] }));
    view.paint = (context) => {
      context.globalAlpha = Number(byId('overlay-strength').value);
      view.inImage(context, () => context.drawImage(picture, 0, 0));
    };
    view.redraw();
    note.textContent = 'Yellow is near, violet is far; where nothing lies over the image the prior has no surface.';
  } catch (error) {
    note.textContent = error.message;
  }
}));
byId('overlay-strength').addEventListener('input', () => view?.redraw());

byId('save-text').addEventListener('click', doing(async () => {
  take(await tell('text', { path: state.station.path, digest: state.station.digest, text: byId('station-text').value }));
  await draw();
}));
byId('reload-text').addEventListener('click', doing(async () => { take(await ask('station', { path: state.station.path })); await draw(); }));
