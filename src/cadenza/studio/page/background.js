// What goes on in the background: practice, policies that learn, and songs that other pages asked for.

/** Shows it, and again soon where something goes on. */
async function listBackground() {
  if (only) return;
  clearTimeout(listBackground.again);
  let found;
  try {
    found = await ask("api/background");
  } catch (error) {
    listBackground.again = setTimeout(listBackground, 2000); // the server may come back
    throw error;
  }
  const { practice, trainings, jobs } = found;
  const others = jobs.filter(({ id }) => !shown.some((each) => each.id === id)), works = trainings.map(training);
  if (practice.title) works.unshift(practised(practice));
  works.unshift(...others.map(planned));
  $("works").replaceChildren(...works);
  $("background").hidden = !works.length;
  const active = trainings.some(({ state }) => state === "learning") || ["preparing", "practising"].includes(practice.status.state);
  $("resting").hidden = !(active && practice.paused);
  const learnt = trainings.map(({ name, f1: best }) => name + (best !== null)).join();
  if (listBackground.learnt !== learnt) await listSongs(); // there may be another policy
  listBackground.learnt = learnt;
  cadenza.background = { practice, trainings };
  if (active || others.length) listBackground.again = setTimeout(listBackground, 2000);
}
function work(title, about, points, acts) {
  const item = make("li"), nav = make("nav");
  for (const [name, run] of acts) {
    nav.append(act(name, `${name}: ${title}`, async () => {
      await run();
      await listBackground();
    }));
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
/** A song that a page asked for which may have been closed: else nobody could end what others wait for. */
function planned({ id, title, status: { state } }) {
  const doing = { queued: "waits for its turn", preparing: "getting ready", playing: "being planned" }[state] ?? "being kept";
  return work(`Playing ${title}`, doing, [], [["Watch", () => watch([id])], ["Cancel", () => ask(`api/jobs/${id}`, "DELETE")]]);
}
function practised({ title, request: wanted, status: { state, f1: values = [], note_onset_f1: onsets = [], share = 0, error } }) {
  const active = ["preparing", "practising"].includes(state);
  const far = { preparing: "getting ready", practising: `${Math.floor(100 * share)} %`, done: "done" }[state] ?? error ?? state;
  const best = values.indexOf(Math.max(...values)), takes = [...new Set([0, best])].filter((i) => i in values);
  const gained = takes.map((i) => inFigures(values[i], onsets[i])).join(" → ");
  const acts = [["Play", () => { set(wanted); return begin(); }]];
  if (active) acts.push(["Stop", () => ask("api/practice", "DELETE")]);
  return work(`Practising ${title}`, [far, gained].filter(Boolean).join(" · "), values.map((value, i) => [i, value]), acts);
}
function training({ name, state, step, steps, f1: best, note_onset_f1: onsets, points, error }) {
  const url = `api/trainings/${encodeURIComponent(name)}`;
  const about = [state, steps && `${step.toLocaleString("en")} of ${steps.toLocaleString("en")} steps`, best === null ? "" : `best ${inFigures(best, onsets)}`, error];
  const acts = state === "learning" ? [["Stop", () => ask(`${url}/stop`, "POST")]] : state === "stopped" ? [["Resume", () => ask(`${url}/resume`, "POST")]] : [];
  if (best !== null) acts.push(["Choose", () => {
    $("agent").value = `policy/${name}`;
    showAgent();
    $("more").open = true;
  }]);
  return work(`Learning ${name}`, about.filter(Boolean).join(" · "), points, acts);
}
async function train() {
  await ask("api/trainings", "POST", JSON.stringify({ ...request(), agent: "planner", steps: Number($("steps").value) }));
  await listBackground();
}
