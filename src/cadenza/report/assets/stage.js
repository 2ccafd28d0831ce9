// The performance in three dimensions. The world is the simulation's: x towards the player,
// y to the player's right, z up, in metres.

/** From where cameras look, by their names: as the buttons have it from `cadenza.cameras`. */
const VIEWS = Object.fromEntries([...document.querySelectorAll("[data-view]")].map(({ dataset: { view, from } }) => [view, from.split(" ").map(Number)]));
const DEPTH = 0.4; // [m] of keyboard and forearms as cameras see them, about; a picture may leave more to falling notes
const FADED = 0.28; // opacity of a palm while it hides a key that sounds
const ALONG_KEY = [-0.4, 0, 0.4, 0.8]; // halves of a key's length from its middle; half of these are to be seen
const FADING = 0.15, APPEARING = 0.8; // [s] that a palm takes to fade, and to be solid again

/**
 * Poses of step rows, blended between rows: `move(time)` puts bodies and keys where they were.
 * Drawn flat, on a canvas of its own over `canvas`, where software would have to draw WebGL.
 */
function createStage(canvas, data, colours) {
  const { scene: parts, jointsAt, angles, states, dt, steps } = data;
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.05, 20);
  camera.up.set(0, 0, 1);
  const overlay = canvas.cloneNode();
  for (const name of ["id", "tabindex", "role", "aria-label"]) overlay.removeAttribute(name);
  overlay.setAttribute("aria-hidden", "true");
  overlay.style.pointerEvents = "none";
  canvas.after(overlay);
  const flatRenderer = createFlatRenderer(overlay);
  let renderer = flatRenderer, solidRenderer = null;

  const hands = createHands(parts.skeleton);
  scene.add(hands.root);
  const palms = new Map(); // the root of a hand -> its palm
  function put(solid, { body, palm }) {
    (body < 0 ? scene : hands.bodies[body]).add(solid);
    if (!palm) return;
    const root = rootOf(parts.skeleton, body);
    if (!palms.has(root)) palms.set(root, createPalm());
    palms.get(root).add(solid);
  }
  for (const geom of parts.geoms) {
    const colour = new THREE.Color().setRGB(...geom.rgba.slice(0, 3), "srgb");
    const solid = mesh(geom.type, geom.size, { colour, roughness: geom.finger === null ? 0.45 : 0.35 });
    solid.position.fromArray(geom.pos);
    solid.quaternion.copy(quaternion(geom.quat));
    solid.userData.order = geom.body < 0 ? 0 : 3;
    put(solid, geom);
  }
  for (const shell of parts.shells ?? []) put(hull(shell), shell); // earlier recordings have none
  const [white, black] = (parts.key_materials ?? [{ rgba: [0.95, 0.93, 0.88] }, { rgba: [0.05, 0.05, 0.05] }]).map(look);
  const keys = parts.keys.map((key) => {
    const hinge = new THREE.Group();
    hinge.position.fromArray(key.hinge);
    const solid = mesh("box", key.size, key.black ? black : white);
    solid.position.fromArray(key.pos).sub(hinge.position);
    solid.userData.order = key.black ? 2 : 1;
    scene.add(hinge.add(solid));
    const marked = key.black ? 0.85 : 1;
    return {
      hinge, solid, half: key.size, axis: new THREE.Vector3(...key.axis), travel: key.travel, state: 0,
      colours: [solid.material.color.clone(), ...colours.map((c) => new THREE.Color(c).multiplyScalar(marked))],
    };
  });
  scene.updateMatrixWorld();
  const keyboard = new THREE.Box3();
  for (const key of keys) keyboard.expandByObject(key.solid);
  const piano = keyboard.clone();
  for (const piece of parts.furniture ?? []) { // earlier recordings have none
    const solid = mesh("box", piece.size, look(piece));
    solid.position.fromArray(piece.pos);
    solid.quaternion.copy(quaternion(piece.quat));
    scene.add(solid);
    piano.expandByObject(solid);
  }
  scene.add(floor(keyboard.min.z - 0.026));
  const inUse = range(data).map((key, i) => Math.min(Math.max(key + (i ? 3 : -3), 0), parts.keys.length - 1));
  const falling = createFallingNotes(data, parts.keys, keyboard, colours.map((c) => new THREE.Color(c)));
  falling.track.visible = false;
  falling.extend(0); // until there is a camera that leaves it more
  scene.add(falling.track);

  const controls = new THREE.OrbitControls(camera, canvas);
  Object.assign(controls, { enableDamping: true, dampingFactor: 0.12, minDistance: 0.15, maxDistance: 5, maxPolarAngle: 1.55, enableZoom: false });
  // The wheel scrolls the page until the picture has been touched.
  canvas.addEventListener("pointerdown", () => { controls.enableZoom = true; });
  canvas.addEventListener("pointerleave", () => { controls.enableZoom = false; });
  canvas.style.touchAction = "pan-y"; // a finger turns the picture sideways, and scrolls the page
  let stale = true, view = "player", shown = -1, drawnAt = performance.now();
  controls.addEventListener("change", () => { stale = true; });
  controls.addEventListener("start", () => { view = null; });

  const outline = outlineOf(piano), follow = createFollower(data), away = new THREE.Vector3();
  /** What cameras look at: from afar, the keys in use and all that hands reach; close by, the hands now; and these as far apart as they get. */
  function sights() {
    const { left, right, elbows, rear, reach, height, widest } = follow(Math.max(shown, 0)), whole = keyboard.clone().union(reach);
    const [low, high] = inUse.map((key) => parts.keys[key].pos[1]);
    [whole.min.y, whole.max.y] = [Math.min(low - 0.015, reach.min.y), Math.max(high + 0.015, reach.max.y)];
    const around = [...outline], [x, y] = VIEWS[view], isBefore = x > Math.abs(y); // the track, on the player's side
    if (falling.track.visible) {
      const wide = view === "close" ? widest : whole.max.y - whole.min.y;
      const [back, up] = falling.extend(isBefore ? wide / camera.aspect - DEPTH : 0);
      const end = falling.track.position.clone().add(new THREE.Vector3(-back, 0, up));
      whole.expandByPoint(end);
      around.push(...pointsOf({ min: end.clone().setY(keyboard.min.y), max: end.clone().setY(keyboard.max.y) }, ALONG));
    }
    if (reach.isEmpty()) return [whole, whole, whole].map((box) => ({ shown: pointsOf(box), around }));
    const between = (from, to) => new THREE.Box3(reach.min.clone().setY(from), reach.max.clone().setY(to));
    const middle = (left + right) / 2, farthest = between(middle - widest / 2, middle + widest / 2);
    const beside = (ys, thick) => ys.flatMap((y) => [-thick, thick].map((z) => new THREE.Vector3(rear, y, height + z)));
    const [first, last] = elbows, ends = beside(elbows, THICK), arms = beside([first - ELBOW, last + ELBOW], ELBOW);
    const hasNotes = falling.track.visible && isBefore;
    return [whole, between(left, right), farthest].map((box) => ({ shown: pointsOf(box), around: [...around, ...ends], arms, hasNotes }));
  }

  /** Looks from a named side, if there is one, as near as keeps in sight what is looked at; falling notes have a track as long as that leaves. */
  function place() {
    stale = true;
    if (view) {
      away.set(...VIEWS[view]).normalize();
      const { target, distance, towards } = placed(away, camera.aspect, view === "close", ...sights());
      camera.position.copy(target).addScaledVector(towards, distance);
      controls.target.copy(target);
      controls.update();
    }
    if (falling.track.visible) falling.move(Math.max(shown, 0));
  }

  function fit(width = canvas.clientWidth, height = canvas.clientHeight, ratio = Math.min(devicePixelRatio, 2)) {
    if (!width || !height) return;
    renderer.setPixelRatio(ratio);
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    place();
  }
  const resized = new ResizeObserver(() => fit());
  resized.observe(canvas);

  function move(time) {
    if (time === shown) return;
    shown = time;
    const { row } = rowAt(time, dt, steps), { row: from, next, blend } = stateAt(time, dt, steps);
    hands.pose(jointsAt(time));
    for (let k = 0; k < keys.length; k++) {
      const key = keys[k], a = angles[from * keys.length + k], b = angles[next * keys.length + k];
      key.hinge.quaternion.setFromAxisAngle(key.axis, ((a + blend * (b - a)) / 255) * key.travel);
      const state = states[row * keys.length + k];
      if (state === key.state) continue;
      key.state = state;
      key.solid.material.color.copy(key.colours[state]);
      key.solid.material.emissive.copy(key.colours[state]).multiplyScalar(state ? 0.4 : 0);
    }
    place();
  }

  const surface = ALONG_KEY.map(() => new THREE.Vector3());
  /** Has palms that hide a key that sounds, or should, let one see it. */
  function fade(seconds) {
    scene.updateMatrixWorld();
    const sounding = keys.filter(({ state }) => state);
    for (const palm of palms.values()) {
      const hidden = sounding.some(({ solid, half }) => {
        surface.forEach((point, i) => solid.localToWorld(point.set(ALONG_KEY[i] * half[0], 0, half[2])));
        return surface.filter((point) => palm.hides(point, camera.position)).length > ALONG_KEY.length / 2;
      });
      stale = palm.fade(hidden, seconds) || stale;
    }
  }

  /** Draws flat, or in 3D where this browser can; returns whether it is flat now. */
  function setFlat(flat) {
    if (!flat && !solidRenderer) solidRenderer = createSolidRenderer(canvas, scene);
    renderer = flat || !solidRenderer ? flatRenderer : solidRenderer;
    overlay.hidden = renderer !== flatRenderer;
    if (!overlay.hidden) solidRenderer?.clear(); // it lies under the overlay
    fit();
    return renderer === flatRenderer;
  }
  setFlat(bySoftware());

  return {
    move,
    setFlat,
    get flat() { return renderer === flatRenderer; },
    /** Whether there is anything but the flat view. */
    solid: graphics() !== null,
    /** Whether a graphics card draws. */
    byCard: !bySoftware(),
    look(name) {
      view = name;
      place();
    },
    showNotes(visible) {
      falling.track.visible = visible;
      place();
    },
    /** Has a picture that is in no page this size [px]. */
    fit: (width, height) => fit(width, height, 1),
    /** What is drawn on. */
    get picture() { return renderer === flatRenderer ? overlay : canvas; },
    /** Draws if anything changed; `seconds` have passed since the last time, by default on the wall clock. */
    draw(seconds = (performance.now() - drawnAt) / 1000) {
      controls.update();
      fade(seconds);
      drawnAt = performance.now();
      if (!stale) return;
      stale = false;
      renderer.render(scene, camera);
    },
    /** Lets go of what would outlive the canvas. */
    end() {
      resized.disconnect();
      controls.dispose(); // which listens to the whole page
      solidRenderer?.dispose();
      solidRenderer?.forceContextLoss();
    },
  };
}

