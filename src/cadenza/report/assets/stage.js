// The performance in three dimensions. The world is the simulation's: x towards the player,
// y to the player's right, z up, in metres.

const VIEWS = { // from where the camera looks at the keyboard
  player: [0.4, 0, 0.92], top: [0.005, 0, 1], audience: [-0.8, 0, 0.62], side: [-0.5, -0.8, 0.5],
};

/** A recording in three dimensions: `move(time)` puts bodies and keys where they were. */
function createStage(canvas, { scene: parts, jointsAt, angles, states, dt, steps }, colours) {
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(28, 1, 0.05, 20);
  camera.up.set(0, 0, 1);
  const renderer = createRenderer(canvas);
  if (!renderer.flat) light(scene, renderer);

  const hands = createHands(parts.skeleton);
  scene.add(hands.root);
  for (const geom of parts.geoms) {
    const colour = new THREE.Color().setRGB(...geom.rgba.slice(0, 3), "srgb");
    const solid = mesh(geom.type, geom.size, colour, geom.finger === null ? 0.45 : 0.35);
    solid.position.fromArray(geom.pos);
    solid.quaternion.copy(quaternion(geom.quat));
    solid.renderOrder = geom.body < 0 ? 0 : 3;
    (geom.body < 0 ? scene : hands.bodies[geom.body]).add(solid);
  }
  const keys = parts.keys.map((key) => {
    const hinge = new THREE.Group();
    hinge.position.fromArray(key.hinge);
    const solid = mesh("box", key.size, new THREE.Color(key.black ? 0x17181b : 0xf4f1ea), key.black ? 0.25 : 0.35);
    solid.position.fromArray(key.pos).sub(hinge.position);
    solid.renderOrder = key.black ? 2 : 1;
    scene.add(hinge.add(solid));
    const marked = key.black ? 0.85 : 1;
    return {
      hinge, solid, axis: new THREE.Vector3(...key.axis), travel: key.travel, state: 0,
      colours: [solid.material.color.clone(), ...colours.map((c) => new THREE.Color(c).multiplyScalar(marked))],
    };
  });
  scene.updateMatrixWorld();
  const keyboard = new THREE.Box3();
  for (const key of keys) keyboard.expandByObject(key.solid);
  scene.add(...furniture(keyboard));

  const target = new THREE.Vector3(0.07, 0, 0.03);
  const controls = new THREE.OrbitControls(camera, canvas);
  Object.assign(controls, { enableDamping: true, dampingFactor: 0.12, minDistance: 0.15, maxDistance: 5, maxPolarAngle: 1.55, enableZoom: false });
  // The wheel scrolls the page until the picture has been touched.
  canvas.addEventListener("pointerdown", () => { controls.enableZoom = true; });
  canvas.addEventListener("pointerleave", () => { controls.enableZoom = false; });
  let stale = true, view = "player";
  controls.addEventListener("change", () => { stale = true; });
  controls.addEventListener("start", () => { view = null; });

  /** Looks from a named side, as near as keeps the whole keyboard and the hands' room in sight. */
  function look(name) {
    view = name;
    const away = new THREE.Vector3(...VIEWS[name]).normalize();
    const room = keyboard.clone().expandByPoint(new THREE.Vector3(0.24, 0, 0.1));
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => new THREE.Vector3(
      i & 1 ? room.max.x : room.min.x, i & 2 ? room.max.y : room.min.y, i & 4 ? room.max.z : room.min.z));
    for (let distance = 0.5; distance < 5; distance *= 1.02) {
      camera.position.copy(target).addScaledVector(away, distance);
      camera.lookAt(target);
      camera.updateMatrixWorld();
      const inside = (p) => (p = p.clone().project(camera), Math.abs(p.x) < 0.98 && Math.abs(p.y) < 0.95);
      if (corners.every(inside)) break;
    }
    controls.target.copy(target);
    controls.update();
    stale = true;
  }

  let coarse = false;
  function fit() {
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width || !height) return;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * (coarse ? 0.5 : 1));
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    if (view) look(view);
    stale = true;
  }
  new ResizeObserver(fit).observe(canvas);

  let shown = -1;
  function move(time) {
    if (time === shown) return;
    shown = time;
    stale = true;
    const { row, next, blend } = rowAt(time, dt, steps);
    hands.pose(jointsAt(time));
    keys.forEach((key, k) => {
      const a = angles[row * keys.length + k], b = angles[next * keys.length + k];
      key.hinge.quaternion.setFromAxisAngle(key.axis, ((a + blend * (b - a)) / 255) * key.travel);
      const state = states[row * keys.length + k];
      if (state === key.state) return;
      key.state = state;
      key.solid.material.color.copy(key.colours[state]);
      key.solid.material.emissive?.copy(key.colours[state]).multiplyScalar(state ? 0.4 : 0);
    });
  }

  return {
    move,
    look,
    /** Draws if anything changed; `quick` trades sharpness for speed. */
    draw(quick) {
      if (quick !== coarse) {
        coarse = quick;
        fit();
      }
      controls.update();
      if (!stale) return;
      stale = false;
      renderer.render(scene, camera);
    },
  };
}

const quaternion = ([w, x, y, z]) => new THREE.Quaternion(x, y, z, w);

function mesh(type, size, colour, roughness) {
  const [a, b, c] = size;
  const geometry = {
    box: () => new THREE.RoundedBoxGeometry(2 * a, 2 * b, 2 * c, 2, Math.min(0.0015, 0.3 * Math.min(a, b, c))),
    capsule: () => new THREE.CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2),
    cylinder: () => new THREE.CylinderGeometry(a, a, 2 * b, 32).rotateX(Math.PI / 2),
    sphere: () => new THREE.SphereGeometry(a, 24, 16),
    ellipsoid: () => new THREE.SphereGeometry(1, 24, 16).scale(a, b, c),
  }[type]();
  const solid = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: colour, roughness, metalness: 0.05 }));
  solid.castShadow = solid.receiveShadow = true;
  solid.userData = { type, size };
  return solid;
}

/** What the simulation leaves out: the bed under the keys, two cheeks, and a floor for shadows. */
function furniture(keyboard) {
  const wood = new THREE.Color(0x1c1d21);
  const { min, max } = keyboard;
  const width = (max.y - min.y) / 2 + 0.022, depth = (max.x - min.x) / 2 + 0.01;
  const bed = mesh("box", [depth, width, 0.011], wood, 0.3);
  bed.position.set((min.x + max.x) / 2 + 0.004, 0, min.z - 0.012);
  const cheeks = [-1, 1].map((side) => {
    const cheek = mesh("box", [depth, 0.009, 0.019], wood, 0.3);
    cheek.position.set(bed.position.x, side * (width - 0.009), min.z + 0.018);
    return cheek;
  });
  const floor = new THREE.Mesh(new THREE.PlaneGeometry(6, 6), new THREE.ShadowMaterial({ opacity: 0.28 }));
  floor.position.z = min.z - 0.024;
  floor.receiveShadow = true;
  return [bed, ...cheeks, floor];
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
  sun.shadow.mapSize.set(2048, 2048);
  Object.assign(sun.shadow.camera, { left: -0.85, right: 0.85, top: 0.7, bottom: -0.7, near: 0.3, far: 4 });
  sun.shadow.normalBias = 0.002;
  sun.shadow.radius = 5;
  scene.add(sun, sun.target);
}

function createRenderer(canvas) {
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  } catch {
    return createFlatRenderer(canvas);
  }
  renderer.shadowMap.enabled = true;
  renderer.toneMapping = THREE.NeutralToneMapping;
  return renderer;
}
