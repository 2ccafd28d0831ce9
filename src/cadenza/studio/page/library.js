// Songs to choose from, and how they are to be played.

const OPTIONS = ["agent", "hand", "hands", "tempo", "transpose", "seed"], NUMBERS = ["tempo", "transpose", "seed"];
const HARDEST = 10; // level
const SWITCHES = ["plain", "expression"];
const MAX_LISTED = 200; // songs at once
const MAX_SENT = 5 << 20; // bytes of a file: more than the server takes, of which it says so
const SONG_GONE = "This song is not here any more. Choose another, or drop its file again.";
let agentTexts = {}, handTitles = {}; // by id: title, and of agents what they do
let songs = [], first = "", chosen = null; // songs, and the one that the page opens with

async function listSongs() {
  const { songs: found, agents, hands, first: opening = "" } = await fetchJson("api/songs");
  [songs, first] = [found, opening];
  agentTexts = agents;
  fillSelect("agent", Object.fromEntries(Object.entries(agents).map(([id, [name]]) => [id, name])));
  handTitles = hands;
  fillSelect("hand", hands);
  showAgent();
  showSongs();
}
const showLevel = () => { $("level").disabled = !$("arrange").checked; };
const showAgent = () => { $("about").textContent = agentTexts[$("agent").value]?.[1] ?? ""; };
/** Returns the title of an agent. */
const nameOfAgent = (agent) => agentTexts[agent]?.[0] ?? agent;
/** Fills a select with values by their names. */
function fillSelect(id, names) {
  const { value } = $(id);
  $(id).replaceChildren(...Object.entries(names).map(([value, name]) => make("option", name, { value })));
  if (value in names) $(id).value = value;
}
function showSongs() {
  const words = $("search").value.toLowerCase().split(/\s+/);
  const matches = ({ title, composer = "", id }) => words.every((word) => `${title} ${composer} ${id}`.toLowerCase().includes(word));
  const found = songs.filter(matches), more = found.length - MAX_LISTED;
  $("songs").replaceChildren(...found.slice(0, MAX_LISTED).map(songItem));
  if (!found.length) $("songs").append(make("li", "Nothing of that name.", { className: "remark" }));
  if (more > 0) $("songs").append(make("li", `${more} more: search for them.`, { className: "remark" }));
  showChosen();
}
/** Marks the button of the chosen song; buttons stay, so that the keyboard focus does. */
function showChosen() {
  for (const button of $("songs").querySelectorAll("[data-song]")) press(button, button.dataset.song === chosen?.id);
}
function songItem(song) {
  const about = song.uploaded ? "yours" : song.composer;
  const level = song.grade ? ` · level ${song.grade.toFixed(1)}` : "";
  const length = make("small", minutes(song.seconds).split(".")[0] + level, { title: level && "How hard it is for robot hands, from 1 to 10" });
  const button = make("button", [make("span", song.title), make("small", about), length], { type: "button", title: `${song.title}, ${about}`, "data-song": song.id });
  button.addEventListener("click", () => { choose(song.id); playChosen(); });
  return make("li", song.uploaded ? [button, labelledButton("×", `Delete ${song.title}`, () => deleteSong(song))] : button);
}
/** Deletes an upload; what was played of it stays. */
async function deleteSong(song) {
  if (!confirm(`Delete your file ${song.title}? Its performances stay.`)) return;
  await fetchJson(`api/songs/${song.id}`, "DELETE");
  await listSongs();
  if (chosen?.id === song.id) choose(null);
}
function choose(id) {
  chosen = songs.find((song) => song.id === id) ?? null;
  for (const id of ["start", "link"]) $(id).disabled = !chosen;
  $("start").textContent = $("start").title = chosen ? `Play ${chosen.title}` : "Play";
  const { tracks = [], remarks = [] } = chosen ?? {};
  $("remarks").textContent = `In this file: ${remarks.join("; ")}.`;
  $("remarks").hidden = !remarks.length;
  $("tracks").hidden = tracks.length < 2;
  $("tracks").replaceChildren(make("legend", "Tracks"), ...tracks.map(({ number, name, instrument, notes: count }) => {
    const box = make("input", [], { type: "checkbox", value: number, checked: true });
    return make("label", [box, make("span", `${name || instrument || `Track ${number}`}, ${count} notes`)]);
  }));
  showChosen();
}
function playRequest() {
  if (!chosen) throw new Refusal(SONG_GONE);
  const wanted = { song: chosen.id }, wrong = NUMBERS.find((name) => !$(name).checkValidity());
  if (wrong) throw new Refusal(`${$(wrong).labels[0].textContent.trim()}: ${$(wrong).validationMessage}`);
  for (const name of OPTIONS) wanted[name] = NUMBERS.includes(name) ? Number($(name).value) : $(name).value;
  for (const name of SWITCHES) wanted[name] = $(name).checked;
  wanted.arrange = $("arrange").checked ? "auto" : "off";
  wanted.level = $("arrange").checked && $("level").value ? Number($("level").value) : null;
  const boxes = [...$("tracks").querySelectorAll("input")], on = boxes.filter((box) => box.checked);
  if (boxes.length && !on.length) throw new Refusal("Choose at least one of the tracks.");
  if (on.length < boxes.length) wanted.tracks = on.map((box) => Number(box.value));
  return wanted;
}
/** Sets all options to those of a request; no song is chosen where that is gone. */
function setOptions(wanted) {
  choose(wanted.song);
  const list = $("songs"), button = list.querySelector('[aria-pressed="true"]');
  if (button) {
    const { top, bottom } = list.getBoundingClientRect(), at = button.getBoundingClientRect();
    if (at.top < top || at.bottom > bottom) list.scrollTop += at.top - top;
  }
  for (const name of OPTIONS) if (wanted[name] !== undefined) $(name).value = wanted[name];
  for (const name of SWITCHES) if (wanted[name] !== undefined) $(name).checked = wanted[name];
  if (wanted.arrange !== undefined) $("arrange").checked = wanted.arrange !== "off";
  if (wanted.level !== undefined) $("level").value = wanted.level ?? "";
  showLevel();
  showAgent();
  const tracks = wanted.tracks ?? [];
  if (tracks.length) for (const box of $("tracks").querySelectorAll("input")) box.checked = tracks.includes(Number(box.value));
}
/** Sets all options, and shows an error where the song is gone. */
function setOptionsToPlay(wanted) {
  setOptions(wanted);
  if (!chosen) showError(SONG_GONE);
}
/** Returns what a link has after its #. */
const toHash = (wanted) => new URLSearchParams(Object.entries(wanted).map(([name, value]) => [name, String(value ?? "")])).toString();
function fromHash() {
  const wanted = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  for (const name of SWITCHES) if (wanted[name]) wanted[name] = wanted[name] === "true";
  if (wanted.level !== undefined) wanted.level = Number(wanted.level) || null;
  if (wanted.tracks) wanted.tracks = wanted.tracks.split(",").map(Number);
  return wanted;
}

