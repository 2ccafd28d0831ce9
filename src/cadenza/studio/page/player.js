// What is played now: a performance, or two side by side and in step, of which one is heard.

const instrument = createInstrument(), looks = createLooks();
// [s] ahead before it plays; less where planning is so many times faster than the music, and least when
// the visitor has waited for `LATE` [s]; twice as much, up to `LONGEST_LEAD`, each time that planning
// falls behind.
const LEAD = 2.5, FAST_LEAD = 1.5, SHORT_LEAD = 1, LONGEST_LEAD = 20, FAST = 1.4, LATE = 2.2;
// [ms] between two pictures of the flat view while it is planned: 30 a second, and a few more that make
// up for those that come late.
const SPARING = 32;
const AHEAD = 1.2; // [s] that sounds are scheduled ahead: a busy machine may draw no frame for a second
const STAGES = { fingers: "Choosing fingers", postures: "Finding postures", practising: "Practising" };
const ENDS = {
  cancelled: "Cancelled.",
  failed: "Drop another file, or choose a piece.",
  gone: "This performance is not there any more. Press Play to have it played again.",
};
let shown = [], heard = null, stage = null, roll = null;
let turns = 0; // how often something has been chosen to be shown
let running = false, paused = false, resumeAt = 0, sounded = 0, written = 0, asked = 0, due = 0;

// The clock is that of the sound where there is one, else the wall's.
const wall = () => performance.now() / 1000, audible = () => instrument.time;
let position = 0, since = 0, source = wall;
function now() {
  if (!running) return position;
  const better = instrument.waits ? wall : audible;
  if (better !== source) {
    if (source === wall) position += wall() - since; // an audio clock that stands has nothing to add
    [source, since] = [better, better()];
  }
  return position + (source() ?? since) - since;
}
function go() {
  source = instrument.waits ? wall : audible;
  [running, since, sounded] = [true, source(), firstRow(position)];
}
function halt(at) {
  position = at;
  running = false;
}

const firstRow = (time) => Math.ceil(time / heard.live.dt - 1e-6);
const lives = () => shown.map(({ live }) => live);
const isReady = () => shown.length > 0 && lives().every((live) => live?.rows);
const available = () => Math.min(...lives().map((live) => live.available));
const whole = () => heard.live.steps * heard.live.dt;
const isComplete = () => shown.every(({ complete }) => complete);

let said = [$("doing").textContent], instead = "";
function say(...what) {
  said = what;
  const [text, done = null, total = null, small = false] = instead ? [instead, null, null, shown.length > 0] : what;
  if ($("doing").textContent !== text) $("doing").textContent = text;
  $("notice").hidden = !text;
  $("notice").classList.toggle("small", small);
  $("done").hidden = total === null;
  if (total !== null) Object.assign($("done"), { max: total || 1, value: done });
}

/** Says something else until that is "": while a file is read, or a keyboard is listened to. */
function sayInstead(text) {
  instead = text;
  say(...said);
}

/** Shows performances, by their ids, from a time on [s]. */
function watch(ids, at = 0) {
  turns++;
  for (const each of shown) each.close();
  instrument.silence();
  clearPicture();
  shown = ids.map((id) => createPerformance(id, changed));
  [heard, position, resumeAt, running, paused, asked] = [shown[0], 0, at, false, false, wall()];
  Object.assign(cadenza, { state: "queued", time: 0, live: null, strikes: [], waits: 0, finished: false, shownFinished: null, began: null });
  $("cancel").disabled = false;
  showNothing();
  showLink();
  bringIntoView();
}
/** Nothing of what was shown before may stand under what is to come. */
function showNothing() {
  roll = null;
  document.title = $("title").textContent = $("title").title = "Cadenza studio";
  $("facts").replaceChildren();
  $("roll-card").hidden = $("looks").hidden = document.querySelector("#stage .legend").hidden = true;
  for (const id of ["clock", "length"]) $(id).textContent = minutes(0);
  Object.assign($("scrub"), { max: 1, value: 0 });
  for (const part of ["planned", "heard"]) $("scrub").style.setProperty(`--${part}`, "0%");
  $("scrub").removeAttribute("aria-valuetext");
  showFigures([null, null, null, null]);
  $("play").disabled = true;
  showPlaying(false);
  say("");
}
function bringIntoView() { // the picture, and what is above it where there is room for both
  for (const part of [document.querySelector("header"), $("picture")]) part.scrollIntoView({ block: "nearest" });
}
const showLink = () => history.replaceState(null, "", `#job=${shown.map(({ id }) => id).join()}`);

