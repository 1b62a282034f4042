// The page: which part is shown, and which station is open.
import { ask, byId, doing, say, tell } from './api.js';
import { showFolder } from './images.js';
import { showStation } from './station.js';
import { showDrawing } from './draw.js';
import { showRuns } from './runs.js';
import { showResults } from './results.js';

const pages = { images: showFolder, station: showStation, draw: showDrawing, runs: showRuns, results: showResults };

// The open station as the server last said it: path, text, digest, values, images, mask, error.
export const state = { station: null };

export function showPage(name, focus = true) {
  for (const page of Object.keys(pages)) byId(page).hidden = page !== name;
  for (const button of document.querySelectorAll('[data-page]')) {
    if (button.dataset.page === name) button.setAttribute('aria-current', 'step');
    else button.removeAttribute('aria-current');
  }
  document.title = `${byId(`${name}-title`).textContent} – Malus Studio`;
  if (focus) byId('main').focus();
  return doing(() => pages[name](state))();
}

// Takes over what the server says of the open station after opening or changing it.
export function take(station) {
  state.station = station;
  byId('open-station').textContent = station.path;
  for (const page of ['station', 'draw']) document.querySelector(`[data-page="${page}"]`).disabled = false;
  return station;
}

export async function openStation(path) {
  take(await ask('station', { path }));
  await showPage('station');
}

// Changes values of the station file, one change after another; what the server then says of it is the truth.
let before = Promise.resolve();
export function change(changes) {
  const made = before.then(async () => take(await tell('set', { path: state.station.path, digest: state.station.digest, changes })));
  before = made.catch(() => {});
  return made;
}

for (const button of document.querySelectorAll('[data-page]')) button.addEventListener('click', () => { say(''); showPage(button.dataset.page); });
showPage('images', false);
