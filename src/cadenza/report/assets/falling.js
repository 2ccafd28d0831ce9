// The notes of the score, sliding down a track behind the keyboard onto their keys: grey until they
// arrive, then in the colour of what became of them.

const TRACK = { ahead: 2.4, past: 0.35, speed: 0.075, slope: 0.5 }; // [s], [s], [m/s], [rad]
const TRACK_LENGTH = (TRACK.ahead + TRACK.past) * TRACK.speed;

/** Behind those `keys` of the scene that lie from number `low` to `high` of the `keyboard`. */
function createFallingNotes(data, keys, keyboard, [low, high], colours) {
  const goal = notes(data, wanted), longest = longestOf(goal);
  const track = new THREE.Group();
  track.position.set(keyboard.min.x - 0.012, 0, keyboard.max.z + 0.016);
  track.quaternion.setFromAxisAngle(new THREE.Vector3(0, 1, 0), Math.PI + TRACK.slope); // x is away
  const [left, right] = [keys[low].pos[1] - 0.03, keys[high].pos[1] + 0.03];
  const strip = (from, length, colour, height) => {
    const solid = mesh("box", [length / 2, (right - left) / 2, 0.001], new THREE.Color(colour), 0.8);
    solid.position.set(from + length / 2, (left + right) / 2, height);
    solid.castShadow = false;
    solid.renderOrder = 0.5;
    track.add(solid);
  };
  strip(0, TRACK_LENGTH, 0x23272f, 0.004);
  strip(TRACK.past * TRACK.speed - 0.0015, 0.003, 0xd5dbe6, 0.0025);

  const coming = [false, true].map((black) => new THREE.Color(black ? 0x8d97a8 : 0xcdd4e0));
  const solids = [];
  let used = 0;
  function put({ key, from, to }, start, end, now, colour) {
    if (used === solids.length) {
      const solid = mesh("box", [0.5, 0.5, 0.5], coming[0].clone(), 0.6);
      solid.castShadow = false;
      solid.renderOrder = 0.6;
      solids.push(solid);
      track.add(solid);
    }
    const solid = solids[used++], x = (time) => (time - now + TRACK.past) * TRACK.speed;
    const near = x(Math.max(from, start)), far = x(Math.min(to, end));
    solid.visible = true;
    solid.scale.set(Math.max(far - near - 0.001, 5e-4), keys[key].black ? 0.009 : 0.013, 0.003);
    solid.position.set((near + far) / 2, keys[key].pos[1], keys[key].black ? -0.001 : 0);
    solid.material.color.copy(colour);
    solid.material.emissive.copy(colour).multiplyScalar(0.35);
  }

  return {
    track,
    /** How far the track goes back and up [m]. */
    end: [TRACK_LENGTH * Math.cos(TRACK.slope), TRACK_LENGTH * Math.sin(TRACK.slope)],
    move(time) {
      used = 0;
      const end = time + TRACK.ahead, start = time - TRACK.past;
      within(goal, longest, time, end, (note) => put(note, time, end, time, coming[Number(keys[note.key].black)]));
      notesBetween(data, start, time, (note) => put(note, start, time, time, colours[note.state - 1]));
      for (let i = used; i < solids.length; i++) solids[i].visible = false;
    },
  };
}
