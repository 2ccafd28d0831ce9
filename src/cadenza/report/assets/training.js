// Keeps what is unfolded, and loads the page anew while the run goes on.

// The browser keeps the place on the page; what is unfolded is left to us.
const settings = document.querySelector("details");
if (settings) {
  settings.open = history.state === "open";
  settings.addEventListener("toggle", () => history.replaceState(settings.open ? "open" : null, ""));
}
if ("running" in document.documentElement.dataset) {
  setInterval(() => { if (!document.querySelector(".u-legend:not([hidden])")) location.reload(); }, 20_000);
}
