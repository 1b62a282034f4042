// Drawing on the image: the object's mask, labels of reflection, flat patches, profiles, the ends of known distances, and control points.
import { ask, byId, doing, make, numberIn, say, send, tell } from './api.js';
import { LABELS, Layer } from './layer.js';
import { change, changing, redo, state, take, undo } from './open_station.js';
import { redraw } from './redraw.js';
import { ImageView } from './view.js';

const stage = byId('draw-stage');
const what = byId('draw-what');
const image = byId('draw-image');
let view = null;
let layer = null;
const unsaved = new Map();  // Painted layers that could not be saved yet, by nameOfLayer().
let shown = { image: null, what: null, station: null, seen: null };
let tool = 'move';
let label = null;
let width = 24;
let tolerance = 18;
let points = [];      // corners of the shape or stroke that is being drawn, in image pixels
let cursor = null;    // crosshair moved by keyboard, in image pixels
let pressed = false;
let end = { distance: 0, name: 'a' };
let point = 0;        // index of the control point that is being marked
let examined = { lines: [], fits: {}, problem: '' };  // last answer of the server on the known distances or control points

const painted = () => what.value in LABELS;
const TOOLS = {
  paint: [['move', 'Move'], ['brush', 'Brush'], ['erase', 'Erase'], ['polygon', 'Polygon'], ['similar', 'Similar color']],
  patch: [['move', 'Move'], ['box', 'Draw a box']], profile: [['move', 'Move'], ['line', 'Draw a line']], scale: [['move', 'Move'], ['mark', 'Set the mark']], control: [['move', 'Move'], ['mark', 'Set the mark']],
};

// Runs tasks one after another. Otherwise two quick choices could combine the image of one with the layer of the other.
let showing = Promise.resolve();
const inTurn = (work) => { showing = showing.catch(() => {}).then(work); return showing; };

// Disables drawing until all such tasks have ended, because they may replace the layer. The keyboard focus is restored afterwards.
let awaited = 0;
let focused = null;
async function resting(work) {
  const drawn = [byId('tools'), stage, byId('draw-side')];
  if (!awaited) focused = document.activeElement;
  awaited += 1;
  for (const part of drawn) part.inert = true;
  try {
    return await work();
  } finally {
    awaited -= 1;
    if (!awaited) {
      for (const part of drawn) part.inert = false;
      if (document.activeElement === document.body) focused.focus({ preventScroll: true });
    }
  }
}

export const showDrawing = () => resting(() => inTurn(showChoice));

async function showChoice() {
  view ??= makeView();
  const list = await imagesOf(what.value);
  const known = [...image.options].map((option) => option.value);
  if (known.length !== list.length || known.some((path, at) => path !== list[at])) image.replaceChildren(...list.map((path) => make('option', { value: path, selected: path === shown.image }, path)));
  for (const part of [image.parentElement, byId('tools'), byId('draw-stage')]) part.hidden = !list.length;
  byId('tools').replaceChildren();
  byId('draw-side').replaceChildren();
  if (list.length) await showImage();
  else byId('draw-side').replaceChildren(make('p', { class: 'note' }, what.value === 'scale' ? 'Known distances are marked in photographs. There are none yet: under Station, choose their folder or a COLMAP model with their cameras.' : state.station.error ?? 'The station has no image that can be shown.'));
}

// What marks call a photograph, by its path: below the photographs' folder, or in the COLMAP model, it may lie in a folder of its own.
let nameOfPhoto = new Map();

// Images to draw on. Known distances are marked in photographs. Control points are marked in the polarized image and in
// photographs; if there is a prior, in the polarized image only.
async function imagesOf(kind) {
  if (kind !== 'scale' && kind !== 'control') return state.station.images;
  if (kind === 'control' && state.station.values.prior) return state.station.images.slice(0, 1);
  const found = await ask('photos', { path: state.station.path });
  nameOfPhoto = new Map(found.map((photo) => [photo.path, photo.image]));
  const photos = [...nameOfPhoto.keys()];
  return kind === 'scale' ? photos : [...state.station.images.slice(0, 1), ...photos.filter((path) => !state.station.images.includes(path))];
}

// Patches and profiles count in the pixels of the results, which have no distortion; all else in those of the image as taken.
const lens = () => what.value === 'patch' || what.value === 'profile' ? state.station.lens : null;