/** Takes in what is new of a performance. */
function changed(performance, what) {
  if (what === "status") showStatus(performance);
  if (what === "request" && performance === heard) showRequest(performance);
  if (what === "live" && lives().every(Boolean)) {
    createPicture();
    hearOnly(heard);
  }
}
function showStatus(performance) {
  const { state, error } = performance.status;
  if (state === "failed") complain(error);
  if (state === "kept") listKept();
  if (state === "kept" || state === "queued") listBackground();
  if (state === "gone") {
    const [id, , wanted] = remembered();
    if (id === performance.id && wanted) setToPlay(wanted);
    history.replaceState(null, "", chosen ? `#${asHash(request())}` : location.pathname);
  }
  if (performance !== heard) return;
  if (performance.request) showFacts(performance);
  $("cancel").disabled = performance.over || performance.complete;
  cadenza.state = state;
  if (state === "cancelled" && isReady()) {
    pause();
    say(ENDS.cancelled, null, null, true);
  }
  proceed();
}
function showRequest({ title, request: wanted }) {
  set(wanted);
  $("title").textContent = $("title").title = title;
  document.title = `${title} · Cadenza studio`;
  showFacts(heard);
}
/** Who plays, and what of the song they do not play. */
function showFacts({ request: wanted, status: { remarks = [] } }) {
  const said = [`Played by ${howPlayed(wanted)}`, ...remarks];
  $("facts").replaceChildren(...said.map((each) => make("span", each)));
}
/** Who plays, and how, where that is not as usual. */
function howPlayed({ agent, hand, seed, tempo, transpose }) {
  const said = [nameOfAgent(agent), hand !== "shadow" && hand, transpose && `${transpose > 0 ? "+" : "−"}${Math.abs(transpose)} semitones`, tempo !== 1 && `${tempo}×`, seed && `seed ${seed}`];
  return said.filter(Boolean).join(" · ");
}

/** Has the sound, the roll and the scores be those of one of the performances shown. */
function hearOnly(performance) {
  instrument.silence();
  heard = performance;
  cadenza.live = heard.live;
  instrument.begin(heard.live);
  sounded = firstRow(now());
  showRequest(heard);
  $("length").textContent = minutes(whole());
  $("scrub").max = whole();
  $("roll-card").hidden = $("looks").hidden = document.querySelector("#stage .legend").hidden = false;
  const old = $("roll"), fresh = old.cloneNode(true);
  old.replaceWith(fresh);
  roll = createRoll(fresh, heard.live, seek);
  roll.draw();
  for (const each of shown) if (each.listen) press(each.listen, each === heard);
  cadenza.shownFinished = null;
}

