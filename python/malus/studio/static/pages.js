// Switches between the parts of the page. studio.js registers the parts here.
import { byId, doing, say } from './api.js';

let pages = {};
let current = 'images';
let turn = 0;

// Name → { show, enter, leave }. show draws the part. enter runs before show, only when the user goes to the part. leave runs before
// another part is shown, and returns an error message or nothing.
export function setPages(all) {
  pages = all;
}

export async function showPage(name, focus = true) {
  const mine = ++turn;
  byId('main').setAttribute('aria-busy', 'true');
  const unsaved = current !== name ? await pages[current].leave?.() : '';
  if (mine !== turn) return;  // Another part has been chosen meanwhile.
  current = name;
  for (const page of Object.keys(pages)) byId(page).hidden = page !== name;
  for (const button of document.querySelectorAll('[data-page]')) {
    if (button.dataset.page === name) button.setAttribute('aria-current', 'step');
    else button.removeAttribute('aria-current');
  }
  document.title = `${byId(`${name}-title`).textContent} – Malus Studio`;
  if (focus) byId('main').focus();
  byId(name).inert = true;  // Its present content may be outdated and must not be edited until it is redrawn.
  await doing(async () => {
    await pages[name].enter?.();
    if (mine === turn) await pages[name].show();
  })();
  if (mine !== turn) return;
  byId(name).inert = false;
  byId('main').removeAttribute('aria-busy');
  if (unsaved) say(unsaved);
}

export const showAgain = () => pages[current].show();
