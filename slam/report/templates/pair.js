// The details of a row of the loop log: its two images with the matches between them, and the decision of each stage.
(() => {
  const dialog = document.getElementById("pair");
  if (!dialog) return;
  const part = (name) => document.getElementById(`pair-${name}`);
  const SVG = document.querySelector("svg").namespaceURI;
  const GAP = 0.015; // between the images, of their width
  let details = null; // read when a row is opened for the first time: it is most of the page
  let table = null;
  let current = null;

  const draw = (name, attributes, parent) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    parent?.append(node);
    return node;
  };

  const drawing = (found) => {
    const { width, height, pictures } = details;
    if (!(found.query in pictures && found.match in pictures)) return null;
    const below = height + GAP * width;
    const label = `${found.caption} Lines join matching points of the two images.`;
    const svg = draw("svg", { viewBox: `0 0 ${width} ${below + height}`, role: "img", "aria-label": label, class: found.outcome });
    [[found.query, 0], [found.match, below]].forEach(([frame, y]) => {
      draw("image", { href: `data:image/webp;base64,${pictures[frame]}`, y, width, height, preserveAspectRatio: "none" }, svg);
    });
    for (let k = 0; k < found.lines.length; k += 4) {
      const [x1, y1, x2, y2] = found.lines.slice(k, k + 4);
      draw("line", { x1, y1, x2, y2: y2 + below }, svg);
      draw("circle", { cx: x1, cy: y1, r: width / 250 }, svg);
      draw("circle", { cx: x2, cy: y2 + below, r: width / 250 }, svg);
    }
    return svg;
  };

  const describe = (lines) => lines.flatMap(([stage, words]) => {
    const term = document.createElement("dt"), description = document.createElement("dd");
    term.textContent = stage;
    description.textContent = words;
    return [term, description];
  });

  const show = (row) => {
    current = row;
    details ??= JSON.parse(document.getElementById("loop-details").textContent);
    const found = details.rows[row.dataset.row];
    const svg = drawing(found);
    part("title").textContent = found.title;
    part("drawing").replaceChildren(...(svg ? [svg] : []));
    part("caption").textContent = found.caption;
    part("stages").replaceChildren(...describe(found.stages));
    part("previous").disabled = !neighbour(-1);
    part("next").disabled = !neighbour(1);
    if (!dialog.open) dialog.showModal();
  };
  const neighbour = (step) => {
    const rows = table.shown();
    return rows[rows.indexOf(current) + step];
  };
  const go = (step) => { if (neighbour(step)) show(neighbour(step)); };

  document.addEventListener("revisit:open", (event) => {
    table = event.detail;
    show(event.target);
  });
  part("previous").addEventListener("click", () => go(-1));
  part("next").addEventListener("click", () => go(1));
  dialog.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step) go(step);
  });
  dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  dialog.addEventListener("close", () => table.focus(current));
})();
