// Plays a performance: the current one.

const instrument = createInstrument(), looks = createLooks(), isLooping = looping();
// [s] that are planned ahead before it plays: `FAST_LEAD` where planning is `FAST` times faster than the
// music, `SHORT_LEAD` when that has taken `LATE_START` [s], and twice as much as before, up to
// `LONGEST_LEAD`, each time that planning falls behind. Where planning is slower than the music, as much as it will fall
// behind by its end. Where others played as it was asked for, the machine is shared: `SHARED_LEAD`.
const LEAD = 2.5, FAST_LEAD = 1.5, SHORT_LEAD = 1, SHARED_LEAD = 8, LONGEST_LEAD = 20, FAST = 1.4, LATE_START = 2.2;
// [ms] between two pictures of the flat view while it is planned: 30 a second, and a few more that make
// up for those that come late.
const FRAME_INTERVAL = 32;
const TELLING_UNIT = 5; // [s] to which it says how long it waits
const SCORES_INTERVAL = 250; // [ms] between two updates of roll and scores
const SOUND_AHEAD = 1.2; // [s] that sounds are scheduled ahead: a busy machine may draw no frame for a second
const STAGE_NOTICES = { fingers: "Choosing fingers", postures: "Finding postures", practising: "Practising" };
const END_NOTICES = {
  cancelled: "Cancelled.",
  failed: "Drop another file, or choose a piece.",
  gone: "This performance is not there any more. Press Play to have it played again.",
};
let current = null, stage = null, roll = null, score = null;
let numChoices = 0; // how often something has been chosen to be shown
let speed = 1;
let isShared = false, running = false, paused = false, resumeAt = 0, nextRow = 0, scoresDrawnAt = 0, askedAt = 0, nextFrame = 0;

// The clock is that of the sound where there is one, else wall time.
const wallTime = () => performance.now() / 1000, audioTime = () => instrument.time;
let position = 0, clockStart = 0, clock = wallTime;
function now() {
  if (!running) return position;
  const better = instrument.isSuspended ? wallTime : audioTime;
  if (better !== clock) {
    if (clock === wallTime) position += speed * (wallTime() - clockStart); // an audio clock that stands has nothing to add
    [clock, clockStart] = [better, better()];
  }
  return position + speed * ((clock() ?? clockStart) - clockStart);
}
function startClock() {
  clock = instrument.isSuspended ? wallTime : audioTime;
  [running, clockStart, nextRow] = [true, clock(), firstRow(position)];
}
function setSpeed(chosen) {
  const at = now();
  speed = chosen;
  if (!running) return;
  instrument.silence(); // what was scheduled is due at other times now
  position = at;
  startClock();
}
function stopClock(at) {
  position = at;
  running = false;
}

const firstRow = (time) => Math.ceil(time / current.recording.dt - 1e-6);
const isReady = () => Boolean(current?.recording?.rows);
const available = () => current.recording.available;
const duration = () => current.recording.steps * current.recording.dt;

let notice = [$("doing").textContent], override = "";
/** Shows a text over the picture, how much is done of what, and whether it is small. */
function showNotice(...shownNotice) {
  notice = shownNotice;
  const [text, done = null, total = null, small = false] = override ? [override, null, null, Boolean(current)] : notice;
  if ($("doing").textContent !== text) $("doing").textContent = text;
  $("notice").hidden = !text;
  $("notice").classList.toggle("small", small);
  $("done").hidden = total === null;
  if (total !== null) Object.assign($("done"), { max: total || 1, value: done });
}

/** Shows another text until it is "": while a file is read, or a keyboard is listened to. */
function overrideNotice(text) {
  override = text;
  showNotice(...notice);
}

