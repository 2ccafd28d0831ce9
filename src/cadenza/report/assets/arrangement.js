// A song that was arranged for the hands: which of its notes were left out, moved or struck again.

const LEFT_OUT = "left out", MOVED = "moved", AGAIN = "struck again";
const OCTAVES = ["", "an octave", "two octaves"];

/**
 * The notes that were changed, as `arrangement` has them (see `cadenza.report.performance_page`), by their
 * beginning: the `key` at which each is drawn, the one that was `written`, `from` and `to` [s], its
 * `part`, its `kind`, by how many keys it was moved `up`, and in words what `became` of it.
 */
function changesOf({ arrangement = [] }) {
  const changed = arrangement.filter(([key, , , played, , again]) => again || played !== key);
  return changed.map(([written, from, to, played, part, again]) => {
    const up = (played ?? written) - written, far = Math.abs(up) / 12;
    const kind = played === null ? LEFT_OUT : up ? MOVED : AGAIN, key = played ?? written;
    const became = kind === MOVED ? `moved ${up > 0 ? "up" : "down"} ${OCTAVES[far] ?? `${far} octaves`}${again ? ", struck again" : ""}` : kind;
    return { key, written, from, to, part, kind, up, became };
  });
}

/** Counts notes that were changed, in words: "46 notes left out, 12 moved". */
function changesInWords(changes) {
  const count = (kind) => changes.filter((change) => change.kind === kind).length;
  return [LEFT_OUT, MOVED, AGAIN].filter(count).map((kind) => `${count(kind)} ${kind}`).join(", ");
}

/** Draws a note that was left out as a faint outline, and marks one that was moved or struck again. */
function drawChange(context, { kind, up }, x, y, width, height) {
  const middle = y + height / 2, size = Math.min(height / 2 - 1, 4);
  context.save();
  context.strokeStyle = context.fillStyle = css(kind === LEFT_OUT ? "--soft" : "--ink");
  context.beginPath();
  if (kind === LEFT_OUT) {
    context.setLineDash([3, 2]);
    context.globalAlpha = 0.75;
    context.roundRect(x + 1, y + 1.5, Math.max(width - 2, 2), height - 3, 2);
    context.stroke();
  } else if (kind === MOVED) { // it points to where the note was moved
    const tip = Math.sign(-up) * size;
    context.moveTo(x + 2, middle - tip);
    context.lineTo(x + 2 + 2 * size, middle - tip);
    context.lineTo(x + 2 + size, middle + tip);
    context.fill();
  } else {
    context.rect(x + 2, middle - 1, 2 * size, 2);
    context.rect(x + 1 + size, middle - size, 2, 2 * size);
    context.fill();
  }
  context.restore();
}
