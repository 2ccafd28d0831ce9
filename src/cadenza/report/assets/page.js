// Puts the parts together: the audio element is the clock, everything else follows it.

const cadenza = window.cadenza = { ready: false, error: null, duration: 0, time: 0, playing: false };
function fail(message) {
  cadenza.error = String(message);
  $("error").textContent = "This page met an error: " + message;
  $("error").hidden = false;
}
window.addEventListener("error", (event) => fail(event.message));
window.addEventListener("unhandledrejection", (event) => fail(event.reason));

await loadLibraries();
const data = await readRecording();
const duration = cadenza.duration = data.steps * data.dt;

// The performance and, if it is there, the goal; one of them sounds and is the clock.
const sounds = ["sound", "goal"].filter((name) => data[name]).map((name) => {
  const sound = $(name);
  sound.src = data[name];
  sound.preservesPitch = false;
  return sound;
});
let audio = sounds[0];

// A browser moves `currentTime` in coarse steps; between them the wall clock carries on.
let heard = 0, heardAt = 0;
function now() {
  if (audio.currentTime !== heard) [heard, heardAt] = [audio.currentTime, performance.now()];
  const ahead = audio.paused || audio.seeking ? 0 : Math.min((performance.now() - heardAt) / 1000, 0.1) * audio.playbackRate;
  return Math.min(heard + ahead, duration);
}

const colours = VERDICTS.map((name) => css("--" + name));
const stage = data.scene.keys ? createStage($("view"), data, colours) : null;
const looks = createLooks(), isLooping = looping();
if (stage) looks.show(stage);
else $("picture").hidden = true;
const roll = createRoll($("roll"), data, seek), rewards = createRewards($("rewards"), data, seek);
const engraving = $("engraving") && await readEngraving($("engraving").textContent);
const score = engraving && createScore($("score"), engraving, data, seek);
if (score) {
  offerScore($("downloads"), score);
  $("show-score").addEventListener("click", toggleScore);
}
const expression = $("expression") && createExpression($("expression"), data, seek);

function seek(time) {
  audio.currentTime = heard = Math.min(Math.max(Number(time) || 0, 0), duration);
  heardAt = performance.now();
  show(heard);
}
const play = () => {
  if (now() >= duration - 1e-3) seek(0);
  return audio.play().catch((error) => { if (error.name !== "AbortError") throw error; }); // paused at once
};
const pause = () => audio.pause();
const toggle = () => (audio.paused ? play() : pause());

let shownRow = -1;
function show(time) {
  cadenza.time = time;
  stage?.move(time);
  roll.move(time);
  score?.move(time);
  rewards.move(time);
  expression?.move(time);
  $("scrub").value = time;
  if ($("clock").textContent !== minutes(time)) { // to change the page costs, even to the same
    $("clock").textContent = minutes(time);
    $("scrub").setAttribute("aria-valuetext", `${minutes(time)} of ${minutes(duration)}`);
  }
  const { row } = rowAt(time, data.dt, data.steps);
  if (row === shownRow) return;
  shownRow = row;
  $("sounding").replaceChildren();
  data.states.subarray(row * data.keys, (row + 1) * data.keys).forEach((state, key) => {
    if (!state) return;
    $("sounding").append(make("span", noteName(key + data.lowest), { className: VERDICTS[state - 1] }));
  });
}

let drawn = -1;
function frame() {
  const time = now();
  if (time !== drawn) show(drawn = time);
  if (time >= duration && !audio.paused) isLooping() ? seek(0) : audio.pause();
  stage?.draw();
  looks.measure(!audio.paused);
  requestAnimationFrame(frame);
}

for (const sound of sounds) {
  for (const event of ["play", "pause", "ended"]) {
    sound.addEventListener(event, () => {
      cadenza.playing = !audio.paused;
      showPlaying(!audio.paused);
      if (cadenza.playing) $("first").hidden = true;
    });
  }
  sound.addEventListener("error", () => fail("the sound cannot be played (" + sound.error.message + ")"));
}
for (const id of ["play", "first"]) $(id).addEventListener("click", toggle);
$("scrub").max = duration;
$("length").textContent = minutes(duration);
$("scrub").addEventListener("input", () => seek($("scrub").value));
$("speed").addEventListener("change", () => { for (const sound of sounds) sound.playbackRate = Number($("speed").value); });

const mute = loudness(
  (muted) => { for (const sound of sounds) sound.muted = muted; },
  (volume) => { for (const sound of sounds) sound.volume = volume; },
);

$("listen").hidden = sounds.length < 2;
choice("data-sound", (name) => {
  const before = audio, time = now(), playing = !audio.paused;
  before.pause();
  audio = $(name);
  seek(time);
  if (playing) play();
});
const BEFORE_A_MISS = 0.7; // [s]
function goToNote(time) {
  seek(time - BEFORE_A_MISS);
  $("performance").scrollIntoView({ block: "nearest" });
}
if ($("misses")) listMisses($("misses"), data, goToNote);
if ($("changes")) listChanges($("changes"), data, goToNote);

listenToKeys({ toggle, mute, fill: fullScreen(), seek, now, end: () => duration });

function redraw() {
  roll.draw();
  show(now());
}
new ResizeObserver(redraw).observe($("roll"));
document.querySelector(".figures").addEventListener("toggle", redraw); // its charts have no width before
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
Object.assign(cadenza, { seek, play, pause, stage, ready: true });
fitToWindow();
redraw();
frame();

const asked = new URLSearchParams(location.search).get("film");
if (!stage) $("film").hidden = true;
else if (asked) sendFilm(data, engraving, JSON.parse(asked));
else offerFilm(data, engraving);
