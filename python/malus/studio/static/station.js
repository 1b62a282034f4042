// The station's fields with the messages of the checks beside each field, the coarse surface over the image, and the text of the
// station file.
import { ask, byId, doing, duration, make, numberIn, picture, say, tell } from './api.js';
import { change, changing, reread, state, take } from './open_station.js';
import { showPage } from './pages.js';
import { redraw } from './redraw.js';
import { ImageView } from './view.js';

let candidates = { priors: [], models: [], images: [] };
let modelImages = [];

export async function showStation() {
  byId('plan').textContent = 'Reading the file …';
  candidates = await ask('candidates');
  if (candidates.note) say(candidates.note);
  await draw();
}

const under = (table, key) => state.station.values[table]?.[key];

// A path from the station file, which is relative to that file, as a path relative to the opened folder.
function named(value) {
  if (!value) return '';
  const parts = state.station.path.split('/').slice(0, -1).concat(String(value).split('/'));
  const result = [];
  for (const part of parts) if (part === '..') result.pop(); else if (part !== '.') result.push(part);
  return result.join('/') || '.';
}

async function draw() {
  forgetPictures();
  showText();
  const model = under('camera', 'colmap_model');
  try {
    modelImages = model ? (await ask('model', { path: named(model) })).images : [];
  } catch {
    modelImages = [];  // The check below reports what is wrong with the model.
  }
  const fresh = groups();
  fresh[0].querySelector('#catalog').open = byId('catalog')?.open ?? false;
  await redraw(byId('fields'), ...fresh);
  await propose();
  check().catch((error) => say(error.message));  // Not awaited: the check is slow, and the fields can be filled in meanwhile.
}

// Removes the pictures that were made from an earlier state of the file. The new number also discards those still being computed.
let pictures = 0;
function forgetPictures() {
  pictures += 1;
  byId('phases').replaceChildren();
  byId('overlay-stage').hidden = true;
  byId('overlay-note').textContent = '';
}

// Shows the text of the file, unless the user is editing it. typedUpon: the state of the file to which the edited text belongs.
const fileText = byId('station-text');
let typedUpon = null;
function showText() {
  const { path, text: content, digest } = state.station;
  if (typedUpon?.path === path && fileText.value !== typedUpon.text) return;
  fileText.value = content;
  typedUpon = { path, digest, text: fileText.value };  // Read back from the field, because the browser changes the line ends.
}

// The files found that are nearest to the station: those below its own folder, else those below the parent folder, and so on. Files
// farther away may belong to other objects.
function nearest(found, pathOf) {
  const folders = state.station.path.split('/').slice(0, -1);
  for (let depth = folders.length; depth > 0; --depth) {
    const below = found.filter((one) => pathOf(one).startsWith(`${folders.slice(0, depth).join('/')}/`));
    if (below.length) return below;
  }
  return found;
}
const nearestFirst = (found, pathOf = (path) => path) => {
  const near = nearest(found, pathOf);
  return [...near, ...found.filter((one) => !near.includes(one))];
};

// Offers the camera model and the coarse surface near the station for use with one press, if the choice is unambiguous.
async function propose() {
  const place = byId('proposal');
  place.hidden = true;
  const models = nearest(candidates.models, (path) => path);
  if (state.station.values.camera || state.station.values.prior || models.length !== 1) return;
  const [model] = models;
  const priors = nearest(candidates.priors.filter(({ kind }) => kind !== 'depth'), ({ path }) => path);
  const { images } = await ask('model', { path: model });
  const own = new Set(['station', ...state.station.images.map((path) => path.split('/').pop().replace(/\.\w+$/, ''))]);
  const views = images.filter((name) => own.has(name.split('/').pop().replace(/\.\w+$/, '')));
  const changes = [{ table: 'camera', key: 'colmap_model', value: model, is_path: true }];
  const words = [`the cameras in ${model}`];
  if (views.length === 1) {
    changes.push({ table: 'camera', key: 'image', value: views[0] });
    words.push(`this station as ${views[0]} among them`);
  }
  if (priors.length === 1) {
    changes.push({ table: 'prior', key: priors[0].kind, value: priors[0].path, is_path: true });
    words.push(`the coarse surface ${priors[0].path}`);
  }
  place.hidden = false;
  place.replaceChildren(make('p', {}, `Found in this folder: ${words.join(', ')}.`), make('p', {}, make('button', { type: 'button', class: 'main', click: () => set(changes).then(() => byId('plan').focus()) }, 'Use them')));
}

