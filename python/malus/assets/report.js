// The before/after picture: a range input lies over it, so that pointer, touch and keyboard all move the edge.
for (const compare of document.querySelectorAll('.compare')) {
  const input = compare.querySelector('input');
  const move = () => compare.style.setProperty('--at', `${input.value}%`);
  input.addEventListener('input', move);
  move();
}