function clearPicture() {
  stage?.end();
  $("halves").replaceChildren();
  stage = null;
}
function createPicture() {
  clearPicture();
  const colours = VERDICTS.map((name) => css("--" + name));
  stage = together(shown.map((performance) => {
    const half = make("div", "", { className: "half" }), canvas = make("canvas", "", { className: "view", tabIndex: 0 });
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The hands over the keyboard: drag to turn, wheel to zoom after a click");
    const seen = make("div", "", { className: "seen" });
    seen.append(canvas);
    half.append(seen);
    if (shown.length > 1) half.append(caption(performance));
    $("halves").append(half);
    return createStage(canvas, performance.live, colours);
  }));
  looks.show(stage);
  stage.move(now());
  if (shown.length > 1) bringIntoView(); // it is higher now
}
/** Who plays it, with what score, and whether it is the one that is heard. */
function caption(performance) {
  const bar = make("div", "", { className: "caption" }), name = howPlayed(performance.request);
  performance.shownScores = make("b", "");
  performance.listen = act("Listen", `Listen to ${name}`, () => hearOnly(performance));
  const close = act("×", `Close ${name}`, () => keepOnly(shown.find((each) => each !== performance)));
  bar.append(make("span", name, { title: name }), performance.shownScores, performance.listen);
  const kept = shown.every(({ status: { state } }) => state === "kept"), isLast = performance === shown.at(-1);
  if (kept && isLast) bar.append(make("a", "Details", { href: `comparisons/${shown.map(({ id }) => id).join("/")}`, target: "_blank", rel: "noopener" }));
  bar.append(close);
  return bar;
}
/** Stages as one. */
const together = (stages) => ({
  move(time) { for (const each of stages) each.move(time); },
  draw() { for (const each of stages) each.draw(); },
  look(name) { for (const each of stages) each.look(name); },
  showNotes(visible) { for (const each of stages) each.showNotes(visible); },
  end() { for (const each of stages) each.end(); },
  setFlat(flat) { return stages.map((each) => each.setFlat(flat)).includes(true); },
  get flat() { return stages.some(({ flat }) => flat); },
  solid: stages.every(({ solid }) => solid),
});

/** Puts another performance of the song beside the one shown; both begin anew. */
function putBeside(id) {
  const first = shown[0].id;
  watch([first, id]);
}
function keepOnly(performance) {
  const time = now();
  watch([performance.id], time);
}

/** How much has to be planned ahead before it plays [s]. */
function lead() {
  if (cadenza.waits) return Math.min(LEAD * 2 ** cadenza.waits, LONGEST_LEAD);
  if (wall() > asked + LATE) return SHORT_LEAD;
  return shown.every(({ pace }) => pace > FAST) ? FAST_LEAD : LEAD;
}

/** Plays while there is something planned ahead, and says what it waits for. */
function proceed() {
  if (!shown.length) return;
  if (!isReady()) return sayWhatIsPrepared(shown.find(({ live }) => !live?.rows));
  instrument.prepare();
  const end = available();
  if (running && now() >= end) {
    halt(end);
    if (isComplete()) finish();
    else cadenza.waits++;
  }
  if (running) say(instrument.waits ? "Click anywhere for sound" : "", null, null, true);
  else if (!paused && !cadenza.finished) goOn(end);
}
function sayWhatIsPrepared({ over, live, status: { state, stage: doing, done, total, before } }) {
  if (over) say(ENDS[state] ?? "", null, null, Boolean(live));
  else if (state === "queued") say(before ? `Waiting for its turn: ${before} before it` : "Waiting for its turn");
  else say(STAGES[doing] ?? "Getting ready", doing ? done : null, doing ? total : null, Boolean(live));
}
function goOn(end) {
  if (position < resumeAt) position = Math.min(resumeAt, end);
  const ahead = end - position, wanted = Math.min(lead(), whole() - position);
  if (isComplete() ? end > position : ahead >= wanted && position >= resumeAt) {
    if (instrument.lacks(position + SHORT_LEAD)) return say("Tuning", null, null, true);
    resumeAt = 0;
    cadenza.began ??= performance.now();
    go();
  } else if (isComplete()) finish();
  else if (shown.some(({ over }) => over)) say(ENDS[shown.find(({ over }) => over).status.state] ?? "", null, null, true);
  else if (heard.status.state === "queued") sayWhatIsPrepared(heard);
  else say(cadenza.waits ? "Planning has fallen behind; a moment" : "Planning ahead", Math.max(ahead, 0), wanted, true);
}
function finish() {
  cadenza.finished = true;
  const [f1, , , onsets] = heard.live.scores, { metrics = { f1, note_onset_f1: onsets } } = heard.status;
  say(`Played with ${inFigures(metrics.f1, metrics.note_onset_f1)}`, null, null, true);
}

