// What the server is asked, and how the page says what went wrong.

const cadenza = window.cadenza = { ready: false, error: null, state: "idle", time: 0, strikes: [], waits: 0 };
function make(name, text = "", attributes = {}) {
  const element = Object.assign(document.createElement(name), attributes);
  element.textContent = text;
  return element;
}
/** A button that says what it acts on to those who do not see where it stands. */
function act(name, label, run) {
  const button = make("button", name, { type: "button" });
  button.setAttribute("aria-label", label);
  button.addEventListener("click", run);
  return button;
}
function complain(message) {
  cadenza.error = String(message);
  $("error").textContent = cadenza.error.charAt(0).toUpperCase() + cadenza.error.slice(1);
  $("error").hidden = false;
}
function calm() {
  cadenza.error = null;
  $("error").hidden = true;
}
/** What cannot be done, and what to do about it: nothing that is wrong with the page. */
class Refusal extends Error {}
window.addEventListener("error", (event) => complain("This page met an error: " + event.message));
window.addEventListener("unhandledrejection", (event) => {
  complain(event.reason?.message ?? String(event.reason));
  if (event.reason instanceof Refusal) event.preventDefault(); // the console is for what is wrong
});
// What was said of the last thing that the visitor did is over with the next.
for (const name of ["click", "change", "drop"]) {
  document.addEventListener(name, ({ target }) => {
    if (name !== "click" || target.closest("button, a, input, select, label, summary")) calm();
  }, true);
}
window.addEventListener("hashchange", calm);

/** F1, and beside it that of note onsets where it is known. */
const inFigures = (f1, onsets) => `F1 ${f1.toFixed(3)}${Number.isFinite(onsets) ? ` · note onsets ${onsets.toFixed(3)}` : ""}`;

const SILENT = "The studio does not answer. Start it again; this page then goes on.";

/** What the server answers; what it refuses is an error of one line. */
async function ask(path, method = "GET", body = undefined) {
  let answer;
  try {
    answer = await fetch(path, { method, body });
  } catch {
    throw new Refusal(SILENT);
  }
  if (cadenza.error === SILENT) calm();
  if (answer.status === 204) return null;
  const said = await answer.json().catch(() => ({ error: `The studio answered ${answer.status}.` }));
  if (!answer.ok) throw new Refusal(said.error);
  return said;
}
