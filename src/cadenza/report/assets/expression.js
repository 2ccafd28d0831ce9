// Loudness and timing of notes over time, played over written: a dot for each note.

/** Columns for uPlot of dots [x, y], each at an x of its own, as notes of a chord have the same. */
function columnsOf(dots) {
  const APART = 1e-6; // [s]
  const sorted = [...dots].sort(([a], [b]) => a - b);
  return [sorted.map(([x], i) => x + i * APART), sorted.map(([, y]) => y)];
}

function createExpression(element, { notes, written, onsetErrors, dt, steps }, seek) {
  const end = steps * dt, velocities = [written, notes.map(({ from, velocity }) => [from, velocity])];
  const late = 10 * Math.ceil(onsetErrors.reduce((most, [, error]) => Math.max(most, Math.abs(error)), 1) / 10);
  drawDots(element, "MIDI velocity", "Velocities of the notes over time, written and played", end, [0, 64, 127], velocities, ["--missed", "--accent"]);
  drawDots(element, "Onset, played minus written [ms]", "How late the notes begin over time", end, [-late, 0, late], [onsetErrors], ["--accent"]);
  return { move: timeline(element, () => [0, end], seek) };
}

/** Charts dots of several `kinds`, each a list of [x, y], between the first and the last of `ticks`. */
function drawDots(element, label, words, end, ticks, kinds, colours) {
  const MARGIN = 0.08; // of the height, so that dots at the edge are whole
  const drawing = addPictureUnder(element, [make("b", label)], words);
  drawing.classList.add("dots");
  const [low, high] = [ticks[0], ticks.at(-1)], margin = MARGIN * (high - low);
  const isUnder = (i) => i < kinds.length - 1; // rings, in which the dots of what was played lie
  createChart(drawing, {
    ...SILENT,
    scales: { x: { time: false, range: [0, end] }, y: { range: [low - margin, high + margin] } },
    axes: [{ show: false }, axis("number", { font: "11px system-ui, sans-serif", size: GUTTER, splits: ticks })],
    series: [{}, ...colours.map((colour, i) => ({
      paths: () => null,
      points: { show: true, size: isUnder(i) ? 8 : 5, width: isUnder(i) ? 1.5 : 0, stroke: () => css(colour), fill: () => (isUnder(i) ? "transparent" : css(colour)) },
    }))],
  }, uPlot.join(kinds.map(columnsOf)));
}
