// One run at a time, in a frame: its own page, put together with what all of them share.

const read = (element) => JSON.parse(element.textContent);
const frame = $("frame"), choice = $("choice"), strips = document.querySelector(".strips");
const shared = { "uplot.min.js": $("uplot").textContent, ...read($("shared")) }, runs = document.querySelectorAll(".run");
const comparison = window.comparison = { ready: false };
let turns = 0;

// What was right when: keys that rightly sound and missing ones above the line, wrong ones below.
const KEY = 6; // [px]
const duration = Number(strips.dataset.duration);
const SECONDS = { time: false, range: [0, duration] };

const colour = (name) => () => css(`--${name}`);

function drawStrip(element) {
  const { dt, hit, missed, wrong } = read(element.querySelector("script"));
  const up = hit.map((count, i) => count + missed[i]), down = wrong.map((count) => -count);
  const [low, high] = [down.reduce((a, b) => Math.min(a, b), 0), up.reduce((a, b) => Math.max(a, b), 0)];
  element.style.height = `${KEY * (high - low) + 2}px`;
  const layer = (label, counts, fill) => ({
    label,
    class: label,
    fill,
    width: 0,
    points: { show: false },
    paths: uPlot.paths.stepped({ align: 1 }),
    value: (chart, _, i, index) => (index === null ? "" : String(counts[Math.min(index, counts.length - 1)])),
  });
  createChart(element, {
    ...EXPLAINED,
    padding: [1, 0, 1, 0],
    scales: { x: SECONDS, y: { range: [low, high] } },
    axes: [{ show: false }, { size: 0, splits: [0], values: () => [], ticks: { show: false }, grid: { stroke: colour("soft"), width: 1 } }],
    series: [
      { label: "time", value: (chart, value) => (value === null ? "" : `${value.toFixed(2)} s`) },
      layer("hit", hit, colour("hit")), layer("missed", missed), layer("wrong", wrong, colour("wrong")),
    ],
    bands: [{ series: [2, 1], fill: colour("missed") }],
  }, [[...hit, 0].map((_, step) => step * dt), ...[hit, up, down].map((counts) => [...counts, counts.at(-1)])]); // the last lasts a step too
}
document.querySelectorAll("div.strip").forEach(drawStrip);
createChart(document.querySelector(".seconds"), {
  ...SILENT,
  scales: { x: SECONDS },
  axes: [axis("seconds", {
    align: 1,
    size: 24,
    gap: 1,
    space: 60,
    ticks: { size: 6, width: 1, stroke: colour("soft") },
    filter: (chart, ticks) => ticks.map((tick) => (tick < 0.95 * duration ? tick : null)), // a label has to fit after the last
  }), { show: false }],
  series: [{}],
}, [[0, duration]]);

/** The player of the run in sight, if it is ready. */
const player = () => (comparison.ready ? frame.contentWindow.cadenza : null);

/** Shows a run, which goes on from `time` [s] if the one before was playing. */
async function show(index, time = player()?.time ?? 0) {
  const turn = ++turns, playing = player()?.playing;
  comparison.ready = false;
  choice.value = index;
  for (const button of document.querySelectorAll("button[data-run]")) button.setAttribute("aria-pressed", button.dataset.run === choice.value);
  frame.srcdoc = read(runs[index]).map((piece) => (Array.isArray(piece) ? shared[piece[0]] : piece)).join("");
  await new Promise((loaded) => { frame.onload = loaded; });
  if (turn !== turns) return;
  const { documentElement: root } = frame.contentDocument, { cadenza } = frame.contentWindow;
  root.classList.add("framed");
  new ResizeObserver(() => { frame.style.height = `${root.offsetHeight}px`; }).observe(root);
  while (!cadenza.ready && cadenza.error === null) await new Promise(requestAnimationFrame);
  if (turn !== turns) return;
  comparison.ready = true;
  cadenza.seek(time);
  if (playing) cadenza.play();
}

choice.addEventListener("change", () => show(choice.value));
for (const chosen of document.querySelectorAll("[data-run]")) {
  chosen.addEventListener("click", (event) => {
    const box = chosen.getBoundingClientRect(), isStrip = chosen.matches(".strip");
    const time = isStrip ? ((event.clientX - box.left) / box.width) * duration : undefined;
    if (chosen.dataset.run !== choice.value) show(chosen.dataset.run, time);
    else if (isStrip) player()?.seek(time);
    if (!isStrip) $("run").scrollIntoView({ block: "nearest" });
  });
}

const cursor = make("div", [], { className: "cursor" });
(function follow() {
  const strip = document.querySelector(`.strip[data-run="${choice.value}"] .u-over`);
  if (cursor.parentElement !== strip) strip.append(cursor);
  cursor.hidden = !player();
  if (player()) cursor.style.left = `${(100 * player().time) / duration}%`;
  requestAnimationFrame(follow);
})();
show(0);