/** The body from which a hand's body hangs, or itself. */
const rootOf = (skeleton, body) => (skeleton[body].parent < 0 ? body : rootOf(skeleton, skeleton[body].parent));
const quaternion = ([w, x, y, z]) => new THREE.Quaternion(x, y, z, w);

const SAMPLES = 0.2; // [s] between the poses of which a camera that follows the hands takes notice
const REACTION = 0.4; // [s] over which it averages, before and after
const FARTHEST = 6; // samples to either side; others would not count
const THICK = 0.02, ELBOW = 0.05; // [m] around the middles of fingers; of the ends of forearms

/**
 * Returns what says of a time [s] where the hands' `left` and `right` edges are along the keyboard [m]
 * and where they end at the `rear`, between `elbows`, smoothed; of a hand that has reached no key
 * that sounds, nothing, if another has. Also the box that fingers and palms reach at any time, empty without hands, how far
 * the edges are from each other at the `widest`, and the `height` of their rear end.
 */
function createFollower(data) {
  const { scene, jointsAt, states, dt, steps } = data, hands = createHands(scene.skeleton), at = new THREE.Vector3();
  const solids = [...scene.geoms, ...(scene.shells ?? [])].filter(({ body }) => body >= 0);
  const bodiesOf = (chosen) => [...new Set(solids.filter(chosen).map(({ body }) => body))];
  const ofTips = bodiesOf(({ finger }) => finger !== null), palms = bodiesOf(({ palm }) => palm);
  const isOfHand = (body) => body >= 0 && (palms.includes(body) || ofTips.includes(body) || isOfHand(scene.skeleton[body].parent));
  const rootOfBody = (body) => rootOf(scene.skeleton, body), roots = [...new Set(ofTips.map(rootOfBody))];
  const wholes = roots.map((root) => bodiesOf(({ body }) => isOfHand(body) && rootOfBody(body) === root));
  const edges = wholes.map(() => ({ ends: [], left: [], right: [], elbow: [], rear: [], plays: false }));
  const reach = new THREE.Box3();
  const place = (body) => at.setFromMatrixPosition(hands.bodies[body].matrixWorld);
  let count = 0, height = 0, widest = 0;
  /** Takes notice of a pose. */
  function sample() {
    const time = count++ * SAMPLES, { row } = rowAt(time, dt, steps), now = new THREE.Box3();
    hands.pose(jointsAt(time));
    hands.root.updateMatrixWorld();
    for (const body of [...ofTips, ...palms]) now.expandByPoint(place(body));
    reach.union(now.expandByScalar(THICK));
    wholes.forEach((bodies, hand) => {
      const ys = bodies.map((body) => place(body).y), left = Math.min(...ys), right = Math.max(...ys);
      edges[hand].ends.push([left, right]);
      for (let i = Math.max(count - 1 - FARTHEST, 0); i < count; i++) {
        const near = edges[hand].ends.slice(Math.max(i - FARTHEST, 0), i + FARTHEST + 1);
        edges[hand].left[i] = Math.min(...near.map(([from]) => from));
        edges[hand].right[i] = Math.max(...near.map(([, to]) => to));
      }
      edges[hand].rear.push(place(roots[hand]).x);
      edges[hand].elbow.push(at.y);
      height = at.z;
      const within = ({ pos }, key) => [HIT, WRONG, COMING].includes(states[row * scene.keys.length + key]) && pos[1] > left - 0.01 && pos[1] < right + 0.01;
      edges[hand].plays ||= scene.keys.some(within);
    });
  }
  /** The mean of a side around a sample, of which near ones count more. */
  function around(middle, side, choose, playing) {
    let sum = 0, weights = 0;
    for (let i = Math.max(middle - FARTHEST, 0); i <= Math.min(middle + FARTHEST, count - 1); i++) {
      const weight = Math.exp((-Math.abs(i - middle) * SAMPLES) / REACTION);
      sum += weight * choose(...playing.map((hand) => hand[side][i]));
      weights += weight;
    }
    return sum / weights;
  }
  return (time) => {
    const end = Math.min(data.available ?? Infinity, steps * dt); // of what has come
    const isNew = count * SAMPLES <= end;
    while (count * SAMPLES <= end) sample();
    const playing = edges.some(({ plays }) => plays) ? edges.filter(({ plays }) => plays) : edges;
    if (isNew) widest = Math.max(...Array.from({ length: count }, (_, i) => Math.max(...playing.map(({ right }) => right[i])) - Math.min(...playing.map(({ left }) => left[i]))));
    const { row, next, blend } = rowAt(time, SAMPLES, count);
    const edge = (side, choose) => {
      const [from, to] = [row, next].map((middle) => around(middle, side, choose, playing));
      return from + blend * (to - from);
    };
    return { left: edge("left", Math.min) - THICK, right: edge("right", Math.max) + THICK, elbows: [edge("elbow", Math.min), edge("elbow", Math.max)], rear: edge("rear", Math.min), reach, height, widest: widest + 2 * THICK };
  };
}