const says = (field) => make('div', { class: 'says', 'data-says': field });
let serial = 0;
const row = (field, title, control, help = '') => {
  control.id ||= `field-${++serial}`;
  if (help) control.setAttribute('aria-describedby', `${control.id}-help`);
  return make('div', { class: 'field' }, make('label', { for: control.id }, title), control, help ? make('div', { class: 'help', id: `${control.id}-help` }, help) : null, says(field));
};
// A field whose content is drawn on the image: shows its present content and a button that opens the Draw page.
const drawn = (field, title, said, what) => row(field, title, make('output', {}, said, ' ', make('button', { type: 'button', class: 'link', click: () => { byId('draw-what').value = what; showPage('draw'); } }, 'draw')));

const set = (changes) => {
  byId('plan').textContent = 'Saving …';
  asked += 1;  // Discards the answer of an earlier check.
  return doing(async () => {
    try {
      await change(changes);
    } finally {
      await draw();  // Also if nothing could be saved: the fields then show again what the file says.
    }
  })();
};
const text = (field, title, table, key, { kind = 'text', help = '', placeholder = '' } = {}) => {
  const value = under(table, key) ?? '';
  const changed = doing((event) => set([{ table, key, value: kind === 'number' ? numberIn(event.target, true) : event.target.value || null }]));
  return row(field, title, kind === 'lines' ? make('textarea', { rows: 3, change: changed }, value) : make('input', { type: kind, step: 'any', value, placeholder, change: changed }), help);
};

// A list to choose from. The present value is added if it is not among the options.
function choice(field, title, present, options, onChange, help = '') {
  const values = options.map(([value]) => value);
  const all = values.includes(present) ? options : [[present, present], ...options];
  return row(field, title, make('select', { change: (event) => onChange(event.target.value) },
    ...all.map(([value, shown]) => make('option', { value, selected: value === present }, shown))), help);
}

const group = (title, ...rows) => make('fieldset', {}, make('legend', {}, title), ...rows.filter(Boolean));

function groups() {
  return [objectGroup(), imagesGroup(), surfaceGroup(), group('What is assessed',
    drawn('patch', 'Flat patches', namesOf('patch'), 'patch'), drawn('profile', 'Profiles', namesOf('profile'), 'profile'))];
}

const CATALOG = [['identifier', 'Inventory number'], ['title', 'Title'], ['maker', 'Maker'], ['date', 'Date'], ['place', 'Place'], ['material', 'Material'], ['description', 'Description', 'lines'], ['collection', 'Collection'],
  ['recorded_by', 'Recorded by'], ['recorded_on', 'Recorded on'], ['rights', 'Rights'], ['license', 'License']];

function objectGroup() {
  return group('The object', text('station', 'Name of the object', 'station', 'name'),
    choice('unit', 'Unit of lengths', under('station', 'unit') ?? 'mm', ['mm', 'um', 'cm', 'm', 'in', 'ft'].map((unit) => [unit, unit]), (value) => set([{ table: 'station', key: 'unit', value }]), 'Unit of every length in the files and in the results.'),
    make('details', { id: 'catalog' }, make('summary', {}, 'For the catalog (goes into the results)'), ...CATALOG.map(([key, title, kind]) => text('object', title, 'object', key, { kind }))));
}

function imagesGroup() {
  const images = under('polarized', 'images') ?? [];
  const index = under('optics', 'refractive_index');
  const setReflection = (value) => set([{ table: 'optics', key: 'reflection', value }]);
  return group('The polarized images',
    row('images', 'Images', make('output', {}, Array.isArray(images) ? images.join(', ') : String(images))),
    row('angles', 'Angles [°]', make('input', { value: [under('polarized', 'angles_deg') ?? []].flat().join(', '), placeholder: 'from the names',
      change: (event) => doing(() => set([{ table: 'polarized', key: 'angles_deg', value: anglesOf(event.target.value) }]))() }), 'Reading of the filter\'s scale for each image; “auto” if the readings are unknown.'),
    choice('angles', 'Scale counts', under('polarized', 'angle_direction') ?? 'ccw', [['ccw', 'counter-clockwise, as the camera sees it'], ['cw', 'clockwise (read from behind the filter)']], (value) => set([{ table: 'polarized', key: 'angle_direction', value }])),
    text('angles', 'Zero of the scale [°]', 'polarized', 'angle_zero_deg', { kind: 'number', placeholder: '0', help: 'Reading of the scale when the filter\'s axis is horizontal (the light that it lets through swings along the image\'s rows).' }),
    choice('response', 'Pixel values', under('polarized', 'response') ?? 'linear', [['linear', 'linear (RAW, scientific)'], ['srgb', 'sRGB (camera JPEG)'], ['gamma:2.2', 'gamma 2.2']], (value) => set([{ table: 'polarized', key: 'response', value }])),
    text('response', 'White level', 'polarized', 'white_level', { kind: 'number', placeholder: 'full scale', help: 'Pixel value at which the sensor saturates, if it is not the full scale of the file.' }),
    drawn('mask', 'Mask', under('polarized', 'mask') ?? 'none: the whole image is the object', 'mask'),
    text('optics', 'Refractive index', 'optics', 'refractive_index', { kind: typeof index === 'string' ? 'text' : 'number', placeholder: '1.5', help: 'About 1.5 for stone, glaze, varnish, glass and most plastics.' }),
    choice('optics', 'Reflection', under('optics', 'reflection') ?? 'auto', [['auto', 'decided for each region'], ['diffuse', 'diffuse (matte)'], ['specular', 'specular (glossy)']], setReflection, 'Regions can be painted under Draw.'),
    metalChoice());
}

