// What the lines are worth under the pointer, and the page anew while the run goes on.

const SIZE = 1000; // of a drawing, in its own units
const POINT = /[ML](-?[\d.]+) (-?[\d.]+)/g;

/** What is `share` (0..1) along an axis that line_chart.py has drawn. */
function scale(text) {
  const [kind, ...ends] = text.split(" "), [low, high] = ends.map(kind === "log" ? (end) => Math.log(end) : Number);
  const at = (share) => low + share * (high - low);
  return { kind, at: kind === "log" ? (share) => Math.exp(at(share)) : at };
}

function inWords(value, kind) {
  const digits = Math.abs(value) < 1000 ? { maximumSignificantDigits: 4 } : { maximumFractionDigits: 0 };
  if (kind !== "seconds") return Math.abs(value) < 1e12 ? value.toLocaleString("en", digits).replace("-", "−") : value.toPrecision(4);
  const minutes = Math.round(value / 60);
  return value < 120 ? `${Math.round(value)} s` : minutes < 60 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** The line's height at `x`, on a straight line between its points; nothing beside them. */
function heightAt(points, x) {
  const next = points.findIndex((point) => point[0] >= x);
  if (next < 0 || (next === 0 && points[0][0] > x)) return null;
  const [x1, y1] = points[next], [x0, y0] = points[Math.max(next - 1, 0)];
  return x1 === x ? y1 : y0 + ((x - x0) / (x1 - x0)) * (y1 - y0);
}

/** Shows the values of all lines where pointer or arrow keys point, at the nearest point of any. */
function explain(drawing) {
  const x = scale(drawing.dataset.x), y = scale(drawing.dataset.y), lines = new Map();
  for (const path of drawing.querySelectorAll("path:not(.grid, .band, .best)")) {
    const kind = path.classList[0], points = [...path.getAttribute("d").matchAll(POINT)].map(([, i, j]) => [Number(i), Number(j)]);
    if (!lines.has(kind)) lines.set(kind, { name: path.textContent, points });
  }
  const stops = [...new Set([...lines.values()].flatMap(({ points }) => points.map(([i]) => i)))].sort((a, b) => a - b);
  const line = document.createElement("div"), values = document.createElement("p");
  line.className = "crosshair";
  values.setAttribute("role", "status");
  let stop = -1;

  function show(index) {
    stop = Math.min(Math.max(index, 0), stops.length - 1);
    line.style.left = `${(100 * stops[stop]) / SIZE}%`;
    values.className = stops[stop] > SIZE / 2 ? "values" : "values right";
    values.replaceChildren(row(drawing.dataset.along, "", inWords(x.at(stops[stop] / SIZE), x.kind)));
    for (const [kind, { name, points }] of lines) {
      const height = heightAt(points, stops[stop]);
      if (height !== null) values.append(row(name, kind, inWords(y.at(1 - height / SIZE), y.kind)));
    }
    drawing.append(line, values);
  }
  function row(name, kind, value) {
    const text = document.createElement("span"), mark = document.createElement("i"), number = document.createElement("b");
    mark.className = kind;
    number.textContent = value;
    text.append(...(kind ? [mark] : []), name + " ", number);
    return text;
  }
  function hide() {
    line.remove();
    values.remove();
    stop = -1;
  }
  function point(event) {
    const box = drawing.getBoundingClientRect(), at = (SIZE * (event.clientX - box.left)) / box.width;
    show(stops.reduce((best, i, index) => (Math.abs(i - at) < Math.abs(stops[best] - at) ? index : best), 0));
  }

  drawing.tabIndex = 0;
  drawing.addEventListener("pointermove", point);
  drawing.addEventListener("pointerdown", point);
  drawing.addEventListener("pointerleave", (event) => { if (event.pointerType === "mouse") hide(); });
  drawing.addEventListener("focus", () => { if (drawing.matches(":focus-visible") && stop < 0) show(stops.length - 1); });
  drawing.addEventListener("blur", hide);
  drawing.addEventListener("keydown", (event) => {
    const to = { ArrowLeft: stop - 1, ArrowRight: stop + 1, Home: 0, End: stops.length - 1 }[event.key];
    if (event.key === "Escape") hide();
    if (to === undefined) return;
    event.preventDefault();
    show(to);
  });
}

document.querySelectorAll(".drawing").forEach(explain);

// The browser keeps the place on the page; what is unfolded is left to us.
const settings = document.querySelector("details");
if (settings) {
  settings.open = history.state === "open";
  settings.addEventListener("toggle", () => history.replaceState(settings.open ? "open" : null, ""));
}
if ("renewed" in document.documentElement.dataset) {
  setInterval(() => { if (!document.querySelector(".crosshair")) location.reload(); }, 20_000);
}
