// Puts the parts together: the audio element is the clock, everything else follows it.

const $ = (id) => document.getElementById(id);
const cadenza = window.cadenza = { ready: false, error: null, duration: 0, time: 0, playing: false };
function fail(message) {
  cadenza.error = String(message);
  $("error").textContent = "This page met an error: " + message;
  $("error").hidden = false;
}
window.addEventListener("error", (event) => fail(event.message));
window.addEventListener("unhandledrejection", (event) => fail(event.reason));

const minutes = (time) => `${Math.floor(time / 60)}:${(time % 60).toFixed(1).padStart(4, "0")}`;

const data = await readRecording();
const duration = cadenza.duration = data.steps * data.dt;

const audio = $("audio");
audio.src = data.sound;
audio.preservesPitch = false;

// A browser moves `currentTime` in coarse steps; between them the wall clock carries on.
let heard = 0, heardAt = 0;
function now() {
  if (audio.currentTime !== heard) [heard, heardAt] = [audio.currentTime, performance.now()];
  const ahead = audio.paused || audio.seeking ? 0 : Math.min((performance.now() - heardAt) / 1000, 0.1) * audio.playbackRate;
  return Math.min(heard + ahead, duration);
}

const colours = ["--hit", "--wrong", "--missed"].map(css);
const stage = data.scene.keys ? createStage($("view"), data, colours) : null;
if (!stage) $("stage").hidden = true;
const roll = createRoll($("roll"), data, seek), rewards = createRewards($("rewards"), data, seek);

function seek(time) {
  audio.currentTime = heard = Math.min(Math.max(Number(time) || 0, 0), duration);
  heardAt = performance.now();
  show(heard);
}
const play = () => {
  if (now() >= duration - 1e-3) seek(0);
  return audio.play();
};
const pause = () => audio.pause();
const toggle = () => (audio.paused ? play() : pause());

let shownRow = -1;
function show(time) {
  cadenza.time = time;
  stage?.move(time);
  roll.move(time);
  rewards.move(time);
  $("scrub").value = time;
  $("clock").textContent = minutes(time);
  $("scrub").setAttribute("aria-valuetext", `${minutes(time)} of ${minutes(duration)}`);
  const { row } = rowAt(time, data.dt, data.steps);
  if (row === shownRow) return;
  shownRow = row;
  $("sounding").replaceChildren();
  data.states.subarray(row * 88, row * 88 + 88).forEach((state, key) => {
    if (!state) return;
    const name = document.createElement("span");
    name.className = ["hit", "wrong", "missed"][state - 1];
    name.textContent = noteName(key);
    $("sounding").append(name);
  });
}

let drawn = -1, frameAt = 0, pace = 0, slow = false;
function frame() {
  const time = now();
  // Without a graphics card a frame takes long: then play coarsely, and stand still sharply.
  pace += 0.3 * (Math.min(performance.now() - frameAt, 300) - pace);
  frameAt = performance.now();
  slow = !audio.paused && (slow || pace > 70);
  if (time !== drawn) show(drawn = time);
  if (time >= duration && !audio.paused) audio.pause();
  stage?.draw(slow);
  requestAnimationFrame(frame);
}

for (const event of ["play", "pause", "ended"]) {
  audio.addEventListener(event, () => {
    cadenza.playing = !audio.paused;
    $("play").classList.toggle("playing", !audio.paused);
    $("play").setAttribute("aria-label", audio.paused ? "Play" : "Pause");
  });
}
audio.addEventListener("error", () => fail("the sound cannot be played (" + audio.error.message + ")"));
$("play").addEventListener("click", toggle);
$("scrub").max = duration;
$("length").textContent = minutes(duration);
$("scrub").addEventListener("input", () => seek($("scrub").value));
$("speed").addEventListener("change", () => { audio.playbackRate = Number($("speed").value); });
const buttons = [...document.querySelectorAll("[data-view]")];
for (const button of buttons) {
  button.addEventListener("click", () => {
    stage.look(button.dataset.view);
    buttons.forEach((other) => other.setAttribute("aria-pressed", other === button));
  });
}
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) return;
  const jump = { ArrowLeft: -1, ArrowRight: 1 }[event.key] * (event.shiftKey ? 5 : 0.5);
  if (event.key === " " && !event.target.matches("button")) toggle();
  else if (jump) seek(now() + jump);
  else if (event.key === "Home") seek(0);
  else return;
  event.preventDefault();
});

function redraw() {
  roll.draw();
  rewards.draw();
  show(now());
}
new ResizeObserver(redraw).observe($("roll"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
Object.assign(cadenza, { seek, play, pause, ready: true });
redraw();
frame();