// What bare metal the object is. A file can also state a refractive index, as a list or a text.
function metalChoice() {
  const metal = under('optics', 'metal') ?? 'auto';
  const names = ['silver', 'gold', 'copper', 'bronze', 'brass', 'iron', 'lead', 'tin', 'aluminum'];
  return choice('optics', 'Bare metal', Array.isArray(metal) ? `${metal[0]}+${metal[1]}i` : metal,
    [['auto', 'found by the images'], ['none', 'no'], ...names.map((name) => [name, name])],
    (value) => set([{ table: 'optics', key: 'metal', value }]), 'Whether the whole object is bare metal, without lacquer, paint or thick patina.');
}

const PRIORS = { cloud: 'point cloud', mesh: 'mesh', depth: 'depth map' };
const SHAPES = ['plane', 'sphere', 'cylinder'];

function surfaceGroup() {
  const path = (table, key) => (value) => set([{ table, key, value: value || null, is_path: true }]);
  const paths = (list) => [['', 'none'], ...list.map((name) => [name, name])];
  const kind = [...Object.keys(PRIORS), ...SHAPES].find((key) => under('prior', key));
  const isShape = SHAPES.includes(kind);
  // The standard deviation is that of the former surface. The new one comes first: a table that is empty in between loses its place.
  const setPrior = (chosen) => set([...Object.keys(PRIORS), ...SHAPES, 'sigma']
    .map((key) => ({ table: 'prior', key, value: chosen.startsWith(`${key}:`) ? chosen.slice(key.length + 1) : null, is_path: key in PRIORS }))
    .sort((one, other) => (one.value === null) - (other.value === null)));
  const withImage = (name) => set([{ table: 'camera', key: 'image', value: name || null }]);
  return group('Camera and coarse surface',
    choice('camera', 'Cameras (COLMAP model)', named(under('camera', 'colmap_model')), paths(nearestFirst(candidates.models)), path('camera', 'colmap_model'), 'A folder with cameras and images of COLMAP. Choose none if the cameras are to be computed from photographs.'),
    modelImages.length ? choice('camera', "This station's name in the model", under('camera', 'image') ?? '', [['', 'choose'], ...modelImages.map((name) => [name, name])], withImage) : null,
    choice('prior', 'Coarse surface (prior)', kind ? `${kind}:${isShape ? '' : named(under('prior', kind))}` : '', [['', 'none'], ...(isShape ? [[`${kind}:`, `${kind}, as the file states it`]] : []), ...nearestFirst(candidates.priors, ({ path }) => path).map((found) => [`${found.kind}:${found.path}`, `${found.path} (${PRIORS[found.kind]})`])], setPrior, 'From photogrammetry or a scanner, in the frame of the cameras. Choose none if it is to be computed from photographs.'),
    kind ? text('prior', 'Its standard deviation', 'prior', 'sigma', { kind: 'number', placeholder: kind === 'cloud' ? 'measured' : '1 GSD', help: `In the unit of lengths: ${isShape ? `how far the object is from the ${kind}` : kind === 'cloud' ? 'of the points about the surface' : 'of its depths; if it is not known, confidence is at most “partial”'}.` }) : null,
    choice('photos', 'Photographs from all around', named(under('photos', 'folder')), paths(nearestFirst(candidates.images)), path('photos', 'folder'), 'Only if there is no coarse surface yet: cameras and surface are then computed from the photographs.'),
    drawn('scale', 'Known distances', String((state.station.values.scale ?? []).length || 'none'), 'scale'),
    drawn('control', 'Control points', namesOf('control'), 'control'));
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
let lastCheck = Promise.resolve();
// A check reads all images. So only one runs at a time, and after several quick changes only the newest state is checked.
async function check() {
  const number = ++asked;
  byId('plan').textContent = 'Checking …';
  byId('plan').className = '';
  let said;
  try {
    await lastCheck;
    if (number !== asked) return;
    const answer = ask('check', { path: state.station.path });
    lastCheck = answer.catch(() => {});
    said = await answer;
  } catch (error) {
    if (number === asked) byId('plan').textContent = 'The station could not be checked.';
    throw error;
  }
  if (number !== asked) return;
  for (const place of document.querySelectorAll('[data-says]')) place.replaceChildren();
  for (const line of said.lines) {
    const place = document.querySelector(`[data-says="${line.field}"]`) ?? document.querySelector('[data-says="station"]');
    place.append(make('p', { class: line.severity }, `${line.severity === 'error' ? 'Wrong' : 'Please look'}: ${line.message}`));
  }
  const wrong = said.lines.filter((line) => line.severity === 'error').length;
  byId('plan').textContent = wrong ? 'The station cannot run yet; see below.'
    : `Ready: ${said.plan.width} × ${said.plan.height} px, about ${duration(said.plan.seconds)} and ${(said.plan.memory_mb / 1000).toFixed(1)} GB expected${said.lines.length ? `; ${said.lines.length} to look at` : ''}.`;
  byId('plan').className = wrong ? 'error' : said.lines.length ? 'warning' : 'good';
  byId('plan-steps').hidden = Boolean(wrong);
  byId('plan-steps').querySelector('ul').replaceChildren(...(said.plan?.does ?? []).map((line) => make('li', {}, line)));
  byId('overlay').hidden = !state.station.values.prior;
}

let view = null;
byId('show-overlay').addEventListener('click', doing(async () => {
  const note = byId('overlay-note');
  note.textContent = 'Projecting the surface into the image …';
  const mine = pictures;
  try {
    const said = await ask('overlay', { path: state.station.path });
    const points = Object.assign(new Image(), { src: said.picture });
    await points.decode();
    if (mine !== pictures) return;
    byId('overlay-stage').hidden = false;
    view ??= new ImageView(byId('overlay-stage'));
    await view.open(state.station.images[0]);
    if (mine !== pictures) return;
    view.paint = (context) => {
      context.globalAlpha = Number(byId('overlay-strength').value);
      view.inImage(context, () => {
        context.imageSmoothingEnabled = false;
        context.drawImage(points, 0, 0, points.width * said.cell, points.height * said.cell);
      });
    };
    view.redraw();
    note.textContent = `Yellow is near (${said.near}), violet is far (${said.far}). Edges and steps in the colors should coincide with those in the image.`;
  } catch (error) {
    if (mine === pictures) note.textContent = error.message;
  }
}));
byId('show-phases').addEventListener('click', doing(async () => {
  const place = byId('phases');
  place.replaceChildren(make('p', { class: 'note' }, 'Comparing the phase with the slopes of the surface …'));
  const mine = pictures;
  try {
    const said = await ask('phases', { path: state.station.path });
    if (mine !== pictures) return;
    const words = `${said.message[0].toUpperCase()}${said.message.slice(1)}.${said.suggestion ? ` To do: ${said.suggestion}${/[?.]$/.test(said.suggestion) ? '' : '.'}` : ''}`;
    place.replaceChildren(make('p', { class: said.severity }, words), make('div', { class: 'maps' },
      picture(said.measured, 'Phase as it was measured, in a circle of colors', 'Measured phase, with the present direction and zero of the scale'),
      picture(said.expected, 'Phase as the coarse surface expects it, in a circle of colors', 'Phase expected from the coarse surface if it is matte. On mirroring parts the opposite color is measured: red for blue, dark for light')));
  } catch (error) {
    if (mine === pictures) place.replaceChildren(make('p', { class: 'error' }, error.message));
  }
}));
byId('overlay-strength').addEventListener('input', () => view?.redraw());

byId('save-text').addEventListener('click', doing(async () => {
  try {
    await changing(async () => {
      const { path, digest } = typedUpon;
      const typed = fileText.value;
      const station = await tell('text', { path, digest, text: typed });
      typedUpon = { path, digest: station.digest, text: typed };
      take(station);
    });
  } catch (error) {
    if (error.status === 409) {
      error.message += '. What you have typed still stands here: reload the file to discard it, or save once more to overwrite the file.';
      typedUpon.digest = state.station.digest;
    }
    throw error;
  }
  await draw();
}));
byId('reload-text').addEventListener('click', doing(async () => { await reread(); typedUpon = null; await draw(); }));
