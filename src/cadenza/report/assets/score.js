// The engraved score (see cadenza.report.engraving), which follows the music.

/** What `engraving_of` has put into a text; its notes are [pitch, beginning, end in s]. */
const readEngraving = async (text) => JSON.parse(await unpackedText(text));

const HEAD = 217, SPOT = 150; // width of a note's head and radius of the spot about it, in units of a drawing
const BEFORE_THE_CURSOR = 0.15, WITH_THE_CURSOR = 0.85; // of a screen that is narrower than a system
const TURNING = 700; // [ms] that a browser takes to scroll smoothly
const AHEAD = 0.4; // [s] before its first note that a system is turned to
const STAFF = 720, SMALLEST_STAFF = 20; // height of a staff, in units of a drawing and at least [px]
const ROOM = 0.38; // of the window's height, for three systems; where it is too little, or narrow, there is one
const SVG_NAMES = "http://www.w3.org/2000/svg";
const addDrawing = (name, attributes, parent) => {
  const element = document.createElementNS(SVG_NAMES, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent.append(element);
  return element;
};

/** Where the middle of a note's head is. */
const middleOf = (note) => Number(note.querySelector("use").getAttribute("x")) + HEAD / 2;

/** Draws the systems of an engraving one below the other. */
function drawSystems(element, { glyphs, systems }) {
  addDrawing("svg", { class: "glyphs", width: 0, height: 0, "aria-hidden": true }, element).innerHTML = `<defs>${glyphs}</defs>`;
  return systems.map(({ width, height, bars, svg }) => {
    const [first, last] = [bars[0].number, bars.at(-1).number];
    const label = first === last ? `Bar ${first}` : `Bars ${first} to ${last}`;
    const drawing = addDrawing("svg", { class: "system", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label }, element);
    drawing.innerHTML = svg;
    return { drawing, width, height, bars, begin: bars[0].begin, anchors: [] };
  });
}

/** The notes by their beginning: `key`, `from` and `to` [s], and what is drawn of each: of tied ones all parts. */
function drawnNotes(element, { notes }, lowest) {
  const found = notes.map(([pitch, from, to]) => ({ key: pitch - lowest, from, to, parts: [] }));
  for (const part of element.querySelectorAll("[data-note]")) {
    part.prepend(addDrawing("circle", { class: "spot", cx: middleOf(part), cy: part.querySelector("use").getAttribute("y"), r: SPOT }, part));
    found[part.dataset.note].parts.push(part);
  }
  return found;
}

/** Gives each system its anchors [time in s, x], between which the cursor moves evenly. */
function placeAnchors(systems, notes) {
  const ofDrawing = new Map(systems.map((system) => [system.drawing, system]));
  for (const { from, parts: [first] } of notes) ofDrawing.get(first.ownerSVGElement).anchors.push([from, middleOf(first)]);
  const SAME = 1e-3; // [s]
  for (const { bars, anchors } of systems) {
    for (const { begin, left } of bars) {
      if (!anchors.some(([time]) => Math.abs(time - begin) < SAME)) anchors.push([begin, left]);
    }
    anchors.push([bars.at(-1).end, bars.at(-1).right]);
    anchors.sort(([a], [b]) => a - b);
    let farthest = 0;
    for (const anchor of anchors) anchor[1] = farthest = Math.max(farthest, anchor[1]);
  }
}

/** Where the cursor is in a system at a time [s]. */
function placeAt(anchors, time) {
  const next = anchors.findIndex(([at]) => at > time);
  if (next <= 0) return anchors.at(next)[1];
  const [[before, left], [after, right]] = [anchors[next - 1], anchors[next]];
  return left + ((right - left) * (time - before)) / (after - before);
}

/**
 * A score whose notes are coloured as they are hit or missed, and which turns with the music; clicks
 * seek. `data` is a recording (see recording.js), whose states may yet be coming.
 */
function createScore(element, engraving, data, seek) {
  const systems = drawSystems(element, engraving), notes = drawnNotes(element, engraving, data.lowest);
  placeAnchors(systems, notes);
  $("sheet-remarks").replaceChildren(...engraving.remarks.map((remark) => make("p", remark, { className: "remark" })));
  const cursor = make("div", [], { className: "cursor" }), longest = longestOf(notes);
  element.append(cursor);
  let now = 0, width = 0, narrow = false, shown = null, sounding = new Set(), touchedAt = -Infinity, turnedAt = -Infinity;
  const bars = systems.flatMap(({ bars }) => bars);

  const stateOf = ({ key }, row) => data.states[row * data.keys + key];
  /** Whether a note has not sounded at all, as far as is known. */
  function isLost(note) {
    const first = Math.floor(note.from / data.dt + 1e-6), last = Math.max(Math.ceil(note.to / data.dt - 1e-6), first + 1), found = new Set();
    for (let row = first; row < Math.min(last, data.steps); row++) found.add(stateOf(note, row));
    return found.has(MISSED) && !found.has(HIT) && !found.has(COMING);
  }
  function mark(note, isSounding, state) {
    for (const part of note.parts) {
      part.classList.toggle("sounding", isSounding);
      part.classList.toggle("hit", isSounding && state === HIT);
      part.classList.toggle("missed", state === MISSED);
    }
  }
  const rest = (note) => mark(note, false, isLost(note) ? MISSED : 0);
  function colour(time) {
    const { row } = rowAt(time, data.dt, data.steps), before = sounding;
    sounding = new Set();
    within(notes, longest, time, time + 1e-6, (note) => sounding.add(note));
    for (const note of before) if (!sounding.has(note)) rest(note);
    for (const note of sounding) mark(note, true, stateOf(note, row));
  }

  /** Makes room for three systems, somewhat smaller where it must be, or for one. */
  function fitSystems() {
    const [{ drawing, width: wide }] = systems, style = getComputedStyle(drawing);
    const [above, below, left, right] = ["Top", "Bottom", "Left", "Right"].map((side) => parseFloat(style[`padding${side}`]));
    const tallest = Math.max(...systems.map(({ height }) => height)), full = Math.max(width, parseFloat(style.minWidth)) - left - right;
    const number = full + left + right > width ? 1 : Math.min(systems.length, 3), scale = Math.min((ROOM * innerHeight / number - above - below) / tallest, full / wide);
    const isLegible = STAFF * scale >= SMALLEST_STAFF || scale === full / wide;
    element.style.setProperty("--wide", `${(isLegible ? scale * wide : full) + left + right}px`);
    const height = isLegible ? number * (scale * tallest + above + below) : (full / wide) * tallest + above + below;
    element.closest(".performance").style.setProperty("--systems", `${Math.ceil(height) + element.offsetHeight - element.clientHeight}px`);
  }

  /** Notes where the systems are in the element [px], so that nothing has to be measured while it plays. */
  function measure() {
    [width, shown] = [element.clientWidth, null];
    if (!width) return; // it is hidden
    fitSystems();
    const { left, top } = element.getBoundingClientRect();
    for (const system of systems) {
      const { a: scale, e, f } = system.drawing.getScreenCTM();
      system.place = { scale, left: e - left + element.scrollLeft, top: f - top + element.scrollTop, height: system.height * scale };
    }
    narrow = element.scrollWidth > width + 1;
  }

  /** Scrolls to the cursor, at `x` [px]: a system that is new to the middle, and a narrow screen sideways. */
  function turnTo(system, x, jumped) {
    const isTurned = system === shown, at = x - element.scrollLeft;
    const isAway = narrow && (at < 0 || at > WITH_THE_CURSOR * width) && (jumped || performance.now() - turnedAt > TURNING);
    if (isTurned && !isAway) return;
    shown = system;
    turnedAt = performance.now();
    const behavior = jumped || matchMedia("(prefers-reduced-motion: reduce)").matches ? "instant" : "smooth";
    const { clientHeight: high, scrollHeight } = element, middle = system.place.top + system.place.height / 2;
    const top = Math.max(Math.min(middle - high / 2, scrollHeight - high), 0), isWhole = ({ place }) => place.top >= top && place.top + place.height <= top + high;
    for (const each of systems) each.drawing.classList.toggle("cut", each !== system && !isWhole(each));
    element.classList.remove("searched");
    element.scrollTo({ behavior, left: narrow ? x - BEFORE_THE_CURSOR * width : 0, top });
  }

  function move(time) {
    const jumped = Math.abs(time - now) > 0.5 || time < now, isStill = time === now;
    now = time;
    if (jumped) notes.forEach(rest);
    colour(time);
    if (!width) return;
    const at = (moment) => systems.findLast(({ begin }) => begin <= moment + 1e-6) ?? systems[0];
    const placeOf = ({ place, anchors }) => place.left + place.scale * placeAt(anchors, time);
    const system = at(time), next = at(time + (jumped || isStill ? 0 : AHEAD)), { place } = system, x = placeOf(system);
    cursor.style.transform = `translate(${x}px, ${place.top}px)`;
    cursor.style.height = `${place.height}px`;
    if (jumped || performance.now() - touchedAt > LOOKING_AROUND) turnTo(next, placeOf(next), jumped || !shown);
  }

  element.addEventListener("click", (event) => {
    const hit = event.target.closest(".note"), drawing = event.target.closest(".system");
    if (hit) return seek(notes[Number(hit.dataset.note)].from);
    const system = systems.find((each) => each.drawing === drawing);
    if (!system) return;
    const { x } = new DOMPoint(event.clientX, event.clientY).matrixTransform(drawing.getScreenCTM().inverse());
    const { anchors } = system, distance = ([, at]) => Math.abs(at - x);
    seek(anchors.slice(0, -1).reduce((nearest, anchor) => (distance(anchor) < distance(nearest) ? anchor : nearest), anchors[0])[0]);
  });
  for (const name of ["wheel", "pointerdown", "touchmove"]) {
    element.addEventListener(name, () => {
      touchedAt = performance.now();
      element.classList.add("searched");
    }, { passive: true });
  }
  element.addEventListener("keydown", (event) => {
    const step = { PageUp: -1, PageDown: 1 }[event.key];
    if (!step) return;
    const here = bars.findLastIndex(({ begin }) => begin <= now + 1e-3);
    seek(bars[Math.min(Math.max(here + step, 0), bars.length - 1)].begin);
    event.preventDefault();
  });
  notes.forEach(rest);
  const fit = () => {
    measure();
    move(now);
  };
  new ResizeObserver(() => requestAnimationFrame(fit)).observe(element); // it changes its own height
  return { move, engraving };
}

/** Shows or hides the score, as its button says. */
function toggleScore() {
  press($("show-score"), !isPressed($("show-score")));
  $("score").hidden = !isPressed($("show-score"));
}

/** Adds downloads of the score, as MusicXML and as a drawing, and a button that prints it. */
function offerScore(downloads, { engraving }) {
  const offer = (label, file, type, content) => {
    const href = URL.createObjectURL(new Blob([content], { type }));
    downloads.append(make("a", label, { className: "button", download: file, href }));
  };
  offer("MusicXML", "score.musicxml", "application/vnd.recordare.musicxml+xml", engraving.musicxml);
  const { systems, frame: [before, after] } = engraving;
  const placed = systems.map(({ top, svg }) => `<g transform="translate(0,${top})">${svg}</g>`);
  offer("Score (SVG)", "score.svg", "image/svg+xml", [before, ...placed, after].join(""));
  const print = make("button", "Print score", { type: "button", className: "button" });
  print.addEventListener("click", () => {
    document.documentElement.classList.add("prints-score");
    window.print();
  });
  window.addEventListener("afterprint", () => document.documentElement.classList.remove("prints-score"));
  downloads.append(print);
}