/** A material as pages have it, of one as recordings have it. */
const look = ({ rgba, roughness = 0.3, metalness = 0.05 }) => ({ colour: new THREE.Color().setRGB(...rgba.slice(0, 3), "srgb"), roughness, metalness });
const materialOf = ({ colour, roughness, metalness = 0.05 }) => litCheaply(new THREE.MeshStandardMaterial({ color: colour, roughness, metalness }));

const BENDS = 5, FEW_BENDS = 3; // of a box from corner to corner, of which the middle one is flat
const ROUND = 0.0015; // [m] of its edges; of large boxes, one does not see that

/** A box with round edges, of its halves [m]. */
function roundedBox(halves) {
  const least = Math.min(...halves), radius = Math.min(ROUND, 0.3 * least), bends = bySoftware() ? FEW_BENDS : BENDS;
  if (radius < 0.01 * least) return new THREE.BoxGeometry(...halves.map((half) => 2 * half));
  const geometry = new THREE.BoxGeometry(1, 1, 1, bends, bends, bends), { position, normal } = geometry.attributes;
  const at = new THREE.Vector3(), corner = new THREE.Vector3(), middle = new THREE.Vector3(...halves).subScalar(radius);
  for (let i = 0; i < position.count; i++) {
    corner.set(...at.fromBufferAttribute(position, i).toArray().map(Math.sign));
    normal.setXYZ(i, ...at.addScaledVector(corner, -0.5 / bends).normalize());
    position.setXYZ(i, ...corner.multiply(middle).addScaledVector(at, radius));
  }
  return geometry;
}
const boxes = new Map(); // white keys share one

