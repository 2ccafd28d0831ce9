// What happens when the visitor clicks, drops or presses a key.

$("search").addEventListener("input", showSongs);
$("agent").addEventListener("change", showAgent);
const levels = Array.from({ length: HARDEST }, (_, i) => make("option", i + 1));
$("level").append(make("option", "all that hands can play", { value: "" }), ...levels);
$("arrange").addEventListener("change", showLevel);
for (const id of ["start", "first"]) $(id).addEventListener("click", playChosen);
$("speed").addEventListener("change", () => setSpeed(Number($("speed").value)));
let stopListening = null;
$("keyboard").hidden = !navigator.requestMIDIAccess && isSecureContext; // it knows none
$("keyboard").addEventListener("click", async () => {
  const onCount = (notes) => overrideNotice(`Listening: ${notes} ${notes === 1 ? "note" : "notes"}`);
  const onPhrase = (bytes) => upload(new File([bytes], `Played at ${new Date().toLocaleTimeString()}.mid`));
  if (stopListening) stopListening();
  stopListening = stopListening ? null : await listenToKeyboards(onCount, onPhrase);
  press($("keyboard"), Boolean(stopListening));
  overrideNotice(stopListening && !current ? "Play something. When you pause, the hands play it after you." : "");
});
$("file").addEventListener("change", () => {
  const [file] = $("file").files;
  $("file").value = ""; // so that the same file can be chosen again
  if (file) upload(file);
});
$("cancel").addEventListener("click", () => fetchJson(`api/jobs/${current.id}`, "DELETE"));
$("play").addEventListener("click", togglePlay);
$("link").addEventListener("click", async () => {
  const link = `${location.origin}${location.pathname}#${toHash(playRequest())}`;
  const copied = await navigator.clipboard?.writeText(link).then(() => true, () => false);
  if (!copied) history.replaceState(null, "", link); // of another machine, browsers let no page copy
  $("link").textContent = copied ? "Copied" : "Now above";
  setTimeout(() => { $("link").textContent = "Copy link"; }, 1500);
});
const mute = loudness((muted) => { instrument.muted = muted; }, (volume) => { instrument.volume = volume; });
for (const name of ["dragenter", "dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    const over = name === "dragenter" || name === "dragover";
    $("picture").classList.toggle("over", over);
    $("drop").classList.toggle("over", over);
    if (name === "drop" && event.dataTransfer.files[0]) upload(event.dataTransfer.files[0]);
  });
}
document.addEventListener("pointerdown", () => { if (current) instrument.wake(); });
$("scrub").addEventListener("input", () => seek(Number($("scrub").value)));

listenToKeys({ toggle: togglePlay, mute, fill: fullScreen(), seek, now, end: available });

/** Opens what the address asks for: a performance, or a song and how it is to be played. */
function openFromAddress() {
  const asked = fromHash(), id = asked.job;
  if (id) {
    const [lastId, time] = remembered();
    watch(id, id === lastId ? time : 0);
  } else if (asked.song) {
    setOptionsToPlay(asked);
    $("more").open = true;
  } else if (!current) return showOpening();
}

await listSongs();
await listPerformances();
await showBackground();
openFromAddress();
window.addEventListener("hashchange", openFromAddress);
new ResizeObserver(() => roll?.draw()).observe($("roll-card"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => roll?.draw());
setInterval(() => { // also where the page is hidden and draws no frames
  updatePlayback();
  scheduleSound();
}, 50);
Object.assign(cadenza, { ready: true, upload, seek, instrument });
fitToWindow();
requestAnimationFrame(frame);
