"use strict";
for (const element of document.querySelectorAll("[data-player]")) {
  mountPlayer(element, document.getElementById(element.dataset.player).textContent);
}
// The space bar scrolls the page, also where there is one player only; a player has it once it is clicked.
document.body.addEventListener("keydown", (event) => {
  if (event.target === document.body) event.stopPropagation();
});