/** Shows a performance, by its id, from a time on [s]. */
function watch(id, at = 0) {
  numChoices++;
  $("first").hidden = true;
  isShared = false;
  current?.close();
  instrument.silence();
  clearPicture();
  [current, position, resumeAt, running, paused, askedAt] = [createPerformance(id, changed), 0, at, false, false, wallTime()];
  Object.assign(cadenza, { state: "queued", time: 0, live: null, strikes: [], waits: 0, finished: false, shownFinished: null, began: null });
  $("cancel").disabled = false;
  showNothing();
  history.replaceState(null, "", `#job=${id}`);
  bringIntoView();
}
/** Clears what belongs to the performance shown before. */
function showNothing() {
  roll = score = null;
  $("score").hidden = $("show-score").hidden = true;
  document.title = $("title").textContent = $("title").title = "Cadenza studio";
  for (const id of ["facts", "verdict", "losses", "sheet-remarks"]) $(id).replaceChildren();
  $("roll-card").hidden = $("looks").hidden = document.querySelector("#stage .legend").hidden = true;
  for (const card of document.querySelectorAll(".explained")) card.hidden = true;
  for (const id of ["clock", "length"]) $(id).textContent = minutes(0);
  Object.assign($("scrub"), { max: 1, value: 0 });
  for (const part of ["planned", "heard"]) $("scrub").style.setProperty(`--${part}`, "0%");
  $("scrub").removeAttribute("aria-valuetext");
  showFigures([null, null, null, null]);
  $("play").disabled = true;
  showPlaying(false);
  showNotice("");
}
function bringIntoView() { // the picture, and what is above it where there is room for both
  for (const part of [document.querySelector("header"), $("picture")]) part.scrollIntoView({ block: "nearest" });
}

/** Shows what has changed: "status", "request", "recording", "engraving", "fingers" or "misses". */
function changed(what) {
  if (what === "misses") showExplanations();
  if (what === "status") showStatus();
  if (what === "request") showRequest();
  if (what === "engraving") showScore();
  if (what === "recording") showRecording();
}
function showStatus() {
  const { state, error } = current.status;
  if (state === "failed") showError(error);
  if (state === "kept") listPerformances();
  if (state === "kept" || state === "queued") showBackground();
  if (state === "gone") {
    const [id, , request] = remembered();
    if (id === current.id && request) setOptionsToPlay(request);
    history.replaceState(null, "", chosen ? `#${toHash(playRequest())}` : location.pathname);
  }
  if (current.request) showFacts();
  $("cancel").disabled = current.over || current.complete;
  $("film").hidden = state !== "kept";
  $("film").href = `performances/${current.id}/report.html#film`;
  cadenza.state = state;
  if (state === "cancelled") {
    if (isReady()) pause();
    paused = true; // what had been planned may still come, and must not begin by itself
    showNotice(END_NOTICES.cancelled, null, null, Boolean(current.recording));
  }
  updatePlayback();
}
function showRequest() {
  const { title, request } = current;
  setOptions(request);
  $("title").textContent = $("title").title = title;
  document.title = `${title} · Cadenza studio`;
  showFacts();
}
/** Shows who plays, how well, and what of the song is not played; what is the file's is said below the list of songs. */
function showFacts() {
  const { request, recording, status: { verdict = "", remarks = recording?.remarks ?? [] } } = current;
  $("facts").replaceChildren(make("span", `Played by ${howPlayed(request)}`));
  $("verdict").textContent = verdict;
  const losses = remarks.filter((remark) => !chosen?.remarks?.includes(remark));
  $("losses").replaceChildren(...losses.map((remark) => make("p", remark, { className: "remark" })));
}
/** Returns who plays, and the options that are not the usual ones. */
function howPlayed({ agent, hand, hands = "both", seed, tempo, transpose, plain, expression, arrange, level }) {
  const parts = [nameOfAgent(agent), hand !== "shadow" && (handTitles[hand] ?? hand), hands !== "both" && (hands === "written" ? "hands as written" : `${hands} hand`), arrange === "off" && "as written", level && `level ${level}`, transpose && `${transpose > 0 ? "+" : "−"}${Math.abs(transpose)} semitones`, tempo !== 1 && `${tempo}×`, plain && "plain notes", expression && "with expression", seed && `take ${seed}`];
  return parts.filter(Boolean).join(" · ");
}

/** Says why notes were missed, and what an arrangement changed. */
function showExplanations() {
  const { misses, arrangement } = current.recording;
  for (const [id, list, rows] of [["misses", listMisses, misses], ["changes", listChanges, arrangement]]) {
    $(id).closest(".card").hidden = !rows.length;
    list($(id), current.recording, goToNote);
  }
  $("misses-title").textContent = `Notes missed or let go early: ${misses.length}`;
  for (const part of document.querySelectorAll(".legend .arranged")) part.hidden = !arrangement.length;
}
const BEFORE_A_NOTE = 0.7; // [s]
function goToNote(time) {
  seek(time - BEFORE_A_NOTE);
  bringIntoView();
}