function mesh(type, size, material) {
  const [a, b, c] = size;
  const geometry = {
    box() {
      if (!boxes.has(String(size))) boxes.set(String(size), roundedBox(size));
      return boxes.get(String(size));
    },
    capsule: () => new THREE.CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2),
    cylinder: () => new THREE.CylinderGeometry(a, a, 2 * b, 32).rotateX(Math.PI / 2),
    sphere: () => new THREE.SphereGeometry(a, 24, 16),
    ellipsoid: () => new THREE.SphereGeometry(1, 24, 16).scale(a, b, c),
  }[type]();
  const solid = new THREE.Mesh(geometry, materialOf(material));
  solid.castShadow = solid.receiveShadow = true;
  solid.userData = { type, size };
  return solid;
}

const FEW_BALLS = 4, SMALL = 0.01; // [m]; such a hull looks round with fewer vertices, too

/**
 * The convex hull of a shell's balls: of a globe's grid of directions, each vertex is the point
 * that lies farthest in its direction, which is also its normal.
 */
function hull({ balls, ...material }) {
  const isFine = !bySoftware() || balls.length > FEW_BALLS || balls.some(([, , , radius]) => radius > SMALL);
  const geometry = new THREE.SphereGeometry(1, ...(isFine ? [24, 16] : [12, 8]));
  const { position } = geometry.attributes, direction = new THREE.Vector3(), centre = new THREE.Vector3();
  for (let i = 0; i < position.count; i++) {
    direction.fromBufferAttribute(position, i);
    if (Math.abs(direction.y) > 0.999999) direction.set(0, Math.sign(direction.y), 0); // else a flat end has a hole
    const far = balls.map(([x, y, z, radius]) => direction.dot(centre.set(x, y, z)) + radius);
    const [x, y, z, radius] = balls[far.indexOf(Math.max(...far))];
    position.setXYZ(i, x + radius * direction.x, y + radius * direction.y, z + radius * direction.z);
  }
  const solid = new THREE.Mesh(geometry, materialOf(look(material)));
  solid.castShadow = solid.receiveShadow = true;
  const isBand = balls.length > FEW_BALLS && balls.every(([, , z]) => z === balls[0][2]);
  solid.userData = { type: "hull", balls, order: isBand ? 2.5 : 3 }; // only the edge of a band is seen about what it holds
  return solid;
}