const nameOfLayer = () => `${shown.what} of ${shown.station}`;

// Saves the painted layer before something else is shown, unless nothing is painted. If saving fails, the layer is kept in this page
// until it is saved, and the error message is returned.
async function saveBefore() {
  if (!layer?.changed || shown.station !== state.station.path || !layer.box(0)) return '';
  try {
    await saveLayer();
    return '';
  } catch (error) {
    unsaved.set(nameOfLayer(), layer);
    return `Your drawing could not be saved; it is kept under Draw. ${error.message}`;
  }
}

// Waits for running tasks first, because their results belong to the layer.
export const leaveDrawing = () => inTurn(saveBefore);

window.addEventListener('beforeunload', (event) => { if (layer?.changed || unsaved.size) event.preventDefault(); });

async function showImage() {
  if (shown.what !== what.value) {
    say(await saveBefore());
    byId('draw-state').textContent = '';
  }
  const seen = JSON.stringify([image.value, lens()]);
  if (shown.seen !== seen) {
    await view.open(image.value, lens());
    cursor = null;
  }
  const fresh = shown.what !== what.value || shown.station !== state.station.path || isOutdated();
  shown = { image: image.value, what: what.value, station: state.station.path, seen };
  if (fresh) {
    points = [];
    tool = 'move';
    layer = painted() ? await loadLayer() : null;
    label = painted() ? LABELS[what.value][0] : null;
  }
  await examine();
  drawTools();
  drawSide();
  view.redraw();
}

// Asks the server where the point or end that is being marked lies in this photo according to its marks in other photos, and how well
// all marks fit.
let questions = 0;
async function examine() {
  const mine = ++questions;
  const said = await examination();
  if (said && mine === questions) examined = said;  // Otherwise a newer request is under way.
}

async function examination() {
  if (what.value === 'scale') return tell('marks', { path: state.station.path, image: here(), distance: end.distance, end: end.name });
  if (what.value === 'control') return tell('control', { path: state.station.path, image: polarized() ? '' : here(), name: entries('control')[point] ? nameOf(entries('control')[point], point) : '' });
  return null;
}

const painting = () => state.station.painted[what.value];
const digestOf = (file) => file?.digest ?? '';
const fits = (one) => one.canvas.width === view.size.x && one.canvas.height === view.size.y;
// Whether the layer must be loaded again: its size differs from the image, or its file has changed and the user has not painted on it.
const isOutdated = () => Boolean(layer && painted()) && (!fits(layer) || (!layer.changed && layer.known !== digestOf(painting())));

async function loadLayer() {
  const kept = unsaved.get(nameOfLayer());
  if (kept && fits(kept)) return kept;
  const loaded = new Layer(view.size.x, view.size.y, what.value);
  loaded.known = digestOf(painting());  // The state of the file that the layer starts from. Saving overwrites no other state.
  if (loaded.known) await loaded.load(await ask('mask', { path: painting().path, kind: what.value }), { remember: false });
  return loaded;
}

// ---- tools ----

function button(text, onClick, attributes = {}) {
  return make('button', { type: 'button', click: doing(async () => { await onClick(); view.redraw(); }), ...attributes }, text);
}

function drawTools() {
  const tools = TOOLS[painted() ? 'paint' : what.value].map(([name, text]) => button(text, () => { tool = name; points = []; drawTools(); }, { 'aria-pressed': String(tool === name), 'data-tool': name }));
  const extra = [button('−', () => view.zoom(1 / 1.5), { 'aria-label': 'Zoom out' }), button('+', () => view.zoom(1.5), { 'aria-label': 'Zoom in' })];
  if (painted()) {
    const number = (text, value, low, high, set) => make('label', {}, `${text} `, make('input', { type: 'number', min: low, max: high, value, change: doing((event) => set(numberIn(event.target))) }));
    if (LABELS[what.value].length > 1) {
      extra.unshift(make('label', {}, 'label ', make('select', { change: (event) => { label = LABELS[what.value][event.target.selectedIndex]; } }, ...LABELS[what.value].map((kind) => make('option', { selected: kind === label }, kind.name)))));
    }
    extra.unshift(number('width [px]', width, 1, 2000, (value) => { width = value; }), number('tolerance', tolerance, 0, 255, (value) => { tolerance = value; }));
    extra.push(button('Undo', () => layer.undo()), button('Redo', () => layer.redo()), button('Clear', () => layer.edit(layer.whole, (context) => context.clearRect(...layer.whole))));
    if (what.value === 'mask') {
      extra.push(button('Find the edge', () => resting(() => inTurn(cutOut)), { title: 'GrabCut: finds the edge of what is roughly painted' }), button("Coarse surface's outline", () => resting(() => inTurn(outline))),
        button('Invert', invert));
    }
    if (inConflict()) extra.push(button('Keep mine', keepMine, { class: 'main' }), button("Take the file's", takeTheirs));
    else extra.push(button('Save', saveLayer, { class: 'main' }));
  }
  redraw(byId('tools'), ...tools, ...extra);
}