/** Shows picture, roll and scores of what is to be played, as soon as that is known. */
function showRecording() {
  clearPicture();
  stage = addPicture(current.recording);
  looks.show(stage);
  stage.move(now());
  cadenza.live = current.recording;
  instrument.setRecording(current.recording);
  nextRow = firstRow(now());
  showRequest();
  showExplanations();
  $("length").textContent = minutes(duration());
  $("scrub").max = duration();
  $("roll-card").hidden = $("looks").hidden = document.querySelector("#stage .legend").hidden = false;
  const old = $("roll"), fresh = old.cloneNode(true);
  old.replaceWith(fresh);
  roll = createRoll(fresh, current.recording, seek);
  roll.draw();
  cadenza.shownFinished = null;
  showScore();
  bringIntoView(); // what is above it may be higher now, and so may be the picture
}
/** Shows the score, if it has been engraved. */
async function showScore() {
  const { recording } = current, engraving = recording.engraving && await readEngraving(recording.engraving);
  if (recording !== current?.recording) return;
  const old = $("score"), fresh = old.cloneNode(false);
  old.replaceWith(fresh);
  $("show-score").hidden = !engraving;
  fresh.hidden = !engraving || !isPressed($("show-score"));
  score = engraving && createScore(fresh, engraving, recording, seek);
  score?.move(now());
}
$("show-score").addEventListener("click", toggleScore);

function clearPicture() {
  stage?.end();
  $("hands-view").replaceChildren();
  stage = null;
}
/** Adds a picture of a recording, and returns its stage. */
function addPicture(recording) {
  const words = "The hands over the keyboard: drag to turn, wheel to zoom after a click";
  const canvas = make("canvas", [], { className: "view", tabIndex: 0, role: "img", "aria-label": words });
  $("hands-view").append(canvas);
  return createStage(canvas, recording, VERDICTS.map((name) => css("--" + name)));
}
/** Shows hands that are ready to play a song, until something is chosen. */
async function showOpening() {
  choose(first);
  $("first").textContent = `▶ ${$("start").textContent}`;
  $("first").hidden = !chosen;
  $("play").disabled = !chosen;
  const picture = await fetchJson("api/opening"), recording = picture && await createStreamedRecording(picture);
  if (!picture || numChoices || current) return;
  stage = addPicture(recording);
  looks.show(stage);
  stage.move(0);
  $("looks").hidden = false;
  showNotice(notice[0], null, null, true);
}
/** Returns how much has to be planned ahead before it plays [s], so that planning does not fall behind. */
function requiredLead() {
  const { pace } = current, behind = pace ? (duration() - available()) * (speed / pace - 1) : 0;
  return Math.max(usualLead(), Math.min(behind, LONGEST_LEAD));
}
function usualLead() {
  if (cadenza.waits) return Math.min(speed * LEAD * 2 ** cadenza.waits, LONGEST_LEAD);
  if (isShared) return speed * SHARED_LEAD;
  if (wallTime() > askedAt + LATE_START) return speed * SHORT_LEAD;
  return speed * (current.pace > speed * FAST ? FAST_LEAD : LEAD);
}

/** Plays while something is planned ahead, and shows what it waits for. */
function updatePlayback() {
  if (!current) return;
  if (!isReady()) return showPreparation();
  instrument.loadTones();
  const end = available();
  if (running && now() >= end) {
    stopClock(end);
    if (!current.complete) cadenza.waits++;
    else if (isLooping()) seek(0);
    else finish();
  }
  if (running) showNotice(instrument.isSuspended ? "Click anywhere for sound" : "", null, null, true);
  else if (!paused && !cadenza.finished) playWhenReady(end);
}
function showPreparation() {
  const { over, recording, status: { state, stage: doing, done, total, before, seconds } } = current;
  if (over) showNotice(END_NOTICES[state] ?? "", null, null, Boolean(recording));
  else if (state === "queued") {
    [askedAt, isShared] = [wallTime(), isShared || before > 0];
    const when = seconds ? `; it begins in about ${seconds} s` : "";
    showNotice(before ? `Waiting for its turn: ${before} before it${when}` : "Waiting for its turn");
  }
  else showNotice(STAGE_NOTICES[doing] ?? "Getting ready", doing ? done : null, doing ? total : null, Boolean(recording));
}
function playWhenReady(end) {
  if (position < resumeAt) position = Math.min(resumeAt, end);
  const ahead = end - position, wanted = Math.min(requiredLead(), duration() - position);
  if (current.complete ? end > position : ahead >= wanted && position >= resumeAt) {
    if (instrument.isMissing(position + SHORT_LEAD)) return showNotice("Tuning", null, null, true);
    resumeAt = 0;
    cadenza.began ??= performance.now();
    startClock();
  } else if (current.complete) finish();
  else if (current.over) showNotice(END_NOTICES[current.status.state] ?? "", null, null, true);
  else {
    const doing = cadenza.waits ? "Planning has fallen behind" : "Planning ahead", patience = Math.ceil((wanted - ahead) / current.pace);
    const when = patience > LATE_START && patience < Infinity ? `; it plays in about ${TELLING_UNIT * Math.ceil(patience / TELLING_UNIT)} s` : "";
    showNotice(doing + when, Math.max(ahead, 0), wanted, true);
  }
}
function finish() {
  cadenza.finished = true;
  showNotice(current.status.verdict ?? "", null, null, true);
}

