// The studio's page: what can be played, and what is played now.

const cadenza = window.cadenza = { ready: false, error: null, state: "idle", time: 0, strikes: [], waits: 0 };
function make(name, text = "", attributes = {}) {
  const element = Object.assign(document.createElement(name), attributes);
  element.textContent = text;
  return element;
}
function complain(message) {
  cadenza.error = String(message);
  $("error").textContent = message;
  $("error").hidden = false;
}
function calm() {
  cadenza.error = null;
  $("error").hidden = true;
}
window.addEventListener("error", (event) => complain("This page met an error: " + event.message));
window.addEventListener("unhandledrejection", (event) => complain(event.reason?.message ?? String(event.reason)));

/** What the server answers; what it refuses is an error of one line. */
async function ask(path, method = "GET", body = undefined) {
  let answer;
  try {
    answer = await fetch(path, { method, body });
  } catch {
    throw new Error("The studio does not answer. Start it again, and open the address that it prints.");
  }
  if (answer.status === 204) return null;
  const said = await answer.json().catch(() => ({ error: `The studio answered ${answer.status}.` }));
  if (!answer.ok) throw new Error(said.error);
  return said;
}

// What can be played

let songs = [], chosen = null, only = null; // the one performance that can be watched
const OPTIONS = ["agent", "hand", "tempo", "transpose", "seed"], NUMBERS = ["tempo", "transpose", "seed"];

async function listSongs() {
  const { songs: found, agents, hands, only: one = null } = await ask("api/songs");
  [songs, only] = [found, one];
  document.body.classList.toggle("one", only !== null);
  offer("agent", agents);
  offer("hand", hands);
  showSongs();
}
/** Lets the visitor choose among values by their names. */
function offer(id, names) {
  const { value } = $(id);
  $(id).replaceChildren(...Object.entries(names).map(([value, name]) => make("option", name, { value })));
  if (value in names) $(id).value = value;
}
function showSongs() {
  const words = $("search").value.toLowerCase().split(/\s+/);
  const matches = ({ title, composer = "", id }) => words.every((word) => `${title} ${composer} ${id}`.toLowerCase().includes(word));
  $("songs").replaceChildren(...songs.filter(matches).map((song) => {
    const button = make("button", "", { type: "button" }), item = make("li");
    const about = song.uploaded ? "yours" : song.composer;
    button.append(make("span", song.title), make("small", minutes(song.seconds).split(".")[0]), make("small", about));
    if (song.grade) button.append(make("small", song.grade.toFixed(1), { title: "Difficulty for robot hands, 1 to 10" }));
    press(button, song === chosen);
    button.addEventListener("click", () => { choose(song.id); begin(); });
    item.append(button);
    return item;
  }));
}
function choose(id) {
  chosen = songs.find((song) => song.id === id) ?? null;
  for (const id of ["start", "link", "train"]) $(id).disabled = !chosen;
  $("start").textContent = chosen ? `Play ${chosen.title}` : "Play";
  const tracks = chosen?.tracks ?? [];
  $("tracks").hidden = tracks.length < 2;
  $("tracks").replaceChildren(make("legend", "Tracks"), ...tracks.map(({ number, name, instrument, notes: count }) => {
    const label = make("label"), box = make("input", "", { type: "checkbox", value: number, checked: true });
    label.append(box, make("span", `${name || instrument || `Track ${number}`}, ${count} notes`));
    return label;
  }));
  showSongs();
}
function request() {
  const wanted = { song: chosen.id };
  for (const name of OPTIONS) wanted[name] = NUMBERS.includes(name) ? Number($(name).value) : $(name).value;
  const boxes = [...$("tracks").querySelectorAll("input")], on = boxes.filter((box) => box.checked);
  if (on.length && on.length < boxes.length) wanted.tracks = on.map((box) => Number(box.value));
  return wanted;
}
function set(wanted) {
  choose(wanted.song);
  for (const name of OPTIONS) if (wanted[name] !== undefined) $(name).value = wanted[name];
  const tracks = wanted.tracks ?? [];
  if (tracks.length) for (const box of $("tracks").querySelectorAll("input")) box.checked = tracks.includes(Number(box.value));
}
const asHash = (wanted) => new URLSearchParams(Object.entries(wanted).map(([name, value]) => [name, String(value)])).toString();
function fromHash() {
  const wanted = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  if (wanted.tracks) wanted.tracks = wanted.tracks.split(",").map(Number);
  return wanted;
}

