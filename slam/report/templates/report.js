"use strict";
(() => {
  const root = document.documentElement;
  const toggle = document.getElementById("theme");
  const wanted = window.matchMedia("(prefers-color-scheme: dark)");

  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : wanted.matches);
  const nameToggle = () => { toggle.textContent = isDark() ? "Light page" : "Dark page"; };
  toggle.hidden = false;
  toggle.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    nameToggle();
  });
  wanted.addEventListener("change", nameToggle);
  nameToggle();

  const table = document.getElementById("ledger");
  if (!table) return;
  const body = table.tBodies[0];
  const rows = Array.from(body.rows);
  const headings = Array.from(table.tHead.rows[0].cells);

  // Numbers by size, words by the alphabet, what is missing always last.
  const compare = (a, b, sign) => {
    if (a === "" || b === "") return (a === "") - (b === "");
    const x = Number(a), y = Number(b);
    const order = Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b) : x - y;
    return sign * order;
  };
  const key = (row, column) => row.cells[column].dataset.order ?? row.cells[column].textContent.trim();

  const sort = (column) => {
    const descending = headings[column].getAttribute("aria-sort") === "ascending";
    headings.forEach((heading) => heading.removeAttribute("aria-sort"));
    headings[column].setAttribute("aria-sort", descending ? "descending" : "ascending");
    rows.sort((a, b) => compare(key(a, column), key(b, column), descending ? -1 : 1));
    body.append(...rows);
  };
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = heading.textContent;
    button.addEventListener("click", () => sort(column));
    heading.replaceChildren(button);
  });

  const form = document.getElementById("filters");
  const fate = document.getElementById("fate");
  const words = document.getElementById("words");
  const count = document.getElementById("count");
  const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));

  const fits = (row) => {
    if (fate.value === "proposed") return "proposed" in row.dataset;
    return fate.value === "" || row.dataset.fate === fate.value;
  };
  const filter = () => {
    const wordsNow = words.value.trim().toLowerCase();
    let shown = 0;
    for (const row of rows) {
      row.hidden = !(fits(row) && texts.get(row).includes(wordsNow));
      shown += row.hidden ? 0 : 1;
    }
    count.textContent = `${shown} of ${rows.length} rows`;
  };
  form.hidden = false;
  form.addEventListener("submit", (event) => event.preventDefault());
  fate.addEventListener("change", filter);
  words.addEventListener("input", filter);
  if (rows.some((row) => "proposed" in row.dataset)) fate.value = "proposed";
  filter();
})();
