// Why notes were missed, and what an arrangement did with others: in tables, and where one points.

/** Of each note that was lost, as `misses` has them (see `cadenza.report.performance_page`). */
function missesOf({ misses = [], lowest, keys }) {
  const numbers = new Map(Array.from({ length: keys }, (_, key) => [noteName(key + lowest), key]));
  return misses.map(([time, note, finger, what, cause, reason]) => ({ key: numbers.get(note), time, note, finger, what, cause, reason }));
}

/** Lists notes that were lost, with those of the same reason in one row; `show(time)` goes there. */
function listMisses(table, data, show) {
  const rows = missesOf(data).map(({ time, note, finger, what, cause, reason }) => ({
    time, cells: [note, finger, what, reason],
    group: cause + reason.replace(/[A-G]♯?-?\d+|[\d.]+/g, ""), // whatever the notes and figures are
    title: cause, reason,
  }));
  listNotes(table, ["Time", "Note", "Finger", "What", "Why"], rows, show);
}

/** Lists notes that were left out, moved or struck again, with those of which the same became in one row. */
function listChanges(table, data, show) {
  const rows = changesOf(data).map((change) => {
    const { written, from, part, became } = change, words = `of the ${part}, ${became}`;
    return { time: from, cells: [noteName(written + data.lowest), part, inFull(change, data)], group: words, title: words, reason: words };
  });
  listNotes(table, ["Time", "Note", "Part", "What"], rows, show);
}

/** What became of a note that was changed, and where it was moved to. */
const inFull = ({ became, kind, key }, { lowest }) => (kind === MOVED ? `${became} to ${noteName(key + lowest)}` : became);

/**
 * Fills a table with notes: their `time` [s], the `cells` after it, and in which `group` they are;
 * a group of several is one row, which opens. Its words are their `reason` where that is the same,
 * else its `title`.
 */
function listNotes(table, titles, rows, show) {
  const groups = new Map();
  for (const row of rows) groups.set(row.group, [...(groups.get(row.group) ?? []), row]);
  const heads = titles.map((title) => make("th", title, { scope: "col" })), largestFirst = [...groups.values()].sort((a, b) => b.length - a.length);
  table.replaceChildren(make("thead", make("tr", heads)), ...largestFirst.map((group) => listGroup(group, titles.length)));
  table.onclick = ({ target }) => {
    const row = target.closest("[data-time]");
    if (row) show(Number(row.dataset.time));
  };
}
function listGroup(group, columns) {
  if (group.length === 1) return make("tbody", listNote(group[0]));
  const [{ reason, title }] = group, words = group.every((each) => each.reason === reason) ? reason : title;
  const button = make("button", `${group.length} notes`, { type: "button", "aria-expanded": false });
  const row = make("tr", make("td", [button, ` ${words}`], { colSpan: columns }), { className: "several" }), body = make("tbody", row);
  row.onclick = () => {
    const open = button.getAttribute("aria-expanded") !== "true";
    button.setAttribute("aria-expanded", open);
    body.replaceChildren(row, ...(open ? group.map(listNote) : []));
    button.focus();
  };
  return body;
}
function listNote({ time, cells }) {
  const button = make("button", `${time.toFixed(2)} s`, { type: "button" }); // so does a click anywhere on the row
  return make("tr", [button, ...cells].map((cell) => make("td", cell)), { "data-time": time });
}

/** What there is to say of a key at a time [s]: what the arrangement did, and why it was missed. */
function explanation(data, changes, key, time) {
  const said = [];
  const change = changes.find((each) => each.key === key && each.from <= time && time < each.to);
  if (change) said.push(`${noteName(change.written + data.lowest)} of the ${change.part}: ${inFull(change, data)}`);
  const { row } = rowAt(time, data.dt, data.steps);
  if (data.states[row * data.keys + key] === MISSED) {
    const miss = missesOf(data).findLast((each) => each.key === key && each.time <= time + data.dt);
    if (miss) said.push(`${miss.note} ${miss.what}: ${miss.reason}`);
  }
  return said.join("\n");
}

/** Says beside the pointer what `textAt(event)` has to say. */
function explainAtPointer(chart, textAt) {
  const tip = make("div", [], { className: "tip", hidden: true });
  chart.querySelector(".tip")?.remove(); // of another performance
  chart.append(tip);
  const point = (event) => {
    const text = textAt(event), box = chart.getBoundingClientRect();
    tip.hidden = !text;
    if (!text) return;
    tip.textContent = text;
    const left = Math.min(event.clientX - box.left + 12, box.width - tip.offsetWidth), above = event.clientY - box.top - tip.offsetHeight - 10;
    tip.style.transform = `translate(${Math.max(left, 0)}px, ${Math.max(above, 0)}px)`;
  };
  for (const kind of ["pointermove", "pointerdown"]) chart.addEventListener(kind, point);
  chart.addEventListener("pointerleave", () => { tip.hidden = true; });
}
