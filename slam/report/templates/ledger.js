// The table of loops: sorted by its headings, filtered by fate and words; its rows open by a button in their first cell.
(() => {
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
    const keys = new Map(rows.map((row) => [row, key(row, column)]));
    rows.sort((a, b) => compare(keys.get(a), keys.get(b), descending ? -1 : 1));
    body.append(...rows);
    enter(shown()[0]);
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
  const shown = () => rows.filter((row) => !row.hidden);

  const fits = (row) => {
    if (fate.value === "proposed") return "proposed" in row.dataset;
    return fate.value === "" || row.dataset.fate === fate.value;
  };
  const filter = () => {
    const wordsNow = words.value.trim().toLowerCase();
    for (const row of rows) row.hidden = !(fits(row) && texts.get(row).includes(wordsNow));
    const left = shown();
    count.textContent = `${left.length} of ${rows.length} rows`;
    enter(left[0]);
  };

  // One tab stop for all rows: arrows go from row to row.
  let entered = null;
  const button = (row) => row.querySelector(".open");
  function enter(row) {
    if (entered) button(entered).tabIndex = -1;
    entered = row;
    if (row) button(row).tabIndex = 0;
  }
  const focus = (row) => {
    if (!row) return;
    enter(row);
    button(row).focus();
  };
  for (const row of rows) {
    const open = document.createElement("button");
    open.type = "button";
    open.className = "open";
    open.tabIndex = -1;
    open.textContent = row.cells[0].textContent;
    open.setAttribute("aria-haspopup", "dialog");
    open.setAttribute("aria-label", `${open.textContent}, open its images`);
    row.cells[0].replaceChildren(open);
  }
  const steps = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -Infinity, End: Infinity };
  body.addEventListener("keydown", (event) => {
    if (!(event.key in steps) || !event.target.matches(".open")) return;
    event.preventDefault();
    const there = shown();
    const wanted = there.indexOf(event.target.closest("tr")) + steps[event.key];
    focus(there[Math.min(Math.max(wanted, 0), there.length - 1)]);
  });
  body.addEventListener("click", (event) => {
    if (window.getSelection().type === "Range") return; // someone copies words
    const row = event.target.closest("tr");
    focus(row);
    row.dispatchEvent(new CustomEvent("revisit:open", { bubbles: true, detail: { shown, focus } }));
  });

  form.hidden = false;
  form.addEventListener("submit", (event) => event.preventDefault());
  fate.addEventListener("change", filter);
  words.addEventListener("input", filter);
  if (rows.some((row) => "proposed" in row.dataset)) fate.value = "proposed";
  filter();
})();