/** Goes to a time that has been planned [s]. */
function seek(time) {
  if (!isReady()) return;
  const at = Math.min(Math.max(time, 0), available());
  if (cadenza.finished) [cadenza.finished, paused] = [false, true];
  instrument.silence();
  [position, clockStart, nextRow, resumeAt, scoresDrawnAt] = [at, clock() ?? clockStart, firstRow(at), 0, 0];
  if (!running) showNotice("");
}
function togglePlay() {
  if (!current && chosen) return playChosen();
  if (!isReady()) return;
  instrument.wake();
  if (cadenza.finished) {
    seek(0);
    paused = false;
  } else if (running) pause();
  else paused = !paused;
}
function pause() {
  stopClock(now());
  instrument.silence();
  paused = true;
}

/** Schedules the sound of the rows that come next. */
function scheduleSound() {
  if (!isReady()) return;
  const time = now(), { recording } = current;
  if (!running || instrument.isSuspended) {
    nextRow = Math.max(nextRow, Math.ceil(time / recording.dt));
    return;
  }
  const audio = instrument.time;
  for (; nextRow < recording.rows && nextRow * recording.dt < time + speed * SOUND_AHEAD; nextRow++) {
    const timeOf = (moment) => Math.max(audio + (moment - time) / speed, audio);
    instrument.playRow(nextRow, timeOf);
    for (let key = 0; key < recording.keys; key++) {
      const moment = recording.changedAt(nextRow, key);
      if (recording.velocity(nextRow, key)) cadenza.strikes.push([moment, key, speed * (timeOf(moment) - audio) + time]);
    }
  }
}

function frame(time) {
  requestAnimationFrame(frame);
  updatePlayback();
  // Without a graphics card, fewer pictures leave more of the machine to who plans.
  if (!stage || (stage.flat && current?.complete === false && time < nextFrame)) return;
  nextFrame = Math.max(Math.min(nextFrame, time) + FRAME_INTERVAL, time);
  if (current) show(now());
  else stage.draw();
}
function show(time) {
  const { recording } = current, fresh = recording.show(time);
  cadenza.time = time;
  stage.move(time);
  stage.draw();
  roll.move(time);
  score?.move(time);
  if ((fresh && performance.now() - scoresDrawnAt > SCORES_INTERVAL) || cadenza.finished !== cadenza.shownFinished) {
    [scoresDrawnAt, cadenza.shownFinished] = [performance.now(), cadenza.finished];
    roll.draw();
    roll.move(time);
    showFigures(recording.scores);
    remember(time);
  }
  showTime(time);
  $("play").disabled = !isReady();
  showPlaying(running);
  looks.measure(running);
}
function showTime(time) {
  const percent = (part) => `${(100 * part) / duration()}%`, { rows, dt } = current.recording;
  $("scrub").style.setProperty("--planned", percent(rows * dt));
  $("scrub").style.setProperty("--heard", percent(time));
  if ($("clock").textContent === minutes(time)) return;
  $("clock").textContent = minutes(time);
  $("scrub").value = time;
  $("scrub").setAttribute("aria-valuetext", `${minutes(time)} of ${minutes(duration())}`);
}
function showFigures(scores) {
  ["f1", "precision", "recall", "onsets"].forEach((name, i) => {
    $(name).textContent = scores[i]?.toFixed(3) ?? "–";
    $(name).parentElement.querySelector("i").style.width = `${100 * (scores[i] ?? 0)}%`;
  });
}

/** Remembers what is shown, for when the page is loaded again. */
const remember = (time) => sessionStorage.setItem("cadenza", JSON.stringify([current.id, time, current.request]));
const remembered = () => JSON.parse(sessionStorage.getItem("cadenza") ?? "[null, 0, null]");
