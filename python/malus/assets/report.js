// The before/after picture: a range input lies over it, so that pointer, touch and keyboard all move the edge.
for (const compare of document.querySelectorAll('.compare')) {
  const input = compare.querySelector('input');
  const move = () => compare.style.setProperty('--at', `${input.value}%`);
  input.addEventListener('input', move);
  move();
}
// A table that is wider than the screen is scrolled by keyboard, too.
const watch = new ResizeObserver((parts) => { for (const { target } of parts) if (target.scrollWidth > target.clientWidth) target.tabIndex = 0; else target.removeAttribute('tabindex'); });
for (const part of document.querySelectorAll('.scroll')) watch.observe(part);