/** The solids of a palm, which become translucent together. */
function createPalm() {
  const solids = [], [ray, across, upwards, centre] = [0, 1, 2, 3].map(() => new THREE.Vector3());
  let opacity = 1;
  return {
    add(solid) {
      const veil = new THREE.Mesh(solid.geometry, new THREE.MeshStandardMaterial({ colorWrite: false })); // what overlaps does not add up
      veil.renderOrder = 4; // after all that is solid, so that it shows through
      veil.visible = false;
      solid.add(veil);
      solids.push({ solid, veil });
    },
    /** Whether it lies between a point and the eye: seen along the line, hulls are around it on all sides. */
    hides(point, eye) {
      ray.copy(eye).sub(point).normalize();
      across.set(-ray.y, ray.x, 0).normalize();
      upwards.copy(ray).cross(across);
      return solids.some(({ solid }) => {
        const circles = (solid.userData.balls ?? [[0, 0, 0, solid.userData.size[0]]]).map(([x, y, z, radius]) => {
          solid.localToWorld(centre.set(x, y, z)).sub(point);
          return centre.dot(ray) > 0 ? [centre.dot(across), centre.dot(upwards), radius] : null;
        }).filter(Boolean);
        return circles.length && DIRECTIONS.every(([c, s]) => circles.some(([x, y, radius]) => c * x + s * y + radius > 0));
      });
    },
    /** Goes towards being faded or not for some seconds; returns whether that changes anything. */
    fade(faded, seconds) {
      const goal = faded ? FADED : 1, most = ((1 - FADED) * seconds) / (faded ? FADING : APPEARING);
      const next = opacity + Math.max(-most, Math.min(most, goal - opacity));
      if (next === opacity) return false;
      opacity = next;
      for (const { solid, veil } of solids) {
        const transparent = opacity < 1;
        const needsUpdate = transparent !== solid.material.transparent; // another shader
        Object.assign(solid.material, { transparent, opacity, needsUpdate });
        solid.renderOrder = transparent ? 5 : 0;
        solid.castShadow = !transparent;
        veil.visible = transparent;
      }
      return true;
    },
  };
}
const DIRECTIONS = Array.from({ length: 12 }, (_, i) => [Math.cos((Math.PI * i) / 6), Math.sin((Math.PI * i) / 6)]);

