// The piano roll and the reward curves: drawn once, with a cursor that moves over them.

const GUTTER = 44; // [px] left of both charts, so that their cursors stand in line
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
const LOOKING_AROUND = 4000; // [ms] for which a roll that was shifted does not follow the cursor

function createRoll(element, data, seek) {
  const canvas = element.querySelector("canvas"), { pedal, dt, steps } = data, duration = steps * dt;
  const played = notes(data), longest = longestOf(played), pedalled = [];
  stretches(steps, (t) => pedal[t], (a, b, state) => pedalled.push({ from: a * dt, to: b * dt, state }));
  const used = played.map(({ key }) => key);
  const low = Math.max(used.reduce((a, b) => Math.min(a, b), 48) - 1, 0), high = Math.min(used.reduce((a, b) => Math.max(a, b), 39) + 1, 87);
  const row = Math.min(Math.max(340 / (high - low + 1), 7), 15);
  const pedalHeight = pedalled.length ? 24 : 0;
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

  function draw() {
    const top = 4, bottom = top + (high - low + 1) * row, foot = bottom + pedalHeight;
    const { context, width } = prepare(canvas, foot + 22);
    length = Math.min(duration, ROLL_WINDOW, (width - GUTTER) / ROLL_SCALE);
    start = Math.min(start, duration - length);
    const x = (t) => GUTTER + ((t - start) / length) * (width - GUTTER);
    const y = (key) => top + (high - key) * row;
    const colours = VERDICTS.map((name) => css("--" + name));
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
    const put = ({ from, to, state }, up, height) => drawNote(context, state, colours, x(from), up, x(to) - x(from), height);
    within(played, longest, start, start + length, (note) => put(note, y(note.key), row));
    for (const press of pedalled) if (press.to > start && press.from < start + length) put(press, bottom + 8, 16);
    context.restore();
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
  let shownRow = -1;

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
      if (row !== shownRow) for (const { values, output } of terms) output.textContent = Number.isNaN(values[row]) ? "–" : decimals(values[row]);
      shownRow = row;
      point(time);
    },
  };
}
