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
// while somebody already fills in the next field.
export function redraw(place, ...children) {
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
