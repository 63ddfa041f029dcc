// The maps before and after, zoomed and moved together, with the frame under the pointer marked in both.
(() => {
  const SVG = document.querySelector("svg").namespaceURI;
  const CLOSEST = 64; // times
  const NUDGE = 0.2; // of the view
  const draw = (name, attributes, parent) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    parent.append(node);
    return node;
  };
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  const views = Array.from(document.querySelectorAll("figure.map"), (figure) => {
    const data = JSON.parse(figure.querySelector("script").textContent);
    const [x, y, width, height] = data.box;
    const svg = figure.querySelector("svg");
    // The contents of the map move into an inner drawing, whose view box can show any part of them.
    const contents = Array.from(svg.querySelectorAll('[id*="-inside-"], [id*="-axes_1"] > image'));
    const inner = draw("svg", { x, y, width, height, class: "inside", preserveAspectRatio: "none" }, svg);
    const ticks = draw("g", { class: "ticks" }, svg);
    const marker = draw("circle", { r: 5, class: "marker", visibility: "hidden" }, svg);
    inner.append(...contents);
    for (const dot of inner.querySelectorAll("use")) { // the style sheet keeps its size on the screen
      dot.style.transformOrigin = `${dot.getAttribute("x")}px ${dot.getAttribute("y")}px`;
    }
    return { figure, svg, inner, ticks, marker, ...data };
  });
  if (!views.length) return;
  const [left, bottom, right, top] = views[0].window;
  const frames = views[0].at.length;
  const whole = { x: left, z: bottom, width: right - left, height: top - bottom };
  let view = { ...whole }; // metres, from the lower left corner
  let frame = null;

  const round = (step, value) => value.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9))).replace("-", "\u2212");
  const between = (from, to) => {
    const raw = (to - from) / 4, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= raw);
    const found = [];
    for (let k = Math.ceil(from / step); k * step <= to; k++) found.push([k * step, round(step, k * step)]);
    return found;
  };
  const place = ({ box: [x, y, width, height] }, [mx, mz]) => [
    x + (width * (mx - view.x)) / view.width,
    y + height - (height * (mz - view.z)) / view.height,
  ];

  const showTicks = (map) => {
    const [x, y, width, height] = map.box;
    map.ticks.replaceChildren();
    for (const [metres, words] of between(view.x, view.x + view.width)) {
      const at = place(map, [metres, 0])[0];
      draw("line", { x1: at, x2: at, y1: y, y2: y + height }, map.ticks);
      draw("text", { x: at, y: y + height + 12, "text-anchor": "middle" }, map.ticks).textContent = words;
    }
    for (const [metres, words] of between(view.z, view.z + view.height)) {
      const at = place(map, [0, metres])[1];
      draw("line", { x1: x, x2: x + width, y1: at, y2: at }, map.ticks);
      draw("text", { x: x - 5, y: at + 3, "text-anchor": "end" }, map.ticks).textContent = words;
    }
  };

  const showFrame = (map) => {
    if (frame === null) return;
    const [mx, mz] = map.at[frame], [px, py] = place(map, [mx, mz]);
    const inside = mx >= view.x && mx <= view.x + view.width && mz >= view.z && mz <= view.z + view.height;
    map.marker.setAttribute("cx", px);
    map.marker.setAttribute("cy", py);
    map.marker.setAttribute("visibility", inside ? "visible" : "hidden");
    const error = map.error.length ? `, error ${map.error[frame].toFixed(2)} m` : "";
    map.readout.textContent = `Frame ${map.frames[frame]}: x ${mx.toFixed(1)} m, z ${mz.toFixed(1)} m${error}`;
  };

  const show = () => {
    const closer = whole.width / view.width;
    for (const map of views) {
      const [x, y, width, height] = map.box;
      const shown = [
        x + (width * (view.x - whole.x)) / whole.width,
        y + (height * (whole.z + whole.height - view.z - view.height)) / whole.height,
        width / closer,
        height / closer,
      ];
      map.inner.setAttribute("viewBox", shown.join(" "));
      map.svg.style.setProperty("--shrink", 1 / closer);
      map.svg.classList.toggle("zoomed", closer > 1);
      map.closer.disabled = closer >= CLOSEST;
      map.farther.disabled = map.all.disabled = closer <= 1;
      if (closer > 1) showTicks(map); else map.ticks.replaceChildren();
      showFrame(map);
    }
  };
  const look = (x, z, width) => {
    view.width = clamp(width, whole.width / CLOSEST, whole.width);
    view.height = (view.width / whole.width) * whole.height;
    view.x = clamp(x, whole.x, whole.x + whole.width - view.width);
    view.z = clamp(z, whole.z, whole.z + whole.height - view.height);
    show();
  };
  // The point stays where it is on the screen.
  const zoom = (factor, [x, z] = [view.x + view.width / 2, view.z + view.height / 2]) => {
    const width = clamp(view.width / factor, whole.width / CLOSEST, whole.width), shrink = width / view.width;
    look(x - (x - view.x) * shrink, z - (z - view.z) * shrink, width);
  };
  const move = (right, up) => look(view.x + right * view.width, view.z + up * view.height, view.width);
  const choose = (wanted) => {
    frame = clamp(wanted, 0, frames - 1);
    views.forEach(showFrame);
  };
  const step = (map, frames) => {
    choose(frame === null ? 0 : frame + frames);
    const [x, z] = map.at[frame];
    if (map.marker.getAttribute("visibility") === "hidden") look(x - view.width / 2, z - view.height / 2, view.width);
  };

  const under = (map, event) => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(map.svg.getScreenCTM().inverse());
    const [x, y, width, height] = map.box;
    const across = (at.x - x) / width, up = 1 - (at.y - y) / height;
    const inside = across >= 0 && across <= 1 && up >= 0 && up <= 1;
    return inside ? [view.x + across * view.width, view.z + up * view.height] : null;
  };
  const nearest = (map, [x, z]) => {
    let best = 0, least = Infinity;
    map.at.forEach(([fx, fz], k) => {
      const far = (fx - x) ** 2 + (fz - z) ** 2;
      if (far < least) [best, least] = [k, far];
    });
    return best;
  };

  const keys = (map) => ({
    ArrowRight: () => step(map, 1), ArrowLeft: () => step(map, -1), PageUp: () => step(map, 50), PageDown: () => step(map, -50),
    Home: () => step(map, -frames), End: () => step(map, frames),
    "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: () => zoom(0),
    w: () => move(0, NUDGE), s: () => move(0, -NUDGE), a: () => move(-NUDGE, 0), d: () => move(NUDGE, 0),
  });

  const control = (map, words, name, act) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = words;
    button.setAttribute("aria-label", `${name}, ${map.svg.getAttribute("aria-label").split(".")[0]}`);
    button.addEventListener("click", act);
    return button;
  };

  for (const map of views) {
    const pane = document.createElement("div");
    pane.className = "pane";
    pane.tabIndex = 0;
    pane.setAttribute("role", "application");
    pane.setAttribute("aria-label", "Map: left and right arrows step through the frames, plus and minus zoom, w a s d move, 0 shows all");
    map.svg.before(pane);
    pane.append(map.svg);

    const bar = document.createElement("div");
    bar.className = "bar";
    map.readout = document.createElement("output");
    map.readout.textContent = "Point at the path to see its frames. Zoom with the buttons, or click the map and use the wheel.";
    map.closer = control(map, "+", "Zoom in", () => zoom(1.5));
    map.farther = control(map, "\u2212", "Zoom out", () => zoom(1 / 1.5));
    map.all = control(map, "All", "Show all", () => zoom(0));
    bar.append(map.closer, map.farther, map.all, map.readout);
    pane.after(bar);

    const acts = keys(map);
    pane.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in acts)) return;
      event.preventDefault();
      acts[event.key]();
    });
    pane.addEventListener("wheel", (event) => {
      const at = under(map, event);
      if (!at || !(event.ctrlKey || document.activeElement === pane)) return; // the wheel scrolls the page unless the map has the focus
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 300), at);
    }, { passive: false });
    let held = null;
    map.svg.addEventListener("pointerdown", (event) => {
      const at = under(map, event);
      if (at) choose(nearest(map, at)); // a finger does not hover
      held = view.width < whole.width ? at : null;
      if (held) map.svg.setPointerCapture(event.pointerId);
    });
    map.svg.addEventListener("pointerup", () => { held = null; });
    map.svg.addEventListener("pointercancel", () => { held = null; });
    map.svg.addEventListener("pointermove", (event) => {
      const at = under(map, event);
      if (held && at) look(view.x + held[0] - at[0], view.z + held[1] - at[1], view.width);
      else if (at) choose(nearest(map, at));
    });
  }
  show();
})();
