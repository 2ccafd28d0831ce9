// What the rows of a recording say: notes, as stretches of them.

const [HIT, WRONG, MISSED, COMING] = [1, 2, 3, 4];
// Of states 1 to 4; in state 0 a key is rightly silent. What is coming has yet to be played.
const VERDICTS = ["hit", "wrong", "missed", "coming"];

const NAMES = ["C", "C♯", "D", "D♯", "E", "F", "F♯", "G", "G♯", "A", "A♯", "B"];
const noteName = (pitch) => NAMES[pitch % 12] + (Math.floor(pitch / 12) - 1);
const isBlack = (pitch) => [1, 3, 6, 8, 10].includes(pitch % 12);

/** Stretches of equal, non-zero state: calls `found(first, end, state)` for rows first..end-1. */
function stretches(steps, stateAt, found) {
  for (let first = 0; first < steps; ) {
    const state = stateAt(first);
    let end = first + 1;
    while (end < steps && stateAt(end) === state) end++;
    if (state) found(first, end, state);
    first = end;
  }
}

/** Of all keys, by their beginning [s]: {key, from, to, state}; `of` maps the state of a row. */
function notes({ states, dt, steps, keys }, of = (state) => state) {
  const found = [];
  for (let key = 0; key < keys; key++) {
    stretches(steps, (t) => of(states[t * keys + key]), (first, end, state) => {
      found.push({ key, from: first * dt, to: end * dt, state });
    });
  }
  return found.sort((a, b) => a.from - b.from);
}
const wanted = (state) => (state === HIT || state === MISSED || state === COMING ? HIT : 0);

/** Calls `found` for the notes of all keys in the rows from `start` to `end` [s]. */
function notesBetween({ states, dt, steps, keys }, start, end, found) {
  const first = Math.max(Math.floor(start / dt), 0), last = Math.min(Math.ceil(end / dt), steps);
  for (let key = 0; key < keys; key++) {
    stretches(last - first, (t) => states[(first + t) * keys + key], (from, to, state) => {
      found({ key, from: (first + from) * dt, to: (first + to) * dt, state });
    });
  }
}

/** Calls `found` for each of `sorted`, of which none is longer than `longest`, within a time. */
function within(sorted, longest, start, end, found) {
  let low = 0, high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle].from < start - longest) low = middle + 1; else high = middle;
  }
  for (; low < sorted.length && sorted[low].from < end; low++) if (sorted[low].to > start) found(sorted[low]);
}
const longestOf = (sorted) => sorted.reduce((longest, { from, to }) => Math.max(longest, to - from), 0);

/** The lowest and the highest key that should sound, or that does where none should. */
function range({ states, keys }) {
  for (const counts of [wanted, (state) => state]) {
    let low = keys, high = -1;
    for (let i = 0; i < states.length; i++) {
      if (!counts(states[i])) continue;
      low = Math.min(low, i % keys);
      high = Math.max(high, i % keys);
    }
    if (high >= 0) return [low, high];
  }
  return [0, keys - 1];
}