async function upload(file) {
  calm();
  say(`Reading ${file.name}`);
  try {
    const { id } = await ask(`api/songs?name=${encodeURIComponent(file.name)}`, "POST", file);
    await listSongs();
    choose(id);
    $("songs").scrollTop = 0;
  } catch (error) {
    say("Drop another file, or choose a piece.");
    throw error;
  }
  await begin();
}
async function begin() {
  calm();
  instrument.wake();
  if (job && !over() && !complete()) await ask(`api/jobs/${job}`, "DELETE");
  const { id } = await ask("api/jobs", "POST", JSON.stringify(request()));
  watch(id, 0);
}

// What is played now

const instrument = createInstrument(), looks = createLooks();
// [s] ahead before it plays; less where planning is so many times faster than the music.
const LEAD = 2.5, SHORT_LEAD = 1, FAST = 1.4;
const AHEAD = 0.35; // [s] that sounds are scheduled ahead
const STAGES = { fingers: "Choosing fingers", postures: "Finding postures", practising: "Practising" };
let job = null, socket = null, live = null, stage = null, roll = null, status = { state: "idle" };
let running = false, paused = false, resumeAt = 0, sounded = 0, came = [], tries = 0;

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
  [running, since, sounded] = [true, source(), Math.ceil(position / live.dt - 1e-6)];
}
function halt(at) {
  position = at;
  running = false;
}

const over = () => ["kept", "failed", "cancelled", "gone"].includes(status.state);
const complete = () => ["played", "writing", "kept"].includes(status.state);

function say(text, done = null, total = null, small = false) {
  if ($("doing").textContent !== text) $("doing").textContent = text;
  $("notice").hidden = !text;
  $("notice").classList.toggle("small", small);
  $("done").hidden = total === null;
  if (total !== null) Object.assign($("done"), { max: total || 1, value: done });
}