function invert() {
  layer.edit(layer.whole, (context) => {
    context.globalCompositeOperation = 'xor';
    context.fillStyle = `rgb(${label.color})`;
    context.fillRect(...layer.whole);
  });
}

// GrabCut with these hints: painted pixels are probably the object (3), pixels near their box probably background (2), all others
// background (0).
async function cutOut() {
  const near = layer.box(0.12);
  if (!near) throw new Error('Paint roughly over the object first; the edge is then found around it.');
  byId('draw-state').textContent = 'Finding the edge …';
  const hints = await layer.png((kind, x, y) => kind ? 3 : x > near[0] && y > near[1] && x < near[2] && y < near[3] ? 2 : 0);
  let said = '';
  try {
    await layer.load(await send('POST', 'cut', { image: image.value }, hints));
    said = 'The edge was found by color. Correct it with brush and eraser, or find it again.';
  } finally {
    byId('draw-state').textContent = said;
  }
}

async function outline() {
  byId('draw-state').textContent = 'Projecting the coarse surface …';
  await layer.load(await ask('outline', { path: state.station.path }));
  byId('draw-state').textContent = 'The mask is now the area that the coarse surface covers.';
}

async function similar([u, v]) {
  const [asked, kind] = [layer, label];
  const found = await tell('similar', { image: shown.image, u: Math.round(u), v: Math.round(v), tolerance });
  await asked.load(found, { add: true, as: kind });
}

async function saveLayer() {
  if (!layer.box(0)) throw new Error('Nothing is painted; a mask without an object cannot be saved.');
  byId('draw-state').textContent = 'Saving …';
  const [saving, place, edits] = [layer, { ...shown }, layer.edits];
  const values = await saving.png();
  const put = () => changing(async () => {
    const station = await send('PUT', 'mask', { path: place.station, kind: place.what, digest: state.station.digest, painted: saving.known }, values);
    saving.known = digestOf(station.painted[place.what]);
    saving.saved = edits;
    take(station);
  });
  try {
    await put();
  } catch (error) {
    if (error.status !== 409) throw error;
    const other = state.station.painted[place.what];
    if (digestOf(other) !== saving.known) {
      if (saving === layer) drawTools();
      byId('draw-state').textContent = '';
      throw new Error(`${other?.path ?? `What ${place.station} names`} was changed by another program or page since it was shown here. Keep what you have drawn, or what is in the file?`);
    }
    await put();  // Only other parts of the station file were changed. The file has been read again by now.
  }
  unsaved.delete(`${place.what} of ${place.station}`);
  if (saving === layer) drawTools();
  byId('draw-state').textContent = `Saved, and named in ${place.station}.`;
}

const inConflict = () => layer.changed && layer.known !== digestOf(painting());

async function keepMine() {
  layer.known = digestOf(painting());
  await saveLayer();
}

async function takeTheirs() {
  unsaved.delete(nameOfLayer());
  layer.saved = layer.edits;
  layer = await loadLayer();
  drawTools();
}

// The `count` numbers in a field. Otherwise the earlier text is restored and an error is thrown.
function numbersIn(field, count) {
  const numbers = field.value.trim().split(/[,;\s]+/).map((part) => part === '' ? NaN : Number(part));
  if (numbers.length === count && numbers.every(Number.isFinite)) return numbers;
  const wrong = field.value;
  field.value = field.defaultValue;
  throw new Error(`“${wrong}” is not ${count} numbers; it stays ${field.value}.`);
}

