// The notes of the score, sliding down a track behind the keyboard onto their keys: until they
// arrive in the colour of their hand and with the number of their finger, or grey if these are not
// known; then in the colour of what became of them.

const TRACK = { ahead: 2.4, past: 0.35, slope: 0.5, drawn: 1.25 }; // [s], [s], [rad]; more than its length, so that notes come from outside the picture
const GLOW = { before: 0.35, now: 1.1, after: 0.15 }; // of its colour that a note sends out, until it sounds, then, and thereafter
const LANE = 0.0004; // [m] half as wide as lines between B and C, and E and F, where no black key is
const SHORTEST_TRACK = 0.2, LONGEST_TRACK = 2; // [m]; in tall pictures it is longer, and notes are faster
// Of notes on white and on black keys: of the right hand, of the left, of an unknown one.
const COMING_NOTES = [[0x9db8f5, 0x6f8fe0], [0xf0b0d4, 0xc777a9], [0xcdd4e0, 0x8d97a8]];
// Numbers from 1 on, made of strokes: the middle upwards and to the right, the length, whether it stands.
const STROKES = [
  [[0.5, 0, 1, true]],
  [[1, 0, 1], [0.75, 0.5, 0.5, true], [0.5, 0, 1], [0.25, -0.5, 0.5, true], [0, 0, 1]],
  [[1, 0, 1], [0.5, 0.5, 1, true], [0.5, 0, 1], [0, 0, 1]],
  [[0.75, -0.5, 0.5, true], [0.5, 0.5, 1, true], [0.5, 0, 1]],
  [[1, 0, 1], [0.75, -0.5, 0.5, true], [0.5, 0, 1], [0.25, 0.5, 0.5, true], [0, 0, 1]],
];
const NUMBER = { high: 0.0105, wide: 0.0055, stroke: 0.0015, edge: 0.002 }; // [m]

/** Gives notes the finger [hand, number] that is to play them. */
function addFingers(goal, { fingers = [], dt }) {
  const byKey = new Map();
  for (const [key, time, ...finger] of fingers) byKey.set(key, [...(byKey.get(key) ?? []), [time, finger]]);
  for (const note of goal) {
    note.finger = byKey.get(note.key)?.find(([time]) => Math.abs(time - note.from) < 1.5 * dt)?.[1];
  }
}

/** Behind the `keys` of the scene, which fill the box `keyboard`. */
function createFallingNotes(data, keys, keyboard, colours) {
  const goal = notes(data, wanted), longest = longestOf(goal);
  const track = new THREE.Group();
  track.position.set(keyboard.min.x - 0.012, 0, keyboard.max.z + 0.016);
  track.quaternion.setFromAxisAngle(new THREE.Vector3(0, 1, 0), Math.PI + TRACK.slope); // x is away
  let speed, length; // [m/s], [m]
  const [left, right] = [keyboard.min.y - 0.015, keyboard.max.y + 0.015];
  /** A strip of the track, `half` as wide to either side of `y`, drawn flat in such an `order`. */
  function strip(colour, y, half, order) {
    const solid = mesh("box", [0.5, half, 0.001], { colour: new THREE.Color(colour), roughness: 0.8 });
    solid.castShadow = false;
    solid.userData.order = order;
    solid.position.y = y;
    track.add(solid);
    return solid;
  }
  const [ground, line] = [0x15171b, 0xd5dbe6].map((colour) => strip(colour, (left + right) / 2, (right - left) / 2, 0.5));
  const whites = keys.filter(({ black }, i) => !black && !keys[i - 1]?.black).map(({ pos, size }) => pos[1] - size[1]);
  const lanes = whites.map((y) => strip(0x343a45, y, LANE, 0.55));
  function lay(solid, from, long, height) {
    solid.scale.x = long;
    solid.position.setX(from + long / 2).setZ(height);
  }

  const coming = COMING_NOTES.map((colours) => colours.map((colour) => new THREE.Color(colour)));
  const ink = new THREE.Color(0x10141c);
  /** Boxes that are used again in each picture: `next()` is one of them. */
  function pool(order) {
    const solids = [];
    let used = 0;
    return {
      next() {
        if (used === solids.length) {
          const solid = mesh("box", [0.5, 0.5, 0.5], { colour: ink.clone(), roughness: 0.6 });
          solid.castShadow = false;
          solid.userData.order = order;
          solids.push(solid);
          track.add(solid);
        }
        solids[used].visible = true;
        return solids[used++];
      },
      begin() { used = 0; },
      end() { for (let i = used; i < solids.length; i++) solids[i].visible = false; },
    };
  }
  const solids = pool(0.6), strokes = pool(0.7);

  function put({ key, from, to }, start, end, now, colour, glow = GLOW.before) {
    const solid = solids.next(), x = (time) => (time - now + TRACK.past) * speed;
    const near = x(Math.max(from, start)), far = x(Math.min(to, end));
    solid.scale.set(Math.max(far - near - 0.001, 5e-4), keys[key].black ? 0.009 : 0.013, 0.003);
    solid.position.set((near + far) / 2, keys[key].pos[1], keys[key].black ? -0.001 : 0);
    solid.material.color.copy(colour);
    solid.material.emissive.copy(colour).multiplyScalar(glow);
    return [near, far];
  }

  function putComing(note, time, end) {
    const [hand, number] = note.finger ?? [2], { black, pos } = keys[note.key];
    const [near, far] = put(note, time, end, time, coming[hand][Number(black)]);
    const room = far - near - 2 * NUMBER.edge, high = Math.min(NUMBER.high, room);
    if (high < NUMBER.high / 2) return;
    for (const [up, right, length, stands] of STROKES[number - 1] ?? []) {
      const stroke = strokes.next(), long = length * (stands ? high : NUMBER.wide) + NUMBER.stroke;
      stroke.scale.set(stands ? long : NUMBER.stroke, stands ? NUMBER.stroke : long, 5e-4);
      stroke.position.set(near + NUMBER.edge + up * high, pos[1] + right * NUMBER.wide, black ? -0.003 : -0.002);
    }
  }

  let numbered = null; // the fingers that notes have; in the studio they come later
  return {
    track,
    /** Has the track be so long [m], if it may; returns how far it goes back and up [m]. */
    extend(wished) {
      length = Math.min(Math.max(wished, SHORTEST_TRACK), LONGEST_TRACK);
      speed = length / (TRACK.ahead + TRACK.past);
      lay(ground, 0, TRACK.drawn * length, 0.004);
      for (const lane of lanes) lay(lane, 0, TRACK.drawn * length, 0.0035);
      lay(line, TRACK.past * speed - 0.001, 0.002, 0.0025);
      return [length * Math.cos(TRACK.slope), length * Math.sin(TRACK.slope)];
    },
    move(time) {
      if (numbered !== data.fingers) addFingers(goal, data);
      numbered = data.fingers;
      solids.begin();
      strokes.begin();
      const end = time + TRACK.drawn * TRACK.ahead, start = time - TRACK.past;
      within(goal, longest, time, end, (note) => putComing(note, time, end));
      notesBetween(data, start, time, (note) => put(note, start, time, time, colours[note.state - 1], note.to < time ? GLOW.after : GLOW.now));
      solids.end();
      strokes.end();
    },
  };
}
