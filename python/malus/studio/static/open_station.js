// The open station: its file's content, and every change of this file.
import { ask, byId, tell } from './api.js';
import { showAgain, showPage } from './pages.js';

// The parts of the page that need an open station.
export const OF_A_STATION = ['station', 'draw', 'options'];

// The open station as the server last described it: path, text, digest, values, images, painted ({mask, labels}: path and digest), and
// error: what is wrong with its images, else with the station.
export const state = { station: null };
// Earlier and later states of its file, for undo and redo.
let past = [];
let future = [];

// Stores the server's description of the station after the station was opened or changed.
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

// Requests that open, read or change the station's file run one after another. So each answer concerns the station that is open when it
// arrives.
let before = Promise.resolve();
function inTurn(work) {
  const made = before.then(work);
  before = made.catch(() => {});
  return made;
}

// Reads the open station again. If another program or page has changed the file, this page's undo steps are dropped.
export function reread() {
  return inTurn(async () => {
    const station = await ask('station', { path: state.station.path });
    if (station.digest !== state.station.digest) [past, future] = [[], []];
    show(station);
  });
}

// Changes the station's file. If another program or page has changed the file meanwhile (409), the file is read again.
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
    throw new Error(`${error.message}. The file has been read again; please make your last change once more.`);
  }
}

// Restores the text of the file before its last change (undo) or after the change undone last (redo).
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

// Changes values of the station file. The server's answer replaces the page's state.
export const change = (changes) => changingPage(async () => take(await tell('set', { path: state.station.path, digest: state.station.digest, changes })));

// Adds a profile that was picked on a result to the open station. The result must be one of this station.
export const keepProfile = (work, ends) => changingPage(async () => take(await tell('keep', { path: state.station.path, digest: state.station.digest, work, ...ends })));
