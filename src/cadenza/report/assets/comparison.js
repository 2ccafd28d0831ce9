// One run at a time, in a frame: its own page, put together with what all of them share.

const $ = (id) => document.getElementById(id);
const read = (element) => JSON.parse(element.textContent);
const frame = $("frame"), choice = $("choice"), strips = document.querySelector(".strips");
const shared = read($("shared")), runs = document.querySelectorAll(".run");
const comparison = window.comparison = { ready: false };
let turns = 0;

/** The player of the run in sight, if it is ready. */
const player = () => (comparison.ready ? frame.contentWindow.cadenza : null);

/** Shows a run, which goes on from `time` [s] if the one before was playing. */
async function show(index, time = player()?.time ?? 0) {
  const turn = ++turns, playing = player()?.playing;
  comparison.ready = false;
  choice.value = index;
  for (const button of document.querySelectorAll("button[data-run]")) button.setAttribute("aria-pressed", button.dataset.run === choice.value);
  frame.srcdoc = read(runs[index]).map((piece) => (typeof piece === "number" ? shared[piece] : piece)).join("");
  await new Promise((loaded) => { frame.onload = loaded; });
  if (turn !== turns) return;
  const { documentElement: root } = frame.contentDocument, { cadenza } = frame.contentWindow;
  root.classList.add("framed");
  new ResizeObserver(() => { frame.style.height = `${root.offsetHeight}px`; }).observe(root);
  while (!cadenza.ready && cadenza.error === null) await new Promise(requestAnimationFrame);
  if (turn !== turns) return;
  comparison.ready = true;
  cadenza.seek(time);
  if (playing) cadenza.play();
}

choice.addEventListener("change", () => show(choice.value));
for (const chosen of document.querySelectorAll("[data-run]")) {
  chosen.addEventListener("click", (event) => {
    const box = chosen.getBoundingClientRect(), isStrip = chosen.matches(".strip");
    const time = isStrip ? ((event.clientX - box.left) / box.width) * Number(strips.dataset.duration) : undefined;
    if (chosen.dataset.run !== choice.value) show(chosen.dataset.run, time);
    else if (isStrip) player()?.seek(time);
    if (!isStrip) $("run").scrollIntoView({ block: "nearest" });
  });
}

const cursor = document.createElement("div");
cursor.className = "cursor";
(function follow() {
  const strip = document.querySelector(`.strip[data-run="${choice.value}"]`);
  if (cursor.parentElement !== strip) strip.append(cursor);
  cursor.hidden = !player();
  if (player()) cursor.style.left = `${(100 * player().time) / Number(strips.dataset.duration)}%`;
  requestAnimationFrame(follow);
})();
show(0);