/** To a time that has been planned [s]. */
function seek(time) {
  if (!isReady()) return;
  const at = Math.min(Math.max(time, 0), available());
  if (cadenza.finished) [cadenza.finished, paused] = [false, true];
  instrument.silence();
  [position, since, sounded, resumeAt, written] = [at, source() ?? since, firstRow(at), 0, 0];
  if (!running) say("");
}
function toggle() {
  if (!isReady()) return;
  instrument.wake();
  if (cadenza.finished) {
    seek(0);
    paused = false;
  } else if (running) pause();
  else paused = !paused;
}
function pause() {
  halt(now());
  instrument.silence();
  paused = true;
}

/** Hands the instrument the rows that are due. */
function sound() {
  if (!isReady()) return;
  const time = now(), { live } = heard;
  if (!running || instrument.waits) {
    sounded = Math.max(sounded, Math.ceil(time / live.dt));
    return;
  }
  const audio = instrument.time;
  for (; sounded < live.rows && sounded * live.dt < time + AHEAD; sounded++) {
    const at = Math.max(audio + sounded * live.dt - time, audio);
    instrument.row(sounded, at);
    for (let key = 0; key < live.keys; key++) if (live.sounds(sounded, key) > 1) cadenza.strikes.push([sounded * live.dt, key, at - audio + time]);
  }
}

function frame(time) {
  requestAnimationFrame(frame);
  proceed();
  // Without a graphics card, fewer pictures leave more of the machine to who plans.
  if (!stage || (stage.flat && !isComplete() && time < due)) return;
  due = Math.max(Math.min(due, time) + SPARING, time);
  show(now());
}
function show(time) {
  const fresh = lives().map((live) => live.show(time)).includes(true);
  cadenza.time = time;
  stage.move(time);
  stage.draw();
  roll.move(time);
  if ((fresh && performance.now() - written > 250) || cadenza.finished !== cadenza.shownFinished) {
    [written, cadenza.shownFinished] = [performance.now(), cadenza.finished];
    roll.draw();
    roll.move(time);
    showScores();
    remember(time);
  }
  showTime(time);
  $("play").disabled = !isReady();
  showPlaying(running);
  looks.measure(running);
}
function showTime(time) {
  const percent = (part) => `${(100 * part) / whole()}%`;
  $("scrub").style.setProperty("--planned", percent(Math.min(...lives().map(({ rows, dt }) => rows * dt))));
  $("scrub").style.setProperty("--heard", percent(time));
  if ($("clock").textContent === minutes(time)) return;
  $("clock").textContent = minutes(time);
  $("scrub").value = time;
  $("scrub").setAttribute("aria-valuetext", `${minutes(time)} of ${minutes(whole())}`);
}
function showScores() {
  showFigures(heard.live.scores);
  for (const { live: { scores: [f1, , , onsets] }, shownScores } of shown) {
    if (shownScores && f1 !== null) shownScores.textContent = inFigures(f1, onsets);
  }
}
function showFigures(scores) {
  ["f1", "precision", "recall", "onsets"].forEach((name, i) => {
    $(name).textContent = scores[i]?.toFixed(3) ?? "–";
    $(name).parentElement.querySelector("i").style.width = `${100 * (scores[i] ?? 0)}%`;
  });
}

/** For when the page is loaded again. */
const remember = (time) => sessionStorage.setItem("cadenza", JSON.stringify([shown[0].id, time, heard.request]));
const remembered = () => JSON.parse(sessionStorage.getItem("cadenza") ?? "[null, 0, null]");
