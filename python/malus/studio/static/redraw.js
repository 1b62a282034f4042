// Drawing a part of the page anew while somebody works in it.
const CONTROLS = 'input, select, textarea, button';

const controlsOf = (place) => [...place.querySelectorAll(CONTROLS)];

// What a control is called, with its group: by that it is found again.
function calledOf(control) {
  const name = control.getAttribute('aria-label') ?? control.labels?.[0]?.textContent ?? control.textContent;
  return `${control.closest('fieldset')?.querySelector('legend')?.textContent ?? ''}: ${name}`;
}

const isText = (control) => control.tagName === 'INPUT' && !['checkbox', 'range'].includes(control.type);

// Replaces what a place shows. The control that has the keyboard keeps it, and what is being typed stays: an answer may arrive
// while somebody already fills in the next field. Nor is a button replaced that is pressed: it would never be released.
export function redraw(place, ...children) {
  waiting.get(place)?.done();
  waiting.delete(place);
  if (pressed && place.contains(pressed)) return new Promise((done) => { waiting.set(place, { children, done }); });
  replace(place, children);
  return Promise.resolve();
}

// What the pointer presses, and what is to be shown in a place when it is released. Choices open by the press itself.
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
  // Browsers take its removal for the end of typing.
  old.addEventListener('change', (event) => event.stopImmediatePropagation(), { capture: true });
  place.replaceChildren(...children);
  const now = controlsOf(place);
  const same = now.find((control) => calledOf(control) === called) ?? now[at];
  same?.focus();
  if (!same || !isText(same)) return;
  if (typed !== null) goOnTyping(same, typed);
  if (marked) markAgain(same, marked);
}

// Where what is marked in a field begins and ends. Fields of numbers do not tell, but whether it is all of them.
function markedIn(field) {
  if (field.selectionStart !== null) return [field.selectionStart, field.selectionEnd];
  return field.value !== '' && String(document.getSelection()) === field.value ? [0, field.value.length] : null;
}

// What was marked stays marked: what is typed next replaces it, as if nothing had been drawn.
function markAgain(field, [start, end]) {
  if (field.selectionStart !== null) field.setSelectionRange(start, end);
  else field.select();
}

// What a program puts into a field does not count as a change by the user: that is told when the field is left.
function goOnTyping(field, typed) {
  field.value = typed;
  let told = false;
  field.addEventListener('change', () => { told = true; }, { once: true });
  field.addEventListener('blur', () => { if (!told && field.value !== field.defaultValue) field.dispatchEvent(new Event('change')); }, { once: true });
}
