// Reads the performances that recording.py has put into the page.

/** The recorded row in force at `time`, the next one, and how far it is towards that. */
function rowAt(time, dt, steps) {
  const at = Math.min(Math.max(time / dt + 1e-6, 0), steps - 1), row = Math.floor(at);
  return { row, next: Math.min(row + 1, steps - 1), blend: at - row };
}

/** The same for states, which a row holds as they are at the end of its step: as sound and notes go. */
function stateAt(time, dt, steps) {
  return rowAt(time - dt, dt, steps);
}

const LOUDEST_NOTE = 127; // MIDI velocity
const fromBase64 = Uint8Array.fromBase64?.bind(Uint8Array) ?? ((text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)));

const inflated = (text) => new Response(new Blob([fromBase64(text)]).stream().pipeThrough(new DecompressionStream("deflate")));

/** What `packed_text` was given. */
const unpackedText = (text) => inflated(text).text();

/** Runs the libraries that the page has as `packed_asset` packs them. */
async function loadLibraries() {
  for (const library of document.querySelectorAll("script.library")) {
    const script = document.createElement("script");
    script.textContent = await unpackedText(library.textContent);
    document.head.append(script);
  }
}

/** What `packed` was given: numbers of the type `Numbers`, row by row. */
async function unpacked(text, steps, Numbers) {
  const planes = new Uint8Array(await inflated(text).arrayBuffer());
  const size = Numbers.BYTES_PER_ELEMENT, count = planes.length / size, columns = count / steps;
  const patterns = new { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[size](count);
  for (let column = 0, i = 0; column < columns; column++) {
    for (let row = 0, sum = 0; row < steps; row++, i++) {
      for (let plane = 0; plane < size; plane++) sum = (sum + (planes[plane * count + i] << (8 * plane))) | 0;
      patterns[row * columns + column] = sum;
    }
  }
  return new Numbers(patterns.buffer);
}

/**
 * The performance that stands at `index` in the page: `dt` [s], `steps`, and of each step
 *   states (`keys` a row) and pedal: 0 rightly silent, 1 hit, 2 wrong, 3 missed;
 *   angles (`keys` a row) of keys, 255 all the way down;
 *   notes that sounded: key, from and to [s], MIDI velocity;
 *   written: [beginning in s, MIDI velocity] of notes that should; onsetErrors: [beginning in s, error in ms];
 *   fingers: [key, beginning in s, 0 for the right hand and 1 for the left, number from 1];
 *   rewards, by name, NaN where there is none;
 *   jointsAt(time): where the hands' joints are [m, rad].
 * `scene` is what `cadenza.scene.drawing` says; `sound` is the address of a WebM file, and `goal`
 * that of another with what should have been played, or null.
 */
async function readRecording(index = 0) {
  const { unit, joints, angles, states, pedal, rewards, notes: sounded, ...plain } =
    JSON.parse(await unpackedText(document.querySelectorAll(".recording")[index].textContent));
  const { dt, steps } = plain, read = (text, Numbers) => unpacked(text, steps, Numbers);
  const positions = await read(joints, Int32Array), width = positions.length / steps;
  const terms = {};
  for (const [name, text] of Object.entries(rewards)) terms[name] = await read(text, Float32Array);
  const addressOf = (element) => element && URL.createObjectURL(new Blob([fromBase64(element.textContent)], { type: "audio/webm" }));
  const played = sounded.map(([key, from, to, velocity]) => ({ key, from, to, velocity })), byKey = new Map();
  for (const note of played) byKey.set(note.key, [...(byKey.get(note.key) ?? []), note]);
  return {
    ...plain,
    notes: played,
    /** MIDI velocity of the note of a key that sounds between two times [s]; the loudest where none does. */
    velocityOf({ key, from, to }) {
      return byKey.get(key)?.find((note) => note.to > from && note.from < to)?.velocity ?? LOUDEST_NOTE;
    },
    angles: await read(angles, Uint8Array),
    states: await read(states, Uint8Array),
    pedal: await read(pedal, Uint8Array),
    rewards: terms,
    sound: addressOf(document.querySelectorAll("script.sound")[index]),
    goal: addressOf(document.querySelectorAll("script.goal")[index] ?? null),
    jointsAt(time) {
      const { row, next, blend } = stateAt(time, dt, steps);
      return Array.from({ length: width }, (_, i) => {
        const [from, to] = [positions[row * width + i], positions[next * width + i]];
        return (from + blend * (to - from)) * unit;
      });
    },
  };
}

/** The hands' bodies, each a group within that of its parent; `pose(joints)` moves them. */
function createHands(skeleton) {
  const root = new THREE.Group(), bodies = skeleton.map(() => new THREE.Group());
  skeleton.forEach(({ parent }, b) => (bodies[parent] ?? root).add(bodies[b]));
  const moves = skeleton.map(({ joints }) => joints.map(({ axis, ...joint }) => ({ axis: new THREE.Vector3(...axis), ...joint })));
  return {
    root,
    bodies,
    pose(joints) {
      skeleton.forEach(({ pos, quat: [w, x, y, z] }, b) => {
        bodies[b].position.set(...pos);
        bodies[b].quaternion.set(x, y, z, w);
        for (const { type, axis, index } of moves[b]) {
          if (type === "slide") bodies[b].translateOnAxis(axis, joints[index]);
          else bodies[b].rotateOnAxis(axis, joints[index]);
        }
      });
    },
  };
}