const boxOf = (list, margin) => [Math.min(...list.map((p) => p[0])) - margin, Math.min(...list.map((p) => p[1])) - margin, Math.max(...list.map((p) => p[0])) + margin + 1, Math.max(...list.map((p) => p[1])) + margin + 1];

// (0, 0) is the corner of the layer's canvas, but the center of the first pixel for `points`.
function trace(context, list) {
  context.beginPath();
  list.forEach(([u, v], index) => context[index ? 'lineTo' : 'moveTo'](u + 0.5, v + 0.5));
}

function stroke(context, color) {
  trace(context, points.length > 1 ? points : [points[0], points[0]]);
  context.lineWidth = width;
  context.lineCap = context.lineJoin = 'round';
  context.strokeStyle = color;
  context.stroke();
}

function endPolygon() {
  if (points.length > 2) {
    layer.edit(boxOf(points, 1), (context) => {
      trace(context, points);
      context.fillStyle = `rgb(${label.color})`;
      context.fill();
    });
  }
  points = [];
}

// ---- pointer and keyboard: press, move, release; positions in image pixels ----

async function press(at) {
  if (tool === 'polygon') {
    const first = points.length > 2 ? view.toStage(points[0]) : null;
    const here = view.toStage(at);
    if (first && Math.hypot(first[0] - here[0], first[1] - here[1]) < 10) endPolygon();
    else points.push(at);
  } else if (tool === 'similar') await inTurn(() => similar(at));
  else if (tool === 'mark') await (what.value === 'scale' ? setEnd(at) : setPoint(at));
  else if (tool !== 'move') { points = [at, at]; pressed = true; }
}

function move(at) {
  if (!pressed) return;
  if (tool === 'brush' || tool === 'erase') points.push(at);
  else points[1] = at;
}

async function release() {
  if (!pressed) return;
  pressed = false;
  const drawn = points;
  if (tool === 'brush' || tool === 'erase') {
    layer.edit(boxOf(points, width / 2 + 1), (context) => {
      if (tool === 'erase') context.globalCompositeOperation = 'destination-out';
      stroke(context, `rgb(${label.color})`);
    });
  }
  points = [];
  if (tool === 'box' || tool === 'line') await addShape(drawn);
}