function watch(id, at) {
  socket?.close();
  instrument.silence();
  [job, live, status, position, resumeAt, running, paused, came, tries] = [id, null, { state: "queued" }, 0, at, false, false, [], 0];
  Object.assign(cadenza, { state: "queued", strikes: [], waits: 0, finished: false, shownFinished: null, began: null });
  history.replaceState(null, "", `#job=${id}`);
  $("cancel").disabled = false;
  listen(id);
}
function listen(id) {
  const ours = socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}${location.pathname}watch/${id}`);
  ours.binaryType = "arraybuffer";
  let order = Promise.resolve();
  ours.onmessage = ({ data }) => {
    order = order.then(() => (ours === socket ? hear(data) : null));
  };
  ours.onclose = () => order.then(() => {
    if (ours !== socket || over()) return;
    if (tries++ < 5) setTimeout(() => { if (ours === socket) listen(id); }, 1000 * tries);
    else complain("The studio does not answer. Start it again, and open the address that it prints.");
  });
}
async function hear(data) {
  if (typeof data !== "string") {
    const bytes = new Uint8Array(data), part = bytes.slice(1);
    if (bytes[0] === "T".charCodeAt(0)) instrument.learn(part);
    else {
      live.add(part);
      came.push([performance.now() / 1000, live.rows]);
    }
    return;
  }
  const said = JSON.parse(data);
  if (said.state) return setStatus(said);
  if (!live) await receive(said);
  else live.restart();
}
function setStatus(said) {
  status = said;
  if (said.state === "gone") {
    say("This performance is over. Choose a piece, or drop a file.");
    history.replaceState(null, "", location.pathname);
  }
  if (said.state === "failed") {
    complain(said.error);
    say("Drop another file, or choose a piece.");
  }
  if (said.state === "cancelled") say("Cancelled.");
  $("cancel").disabled = over() || complete();
  if (said.state === "kept") {
    listKept();
    listBackground();
  }
  cadenza.state = said.state;
}

async function receive(about) {
  const [coming, { title }] = await Promise.all([createLive(about), titleOf(job)]);
  cadenza.live = live = coming;
  instrument.begin(live);
  createPicture();
  $("title").textContent = title;
  document.title = `${title} · Cadenza studio`;
  $("length").textContent = minutes(live.steps * live.dt);
  $("roll-card").hidden = $("looks").hidden = document.querySelector("#stage .legend").hidden = false;
  const old = $("roll"), fresh = old.cloneNode(true);
  old.replaceWith(fresh);
  roll = createRoll(fresh, live, () => {});
  roll.draw();
}
async function titleOf(id) {
  const found = (await ask("api/jobs")).find((each) => each.id === id);
  if (found) {
    set(found.request);
    const { agent, hand, seed } = found.request;
    $("facts").replaceChildren(...[["agent", $("agent").selectedOptions[0]?.textContent ?? agent], ["hands", hand], ["seed", seed]].map(([name, value]) => {
      const fact = make("span", name + " ");
      fact.append(make("b", String(value)));
      return fact;
    }));
  }
  return found ?? { title: "Performance" };
}
function createPicture() {
  for (const old of $("stage").querySelectorAll("canvas")) {
    old.getContext("webgl2")?.getExtension("WEBGL_lose_context")?.loseContext();
    old.remove();
  }
  const canvas = make("canvas", "", { id: "view", className: "view", tabIndex: 0 });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "The hands over the keyboard: drag to turn, wheel to zoom after a click");
  $("stage").prepend(canvas);
  stage = createStage(canvas, live, VERDICTS.map((name) => css("--" + name)));
  looks.show(stage);
  stage.move(0);
}

/** How many seconds of music a second of planning brings, lately. */
function pace() {
  const last = came.at(-1), first = came.find(([at]) => at > last[0] - 2);
  return first === last ? Infinity : ((last[1] - first[1]) * live.dt) / (last[0] - first[0]);
}
function lead() {
  return !cadenza.waits && came.length > 5 && pace() > FAST ? SHORT_LEAD : LEAD;
}

/** Plays while there is something planned ahead, and says what it waits for. */
function proceed() {
  if (!live || !live.rows) {
    if (over() || status.state === "idle") return;
    const { state, stage: doing, done, total } = status;
    if (state === "queued") say("Waiting for its turn");
    else say(STAGES[doing] ?? "Getting ready", doing ? done : null, doing ? total : null, Boolean(live));
    return;
  }
  const end = live.available, time = now();
  if (running && time >= end) {
    halt(end);
    if (complete()) finish();
    else cadenza.waits++;
  }
  if (running) say(instrument.waits ? "Click anywhere for sound" : "", null, null, true);
  if (!running && !paused && !cadenza.finished) {
    if (position < resumeAt) position = Math.min(resumeAt, end);
    const ahead = end - position, wanted = Math.min(lead(), live.steps * live.dt - position);
    if (complete() ? end > position : ahead >= wanted && position >= resumeAt) {
      resumeAt = 0;
      cadenza.began ??= performance.now();
      go();
    } else if (complete()) finish();
    else if (over()) say(status.state === "cancelled" ? "Cancelled." : "");
    else say(cadenza.waits ? "Planning has fallen behind; a moment" : "Planning ahead", Math.max(ahead, 0), wanted, true);
  }
}
function finish() {
  cadenza.finished = true;
  const { metrics } = status;
  say(`Played with F1 ${(metrics?.f1 ?? live.scores[0]).toFixed(3)}`, null, null, true);
}
function again() {
  cadenza.finished = false;
  instrument.silence();
  live.clear();
  position = 0;
}
function toggle() {
  if (!live) return;
  instrument.wake();
  if (cadenza.finished) again();
  else if (running) {
    halt(now());
    instrument.silence();
    paused = true;
  } else paused = !paused;
}

/** Hands the instrument the rows that are due. */
function sound() {
  const time = now();
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

let written = 0;
function frame() {
  proceed();
  if (live && stage && roll) {
    const time = now(), fresh = live.show(time), active = running;
    cadenza.time = time;
    stage.move(time);
    stage.draw();
    roll.move(time);
    if ((fresh && performance.now() - written > 250) || cadenza.finished !== cadenza.shownFinished) {
      [written, cadenza.shownFinished] = [performance.now(), cadenza.finished];
      roll.refresh();
      roll.move(time);
      showScores();
      sessionStorage.setItem("cadenza", JSON.stringify([job, time]));
    }
    const whole = live.steps * live.dt;
    $("clock").textContent = minutes(time);
    $("planned").style.transform = `scaleX(${(live.rows * live.dt) / whole})`;
    $("heard").style.transform = `scaleX(${time / whole})`;
    $("play").disabled = !live.rows;
    showPlaying(active);
    looks.measure(active);
  }
  requestAnimationFrame(frame);
}
function showScores() {
  ["f1", "precision", "recall"].forEach((name, i) => {
    const value = live.scores[i];
    $(name).textContent = value === null ? "–" : value.toFixed(3);
    $(name).parentElement.querySelector("i").style.width = `${100 * (value ?? 0)}%`;
  });
}

// What is kept

const KEPT = { "report.html": "Report", "video.mp4": "Video", "played.mid": "MIDI" };
async function listKept() {
  const kept = await ask("api/performances");
  $("kept").replaceChildren(...kept.map((each) => {
    const item = make("li"), links = make("nav");
    const about = `F1 ${each.f1.toFixed(3)} · ${minutes(each.seconds)} · ${new Date(1000 * each.finished).toLocaleString()}`;
    for (const [file, name] of Object.entries(KEPT)) {
      if (!each.files.includes(file)) continue;
      const link = make("a", name, { href: `performances/${each.id}/${file}`, target: "_blank", rel: "noopener" });
      if (file !== "report.html") link.download = `${each.title}${file.slice(file.lastIndexOf("."))}`;
      link.setAttribute("aria-label", `${name} of ${each.title}`);
      links.append(link);
    }
    const again = make("button", "Settings", { type: "button" });
    again.setAttribute("aria-label", `Settings of ${each.title}`);
    again.addEventListener("click", () => { set(each.request); $("more").open = true; });
    const beside = make("button", "Compare", { type: "button" });
    beside.setAttribute("aria-label", `Compare ${each.title}`);
    beside.addEventListener("click", () => compare(each));
    const remove = make("button", "Delete", { type: "button" });
    remove.setAttribute("aria-label", `Delete ${each.title}`);
    remove.addEventListener("click", async () => {
      if (!confirm(`Delete this performance of ${each.title}?`)) return;
      await ask(`api/performances/${each.id}`, "DELETE");
      await listKept();
    });
    links.append(again, beside, remove);
    item.append(make("b", each.title), make("small", about), links);
    return item;
  }));
}

/** The second performance is compared with the first. */
let compared = null;
function compare(each) {
  const first = compared;
  compared = first === null ? each : null;
  $("comparing").hidden = compared === null;
  $("comparing").textContent = compared && `Choose another performance to compare with that of ${compared.title}, F1 ${compared.f1.toFixed(3)}.`;
  if (first && first.id !== each.id) window.open(`comparisons/${first.id}/${each.id}`, "_blank", "noopener");
}

// What goes on in the background

const f1 = (value) => `F1 ${value.toFixed(3)}`;
/** Shows it, and again soon where something goes on. */
async function listBackground() {
  if (only) return;
  clearTimeout(listBackground.again);
  const { practice, trainings } = await ask("api/background");
  const works = trainings.map(training);
  if (practice.title) works.unshift(practised(practice));
  $("works").replaceChildren(...works);
  $("background").hidden = !works.length;
  const active = trainings.some(({ state }) => state === "learning") || ["preparing", "practising"].includes(practice.status.state);
  $("resting").hidden = !(active && practice.paused);
  const learnt = trainings.map(({ name, f1: best }) => name + (best !== null)).join();
  if (listBackground.learnt !== learnt) await listSongs(); // there may be another policy
  listBackground.learnt = learnt;
  cadenza.background = { practice, trainings };
  if (active) listBackground.again = setTimeout(listBackground, 2000);
}
function work(title, about, points, acts) {
  const item = make("li"), nav = make("nav");
  for (const [name, act] of acts) {
    const button = make("button", name, { type: "button" });
    button.setAttribute("aria-label", `${name}: ${title}`);
    button.addEventListener("click", async () => {
      calm();
      await act();
      await listBackground();
    });
    nav.append(button);
  }
  item.append(make("b", title), make("small", about));
  if (points.length > 1) item.append(curve(points));
  item.append(nav);
  return item;
}
/** Of F1 between 0 and 1, from the first point to the last. */
function curve(points) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const draw = (name, attributes) => {
    const drawn = document.createElementNS(svg.namespaceURI, name);
    for (const [key, value] of Object.entries(attributes)) drawn.setAttribute(key, value);
    svg.append(drawn);
  };
  const [first, last] = [points[0][0], points.at(-1)[0]];
  for (const [key, value] of [["viewBox", "0 0 100 44"], ["preserveAspectRatio", "none"], ["role", "img"], ["aria-label", `F1 from ${points[0][1].toFixed(3)} to ${points.at(-1)[1].toFixed(3)}`]]) svg.setAttribute(key, value);
  draw("path", { d: "M0 2H100M0 42H100" });
  draw("polyline", { points: points.map(([x, y]) => `${(100 * (x - first)) / (last - first || 1)},${42 - 40 * y}`).join(" ") });
  return svg;
}
function practised({ title, request: wanted, status: { state, f1: values = [], share = 0, error } }) {
  const active = ["preparing", "practising"].includes(state);
  const far = { preparing: "getting ready", practising: `${Math.floor(100 * share)} %`, done: "done" }[state] ?? error ?? state;
  const gained = values.length ? ` · ${[...new Set([values[0], Math.max(...values)].map((value) => value.toFixed(3)))].join(" → ")}` : "";
  const acts = [["Play", () => { set(wanted); return begin(); }]];
  if (active) acts.push(["Stop", () => ask("api/practice", "DELETE")]);
  return work(`Practising ${title}`, `${far}${gained && ` · F1${gained.slice(2)}`}`, values.map((value, i) => [i, value]), acts);
}
function training({ name, state, step, steps, f1: best, points, error }) {
  const url = `api/trainings/${encodeURIComponent(name)}`;
  const about = [state, `${step.toLocaleString("en")} of ${steps.toLocaleString("en")} steps`, best === null ? "" : `best ${f1(best)}`, error];
  const acts = state === "learning" ? [["Stop", () => ask(`${url}/stop`, "POST")]] : state === "stopped" ? [["Resume", () => ask(`${url}/resume`, "POST")]] : [];
  if (best !== null) acts.push(["Choose", () => { $("agent").value = `policy/${name}`; $("more").open = true; }]);
  return work(`Learning ${name}`, about.filter(Boolean).join(" · "), points, acts);
}
async function train() {
  calm();
  await ask("api/trainings", "POST", JSON.stringify({ ...request(), agent: "planner", steps: Number($("steps").value) }));
  await listBackground();
}

// What the visitor does

$("search").addEventListener("input", showSongs);
$("start").addEventListener("click", begin);
$("train").addEventListener("click", train);
let stopListening = null;
$("keyboard").hidden = !navigator.requestMIDIAccess;
$("keyboard").addEventListener("click", async () => {
  calm();
  const told = (notes) => say(`Listening: ${notes} ${notes === 1 ? "note" : "notes"}`, null, null, Boolean(live));
  const phrase = (bytes) => upload(new File([bytes], `Played at ${new Date().toLocaleTimeString()}.mid`));
  if (stopListening) stopListening();
  stopListening = stopListening ? null : await listenToKeyboards(told, phrase);
  press($("keyboard"), Boolean(stopListening));
  if (stopListening && !job) say("Play something. When you pause, the hands play it after you.");
});
$("file").addEventListener("change", () => { if ($("file").files[0]) upload($("file").files[0]); });
$("cancel").addEventListener("click", () => ask(`api/jobs/${job}`, "DELETE"));
$("play").addEventListener("click", toggle);
$("link").addEventListener("click", async () => {
  await navigator.clipboard.writeText(`${location.origin}${location.pathname}#${asHash(request())}`);
  $("link").textContent = "Copied";
  setTimeout(() => { $("link").textContent = "Copy link"; }, 1500);
});
const mute = loudness((muted) => { instrument.muted = muted; }, (volume) => { instrument.volume = volume; });
for (const name of ["dragenter", "dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    if (only) return;
    const over = name === "dragenter" || name === "dragover";
    $("picture").classList.toggle("over", over);
    $("drop").classList.toggle("over", over);
    if (name === "drop" && event.dataTransfer.files[0]) upload(event.dataTransfer.files[0]);
  });
}
document.addEventListener("pointerdown", () => { if (live) instrument.wake(); });
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input, select, textarea")) return;
  if (event.key === " " && event.target.matches("button, a, summary")) return;
  const act = { " ": toggle, m: mute }[event.key.toLowerCase()];
  if (!act) return;
  act();
  event.preventDefault();
});

await listSongs();
await listKept();
await listBackground();
const asked = fromHash();
if (asked.job || only) {
  const [id, time] = JSON.parse(sessionStorage.getItem("cadenza") ?? "[null, 0]");
  const wanted = only ?? asked.job;
  watch(wanted, id === wanted ? time : 0);
} else if (asked.song) {
  set(asked);
  $("more").open = true;
}
new ResizeObserver(() => roll?.draw()).observe($("roll-card"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => roll?.draw());
setInterval(() => { // also where the page is hidden and draws no frames
  proceed();
  if (live) sound();
}, 50);
Object.assign(cadenza, { ready: true, upload, instrument });
frame();
