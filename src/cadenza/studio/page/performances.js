// Kept performances, to watch again and download.

const FILE_TITLES = { "report.html": "Report", "report.html#film": "Film", "played.mid": "MIDI", "wanted.mid": "Wanted MIDI" };
const FILE_NAMES = { "wanted.mid": ", as wanted" }; // after the title, where two files have the same ending

async function listPerformances() {
  const kept = await fetchJson("api/performances");
  $("kept").replaceChildren(...kept.map(performanceItem));
}
function performanceItem(each) {
  const links = make("nav"), { id, title, has_states: canWatch } = each;
  const when = new Date(1000 * each.finished).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
  const about = `${minutes(each.seconds).split(".")[0]} · ${when}`;
  if (canWatch) links.append(labelledButton("Watch", `Watch ${title}`, () => { instrument.wake(); watch(id); }));
  for (const [file, name] of Object.entries(FILE_TITLES)) {
    if (!each.files.includes(file.split("#")[0])) continue;
    const link = make("a", name, { href: `performances/${id}/${file}`, target: "_blank", rel: "noopener", "aria-label": `${name} of ${title}` });
    if (!file.startsWith("report.html")) link.download = `${title}${FILE_NAMES[file] ?? ""}${file.slice(file.lastIndexOf("."))}`;
    links.append(link);
  }
  links.append(labelledButton("Delete", `Delete ${title}`, () => deletePerformance(each)));
  return make("li", [make("b", title, { title }), make("small", each.verdict), make("small", howPlayed(each.request)), make("small", about), links]);
}
async function deletePerformance({ id, title }) {
  if (!confirm(`Delete this performance of ${title}?`)) return;
  await fetchJson(`api/performances/${id}`, "DELETE");
  await listPerformances();
}
