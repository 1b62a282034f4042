// Redraws a part of the page while the user works in it.
const CONTROLS = 'input, select, textarea, button';

const controlsOf = (place) => [...place.querySelectorAll(CONTROLS)];

// Label of a control with that of its group. It identifies the control after a redraw.
function calledOf(control) {
  const name = control.getAttribute('aria-label') ?? control.labels?.[0]?.textContent ?? control.textContent;
  return `${control.closest('fieldset')?.querySelector('legend')?.textContent ?? ''}: ${name}`;
}

const isText = (control) => control.tagName === 'TEXTAREA' || (control.tagName === 'INPUT' && !['checkbox', 'range'].includes(control.type));

// Replaces the children of `place`. The focused control keeps the focus and its typed text, because an answer may arrive while the
// user already fills in the next field. While the pointer is pressed in `place`, the replacement waits: otherwise a pressed button
// would get no click.
export function redraw(place, ...children) {
  waiting.get(place)?.done();
  waiting.delete(place);
  if (pressed && place.contains(pressed)) return new Promise((done) => { waiting.set(place, { children, done }); });
  replace(place, children);
  return Promise.resolve();
}

// The element that is being pressed, and the children to show in each place after its release. Lists to choose from (select) open by
// the press itself and do not count.
let pressed = null;
const waiting = new Map();
document.addEventListener('pointerdown', (event) => { pressed = event.target.closest('select') ? null : event.target; }, { capture: true });
const letGo = (event) => {
  if (!pressed || event.buttons) return;
  pressed = null;
  setTimeout(() => {  // The click comes after this event.
    const all = [...waiting];
    waiting.clear();
    for (const [place, { children, done }] of all) { replace(place, children); done(); }
  });
};
for (const name of ['pointerup', 'pointercancel', 'pointermove']) document.addEventListener(name, letGo, { capture: true });

function replace(place, children) {
  const before = controlsOf(place);
  const at = before.indexOf(document.activeElement);
  if (at < 0) {
    place.replaceChildren(...children);
    return;
  }
  const old = before[at];
  const called = calledOf(old);
  const typed = isText(old) && old.value !== old.defaultValue ? old.value : null;
  const marked = isText(old) ? markedIn(old) : null;
  // Browsers send a change event when a focused field is removed, as if the user had finished typing.
  old.addEventListener('change', (event) => event.stopImmediatePropagation(), { capture: true });
  place.replaceChildren(...children);
  const now = controlsOf(place);
  const same = now.find((control) => calledOf(control) === called) ?? now[at];
  same?.focus();
  if (!same || !isText(same)) return;
  if (typed !== null) goOnTyping(same, typed);
  if (marked) markAgain(same, marked);
}

// Start and end of the selection in a field. Number fields do not report these; only whether all of their text is selected is known.
function markedIn(field) {
  if (field.selectionStart !== null) return [field.selectionStart, field.selectionEnd];
  return field.value !== '' && String(document.getSelection()) === field.value ? [0, field.value.length] : null;
}

// Restores the selection, so that the next typed letter replaces it as if nothing had been redrawn.
function markAgain(field, [start, end]) {
  if (field.selectionStart !== null) field.setSelectionRange(start, end);
  else field.select();
}

// Restores typed text. Browsers send no change event for text set by a program, so it is sent here when the field is left.
function goOnTyping(field, typed) {
  field.value = typed;
  let told = false;
  field.addEventListener('change', () => { told = true; }, { once: true });
  field.addEventListener('blur', () => { if (!told && field.value !== field.defaultValue) field.dispatchEvent(new Event('change')); }, { once: true });
}
