// Charts over a common x, drawn by uPlot: their axes, and what they say under the pointer.

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const FONT = "12px system-ui, sans-serif";

const rounds = (low, high) => Array.from({ length: high - low }, (_, i) => [1, 2, 5].map((n) => Number(`${n}e${low + i}`))).flat();
const INCREMENTS = rounds(-31, 31); // distances between ticks

const minus = (text) => text.replaceAll("-", "−").replace("e+", "e");

/** `values` in one unit, with as many decimals as their distance needs. */
function inUnit(values, step) {
  const largest = Math.max(...values.map(Math.abs)), isPlain = largest === 0 || (largest >= 1e-3 && largest < 1e9);
  const [size, unit] = largest >= 1e6 ? [1e6, " M"] : largest >= 1e4 ? [1e3, " k"] : [1, ""];
  const decimals = Math.max(-Math.floor(Math.log10(step / (isPlain ? size : largest)) + 1e-9), 0);
  const text = (value) => (isPlain ? (value / size).toFixed(decimals) + unit : value.toExponential(decimals));
  return values.map((value) => (value ? minus(text(value)) : "0"));
}

const LABELS = { number: inUnit, log: (values) => values.flatMap((value) => inUnit([value], value)) };

/** Four digits of a number. */
function inWords(value) {
  const size = Math.abs(value);
  if (size && (size < 1e-3 || size >= 1e12)) return minus(String(Number(value.toPrecision(4)).toExponential()));
  return minus(value.toLocaleString("en", size < 1000 ? { maximumSignificantDigits: 4 } : { maximumFractionDigits: 0 }));
}

/** An axis of what is "number" or "log". */
const axis = (kind, more) => ({
  font: FONT,
  labelFont: FONT,
  stroke: () => css("--soft"),
  grid: {
    stroke: () => css("--line"),
    width: 1,
    filter: (chart, ticks, i, ...more) => chart.axes[i].filter(chart, ticks, i, ...more), // where there are labels
  },
  ticks: { show: false },
  ...(kind === "log" ? {} : { incrs: INCREMENTS }),
  values(chart, ticks, i, space, step) {
    const labels = LABELS[kind](ticks.filter((tick) => tick !== null), step);
    return ticks.map((tick) => (tick === null ? "" : labels.shift()));
  },
  ...more,
});

/** A chart that fills `element`, whatever becomes of its width and of the scheme of colours. */
function createChart(element, options, data) {
  const size = () => ({ width: element.clientWidth, height: element.clientHeight });
  const chart = new uPlot({ ...size(), ...options }, data, element);
  new ResizeObserver(() => chart.setSize(size())).observe(element);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => chart.redraw());
  return chart;
}

/** Options for a chart that says nothing where a pointer is. */
const SILENT = { padding: [0, 0, 0, 0], legend: { show: false }, cursor: { show: false } };

/** Options for a chart that says what its lines are worth where a pointer, finger or key points. */
const EXPLAINED = {
  cursor: {
    y: false,
    drag: { x: false },
    dataIdx: (chart, i, index) => index, // also where a line has no point of its own
    points: { size: 7 },
    // To the nearest point of any line.
    move: (chart, left, top) => [left < 0 ? left : chart.valToPos(chart.data[0][chart.posToIdx(left)], "x"), top],
  },
  legend: {
    mount(chart, values) {
      values.setAttribute("aria-live", "polite");
      values.hidden = true;
      chart.over.append(values);
    },
  },
  hooks: {
    ready: [followKeysAndFingers],
    setCursor: [(chart) => {
      const values = chart.over.querySelector(".u-legend"), { idx, left } = chart.cursor;
      values.hidden = idx === null;
      values.classList.toggle("left", left > chart.over.clientWidth / 2);
    }],
  },
};

function followKeysAndFingers(chart) {
  const { over } = chart, last = () => chart.data[0].length - 1;
  const show = (index) => chart.setCursor({ left: chart.valToPos(chart.data[0][Math.min(Math.max(index, 0), last())], "x"), top: 0 });
  const hide = () => chart.setCursor({ left: -10, top: -10 });
  over.tabIndex = 0;
  over.setAttribute("role", "figure");
  over.setAttribute("aria-label", chart.root.parentElement.dataset.words);
  for (const kind of ["pointerdown", "pointermove"]) {
    over.addEventListener(kind, (event) => {
      if (event.pointerType !== "mouse") chart.setCursor({ left: event.clientX - over.getBoundingClientRect().left, top: 0 });
    });
  }
  over.addEventListener("focus", () => { if (over.matches(":focus-visible") && chart.cursor.idx === null) show(last()); });
  over.addEventListener("blur", hide);
  over.addEventListener("keydown", (event) => {
    const at = chart.cursor.idx ?? -1, to = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: last() }[event.key];
    if (event.key === "Escape") hide();
    if (to === undefined) return;
    event.preventDefault();
    show(to);
  });
}
