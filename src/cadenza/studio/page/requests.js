// Requests to the server, and errors on the page.

const cadenza = window.cadenza = { ready: false, error: null, state: "idle", time: 0, strikes: [], waits: 0 };
/** Returns a button whose label says to screen readers what it acts on. */
const labelledButton = (name, label, run) => make("button", name, { type: "button", "aria-label": label, onclick: run });
function showError(message) {
  cadenza.error = String(message);
  $("error").textContent = cadenza.error; // as it is: it may begin with the name of a file
  $("error").hidden = false;
}
function clearError() {
  cadenza.error = null;
  $("error").hidden = true;
}
/** An error of the visitor or the server, and what to do about it; the page itself works. */
class Refusal extends Error {}
window.addEventListener("error", (event) => showError("This page met an error: " + event.message));
window.addEventListener("unhandledrejection", (event) => {
  showError(event.reason?.message ?? String(event.reason));
  if (event.reason instanceof Refusal) event.preventDefault(); // the console is for what is wrong
});
// An error disappears when the visitor does something else.
for (const name of ["click", "change", "drop"]) {
  document.addEventListener(name, ({ target }) => {
    if (name !== "click" || target.closest("button, a, input, select, label, summary")) clearError();
  }, true);
}
window.addEventListener("hashchange", clearError);

const NO_ANSWER = "The studio does not answer. Start it again; this page then goes on.";

/** Returns what the server answers; throws a `Refusal` of one line where it refuses. */
async function fetchJson(path, method = "GET", body = undefined) {
  let answer;
  try {
    answer = await fetch(path, { method, body });
  } catch {
    throw new Refusal(NO_ANSWER);
  }
  if (cadenza.error === NO_ANSWER) clearError();
  if (answer.status === 204) return null;
  const content = await answer.json().catch(() => ({ error: `The studio answered ${answer.status}.` }));
  if (!answer.ok) throw new Refusal(content.error);
  return content;
}
