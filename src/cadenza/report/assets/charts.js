// The piano roll and the reward curves: drawn once, with a cursor that moves over them.

const GUTTER = 44; // [px] left of both charts, so that their cursors stand in line
const NAMES = ["C", "C♯", "D", "D♯", "E", "F", "F♯", "G", "G♯", "A", "A♯", "B"];
const noteName = (key) => NAMES[(key + 9) % 12] + (Math.floor((key + 9) / 12));
const isBlack = (key) => [1, 3, 6, 8, 10].includes((key + 9) % 12);
/** Three decimals, and no minus before a zero. */
const decimals = (number) => number.toFixed(3).replace(/^-(?=0\.0+$)/, "");
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

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

/** Stretches of equal, non-zero state: calls `found(first, end, state)` for rows first..end-1. */
function stretches(steps, stateAt, found) {
  for (let first = 0; first < steps; ) {
    const state = stateAt(first);
    let end = first + 1;
    while (end < steps && stateAt(end) === state) end++;
    if (state) found(first, end, state);
    first = end;
  }
}

/** Hit is filled, missed an outline, wrong hatched: to be told apart without colours too. */
function drawNote(context, state, colours, x, y, width, height) {
  const inset = Math.min(1, height / 8);
  [x, y, width, height] = [x + 0.5, y + inset, Math.max(width - 1, 1.5), height - 2 * inset];
  context.beginPath();
  context.roundRect(x, y, width, height, Math.min(3, height / 3, width / 3));
  const colour = colours[state - 1];
  context.fillStyle = context.strokeStyle = colour;
  context.lineWidth = 1.5;
  if (state === 1) { context.fill(); return; }
  context.save();
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

/** A chart over time: clicks and drags seek, the cursor follows, `span()` is what is in sight. */
function timeline(element, span, seek) {
  const cursor = element.querySelector(".cursor");
  const at = (event) => {
    const box = element.getBoundingClientRect(), [start, end] = span();
    const share = (event.clientX - box.left - GUTTER) / (box.width - GUTTER);
    seek(start + Math.min(Math.max(share, 0), 1) * (end - start));
  };
  element.addEventListener("pointerdown", (event) => { element.setPointerCapture(event.pointerId); at(event); });
  element.addEventListener("pointermove", (event) => { if (element.hasPointerCapture(event.pointerId)) at(event); });
  return (time) => {
    const [start, end] = span();
    const share = Math.min(Math.max((time - start) / (end - start), 0), 1);
    cursor.style.transform = `translateX(${GUTTER + share * (element.clientWidth - GUTTER)}px)`;
  };
}

const ROLL_WINDOW = 24; // [s] in sight at once of a longer piece

function createRoll(element, { states, pedal, dt, steps }, seek) {
  const canvas = element.querySelector("canvas"), duration = steps * dt;
  const used = [...Array(88).keys()].filter((key) => { for (let t = 0; t < steps; t++) if (states[t * 88 + key]) return true; return false; });
  const low = Math.max(Math.min(...used, 48) - 1, 0), high = Math.min(Math.max(...used, 39) + 1, 87);
  const row = Math.min(Math.max(340 / (high - low + 1), 7), 15);
  const length = Math.min(duration, ROLL_WINDOW);
  let start = 0;
  const span = () => [start, start + length];
  const point = timeline(element, span, seek);

  function draw() {
    const top = 4, keysHeight = (high - low + 1) * row, pedalTop = top + keysHeight + 8;
    const { context, width } = prepare(canvas, pedalTop + 16 + 22);
    const x = (time) => GUTTER + ((time - start) / length) * (width - GUTTER);
    const y = (key) => top + (high - key) * row;
    const colours = [css("--hit"), css("--wrong"), css("--missed")];
    for (let key = low; key <= high; key++) {
      context.fillStyle = css(isBlack(key) ? "--row" : "--card");
      context.fillRect(GUTTER, y(key), width - GUTTER, row);
      const isC = (key + 9) % 12 === 0;
      context.fillStyle = css("--line");
      if (isC) context.fillRect(GUTTER, y(key) + row - 0.5, width - GUTTER, 1);
      context.textAlign = "right";
      context.fillStyle = css(isC ? "--ink" : "--soft");
      if (isC || (row >= 12 && !isBlack(key))) context.fillText(noteName(key), GUTTER - 7, y(key) + row / 2 + 0.5);
    }
    context.fillStyle = css("--row");
    context.fillRect(GUTTER, pedalTop, width - GUTTER, 16);
    context.fillStyle = css("--soft");
    context.fillText("Pedal", GUTTER - 7, pedalTop + 8);
    const tick = [0.5, 1, 2, 5, 10].find((t) => (t / length) * (width - GUTTER) > 55) ?? 10;
    context.textAlign = "center";
    for (let t = Math.ceil(start / tick) * tick; t <= start + length + 1e-6; t += tick) {
      context.fillStyle = css("--line");
      context.fillRect(x(t) - 0.5, top, 1, pedalTop + 16 - top);
      context.fillStyle = css("--soft");
      context.fillText(`${t} s`, Math.min(Math.max(x(t), GUTTER + 8), width - 14), pedalTop + 16 + 12);
    }
    context.save();
    context.beginPath();
    context.rect(GUTTER, 0, width - GUTTER, pedalTop + 16);
    context.clip();
    const note = (first, end, state, up, height) => {
      if (end * dt > start && first * dt < start + length) drawNote(context, state, colours, x(first * dt), up, x(end * dt) - x(first * dt), height);
    };
    for (const key of used) stretches(steps, (t) => states[t * 88 + key], (a, b, s) => note(a, b, s, y(key), row));
    stretches(steps, (t) => pedal[t], (a, b, s) => note(a, b, s, pedalTop, 16));
    context.restore();
  }

  return {
    draw,
    move(time) {
      if (time < start || time > start + length) {
        start = Math.min(Math.max(time - 0.08 * length, 0), duration - length);
        draw();
      }
      point(time);
    },
  };
}

function createRewards(element, { rewards, dt, steps }, seek) {
  const terms = Object.entries(rewards).map(([name, values]) => {
    const title = document.createElement("div"), here = document.createElement("span"), output = document.createElement("output"), canvas = document.createElement("canvas");
    const known = values.filter((v) => !Number.isNaN(v));
    const mean = known.reduce((sum, v) => sum + v, 0) / Math.max(known.length, 1);
    title.className = "term";
    const label = document.createElement("b");
    label.textContent = name.replaceAll("_", " ");
    const text = document.createElement("span");
    text.append(label, ` mean ${decimals(mean)}`);
    here.append("at the cursor ", output);
    title.append(text, here);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Reward ${label.textContent} over time, mean ${decimals(mean)}`);
    element.append(title, canvas);
    return { values, output, canvas, low: Math.min(0, ...known.length ? [known.reduce((a, b) => Math.min(a, b))] : []), high: Math.max(0, ...known.length ? [known.reduce((a, b) => Math.max(a, b))] : []) };
  });
  const point = timeline(element, () => [0, steps * dt], seek);

  function draw() {
    for (const { values, canvas, low, high } of terms) {
      const { context, width, height } = prepare(canvas, 46);
      const scale = (height - 8) / (high - low || 1);
      const x = (step) => GUTTER + (step / steps) * (width - GUTTER), y = (v) => height - 4 - (v - low) * scale;
      context.fillStyle = css("--row");
      context.fillRect(GUTTER, 0, width - GUTTER, height);
      context.fillStyle = css("--soft");
      context.textAlign = "right";
      for (const v of high - low > 1e-9 ? [low, high] : [0]) context.fillText(Number(v.toPrecision(2)), GUTTER - 7, Math.min(Math.max(y(v), 6), height - 6), GUTTER - 7);
      const line = new Path2D();
      values.forEach((v, step) => { if (!Number.isNaN(v)) { line.lineTo(x(step), y(v)); line.lineTo(x(step + 1), y(v)); } });
      context.strokeStyle = css("--accent");
      context.lineWidth = 1.5;
      context.lineJoin = "round";
      context.stroke(line);
    }
  }

  return {
    draw,
    move(time) {
      const { row } = rowAt(time, dt, steps);
      for (const { values, output } of terms) output.textContent = Number.isNaN(values[row]) ? "–" : decimals(values[row]);
      point(time);
    },
  };
}