function makeView() {
  const made = new ImageView(stage);
  const viewer = made.viewer;
  const act = (work) => doing(async (event) => { await work(made.toImage(event.position)); made.redraw(); });
  viewer.addHandler('canvas-press', act(press));
  viewer.addHandler('canvas-drag', (event) => {
    if (tool === 'move' || tool === 'polygon') return;
    event.preventDefaultAction = true;
    move(made.toImage(event.position));
    made.redraw();
  });
  viewer.addHandler('canvas-release', doing(async () => { await release(); made.redraw(); }));
  viewer.addHandler('canvas-double-click', () => { if (tool === 'polygon') { endPolygon(); made.redraw(); } });
  made.paint = paint;
  return made;
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const onKey = doing(async (event) => {
  cursor ??= [Math.round(view.size.x / 2), Math.round(view.size.y / 2)];
  if (event.key in ARROWS) {
    const step = event.shiftKey ? 1 : Math.max(1, Math.round(view.size.x / 60));
    cursor = cursor.map((value, axis) => Math.min(Math.max(value + step * ARROWS[event.key][axis], 0), (axis ? view.size.y : view.size.x) - 1));
    move(cursor);
  } else if (event.key === 'Enter') await (pressed ? release() : press(cursor));
  else if (event.key === 'Escape') { if (tool === 'polygon') endPolygon(); points = []; pressed = false; }
  else if (event.key === '+') view.zoom(1.5);
  else if (event.key === '-') view.zoom(1 / 1.5);
  else if (event.key === 'z') await (layer ? layer.undo() : undo());
  else if (event.key === 'y') await (layer ? layer.redo() : redo());
  byId('draw-state').textContent = `Crosshair at ${cursor[0]}, ${cursor[1]}${pressed ? ', pressed' : ''}`;
  view.redraw();
});
// All other keys keep their meaning in the browser: Tab moves the focus, Ctrl and + enlarges the page.
stage.addEventListener('keydown', (event) => {
  const known = event.ctrlKey || event.metaKey ? ['z', 'y'] : [...Object.keys(ARROWS), 'Enter', 'Escape', '+', '-'];
  if (view?.size && event.target === stage && known.includes(event.key)) onKey(event);
});

// ---- overlay on the image ----

function paint(context) {
  if (layer) {
    context.globalAlpha = 0.45;
    view.inImage(context, () => { context.imageSmoothingEnabled = false; context.drawImage(layer.canvas, 0, 0); });
    context.globalAlpha = 1;
    if (points.length && tool === 'brush') view.inImage(context, () => stroke(context, `rgba(${label.color}, 0.6)`));
    if (points.length && tool === 'erase') view.inImage(context, () => stroke(context, 'rgba(255, 255, 255, 0.5)'));
    if (points.length && tool === 'polygon') outlined(context, points.map((p) => view.toStage(p)), true);
  }
  for (const entry of state.station?.values.patch ?? []) if (what.value === 'patch') outlined(context, corners(entry.box), true, entry.name);
  for (const entry of state.station?.values.profile ?? []) if (what.value === 'profile') outlined(context, [entry.from, entry.to].map((p) => view.toStage(p)), false, entry.name);
  if (what.value === 'scale' || what.value === 'control') for (const line of examined.lines) if (line.length > 1) outlined(context, line.map((p) => view.toStage(p)), false);
  if (what.value === 'scale' || what.value === 'control') for (const [text, at] of what.value === 'scale' ? marksHere() : pointsHere()) cross(context, view.toStage(at), text);
  if (tool === 'box' && points.length) outlined(context, corners([...points[0], ...points[1]]), true);
  if (tool === 'line' && points.length) outlined(context, points.map((p) => view.toStage(p)), false);
  if (cursor) cross(context, view.toStage(cursor), '');
}

const corners = ([x0, y0, x1, y1]) => [[x0 - 0.5, y0 - 0.5], [x1 + 0.5, y0 - 0.5], [x1 + 0.5, y1 + 0.5], [x0 - 0.5, y1 + 0.5]].map((p) => view.toStage(p));

// Draws a path in red on white, which is seen on any image.
function redOnWhite(context, thick, path) {
  for (const [color, lineWidth] of [['#fff', 4], ['#c22f43', thick]]) {
    context.beginPath();
    path();
    context.strokeStyle = color;
    context.lineWidth = lineWidth;
    context.stroke();
  }
}

function outlined(context, list, closed, text) {
  redOnWhite(context, 2, () => {
    list.forEach(([x, y], index) => context[index ? 'lineTo' : 'moveTo'](x, y));
    if (closed) context.closePath();
  });
  if (text) written(context, text, list[0]);
}

function written(context, text, [x, y]) {
  context.font = '600 14px system-ui, sans-serif';
  context.fillStyle = '#c22f43';
  context.fillRect(x + 4, y + 4, context.measureText(text).width + 10, 20);
  context.fillStyle = '#fff';
  context.fillText(text, x + 9, y + 19);
}

function cross(context, [x, y], text) {
  redOnWhite(context, 1.5, () => {
    for (const [dx, dy] of [[10, 0], [0, 10]]) { context.moveTo(x - dx, y - dy); context.lineTo(x + dx, y + dy); }
  });
  if (text) written(context, text, [x, y]);
}

// ---- lists beside the image: patches, profiles, distances ----

// Each list with all changes made so far, including those that the server has not yet confirmed.
const drafts = new Map();
function entries(list) {
  let draft = drafts.get(list);
  if (!draft || (!draft.awaited && draft.station !== state.station)) {
    draft = { station: state.station, all: structuredClone(state.station.values[list] ?? []), awaited: 0 };
    drafts.set(list, draft);
  }
  return draft.all;
}

// Sends changed entries to the server. Throws if the list was replaced meanwhile, so that `all` belongs to an outdated list.
async function store(list, all) {
  if (entries(list) !== all) throw new Error('The list has changed meanwhile; please make your last change once more.');
  const draft = drafts.get(list);
  draft.awaited += 1;
  try {
    await change([{ list, entries: all }]);
    draft.station = state.station;
  } catch (error) {
    if (drafts.get(list) === draft) drafts.delete(list);
    if (what.value === list) drawSide();
    throw error;
  } finally {
    draft.awaited -= 1;
  }
  if (what.value !== list) return;  // Another list or layer is shown by now.
  await examine();
  drawSide();
  view.redraw();
}

function remove(list, all, entry) {
  const at = all.indexOf(entry);
  if (at < 0) return undefined;  // The button was pressed twice.
  all.splice(at, 1);
  const marked = list === 'scale' ? end.distance : point;
  if (tool === 'mark' && at === marked) {  // Otherwise the next entry would be marked.
    tool = 'move';
    drawTools();
  }
  if (at < marked && list === 'scale') end.distance -= 1;
  if (at < marked && list === 'control') point -= 1;
  return store(list, all);
}

async function addShape([[u0, v0], [u1, v1]]) {
  if (Math.hypot(u1 - u0, v1 - v0) < 2) return;
  const list = what.value;
  const all = entries(list);
  const round = [u0, v0, u1, v1].map((value, at) => Math.min(Math.max(Math.round(value), 0), (at % 2 ? view.size.y : view.size.x) - 1));
  const names = new Set(all.map((entry) => entry.name));
  let name = all.length + 1;
  while (names.has(String(name))) name += 1;
  all.push(list === 'patch' ? { name: String(name), box: [Math.min(round[0], round[2]), Math.min(round[1], round[3]), Math.max(round[0], round[2]), Math.max(round[1], round[3])] }
    : { name: String(name), from: round.slice(0, 2), to: round.slice(2) });
  await store(list, all);
}

function drawSide() {
  const side = byId('draw-side');
  if (painted()) redraw(side, make('p', { class: 'note' }, what.value === 'mask'
    ? 'Paint the object. “Find the edge” searches its outline around the painted area; “Similar color” adds connected pixels of similar color.' : 'Blue: diffuse. Orange: specular. Malus decides for all unpainted pixels.'));
  else if (what.value === 'scale') redraw(side, ...scaleSide());
  else if (what.value === 'control') redraw(side, ...controlSide());
  else redraw(side, ...shapeSide(what.value));
}

function shapeSide(list) {
  const all = entries(list);
  const keys = list === 'patch' ? ['box'] : ['from', 'to'];
  const row = (entry, at) => make('fieldset', {}, make('legend', {}, `${list} ${entry.name ?? at + 1}`),
    make('label', {}, 'name ', make('input', { value: entry.name ?? '', change: doing((event) => { entry.name = event.target.value || undefined; return store(list, all); }) })),
    ...keys.map((key) => make('label', {}, `${key} [px] `, make('input', { value: entry[key].join(', '), change: doing((event) => { entry[key] = numbersIn(event.target, entry[key].length); return store(list, all); }) }))),
    button('Remove', () => remove(list, all, entry)));
  return [...whereItCounts(), ...all.map(row), button(`Add one by numbers`, () => addShape([[0.4 * view.size.x, 0.4 * view.size.y], [0.6 * view.size.x, 0.6 * view.size.y]]))];
}

function whereItCounts() {
  if (lens()) return [make('p', { class: 'note' }, 'The image is shown without the distortion of the lens, as the results are: patches and profiles count in their pixels.')];
  return state.station.lens_known ? [] : [make('p', { class: 'note' }, 'The lens is not known here. If it distorts, what is drawn here lies beside its place in the results, which have no distortion; a profile that is picked on a result lies right.')];
}

const here = () => nameOfPhoto.get(image.value) ?? image.value.split('/').pop();
const marksHere = () => entries('scale').flatMap((entry, at) => ['a', 'b'].flatMap((name) => (entry[name] ?? []).filter((mark) => mark.image === here()).map((mark) => [`${at + 1}${name}`, [mark.x, mark.y]])));

const unit = () => state.station.values.station?.unit ?? 'mm';
const rounded = (value) => Math.round(10 * value) / 10;

// The marks of a point or end, with the one in this photo at another place.
const marksWith = (marks, [x, y]) => [...(marks ?? []).filter((mark) => mark.image !== here()), { image: here(), x: rounded(x), y: rounded(y) }];

async function setEnd(at) {
  const all = entries('scale');
  const entry = all[end.distance];
  if (!entry) throw new Error('Add a known distance first, and choose which of its ends is marked.');
  entry[end.name] = marksWith(entry[end.name], at);
  await store('scale', all);
}

function scaleSide() {
  const all = entries('scale');
  const row = (entry, at) => make('fieldset', {}, make('legend', {}, `distance ${at + 1}`),
    make('label', {}, `length [${unit()}] `, make('input', { type: 'number', step: 'any', value: entry.distance, change: doing((event) => { entry.distance = numberIn(event.target); return store('scale', all); }) })),
    ...['a', 'b'].map((name) => make('p', {}, button(`Mark end ${name}`, async () => { end = { distance: at, name }; tool = 'mark'; await examine(); drawTools(); drawSide(); stage.focus(); }, { 'aria-pressed': String(tool === 'mark' && end.distance === at && end.name === name) }),
      ` in ${(entry[name] ?? []).length} photos: ${(entry[name] ?? []).map((mark) => mark.image).join(', ') || 'none yet, two or more are needed'}`)),
    at === end.distance ? offTheLines() : null, fitOf(at),
    button('Remove', () => remove('scale', all, entry)));
  return [make('p', { class: 'note' }, examined.problem || 'Red lines: positions of the end that fit its marks in the other photos.'), ...all.map(row), button('Add a known distance', () => { all.push({ distance: 100, a: [], b: [] }); return store('scale', all); })];
}

// Distance of the mark in this photo from the epipolar lines of the marks in the other photos.
function offTheLines() {
  const mark = (entries('scale')[end.distance]?.[end.name] ?? []).find((one) => one.image === here());
  const away = mark ? examined.lines.filter((line) => line.length > 1).map((line) => Math.min(...line.slice(1).map((to, at) => distanceTo(line[at], to, [mark.x, mark.y])))) : [];
  if (!away.length) return null;
  const worst = Math.max(...away);
  return make('p', { class: worst > 3 ? 'warning' : 'note' }, `End ${end.name} lies ${worst.toFixed(1)} px from ${away.length > 1 ? 'the farthest of its lines' : 'its line'} in this photo.`);
}

function distanceTo([x0, y0], [x1, y1], [x, y]) {
  const [dx, dy] = [x1 - x0, y1 - y0];
  const share = Math.min(Math.max(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1), 0), 1);
  return Math.hypot(x - x0 - share * dx, y - y0 - share * dy);
}

