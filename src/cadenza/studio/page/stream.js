// A performance that the server streams while it is played.

const OVER = ["kept", "failed", "cancelled", "gone"], COMPLETE = ["played", "writing", "kept"];
const PACE_WINDOW = 10, MIN_ARRIVALS = 6; // [s] and messages over which the pace of planning is measured
const RETRY_DELAY = 500, MAX_RETRY_DELAY = 5000; // [ms] before the next attempt to reach the server, for each that failed; and at most

/**
 * Receives a performance from the server: its `title` and `request`, `status`, and a `recording` once
 * it is known what is to be played. `changed(what)` is called for each of these.
 */
function createPerformance(id, changed) {
  let socket = null, attempts = 0, closed = false;
  const performance = {
    id, title: "", request: null, status: { state: "queued" }, recording: null,
    arrivals: [], // latest messages: time [s], number of rows
    /** Seconds of music that are planned a second, lately; null before that is known. */
    get pace() {
      const [first, last] = [this.arrivals[0], this.arrivals.at(-1)];
      return this.arrivals.length < MIN_ARRIVALS ? null : ((last[1] - first[1]) * this.recording.dt) / Math.max(last[0] - first[0], 1e-3);
    },
    get over() { return OVER.includes(this.status.state); },
    /** Whether nothing more is to come of the music. */
    get complete() { return COMPLETE.includes(this.status.state); },
    close() {
      closed = true;
      socket.close();
    },
  };
  async function receive(data) {
    if (typeof data !== "string") {
      performance.recording.add(new Uint8Array(data));
      const { arrivals, recording } = performance, at = window.performance.now() / 1000;
      arrivals.push([at, recording.rows]);
      while (arrivals.length > MIN_ARRIVALS && arrivals[1][0] < at - PACE_WINDOW) arrivals.shift();
      return;
    }
    const message = JSON.parse(data);
    let what = "recording";
    if (message.state) [performance.status, what] = [message, "status"];
    else if (message.request) [what] = ["request", Object.assign(performance, message)];
    else if (!message.dt) { // fingers, misses or the engraving, which have become known
      Object.assign(performance.recording, message);
      [what] = Object.keys(message);
    } else if (performance.recording) return performance.recording.restart(); // sent again
    else performance.recording = await createStreamedRecording(message);
    if (!closed) changed(what);
  }
  (function connect() {
    const ours = socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}${location.pathname}watch/${id}`);
    ours.binaryType = "arraybuffer";
    let order = Promise.resolve();
    ours.onopen = () => {
      attempts = 0;
      if (cadenza.error === NO_ANSWER) clearError();
    };
    ours.onmessage = ({ data }) => { order = order.then(() => (closed ? null : receive(data))); };
    ours.onclose = () => order.then(() => {
      if (closed || performance.over) return;
      if (attempts++ > 1) showError(NO_ANSWER);
      setTimeout(() => { if (!closed) connect(); }, Math.min(RETRY_DELAY * attempts, MAX_RETRY_DELAY));
    });
  })();
  return performance;
}

const SOUNDS = 128, STEP_PARTS = 255; // as in cadenza.studio.messages

/**
 * Returns a recording (see recording.js) whose rows come one after the other, and whose states hold
 * only what has been shown. `about` is the header that the server sends, see `cadenza.studio.state_stream`.
 */
async function createStreamedRecording(about) {
  const { dt, steps, keys, lowest, joints: width, row: size, start, scene, sound } = about;
  const goal = await unpacked(about.goal, steps, Uint8Array), goalPedal = await unpacked(about.pedal, steps, Uint8Array);
  const bytes = new Uint8Array(steps * size), numbers = new Float32Array(bytes.buffer), posture = Float32Array.from(start);
  const angles = new Uint8Array(steps * keys), states = new Uint8Array(steps * keys), pedal = new Uint8Array(steps);
  const depths = 4 * width, sounding = depths + keys, timesAt = sounding + keys, pedalAt = timesAt + keys;
  const onsets = createOnsets(about.notes);
  let filled = 0, received = 0, shown = 0, sums = [0, 0, 0], silent = true; // until a note is wanted or sounds
  const clear = () => {
    [shown, sums, silent] = [0, [0, 0, 0], true];
    onsets.clear();
    goal.forEach((wants, i) => { states[i] = wants ? COMING : 0; });
    goalPedal.forEach((wants, i) => { pedal[i] = wants ? COMING : 0; });
  };
  clear();
  const verdict = (wants, sounds) => (wants ? (sounds ? HIT : MISSED) : sounds ? WRONG : 0);
  const ratio = (a, b) => (b ? a / b : 1);
  const rows = () => Math.floor(filled / size);
  const sounds = (row, key) => bytes[row * size + sounding + key] >= SOUNDS;
  const velocity = (row, key) => bytes[row * size + sounding + key] % SOUNDS;
  const changedAt = (row, key) => (row + bytes[row * size + timesAt + key] / STEP_PARTS) * dt;
  const pedalDown = (row) => bytes[row * size + pedalAt] > 0;
  return {
    dt, steps, keys, lowest, scene, sound, angles, states, pedal,
    /** The score, once it is engraved, see `readEngraving`. */
    engraving: about.engraving ?? null,
    /** What of the song is not played, what became of each note, and why notes were missed, once that is known. */
    remarks: about.remarks ?? [], arrangement: about.arrangement ?? [], misses: about.misses ?? [],
    /** As in `recording.js`, once they are known. */
    fingers: about.fingers ?? [],
    /** Rows that have come. */
    get rows() { return rows(); },
    /** Up to when it can be played [s]. */
    get available() { return (rows() < steps ? Math.max(rows() - 1, 0) : steps) * dt; },
    sounds, pedalDown,
    /** MIDI velocity of a key that is struck in a row, else 0. */
    velocity,
    /** When a key was struck in a row, or else ceased to sound in it [s]. */
    changedAt,
    add(part) {
      const first = rows();
      bytes.set(part.subarray(0, bytes.length - received), received);
      received = Math.min(received + part.length, bytes.length);
      filled = Math.max(filled, received);
      for (let row = first; row < rows(); row++) {
        angles.set(bytes.subarray(row * size + depths, row * size + sounding), row * keys);
      }
    },
    /** Begins again with the first row. */
    restart() { received = 0; },
    jointsAt(time) {
      if (!rows()) return posture;
      const { row, next, blend } = stateAt(time, dt, rows()), stride = size / 4;
      for (let i = 0; i < width; i++) {
        const from = numbers[row * stride + i];
        posture[i] = from + blend * (numbers[next * stride + i] - from);
      }
      return posture;
    },
    /** Shows what became of all keys up to a time, and of nothing later; returns whether that is new. */
    show(time) {
      const end = Math.min(Math.floor(time / dt + 1e-6) + 1, rows());
      if (end < shown) clear();
      const first = shown;
      for (; shown < end; shown++) {
        let hits = 0, played = 0, want = 0;
        for (let key = 0; key < keys; key++) {
          const at = shown * keys + key, heard = sounds(shown, key);
          hits += goal[at] && heard ? 1 : 0;
          played += heard ? 1 : 0;
          want += goal[at];
          if (velocity(shown, key)) onsets.strike(key, changedAt(shown, key));
          states[at] = verdict(goal[at], heard);
        }
        pedal[shown] = verdict(goalPedal[shown], pedalDown(shown));
        silent &&= !(played || want);
        [ratio(2 * hits, played + want), ratio(hits, played), ratio(hits, want)].forEach((value, i) => { sums[i] += value; });
      }
      return shown > first;
    },
    /** F1, precision and recall of the steps shown, and F1 of note onsets, as in `cadenza.music.metrics`; null in silence. */
    get scores() { return !silent ? [...sums.map((sum) => sum / shown), onsets.f1(shown * dt)] : [null, null, null, null]; },
  };
}

const ONSET_TOLERANCE = 500; // [0.1 ms] that a note may begin too early or too late
/** Matches notes [key, beginning in s] with the keys that are struck one after the other. */
function createOnsets(notes) {
  const starts = new Map(), all = notes.map(([, start]) => start).sort((a, b) => a - b);
  for (const [key, start] of notes) {
    if (!starts.has(key)) starts.set(key, []);
    starts.get(key).push(start);
  }
  let next = new Map(), struck = 0, found = 0, begun = 0; // `next` of a key, among its notes
  return {
    clear() { [next, struck, found, begun] = [new Map(), 0, 0, 0]; },
    strike(key, at) {
      const wanted = starts.get(key) ?? [], off = (i) => Math.round(1e4 * (wanted[i] - at));
      let i = next.get(key) ?? 0;
      while (i < wanted.length && off(i) < -ONSET_TOLERANCE) i++;
      if (i < wanted.length && off(i) <= ONSET_TOLERANCE) [found, i] = [found + 1, i + 1];
      next.set(key, i);
      struck++;
    },
    /** Returns F1 of the notes that begin before a time [s]; one that is struck a little early may not be among them. */
    f1(time) {
      while (begun < all.length && all[begun] < time - 1e-9) begun++;
      return struck + begun ? Math.min((2 * found) / (struck + begun), 1) : 1;
    },
  };
}