async function upload(file) {
  overrideNotice(`Reading ${file.name}`);
  try {
    const content = await file.slice(0, MAX_SENT).arrayBuffer().catch(() => {
      throw new Refusal(`${file.name}: cannot be read; drop a file, no folder`);
    });
    const { id } = await fetchJson(`api/songs?name=${encodeURIComponent(file.name.toWellFormed())}`, "POST", content);
    await listSongs();
    choose(id);
    $("songs").scrollTop = 0;
  } finally {
    overrideNotice("");
  }
  await playChosen();
}
let asked = ""; // what the server is being asked to play
/** Plays the chosen song, instead of one that is being planned for this page; what is being prepared already goes on. */
async function playChosen() {
  instrument.wake();
  const wanted = JSON.stringify(playRequest());
  if (wanted === asked || (wanted === current?.wanted && !current.over && !isReady())) return bringIntoView();
  const choiceNumber = ++numChoices;
  asked = wanted;
  try {
    if (current && !current.over && !current.complete) await fetchJson(`api/jobs/${current.id}`, "DELETE");
    if (choiceNumber !== numChoices) return;
    const { id } = await fetchJson("api/jobs", "POST", wanted);
    if (choiceNumber !== numChoices) await fetchJson(`api/jobs/${id}`, "DELETE"); // something else was chosen meanwhile
    else {
      watch(id);
      current.wanted = wanted;
    }
  } finally {
    if (asked === wanted) asked = "";
  }
}
