// Line charts, whose numbers training_page.py leaves on a page.

const ALONG = "control steps";
const DOTTED = 40; // lines of no more points than this show each of them

/** What a line is worth at a place, between its points too; nothing beside them. */
function valueAt(x, y, index) {
  let before = index, after = index;
  while (before >= 0 && y[before] === undefined) before--;
  while (after < y.length && y[after] === undefined) after++;
  if (before < 0 || after === y.length) return null;
  return y[before] + (before === after ? 0 : ((x[index] - x[before]) / (x[after] - x[before])) * (y[after] - y[before]));
}

/** Round numbers below and above, which uPlot's ranges of logarithmic axes go far beyond. */
const roundly = (chart, low, high) => [INCREMENTS.findLast((n) => n < low), INCREMENTS.find((n) => n > high)];

function drawCurves(element) {
  const { end, y, lines } = JSON.parse(element.querySelector("script").textContent);
  const tables = lines.map((line) => [line.x, line.y, ...(line.band ?? [])]);
  const bold = lines.some(({ kind }) => kind === "mean") ? "mean" : "run", series = [], bands = [];
  for (const { kind, name, y: { length }, band } of lines) {
    const colour = () => css(`--${kind}`);
    series.push({
      label: name,
      class: kind,
      stroke: colour,
      width: kind.startsWith(bold) ? 2.5 : 1.5,
      cap: "round",
      points: { show: length <= DOTTED, size: 5, width: 0, fill: colour, stroke: colour },
      value: (chart, _, i, index) => (index === null ? "" : shown(valueAt(chart.data[0], chart.data[i], index))),
    });
    if (!band) continue;
    bands.push({ series: [series.length + 2, series.length + 1], fill: () => `${colour()}29` });
    for (const edge of band) series.push({ class: "edge", width: 0, points: { show: false } });
  }
  const shown = (value) => (value === null ? "" : inWords(value));
  createChart(element, {
    ...EXPLAINED,
    scales: {
      x: { time: false, range: [0, end] },
      y: { share: { range: [0, 1] }, log: { distr: 3, range: roundly } }[y] ?? {},
    },
    padding: [8, 20, 0, 0], // half of the last label
    axes: [
      axis("number", { label: ALONG, labelSize: 20, size: 24, space: 55 }),
      axis(y === "log" ? "log" : "number", { size: (chart, labels) => 4 + 8 * Math.max(6, ...(labels ?? []).map(({ length }) => length)), space: 22 }),
    ],
    series: [{ label: ALONG, value: (chart, value) => (value === null ? "" : inWords(value)) }, ...series],
    bands,
  }, uPlot.join(tables));
}

document.querySelectorAll(".curves").forEach(drawCurves);