function fitOf(at) {
  const fit = examined.fits[at + 1];
  if (!fit) return null;
  return make('p', { class: fit.worst_px > 2 ? 'warning' : 'note' }, `Marks fit to ${fit.rms_px.toFixed(2)} px (worst ${fit.worst_px.toFixed(2)} px in ${fit.worst_image}); the length is off by ${fit.residual.toPrecision(2)}.`);
}

// ---- control points ----

const polarized = () => state.station.images.includes(image.value);
const markOf = (entry) => polarized() ? entry.pixel : (entry.marks ?? []).filter((mark) => mark.image === here()).map((mark) => [mark.x, mark.y])[0];
// A point without a name is named by its number, as in the station reader.
const nameOf = (entry, at) => entry.name ?? String(at + 1);
const pointsHere = () => entries('control').flatMap((entry, at) => markOf(entry) ? [[nameOf(entry, at), markOf(entry)]] : []);

async function setPoint(at) {
  const all = entries('control');
  const entry = all[point];
  if (!entry) throw new Error('Add a control point first, and choose which one is marked.');
  if (polarized()) entry.pixel = at.map(rounded);
  else entry.marks = marksWith(entry.marks, at);
  await store('control', all);
}

// Reads lines "name X Y Z", as instruments and spreadsheets write them. A known name gets new coordinates.
async function takeCoordinates(text) {
  const read = text.split('\n').map((row) => row.trim()).filter(Boolean).map((line) => {
    const columns = line.split(/[;\s]+/);
    const decimalCommas = columns.length > 2 && columns.some((column) => /^[-+]?\d+,\d+$/.test(column));
    const [name, ...xyz] = line.split(/[;,\s]+/);
    const numbers = xyz.map(Number);
    if (decimalCommas || numbers.length !== 3 || !numbers.every(Number.isFinite)) throw new Error(`“${line}” is not a name and three numbers X Y Z with decimal points.`);
    return { name, xyz: numbers };
  });
  const all = entries('control');
  for (const { name, xyz } of read) {
    const known = all.find((entry, at) => nameOf(entry, at) === name);
    if (known) known.xyz = xyz;
    else all.push({ name, xyz });
  }
  await store('control', all);
}

