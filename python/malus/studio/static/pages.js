// Which part of the page is shown. It knows none of the parts: studio.js names them.
import { byId, doing, say } from './api.js';

let pages = {};
let current = 'images';
let turn = 0;

// Name → { show, enter, leave }: what draws the part, what is done before that when the user goes there, and what before another
// part is shown; leave returns what went wrong, or nothing.
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
  byId(name).inert = true;  // What it showed before may be outdated: nothing is changed upon that.
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
