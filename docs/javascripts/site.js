// The theme's search is a dialog without a name for those who hear the page.
document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
// What is scrolled by a finger is scrolled by the keyboard, too: wide tables on narrow screens.
addEventListener("load", () => {
  for (const table of document.querySelectorAll(".md-typeset__scrollwrap")) table.tabIndex = 0;
});
