// A picture of the same scene on a plain canvas, for browsers without WebGL: boxes as faces, round
// things as thick lines; furniture first, then white keys, black keys and hands, of each the
// farthest first. No shadows.

const FACES = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

function createFlatRenderer(canvas) {
  const context = canvas.getContext("2d");
  const sun = new THREE.Vector3(0.3, -0.4, 0.87);
  let ratio = 1, width = 1, height = 1, camera;

  const project = (point) => {
    const depth = point.distanceTo(camera.position);
    const { x, y } = point.clone().project(camera);
    return { x: ((1 + x) / 2) * width, y: ((1 - y) / 2) * height, depth };
  };
  const paint = (colour, brightness) => "#" + colour.clone().multiplyScalar(brightness).getHexString();

  function faces(solid, [a, b, c], shapes) {
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((i) =>
      new THREE.Vector3(i & 1 ? a : -a, i & 2 ? b : -b, i & 4 ? c : -c).applyMatrix4(solid.matrixWorld));
    for (const face of FACES) {
      const [p, q, r, s] = face.map((i) => corners[i]);
      const normal = q.clone().sub(p).cross(s.clone().sub(p)).normalize();
      const middle = p.clone().add(r).multiplyScalar(0.5);
      if (normal.dot(camera.position.clone().sub(middle)) <= 0) continue;
      const points = [p, q, r, s].map(project);
      const fill = paint(solid.material.color, 0.45 + 0.55 * Math.max(0, normal.dot(sun)));
      shapes.push({ order: solid.renderOrder, depth: camera.position.distanceTo(middle), fill, points });
    }
  }

  function rod(solid, radius, half, shapes) {
    const ends = [-half, half].map((z) => project(new THREE.Vector3(0, 0, z).applyMatrix4(solid.matrixWorld)));
    const depth = (ends[0].depth + ends[1].depth) / 2;
    const thickness = (radius * height) / (depth * Math.tan((camera.fov * Math.PI) / 360));
    shapes.push({ order: solid.renderOrder, depth: depth - radius, stroke: paint(solid.material.color, 0.85), points: ends, thickness });
  }

  return {
    flat: true,
    setPixelRatio(value) { ratio = value; },
    setSize(w, h) { [canvas.width, canvas.height] = [w * ratio, h * ratio]; [width, height] = [w, h]; },
    render(scene, seenFrom) {
      camera = seenFrom;
      camera.updateMatrixWorld();
      scene.updateMatrixWorld();
      const shapes = [];
      scene.traverse((solid) => {
        const { type, size } = solid.userData;
        if (type === "box") faces(solid, size, shapes);
        else if (type === "capsule" || type === "cylinder") rod(solid, size[0], size[1], shapes);
        else if (type) rod(solid, size[0], 1e-6, shapes);
      });
      shapes.sort((a, b) => a.order - b.order || b.depth - a.depth);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, width, height);
      context.lineCap = context.lineJoin = "round";
      for (const { points, fill, stroke, thickness } of shapes) {
        context.beginPath();
        points.forEach(({ x, y }) => context.lineTo(x, y));
        context.closePath();
        context.fillStyle = fill;
        context.strokeStyle = stroke ?? fill;
        context.lineWidth = thickness ?? 0.5;
        if (fill) context.fill();
        context.stroke();
      }
    },
  };
}
