// One plan view that moves from before to after: trajectory, landmarks and loops between their two positions.
(() => {
  const figure = document.getElementById("blend");
  if (!figure) return;
  const { truth, loops, dots, errors } = JSON.parse(figure.querySelector("script").textContent);
  const [before, after] = Array.from(document.querySelectorAll("figure.map script"), (map) => JSON.parse(map.textContent));
  const [left, bottom, right, top] = before.window;
  const svg = figure.querySelector("svg");
  const slider = figure.querySelector("input"), play = figure.querySelector("button"), words = figure.querySelector("output");
  const STEPS = Number(slider.max), SECONDS = 2.5;
  const still = window.matchMedia("(prefers-reduced-motion: reduce)");
  svg.setAttribute("viewBox", [left, -top, right - left, top - bottom].join(" "));

  const layer = (name) => svg.querySelector(`.${name}`);
  const number = (value) => Math.round(value * 100) / 100;
  const point = ([x, z]) => `${number(x)} ${number(-z)}`; // up on the page is -y
  const line = (points) => (points.length ? `M${points.map(point).join("L")}` : "");
  const between = (from, to, share) => from.map(([x, z], k) => [x + (to[k][0] - x) * share, z + (to[k][1] - z) * share]);
  const draw = (share) => {
    const path = between(before.at, after.at, share);
    layer("path").setAttribute("d", line(path));
    layer("loops").setAttribute("d", loops.map(([query, match]) => line([path[query], path[match]])).join(""));
    layer("dots").setAttribute("d", between(dots.before, dots.after, share).map((at) => `M${point(at)}h0`).join(""));
    svg.style.setProperty("--share", `${100 * share}%`);
    words.textContent = share === 0 ? `Before${errors[0]}` : share === 1 ? `After${errors[1]}` : "Between the two";
  };
  layer("truth").setAttribute("d", line(truth));

  let running = 0;
  const show = (step) => {
    slider.value = step;
    draw(step / STEPS);
  };
  const stop = () => { cancelAnimationFrame(running); running = 0; };
  const move = () => {
    stop();
    const begin = Number(slider.value), end = begin === STEPS ? 0 : STEPS, start = performance.now();
    if (still.matches) return show(end);
    const advance = (now) => {
      const part = Math.min(Math.max((now - start) / (1000 * SECONDS), 0), 1);
      show(Math.round(begin + (end - begin) * part * part * (3 - 2 * part)));
      running = part < 1 ? requestAnimationFrame(advance) : 0;
    };
    running = requestAnimationFrame(advance);
  };
  slider.addEventListener("input", () => { stop(); draw(Number(slider.value) / STEPS); });
  play.addEventListener("click", move);
  figure.hidden = false;
  show(0);
})();
