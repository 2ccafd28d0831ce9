// What goes on in the background: practice, and songs that other pages asked for.

const POLL_INTERVAL = 2000; // [ms]

/** Shows the background work, and again soon where something goes on. */
async function showBackground() {
  clearTimeout(showBackground.again);
  let found;
  try {
    found = await fetchJson("api/background");
  } catch (error) {
    showBackground.again = setTimeout(showBackground, POLL_INTERVAL); // the server may come back
    throw error;
  }
  const { practice, jobs } = found, others = jobs.filter(({ id }) => id !== current?.id), items = others.map(jobItem);
  if (practice.title) items.push(practiceItem(practice));
  $("works").replaceChildren(...items);
  $("background").hidden = !items.length;
  const active = isActive(practice.status);
  $("resting").hidden = !(active && practice.paused);
  if (active || others.length) showBackground.again = setTimeout(showBackground, POLL_INTERVAL);
}
const isActive = ({ state }) => ["preparing", "practising"].includes(state);
function taskItem(title, about, points, actions) {
  const item = make("li", [make("b", title), make("small", about)]);
  if (points.length > 1) addCurveOfF1(item, points);
  item.append(make("nav", actions.map(([name, run]) => labelledButton(name, `${name}: ${title}`, async () => {
    await run();
    await showBackground();
  }))));
  return item;
}
/** Draws F1 between 0 and 1, from the first point to the last. */
function addCurveOfF1(item, points) {
  const [[first, from], [last, to]] = [points[0], points.at(-1)], label = `F1 from ${from.toFixed(3)} to ${to.toFixed(3)}`;
  const svg = addDrawing("svg", { viewBox: "0 0 100 44", preserveAspectRatio: "none", role: "img", "aria-label": label }, item);
  addDrawing("path", { d: "M0 2H100M0 42H100" }, svg);
  addDrawing("polyline", { points: points.map(([x, y]) => `${(100 * (x - first)) / (last - first || 1)},${42 - 40 * y}`).join(" ") }, svg);
}
/** Returns the item of a song that another page asked for, which may have been closed: anybody can end it. */
function jobItem({ id, title, status: { state } }) {
  const doing = { queued: "waits for its turn", preparing: "getting ready", playing: "being planned" }[state] ?? "writing its files";
  return taskItem(`Playing ${title}`, doing, [], [["Watch", () => watch(id)], ["Cancel", () => fetchJson(`api/jobs/${id}`, "DELETE")]]);
}
function practiceItem({ title, request, status }) {
  const { state, f1: values = [], note_onset_f1: onsets = [], share = 0, error } = status;
  const progress = { preparing: "getting ready", practising: `${Math.floor(100 * share)} %`, done: "done" }[state] ?? error ?? state;
  const best = values.indexOf(Math.max(...values)), marked = [...new Set([0, best])].filter((i) => i in values);
  const gained = marked.map((i) => `F1 ${values[i].toFixed(3)}${Number.isFinite(onsets[i]) ? ` · note onsets ${onsets[i].toFixed(3)}` : ""}`).join(" → ");
  const actions = [["Play", () => { setOptions(request); return playChosen(); }]];
  if (isActive(status)) actions.push(["Stop", () => fetchJson("api/practice", "DELETE")]);
  return taskItem(`Practising ${title}`, [progress, gained].filter(Boolean).join(" · "), values.map((value, i) => [i, value]), actions);
}
