// The open station: what its file says, and every change of it.
import { ask, byId, tell } from './api.js';
import { showAgain, showPage } from './pages.js';

// The parts of the page that need an open station.
export const OF_A_STATION = ['station', 'draw', 'options'];

// The open station as the server last said it: path, text, digest, values, images, painted ({mask, labels}: path and digest), and what
// is wrong with its images or else with it (error).
export const state = { station: null };
// Earlier and later states of its file, for undo and redo.
let past = [];
let future = [];

// Takes over what the server says of the open station after opening or changing it.
export function take(station) {
  const before = state.station;
  if (before?.path !== station.path) [past, future] = [[], []];
  else if (before.text !== station.text) {
    past.push(before.text);
    future = [];
  }
  return show(station);
}

function show(station) {
  state.station = station;
  byId('open-station').textContent = station.path;
  byId('history').hidden = false;
  byId('undo').disabled = !past.length;
  byId('redo').disabled = !future.length;
  for (const page of OF_A_STATION) document.querySelector(`[data-page="${page}"]`).disabled = false;
  return station;
}

// What opens, reads and changes the station's file, one after another: an answer is about the station that is open when it comes.
let before = Promise.resolve();
function inTurn(work) {
  const made = before.then(work);
  before = made.catch(() => {});
  return made;
}

// Reads the open station again. What another program or page has changed is no step of this page's undo.
export function reread() {
  return inTurn(async () => {
    const station = await ask('station', { path: state.station.path });
    if (station.digest !== state.station.digest) [past, future] = [[], []];
    show(station);
  });
}

// A change of the station's file, after which it is read again if another program or page has changed it meanwhile.
export async function changing(work) {
  try {
    return await inTurn(work);
  } catch (error) {
    if (error.status === 409) await reread();
    throw error;
  }
}

async function changingPage(work) {
  try {
    return await changing(work);
  } catch (error) {
    if (error.status !== 409) throw error;
    await showAgain();
    throw new Error(`${error.message}. It has been read again; please make your last change once more.`);
  }
}

// The file as it was before its last change, or after the change that was undone last.
async function step(from, to) {
  await changingPage(async () => {
    const text = from().at(-1);
    if (text === undefined) return;
    const left = state.station.text;
    const station = await tell('text', { path: state.station.path, digest: state.station.digest, text });
    from().pop();
    to().push(left);
    show(station);
  });
  await showAgain();
}
export const undo = () => step(() => past, () => future);
export const redo = () => step(() => future, () => past);

export async function openStation(path) {
  await inTurn(async () => take(await ask('station', { path })));
  await showPage('station');
}

export async function createStation(content) {
  await inTurn(async () => take(await tell('create', content)));
  await showPage('station');
}

// Changes values of the station file; what the server then says of it is the truth.
export const change = (changes) => changingPage(async () => take(await tell('set', { path: state.station.path, digest: state.station.digest, changes })));

// Adds a profile that was picked on a result to the open station, if the result is of that.
export const keepProfile = (work, ends) => changingPage(async () => take(await tell('keep', { path: state.station.path, digest: state.station.digest, work, ...ends })));
