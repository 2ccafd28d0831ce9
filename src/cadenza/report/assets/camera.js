// Where a camera stands so that what it looks at fills the picture, as `cadenza.cameras` has it, which knows of no forearms.

const FIELD_OF_VIEW = 28; // [degree]
const MARGINS = [0.97, 0.95]; // of width and height of the picture, that is for what it looks at
const FILLED = 0.88; // of width and height, at least, with what is around; or it turns
const CLOSEST = 0.05; // [m] in front of the camera that is seen
const ROUNDS = 8; // of fitting, after which nothing moves by a pixel
const MAX_TURN = (70 * Math.PI) / 180; // around hands that are too far apart to fill a picture
const HALVINGS = 11; // of it, down to .03 degrees
const ALONG = 65; // points of a long edge, of which some are beside the picture

/** So many points on each long edge of a box. */
function pointsOf({ min, max }, count = 2) {
  const along = Array.from({ length: count }, (_, i) => min.y + ((max.y - min.y) * i) / (count - 1));
  return [min.x, max.x].flatMap((x) => [min.z, max.z].flatMap((z) => along.map((y) => new THREE.Vector3(x, y, z))));
}

/** Points of a case in a box, which is low at the front, and high at the back. */
const outlineOf = (box) => pointsOf(box, ALONG).filter(({ x, z }) => x < box.max.x || z < box.max.z);

/**
 * Places a camera that stands in the direction `away` in a picture of some aspect, and returns what
 * is in the middle of the picture, how far it is [m], and the direction: turned, where hands would
 * not fill the picture while they are farthest apart (`widest`). It looks at the points `shown`
 * of `whole`, or of `hands` if it is `close` or the picture would not be filled, also by the points
 * `around`: from side to side only if it has no notes that fall (`hasNotes`), which would be cut.
 */
function placed(away, aspect, close, whole, hands, widest) {
  const slope = Math.tan((FIELD_OF_VIEW * Math.PI) / 360), slopes = [aspect * slope, slope], up = new THREE.Vector3(0, 0, 1);
  const at = new THREE.Vector3(), target = new THREE.Vector3(), towards = new THREE.Vector3();
  let distance = 1, axes;
  function turn(angle) {
    towards.copy(away).applyAxisAngle(up, angle);
    const side = up.clone().cross(towards).normalize();
    axes = [side, towards.clone().cross(side)];
  }
  /** Where a point is in the picture, which reaches from -1 to 1 both ways. */
  function seen(point) {
    at.copy(point).sub(target);
    const depth = Math.max(distance - at.dot(towards), CLOSEST);
    return axes.map((axis, i) => at.dot(axis) / depth / slopes[i]);
  }
  const between = (places, i) => [Math.min(...places.map((place) => place[i])), Math.max(...places.map((place) => place[i]))];
  const move = (shift) => axes.forEach((axis, i) => target.addScaledVector(axis, shift[i] * slopes[i] * distance));
  /** Has points in the middle, as large as there is room for. */
  function fit(points) {
    new THREE.Box3().setFromPoints(points).getCenter(target);
    distance = 1;
    for (let round = 0; round < ROUNDS; round++) {
      const places = points.map(seen), ends = [0, 1].map((i) => between(places, i));
      move(ends.map(([low, high]) => (low + high) / 2));
      distance *= Math.max(...ends.map(([low, high], i) => (high - low) / 2 / MARGINS[i]));
    }
    return distance;
  }
  /** Returns the bounds of what is seen, each way without what is outside the other way. */
  function extent({ shown, around }) {
    const places = [...shown, ...around].map(seen);
    return axes.map((_, i) => {
      const inside = places.filter((place) => Math.abs(place[1 - i]) <= 1);
      return between(inside.length ? inside : places, i);
    });
  }
  /** How much of width and height is filled. */
  const filled = (sight) => extent(sight).map(([low, high]) => (high - low) / 2);
  /** Moves so that as little as can be is empty, at both edges the same; to the side, so that the ends of forearms are not cut if there is room. */
  function settle(sight) {
    const places = sight.shown.map(seen), whole = between([...places, ...(sight.arms ?? []).map(seen)], 0);
    move(extent(sight).map(([low, high], i) => {
      let shift = high - low < 2 ? (low + high) / 2 : Math.min(high - 1, 0) + Math.max(low + 1, 0);
      if (i === 0) shift = Math.max(Math.min(shift, whole[0] + 1), whole[1] - 1);
      const [first, last] = between(places, i);
      return Math.min(Math.max(shift, Math.min(last - 1, 0)), Math.max(first + 1, 0));
    }));
  }
  /** Turns as little as fills the picture the way in which it is not filled. */
  function turnToFill(sight) {
    let low = 0, high = MAX_TURN;
    const filledAt = (angle) => (turn(angle), fit(sight.shown), filled(sight));
    const way = filledAt(0).findIndex((share) => share < FILLED);
    if (way < 0) return;
    for (let halving = 0; halving < HALVINGS; halving++) {
      const middle = (low + high) / 2;
      if (filledAt(middle)[way] >= FILLED) high = middle;
      else low = middle;
    }
  }
  turn(0);
  let sight = whole;
  const afar = fit(whole.shown), [wide, high] = filled(whole);
  if (close || high < FILLED || (wide < FILLED && !whole.hasNotes)) {
    sight = hands;
    turnToFill(widest);
  }
  const nearest = sight === hands ? fit(hands.shown) : afar;
  distance = close ? nearest : afar;
  for (let round = 0; round < ROUNDS; round++) {
    if (distance > nearest) distance = Math.max(nearest, (distance * Math.min(...filled(sight))) / FILLED);
    settle(sight);
  }
  return { target, distance, towards };
}
