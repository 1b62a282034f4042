// Requests to Studio's server, and small helpers for building the page.
const pageToken = document.querySelector('meta[name="malus-page"]').content;

async function answerOf(response) {
  const type = response.headers.get('Content-Type') || '';
  if (response.ok) return type.includes('json') ? response.json() : response.blob();
  const said = type.includes('json') ? await response.json() : { error: await response.text() };
  throw Object.assign(new Error(said.error), { status: response.status });
}

const reach = async (address, options) => {
  let response;
  try {
    response = await fetch(address, options);
  } catch {
    throw new Error('Malus Studio does not answer; it may have been closed. If so, the runs that it had started have stopped, too.');
  }
  return answerOf(response);
};

export const addressOf = (name, query = {}) => `/api/${name}?${new URLSearchParams(query)}`;
export const ask = (name, query) => reach(addressOf(name, query));
export const tell = (name, body) => reach(`/api/${name}`, { method: 'POST', headers: { 'X-Malus-Page': pageToken }, body: JSON.stringify(body) });
export const send = (method, name, query, body) => reach(addressOf(name, query), { method, headers: { 'X-Malus-Page': pageToken }, body });

// An element with attributes (functions become listeners) and children.
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === 'function') element.addEventListener(key, value);
    else if (value === true) element.setAttribute(key, '');
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export const picture = (src, alt, caption) => make('figure', {}, make('img', { src, alt }), make('figcaption', {}, caption));

export const byId = (id) => document.getElementById(id);
const message = byId('message');
export const say = (text) => { message.textContent = text || ''; };

// Wraps a listener: errors are shown in the message line, after earlier messages were cleared.
export const doing = (work) => async (event) => {
  event?.preventDefault?.();
  say('');
  try {
    return await work(event);
  } catch (error) {
    say(error.message);
  }
};

// Wraps a listener: calls are ignored while an earlier call is still running, because a button may be pressed twice.
export const once = (work) => {
  let busy = false;
  return async (event) => {
    if (busy) return undefined;
    busy = true;
    try {
      return await work(event);
    } finally {
      busy = false;
    }
  };
};

// The number in a field; null for an empty field that may be empty. If the field holds no number, its earlier value is restored
// and an error is thrown.
export function numberIn(field, mayBeEmpty = false) {
  if (field.value.trim() !== '') return Number(field.value);
  if (mayBeEmpty && !field.validity.badInput) return null;
  field.value = field.defaultValue;
  throw new Error(`Expected a number; it stays ${field.value || 'empty'}.`);
}

const METERS = { um: 1e-6, mm: 1e-3, cm: 1e-2, m: 1, in: 0.0254, ft: 0.3048 };
// A length of the station's unit in µm, mm or m, whichever gives a short number.
export function length(value, unit, digits = 2) {
  if (value === null || value === undefined) return '–';
  const meters = value * METERS[unit];
  const [factor, name] = [[1e6, 'µm'], [1e3, 'mm'], [1, 'm']].find(([f]) => Math.abs(meters) * f < 1000) ?? [1, 'm'];
  const shown = meters * factor;
  return `${Math.abs(shown) < 10 ** digits ? Number(shown.toPrecision(digits)) : shown.toFixed(0)} ${name}`;
}

export const duration = (seconds) => seconds === null ? '' : seconds < 90 ? `${Math.max(5, 5 * Math.round(seconds / 5))} s`
  : seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
