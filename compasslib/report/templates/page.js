"use strict";
// Without this script the page is whole; with it the overviews sort and everything is open on paper.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0], status = document.getElementById(table.dataset.status);
  const heads = [...table.tHead.rows[0].cells], first = [...body.rows];
  const order = new Map(first.map((row, k) => [row, k]));
  const key = (row, k) => row.cells[k].dataset.key;
  const compare = (a, b) => {
    const x = Number(a), y = Number(b);
    return Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b, "en", {numeric: true}) : x - y;
  };
  const sort = (k, down) => {
    const rows = [...first].sort((a, b) => {
      const x = key(a, k), y = key(b, k);
      if (x === undefined || y === undefined) return (x === undefined) - (y === undefined) || order.get(a) - order.get(b);
      return (down ? -1 : 1) * compare(x, y) || order.get(a) - order.get(b);
    });
    body.append(...rows);
    heads.forEach((head, i) => head.setAttribute("aria-sort", i !== k ? "none" : down ? "descending" : "ascending"));
    status.textContent = `Sorted by ${heads[k].textContent.toLowerCase()}, ${down ? "largest or last" : "smallest or first"} first.`;
  };
  heads.forEach((head, k) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => sort(k, head.getAttribute("aria-sort") === "ascending"));
  });
}
// What is folded is printed too, and folded again afterwards.
let opened = [];
addEventListener("beforeprint", () => {
  opened = [...document.querySelectorAll("details:not([open])")];
  for (const one of opened) one.open = true;
});
addEventListener("afterprint", () => { for (const one of opened) one.open = false; });
