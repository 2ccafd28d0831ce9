// A picture of the same scene on a plain canvas, for browsers that draw WebGL slowly or not at all:
// boxes as faces, round things as thick lines and ellipses; what lies lower first, of each the
// farthest first. No shadows. Made to draw 60 times a second: it allocates nothing while it plays.

const SHADES = 24;
const SIDES = 28; // of the outline of a hull
const RIM_AND_INSIDE = [[0.45, 0.8], [0.85, 0]]; // brightness, and by how many pixels wider: a stroke takes longer

function createFlatRenderer(canvas) {
  const picture = canvas.getContext("2d"), veil = document.createElement("canvas").getContext("2d");
  let context = picture; // what is drawn on
  const sun = [0.3, -0.4, 0.87];
  const records = new Map(), shapes = [];
  const point = new Float64Array(3); // as it is projected
  const clip = new Float64Array(16); // of the camera, column by column
  let ratio = 1, width = 1, height = 1, eyeX = 0, eyeY = 0, eyeZ = 0;
  let enlarged = 1; // halves of the picture's height that a metre fills at a distance of one
  let near = 0; // how far from the eye the picture begins [m]

  /** The matrix product of what the camera sees and where it is. */
  function aim(camera) {
    const p = camera.projectionMatrix.elements, v = camera.matrixWorldInverse.elements;
    for (let column = 0; column < 4; column++) {
      for (let row = 0; row < 4; row++) {
        let sum = 0;
        for (let i = 0; i < 4; i++) sum += p[row + 4 * i] * v[i + 4 * column];
        clip[row + 4 * column] = sum;
      }
    }
    const e = camera.matrixWorld.elements;
    [eyeX, eyeY, eyeZ] = [e[12], e[13], e[14]];
    enlarged = p[5];
    near = camera.near;
  }
  /** Writes x, y [px] and w of a point of the world (`one` is 1) or of a direction (0). */
  function project(out, at, x, y, z, one) {
    out[at] = clip[0] * x + clip[4] * y + clip[8] * z + clip[12] * one;
    out[at + 1] = clip[1] * x + clip[5] * y + clip[9] * z + clip[13] * one;
    out[at + 2] = clip[3] * x + clip[7] * y + clip[11] * z + clip[15] * one;
  }
  const screenX = (x, w) => (1 + x / w) * 0.5 * width;
  const screenY = (y, w) => (1 - y / w) * 0.5 * height;

  function recordOf(solid) {
    let record = records.get(solid);
    if (!record) {
      const { type, size, balls } = solid.userData;
      const half = balls ? [0, 0, 0] : type === "box" || type === "ellipsoid" ? size : type === "sphere" ? [size[0], size[0], size[0]] : [size[0], size[0], size[1]];
      record = { solid, type, half, axes: new Float64Array(12), homogeneous: new Float64Array(12), corners: new Float64Array(16), balls, circles: new Float64Array(3 * (balls?.length ?? 0)), depth: 0, order: solid.userData.order ?? 0, shades: [], r: -1, g: -1, b: -1 };
      records.set(solid, record);
    }
    return record;
  }

  /** The solid's colour in one of `SHADES` brightnesses, as CSS has it. */
  function paint(record, brightness) {
    const { color } = record.solid.material;
    if (color.r !== record.r || color.g !== record.g || color.b !== record.b) {
      Object.assign(record, { r: color.r, g: color.g, b: color.b });
      record.shades.length = 0;
    }
    const shade = Math.round(brightness * SHADES);
    return (record.shades[shade] ??= "#" + color.clone().multiplyScalar(shade / SHADES).getHexString());
  }

  /** Centre and half axes of the solid, in the world and for the screen. */
  function locate(record) {
    const e = record.solid.matrixWorld.elements, { axes, half, homogeneous } = record;
    for (let i = 0; i < 3; i++) {
      for (let j = 0; j < 3; j++) axes[3 * i + j] = e[4 * i + j] * half[i];
      project(homogeneous, 3 * i, axes[3 * i], axes[3 * i + 1], axes[3 * i + 2], 0);
      axes[9 + i] = e[12 + i];
    }
    project(homogeneous, 9, axes[9], axes[10], axes[11], 1);
    record.depth = Math.hypot(axes[9] - eyeX, axes[10] - eyeY, axes[11] - eyeZ);
    if (record.balls) locateBalls(record, e);
  }

  /** The circles as which the balls of a hull appear: x, y and radius [px]. */
  function locateBalls(record, e) {
    const { balls, circles, axes } = record;
    let nearest = Infinity;
    for (let i = 0; i < balls.length; i++) {
      const [bx, by, bz, radius] = balls[i];
      const x = e[0] * bx + e[4] * by + e[8] * bz + e[12], y = e[1] * bx + e[5] * by + e[9] * bz + e[13], z = e[2] * bx + e[6] * by + e[10] * bz + e[14];
      project(point, 0, x, y, z, 1);
      circles[3 * i] = screenX(point[0], point[2]);
      circles[3 * i + 1] = screenY(point[1], point[2]);
      circles[3 * i + 2] = (radius * enlarged * 0.5 * height) / point[2];
      nearest = Math.min(nearest, point[2]);
      if (i === 0) [axes[9], axes[10], axes[11]] = [0, 0, 0];
      axes[9] += x / balls.length; axes[10] += y / balls.length; axes[11] += z / balls.length;
    }
    record.homogeneous[11] = nearest;
    record.depth = Math.hypot(axes[9] - eyeX, axes[10] - eyeY, axes[11] - eyeZ);
  }

  /** Whether all of the solid is before the camera; what is beside or behind it has no outline. */
  const isBefore = ({ homogeneous: h }) => h[11] - Math.abs(h[2]) - Math.abs(h[5]) - Math.abs(h[8]) > near;

  function drawBox(record) {
    const { axes, homogeneous: h, corners } = record;
    let left = Infinity, right = -Infinity;
    for (let i = 0; i < 8; i++) {
      const a = i & 1 ? 1 : -1, b = i & 2 ? 1 : -1, c = i & 4 ? 1 : -1;
      const w = h[11] + a * h[2] + b * h[5] + c * h[8];
      corners[2 * i] = screenX(h[9] + a * h[0] + b * h[3] + c * h[6], w);
      corners[2 * i + 1] = screenY(h[10] + a * h[1] + b * h[4] + c * h[7], w);
      left = Math.min(left, corners[2 * i]);
      right = Math.max(right, corners[2 * i]);
    }
    if (right < 0 || left > width) return;
    for (let axis = 0; axis < 3; axis++) {
      const x = axes[3 * axis], y = axes[3 * axis + 1], z = axes[3 * axis + 2], square = x * x + y * y + z * z;
      const towards = x * (eyeX - axes[9]) + y * (eyeY - axes[10]) + z * (eyeZ - axes[11]);
      if (Math.abs(towards) <= square) continue; // neither of its two faces is seen
      const sign = towards > 0 ? 1 : -1, first = sign > 0 ? 1 << axis : 0;
      const p = 1 << (axis + 1) % 3, q = 1 << (axis + 2) % 3;
      const lit = (sign * (x * sun[0] + y * sun[1] + z * sun[2])) / Math.sqrt(square);
      context.fillStyle = paint(record, 0.45 + 0.55 * Math.max(0, lit));
      context.beginPath();
      context.moveTo(corners[2 * first], corners[2 * first + 1]);
      context.lineTo(corners[2 * (first | p)], corners[2 * (first | p) + 1]);
      context.lineTo(corners[2 * (first | p | q)], corners[2 * (first | p | q) + 1]);
      context.lineTo(corners[2 * (first | q)], corners[2 * (first | q) + 1]);
      context.fill();
    }
  }

  /** Adds the outline of an ellipsoid, or of a disc (`axes` 2), moved by `shift` of the last axis. */
  function addEllipse(h, shift, axes, wider) {
    const w = h[11] + shift * h[8], x = h[9] + shift * h[6], y = h[10] + shift * h[7];
    let xx = 0, xy = 0, yy = 0;
    for (let i = 0; i < axes; i++) { // derivative of the projection along each half axis
      const dx = ((h[3 * i] - (x / w) * h[3 * i + 2]) / w) * 0.5 * width, dy = (-(h[3 * i + 1] - (y / w) * h[3 * i + 2]) / w) * 0.5 * height;
      xx += dx * dx; xy += dx * dy; yy += dy * dy;
    }
    const mean = (xx + yy) / 2, spread = Math.hypot((xx - yy) / 2, xy), angle = 0.5 * Math.atan2(2 * xy, xx - yy);
    const [cx, cy, major] = [screenX(x, w), screenY(y, w), Math.sqrt(mean + spread) + wider];
    context.moveTo(cx + major * Math.cos(angle), cy + major * Math.sin(angle));
    context.ellipse(cx, cy, major, Math.sqrt(Math.max(mean - spread, 0)) + wider, angle, 0, 2 * Math.PI);
  }

  /** Adds a rod with `round` ends or discs for ends. */
  function addRod(record, round, wider) {
    const { homogeneous: h, half } = record;
    const x0 = screenX(h[9] - h[6], h[11] - h[8]), y0 = screenY(h[10] - h[7], h[11] - h[8]);
    const x1 = screenX(h[9] + h[6], h[11] + h[8]), y1 = screenY(h[10] + h[7], h[11] + h[8]);
    const scale = half[0] * enlarged * 0.5 * height, r0 = scale / (h[11] - h[8]) + wider, r1 = scale / (h[11] + h[8]) + wider;
    const length = Math.hypot(x1 - x0, y1 - y0) || 1, nx = (y1 - y0) / length, ny = (x0 - x1) / length;
    context.moveTo(x0 + r0 * nx, y0 + r0 * ny);
    context.lineTo(x1 + r1 * nx, y1 + r1 * ny);
    context.lineTo(x1 - r1 * nx, y1 - r1 * ny);
    context.lineTo(x0 - r0 * nx, y0 - r0 * ny);
    if (round) {
      const turn = Math.atan2(ny, nx);
      context.moveTo(x0 + r0 * nx, y0 + r0 * ny);
      context.arc(x0, y0, r0, turn, turn + 2 * Math.PI);
      context.moveTo(x1 + r1 * nx, y1 + r1 * ny);
      context.arc(x1, y1, r1, turn, turn + 2 * Math.PI);
    } else {
      addEllipse(h, -1, 2, wider);
      addEllipse(h, 1, 2, wider);
    }
  }

  /** Adds the outline of a hull: in each direction, the farthest point of its circles. */
  function addHull({ circles }, wider) {
    for (let i = 0; i < SIDES; i++) {
      const dx = Math.cos((2 * Math.PI * i) / SIDES), dy = Math.sin((2 * Math.PI * i) / SIDES);
      let best = 0, farthest = -Infinity;
      for (let j = 0; j < circles.length; j += 3) {
        const far = circles[j] * dx + circles[j + 1] * dy + circles[j + 2];
        if (far > farthest) [best, farthest] = [j, far];
      }
      const radius = circles[best + 2] + wider, x = circles[best] + radius * dx, y = circles[best + 1] + radius * dy;
      if (i === 0) context.moveTo(x, y); else context.lineTo(x, y);
    }
    context.closePath();
  }

  function addOutline(record, wider) {
    if (record.balls) { addHull(record, wider); return; }
    if (record.type === "ellipsoid" || record.type === "sphere") addEllipse(record.homogeneous, 0, 3, wider);
    else addRod(record, record.type === "capsule", wider);
  }

  function drawRound(record) {
    for (const [brightness, wider] of RIM_AND_INSIDE) {
      context.beginPath();
      addOutline(record, wider);
      context.fillStyle = paint(record, brightness);
      context.fill();
    }
  }

  /** Those that one sees through, on a veil, so that what overlaps does not add up. */
  function drawTranslucent() {
    let opacity = 0;
    for (const { solid: { material } } of shapes) if (material.transparent) opacity = Math.max(opacity, material.opacity);
    if (!opacity) return;
    context = veil;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    for (const record of shapes) if (record.solid.material.transparent) drawRound(record);
    context = picture;
    context.globalAlpha = opacity;
    context.drawImage(veil.canvas, 0, 0, width, height);
    context.globalAlpha = 1;
  }

  let count = 0;
  function collect(node) {
    if (!node.visible) return;
    if (node.userData.type) {
      const record = recordOf(node);
      locate(record);
      if (isBefore(record)) shapes[count++] = record;
    }
    for (let i = 0; i < node.children.length; i++) collect(node.children[i]);
  }

  return {
    setPixelRatio(value) { ratio = value; },
    setSize(w, h) {
      for (const { canvas: each } of [picture, veil]) [each.width, each.height] = [w * ratio, h * ratio];
      [width, height] = [w, h];
    },
    render(scene, camera) {
      camera.updateMatrixWorld();
      scene.updateMatrixWorld();
      aim(camera);
      count = 0;
      collect(scene);
      shapes.length = count;
      shapes.sort((a, b) => a.order - b.order || b.depth - a.depth);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, width, height);
      for (let i = 0; i < count; i++) {
        if (shapes[i].solid.material.transparent) continue;
        if (shapes[i].type === "box") drawBox(shapes[i]); else drawRound(shapes[i]);
      }
      drawTranslucent();
    },
  };
}
