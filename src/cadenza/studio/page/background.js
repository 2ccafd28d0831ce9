// What goes on in the background: practice, policies that learn, and songs that other pages asked for.

const POLL_INTERVAL = 2000; // [ms]

/** Shows the background work, and again soon where something goes on. */
async function showBackground() {
  if (only) return;
  clearTimeout(showBackground.again);
  let found;
  try {
    found = await fetchJson("api/background");
  } catch (error) {
    showBackground.again = setTimeout(showBackground, POLL_INTERVAL); // the server may come back
    throw error;
  }
  const { practice, trainings, jobs } = found;
  const others = jobs.filter(({ id }) => !shown.some((each) => each.id === id)), items = trainings.map(trainingItem);
  if (practice.title) items.unshift(practiceItem(practice));
  items.unshift(...others.map(jobItem));
  $("works").replaceChildren(...items);
  $("background").hidden = !items.length;
  const active = trainings.some(({ state }) => state === "learning") || ["preparing", "practising"].includes(practice.status.state);
  $("resting").hidden = !(active && practice.paused);
  const learnt = trainings.map(({ name, f1: best }) => name + (best !== null)).join();
  if (showBackground.learnt !== learnt) await listSongs(); // there may be another policy
  showBackground.learnt = learnt;
  cadenza.background = { practice, trainings };
  if (active || others.length) showBackground.again = setTimeout(showBackground, POLL_INTERVAL);
}
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
  return taskItem(`Playing ${title}`, doing, [], [["Watch", () => watch([id])], ["Cancel", () => fetchJson(`api/jobs/${id}`, "DELETE")]]);
}
function practiceItem({ title, request: wanted, status: { state, f1: values = [], note_onset_f1: onsets = [], share = 0, error } }) {
  const active = ["preparing", "practising"].includes(state);
  const progress = { preparing: "getting ready", practising: `${Math.floor(100 * share)} %`, done: "done" }[state] ?? error ?? state;
  const best = values.indexOf(Math.max(...values)), marked = [...new Set([0, best])].filter((i) => i in values);
  const gained = marked.map((i) => formatScores(values[i], onsets[i])).join(" → ");
  const actions = [["Play", () => { setOptions(wanted); return playChosen(); }]];
  if (active) actions.push(["Stop", () => fetchJson("api/practice", "DELETE")]);
  return taskItem(`Practising ${title}`, [progress, gained].filter(Boolean).join(" · "), values.map((value, i) => [i, value]), actions);
}
function trainingItem({ name, state, step, steps, f1: best, note_onset_f1: onsets, points, error }) {
  const url = `api/trainings/${encodeURIComponent(name)}`;
  const about = [state, steps && `${step.toLocaleString("en")} of ${steps.toLocaleString("en")} steps`, best === null ? "" : `best ${formatScores(best, onsets)}`, error];
  const actions = state === "learning" ? [["Stop", () => fetchJson(`${url}/stop`, "POST")]] : state === "stopped" ? [["Resume", () => fetchJson(`${url}/resume`, "POST")]] : [];
  if (best !== null) actions.push(["Choose", () => {
    $("agent").value = `policy/${name}`;
    showAgent();
    $("more").open = true;
  }]);
  return taskItem(`Learning ${name}`, about.filter(Boolean).join(" · "), points, actions);
}
async function train() {
  await fetchJson("api/trainings", "POST", JSON.stringify({ ...playRequest(), agent: "planner", steps: Number($("steps").value) }));
  await showBackground();
}
