// The reward of each step, term by term.

/** Three decimals, and no minus before a zero. */
const decimals = (number) => number.toFixed(3).replace(/^-(?=0\.0+$)/, "");

/** Adds a picture that `words` describe to `element`, under a title of these `parts`; it is yet to be drawn. */
function addPictureUnder(element, parts, words) {
  const drawing = make("div", [], { className: "drawing", role: "img", "aria-label": words });
  element.append(make("div", parts, { className: "term" }), drawing);
  return drawing;
}

function createRewards(element, { rewards, dt, steps }, seek) {
  const terms = Object.entries(rewards).map(([name, values]) => {
    const known = values.filter((v) => !Number.isNaN(v)), term = name.replaceAll("_", " ");
    const mean = `mean ${decimals(known.reduce((sum, v) => sum + v, 0) / Math.max(known.length, 1))}`;
    const output = make("output"), label = make("span", [make("b", term), ` ${mean}`]), here = make("span", ["at the cursor ", output]);
    drawReward(addPictureUnder(element, [label, here], `Reward ${term} over time, ${mean}`), values);
    return { values, output };
  });
  const point = timeline(element, () => [0, steps * dt], seek);
  let shownRow = -1;

  return {
    move(time) {
      const { row } = rowAt(time, dt, steps);
      if (row !== shownRow) for (const { values, output } of terms) output.textContent = Number.isNaN(values[row]) ? "–" : decimals(values[row]);
      shownRow = row;
      point(time);
    },
  };
}

function drawReward(element, values) {
  const y = [...values, values.at(-1)].map((v) => (Number.isNaN(v) ? null : v)); // the last lasts a step too
  const low = y.reduce((a, b) => Math.min(a, b), 0), high = y.reduce((a, b) => Math.max(a, b), 0), margin = 0.18 * (high - low) || 1; // for the labels
  createChart(element, {
    ...SILENT,
    scales: { x: { time: false, range: [0, values.length] }, y: { range: [low - margin, high + margin] } },
    axes: [{ show: false }, axis("number", {
      font: "11px system-ui, sans-serif",
      size: GUTTER,
      grid: { show: false },
      splits: high - low > 1e-9 ? [low, high] : [0],
      values: (chart, ends) => ends.map((v) => inWords(Number(v.toPrecision(Math.abs(v) < 1e-3 ? 1 : 2)))),
    })],
    series: [{}, { stroke: () => css("--accent"), width: 1.5, points: { show: false }, paths: uPlot.paths.stepped({ align: 1 }) }],
  }, [y.map((_, step) => step), y]);
}