// Typed coordinates that are not taken yet. They are kept here because the list is redrawn whenever the file was written.
let coordinates = '';

async function takeTyped() {
  const text = coordinates;
  coordinates = '';
  try {
    await takeCoordinates(text);
  } catch (error) {
    coordinates = text;
    throw error;
  }
}

function controlSide() {
  const all = entries('control');
  const kept = () => store('control', all);
  const axis = (entry, at) => make('label', {}, `${'XYZ'[at]} `, make('input', { type: 'number', step: 'any', value: entry.xyz[at], change: doing((event) => { entry.xyz[at] = numberIn(event.target); return kept(); }) }));
  const row = (entry, at) => make('fieldset', {}, make('legend', {}, `point ${nameOf(entry, at)}`),
    make('label', {}, 'name ', make('input', { value: entry.name ?? '', change: doing((event) => { entry.name = event.target.value || undefined; return kept(); }) })),
    ...[0, 1, 2].map((index) => axis(entry, index)),
    make('label', {}, 'only to check ', make('input', { type: 'checkbox', checked: entry.check ?? false, change: doing((event) => { entry.check = event.target.checked || undefined; return kept(); }) })),
    make('p', {}, button('Mark it', async () => { point = at; tool = 'mark'; await examine(); drawTools(); drawSide(); stage.focus(); }, { 'aria-pressed': String(tool === 'mark' && point === at) }), ` ${markedIn(entry)}`),
    ...fitOfPoint(nameOf(entry, at)), button('Remove', () => remove('control', all, entry)));
  const pasted = make('textarea', { rows: 4, placeholder: 'P1 104.2 88.0 12.5', 'aria-label': 'Coordinates, a point a line: name X Y Z', input: (event) => { coordinates = event.target.value; } }, coordinates);
  return [make('p', { class: 'note' }, examined.problem || verdict()), ...all.map(row),
    make('fieldset', {}, make('legend', {}, 'add points'), pasted, button('Take these coordinates', takeTyped))];
}

