// The piano roll: drawn once, with a cursor that moves over it.

const GUTTER = 44; // [px] left of both charts, so that their cursors stand in line

/** A canvas ready to draw on in CSS pixels. */
function prepare(canvas, height) {
  const ratio = devicePixelRatio, width = canvas.parentElement.clientWidth;
  canvas.style.height = height + "px";
  [canvas.width, canvas.height] = [width * ratio, height * ratio];
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "11px system-ui, sans-serif";
  context.textBaseline = "middle";
  return { context, width, height };
}

const FAINTEST = 0.3; // opacity of the softest notes

/**
 * Hit is filled, missed and coming an outline, wrong hatched: to be told apart without colours. The
 * louder a hit, from 0 to 1, the fuller is its colour.
 */
function drawNote(context, state, colours, x, y, width, height, loudness = 1) {
  const inset = Math.min(1, height / 8);
  [x, y, width, height] = [x + 0.5, y + inset, Math.max(width - 1, 1.5), height - 2 * inset];
  context.beginPath();
  context.roundRect(x, y, width, height, Math.min(3, height / 3, width / 3));
  const colour = colours[state - 1];
  context.fillStyle = context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.save();
  if (state === 1) {
    context.globalAlpha = FAINTEST + (1 - FAINTEST) * loudness;
    context.fill();
    context.restore();
    return;
  }
  context.globalAlpha = state === 2 ? 0.35 : 0.12;
  context.fill();
  context.globalAlpha = 1;
  context.clip();
  if (state === 2) {
    for (let offset = -height; offset < width; offset += 5) {
      context.moveTo(x + offset, y + height);
      context.lineTo(x + offset + height, y);
    }
  }
  context.lineWidth = state === 2 ? 1.8 : 3;
  context.stroke();
  context.restore();
}

/**
 * A chart over time: clicks and drags seek, the cursor follows, `span()` is what is in sight. With
 * `pan(seconds)`, fingers and sideways wheels shift what is in sight, and a tap seeks.
 */
function timeline(element, span, seek, pan) {
  const cursor = element.querySelector(".cursor");
  const scale = () => { const [start, end] = span(); return (end - start) / (element.clientWidth - GUTTER); };
  const at = (event) => {
    const share = (event.clientX - element.getBoundingClientRect().left - GUTTER) * scale(), [start, end] = span();
    seek(Math.min(Math.max(start + share, start), end));
  };
  let held = null, moved = false;
  element.addEventListener("pointerdown", (event) => {
    [held, moved] = [event.clientX, false];
    element.setPointerCapture(event.pointerId);
    if (!pan || event.pointerType !== "touch") at(event);
  });
  element.addEventListener("pointermove", (event) => {
    if (!element.hasPointerCapture(event.pointerId)) return;
    if (!pan || event.pointerType !== "touch") return at(event);
    if (!moved && Math.abs(event.clientX - held) < 6) return;
    pan((held - event.clientX) * scale());
    [held, moved] = [event.clientX, true];
  });
  element.addEventListener("pointerup", (event) => {
    if (pan && event.pointerType === "touch" && !moved) at(event);
  });
  if (pan) element.addEventListener("wheel", (event) => {
    const sideways = event.shiftKey ? event.deltaX || event.deltaY : event.deltaX;
    if (Math.abs(sideways) <= Math.abs(event.shiftKey ? 0 : event.deltaY)) return;
    event.preventDefault();
    pan(sideways * scale());
  }, { passive: false });
  return (time) => {
    const [start, end] = span();
    const share = (time - start) / (end - start);
    cursor.hidden = share < 0 || share > 1;
    cursor.style.transform = `translateX(${GUTTER + share * (element.clientWidth - GUTTER)}px)`;
  };
}

const ROLL_WINDOW = 24; // [s] in sight at once of a longer piece, on a wide screen
const ROLL_SCALE = 34; // [px] for each second, at least
const FINGER = { size: 11, width: 8 }; // [px] of a number
const BEYOND = 1; // [s] out of sight where what lasts longer is cut off
const LOOKING_AROUND = 4000; // [ms] for which a roll that was shifted does not follow the cursor

