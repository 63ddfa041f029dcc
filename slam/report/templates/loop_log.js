// The loop log: sorted by its headings, filtered by outcome and text; a button in the first cell opens a row.
(() => {
  const table = document.getElementById("loop-log");
  if (!table) return;
  const body = table.tBodies[0];
  const rows = sortable(table, () => enter(shown()[0]));

  const form = document.getElementById("filters");
  const outcome = document.getElementById("outcome");
  const search = document.getElementById("words");
  const count = document.getElementById("count");
  const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));
  const shown = () => rows.filter((row) => !row.hidden);

  const fits = (row) => {
    if (outcome.value === "accepted") return "accepted" in row.dataset;
    return outcome.value === "" || row.dataset.outcome === outcome.value;
  };
  const filter = () => {
    const wanted = search.value.trim().toLowerCase();
    for (const row of rows) row.hidden = !(fits(row) && texts.get(row).includes(wanted));
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
    if (window.getSelection().type === "Range") return; // text is being selected
    const row = event.target.closest("tr");
    focus(row);
    row.dispatchEvent(new CustomEvent("revisit:open", { bubbles: true, detail: { shown, focus } }));
  });

  form.hidden = false;
  form.addEventListener("submit", (event) => event.preventDefault());
  outcome.addEventListener("change", filter);
  search.addEventListener("input", filter);
  if (rows.some((row) => "accepted" in row.dataset)) outcome.value = "accepted";
  filter();
})();