function markedIn(entry) {
  const places = [...(entry.pixel ? ['the polarized image'] : []), ...(entry.marks ?? []).map((mark) => mark.image)];
  return places.length ? `in ${places.join(', ')}` : 'not marked yet';
}

const counted = (count, one, several) => `${count} ${count === 1 ? one : several}`;

function verdict() {
  const { image: seen, datum } = examined;
  const said = [];
  const accuracy = seen?.center_sigma == null ? '' : `, ± ${seen.center_sigma.toPrecision(2)} ${unit()}`;
  if (seen?.use === 'resection') said.push(`The camera's pose follows from ${counted(seen.points.filter((one) => !one.check).length, 'point', 'points')}${accuracy}.`);
  if (datum) said.push(`Coordinates fit to ${datum.sigma.toPrecision(2)} ${unit()}.`);
  for (const found of [seen, datum]) if (found?.doubtful) said.push(`Without point ${found.doubtful} the other points fit far better: is its mark right?`);
  return said.join(' ') || 'Mark each point where the image shows it.';
}

function fitOfPoint(name) {
  const seen = examined.image?.points.find((one) => one.name === name);
  const placed = examined.datum?.points.find((one) => one.name === name);
  const line = (worst, text) => make('p', { class: worst ? 'warning' : 'note' }, text);
  const found = [];
  if (seen) {
    const off = seen.du_px === null ? Infinity : Math.hypot(seen.du_px, seen.dv_px);
    found.push(line(off > 3, seen.du_px === null ? 'Lies behind the camera.' : `Off by ${off.toFixed(1)} px in the polarized image.`));
  }
  if (placed) found.push(line(placed.rms_px > 2, `Off by ${Math.hypot(...placed.offset).toPrecision(2)} ${unit()} in the photos; its marks fit to ${placed.rms_px.toFixed(2)} px.`));
  return found;
}

what.addEventListener('change', doing(() => showDrawing()));
image.addEventListener('change', doing(() => resting(() => inTurn(showImage))));