function createRoll(element, data, seek) {
  const canvas = element.querySelector("canvas"), { states, pedal, dt, steps, keys, lowest } = data, duration = steps * dt;
  const used = new Set(), changes = changesOf(data);
  for (const { key } of changes) if (key >= 0 && key < keys) used.add(key);
  states.forEach((state, i) => { if (state) used.add(i % keys); });
  const low = Math.max(Math.min(...used, 69 - lowest, keys - 1) - 1, 0), high = Math.min(Math.max(...used, 60 - lowest, 0) + 1, keys - 1);
  const row = Math.min(Math.max(340 / (high - low + 1), 7), 15);
  const pedalHeight = pedal.some(Boolean) ? 24 : 0, top = 4;
  const words = canvas.dataset.words ??= canvas.getAttribute("aria-label");
  if (changes.length) canvas.setAttribute("aria-label", `${words}; by the arrangement, ${changesInWords(changes)}`);
  let start = 0, length = duration, shiftedAt = -Infinity, time = 0;
  const span = () => [start, start + length];
  const point = timeline(element, span, seek, (seconds) => {
    shiftedAt = performance.now();
    show(start + seconds);
  });

  function show(from) {
    start = Math.min(Math.max(from, 0), duration - length);
    draw();
    point(time);
  }

  explainAtPointer(element, ({ clientX, clientY }) => {
    const box = element.getBoundingClientRect(), key = high - Math.floor((clientY - box.top - top) / row);
    const time = start + ((clientX - box.left - GUTTER) / (box.width - GUTTER)) * length;
    return key < low || key > high || time < start ? "" : explanation(data, changes, key, time);
  });

  function draw() {
    const bottom = top + (high - low + 1) * row, foot = bottom + pedalHeight;
    const { context, width } = prepare(canvas, foot + 22);
    length = Math.min(duration, ROLL_WINDOW, (width - GUTTER) / ROLL_SCALE);
    start = Math.min(start, duration - length);
    const x = (t) => GUTTER + ((t - start) / length) * (width - GUTTER);
    const y = (key) => top + (high - key) * row;
    const colours = VERDICTS.map((name) => css("--" + name));
    for (let key = low; key <= high; key++) {
      context.fillStyle = css(isBlack(key + lowest) ? "--row" : "--card");
      context.fillRect(GUTTER, y(key), width - GUTTER, row);
      const isC = (key + lowest) % 12 === 0;
      context.fillStyle = css("--line");
      if (isC) context.fillRect(GUTTER, y(key) + row - 0.5, width - GUTTER, 1);
      context.textAlign = "right";
      context.fillStyle = css(isC ? "--ink" : "--soft");
      if (isC || (row >= 12 && !isBlack(key + lowest))) context.fillText(noteName(key + lowest), GUTTER - 7, y(key) + row / 2 + 0.5);
    }
    if (pedalHeight) {
      context.fillStyle = css("--row");
      context.fillRect(GUTTER, bottom + 8, width - GUTTER, 16);
      context.fillStyle = css("--soft");
      context.fillText("Pedal", GUTTER - 7, bottom + 16);
    }
    const tick = [0.5, 1, 2, 5, 10].find((t) => (t / length) * (width - GUTTER) > 55) ?? 10;
    context.textAlign = "center";
    for (let t = Math.ceil(start / tick) * tick; t <= start + length + 1e-6; t += tick) {
      context.fillStyle = css("--line");
      context.fillRect(x(t) - 0.5, top, 1, foot - top);
      context.fillStyle = css("--soft");
      context.fillText(`${t} s`, Math.min(Math.max(x(t), GUTTER + 8), width - 14), foot + 12);
    }
    context.save();
    context.beginPath();
    context.rect(GUTTER, 0, width - GUTTER, foot);
    context.clip();
    const put = ({ from, to, state }, up, height, loudness) => drawNote(context, state, colours, x(from), up, x(to) - x(from), height, loudness);
    const [from, to] = [start - BEYOND, start + length + BEYOND];
    notesBetween(data, from, to, (note) => put(note, y(note.key), row, (data.velocityOf?.(note) ?? LOUDEST_NOTE) / LOUDEST_NOTE));
    for (const change of changes) {
      if (change.to > from && change.from < to) drawChange(context, change, x(change.from), y(change.key), x(change.to) - x(change.from), row);
    }
    notesBetween({ states: pedal, dt, steps, keys: 1 }, from, to, (press) => put(press, bottom + 8, 16));
    drawFingers(context, width, x, (key) => y(key) + row / 2);
    context.restore();
  }

  /** Numbers before notes, in the colour of the hand; not where one would hide another. */
  function drawFingers(context, width, x, y) {
    const colours = [css("--right"), css("--left")], drawn = [];
    Object.assign(context, { font: `600 ${FINGER.size}px system-ui, sans-serif`, textAlign: "right", lineJoin: "round", lineWidth: 2, strokeStyle: css("--card") });
    for (const [key, time, hand, number] of data.fingers ?? []) {
      const [right, middle] = [x(time) - 1, y(key)];
      if (right < GUTTER + FINGER.width || right > width || key < low || key > high) continue;
      if (drawn.some(([a, b]) => Math.abs(a - right) < FINGER.width && Math.abs(b - middle) < FINGER.size)) continue;
      drawn.push([right, middle]);
      context.fillStyle = colours[hand];
      context.strokeText(number, right, middle);
      context.fillText(number, right, middle);
    }
  }

  return {
    draw,
    move(now) {
      const jumped = Math.abs(now - time) > 0.5;
      time = now;
      const away = now < start || now > start + length;
      if (away && (jumped || performance.now() - shiftedAt > LOOKING_AROUND)) show(now - 0.08 * length);
      else point(now);
    },
  };
}
