// The before/after picture: a range input covers it, so that pointer, touch and keyboard all move the edge.
for (const compare of document.querySelectorAll('.compare')) {
  const input = compare.querySelector('input');
  const move = () => compare.style.setProperty('--at', `${input.value}%`);
  input.addEventListener('input', move);
  move();
}
// Tables wider than the screen get the keyboard focus, so that they can be scrolled by keyboard, too.
const watch = new ResizeObserver((parts) => { for (const { target } of parts) if (target.scrollWidth > target.clientWidth) target.tabIndex = 0; else target.removeAttribute('tabindex'); });
for (const part of document.querySelectorAll('.scroll')) watch.observe(part);
