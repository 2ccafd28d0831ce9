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
window.addEventListener("error", (event) => complain("This page met an error: " + event.message));
window.addEventListener("unhandledrejection", (event) => complain(event.reason?.message ?? String(event.reason)));

const SILENT = "The studio does not answer. Start it again; this page then goes on.";

/** What the server answers; what it refuses is an error of one line. */
async function ask(path, method = "GET", body = undefined) {
  let answer;
  try {
    answer = await fetch(path, { method, body });
  } catch {
    throw new Error(SILENT);
  }
  if (answer.status === 204) return null;
  const said = await answer.json().catch(() => ({ error: `The studio answered ${answer.status}.` }));
  if (!answer.ok) throw new Error(said.error);
  return said;
}
