// The most important options with their meanings and allowed values. Only values that differ from the default are written.
import { ask, byId, doing, make, tell } from './api.js';
import { state } from './open_station.js';
import { redraw } from './redraw.js';

export async function showOptions() {
  draw(await ask('options', { path: state.station.path }));
}

function draw({ options, file }) {
  byId('options-file').textContent = `Options that differ from the defaults are stored in ${file}, which every run of this station reads.`;
  redraw(byId('option-list'), ...options.map(row));
}

function row(option) {
  const id = `option-${option.name.replace('.', '-')}`;
  const says = make('p', { class: 'error', id: `${id}-wrong` });
  const changed = option.value !== option.default;
  const set = async (value) => {
    try {
      draw(await tell('option', { path: state.station.path, name: option.name, value }));
    } catch (error) {
      says.textContent = error.message;
    }
  };
  const named = namesOf(option.kind);
  const control = controlOf(option, named, { id, 'aria-describedby': `${id}-help ${id}-wrong` }, (value) => set(value === option.default ? null : value));
  return make('div', { class: `field${changed ? ' changed' : ''}` }, make('label', { for: id }, option.title),
    make('div', { class: 'row' }, control, changed ? make('button', { type: 'button', 'aria-label': `${option.title}: back to the default`, click: doing(async () => { await set(null); byId(id).focus(); }) }, 'Back to the default') : null),
    make('div', { class: 'says' }, make('p', { class: 'note', id: `${id}-help` }, make('code', {}, option.name), `: ${option.meaning.replace(/ …$/, '')}. Default: ${option.default}.${named ? '' : ` Allowed: ${option.allowed}.`}`), says));
}

// The names that an option of this kind can be; null for others.
function namesOf(kind) {
  if (kind === 'true or false') return ['true', 'false'];
  return /^("\w+"( \| )?)+$/.test(kind) ? kind.split(' | ').map((word) => word.slice(1, -1)) : null;
}

// A list to choose from if the option has named values, else a text field, whose numbers are sent as numbers.
function controlOf({ kind, value }, named, attributes, set) {
  if (named) {
    return make('select', { ...attributes, change: (event) => set(kind === 'true or false' ? event.target.value === 'true' : event.target.value) },
      ...named.map((word) => make('option', { value: word, selected: word === String(value) }, word)));
  }
  const typed = (text) => text.trim() === '' ? null : Number.isNaN(Number(text)) ? text.trim() : Number(text);
  return make('input', { ...attributes, value, change: (event) => set(typed(event.target.value)) });
}