const SHADOW_PIXELS = 2048; // of a side of what the sun sees

/** A floor that is seen by the shadows on it. */
function floor(height) {
  const plane = new THREE.Mesh(new THREE.PlaneGeometry(6, 6), litCheaply(new THREE.ShadowMaterial({ opacity: 0.28 })));
  plane.position.z = height;
  plane.receiveShadow = true;
  return plane;
}

function light(scene, renderer) {
  const generator = new THREE.PMREMGenerator(renderer);
  const room = new THREE.RoomEnvironment();
  room.rotation.x = Math.PI / 2; // the room's up is y
  scene.environment = generator.fromScene(room, 0.04).texture;
  scene.environmentIntensity = 0.55;
  const sun = new THREE.DirectionalLight(0xfff4e6, 2.1);
  sun.position.set(0.5, -0.7, 1.6);
  sun.castShadow = true;
  sun.shadow.mapSize.setScalar(SHADOW_PIXELS);
  Object.assign(sun.shadow.camera, { left: -0.85, right: 0.85, top: 0.7, bottom: -0.7, near: 0.3, far: 4 });
  sun.shadow.normalBias = 0.002;
  sun.shadow.radius = 5;
  scene.add(sun, sun.target);
}

/** With light and shadows; null where WebGL does not work. */
function createSolidRenderer(canvas, scene) {
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  } catch {
    return null;
  }
  renderer.shadowMap.enabled = true;
  renderer.toneMapping = THREE.NeutralToneMapping;
  light(scene, renderer);
  return renderer;
}
