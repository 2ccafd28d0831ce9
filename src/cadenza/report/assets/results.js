// The charts and the table of all pieces, for the pieces, the metric and the agent that are chosen.

const { metrics, agents, groups, pieces, values } = JSON.parse($("data").textContent);
const NAMED = 13; // [px] a column has to be this wide for its name
const LONGEST = 30; // characters of a name
const chosen = { group: 0, metric: 0, agent: 0 };
const order = { by: null, falling: true };
let columnsOf = agents.length > 1 ? "agents" : "metrics";

const LIKE_TEXT = new Intl.Collator("en", { numeric: true, sensitivity: "base" });
const metric = () => metrics[chosen.metric];
const members = () => groups[chosen.group].pieces;
const value = (piece, agent = chosen.agent, of = chosen.metric) => values[of][0][agent][piece];
const interval = (piece, agent = chosen.agent, of = chosen.metric) => [1, 2].map((end) => values[of][end][agent][piece]);
const fixed = (number, { decimals } = metric()) => (number === null ? "–" : minus(number.toFixed(decimals)));
const colour = (agent) => css(`--run${agent % 8}`);

function withInterval(piece, agent, of = chosen.metric) {
  const [low, high] = interval(piece, agent, of), known = fixed(value(piece, agent, of), metrics[of]);
  return low === null ? known : `${known} (${fixed(low, metrics[of])} to ${fixed(high, metrics[of])})`;
}

/** From 0 to 1, or to a little above all that is drawn. */
const upwards = (chart, low, high) => [0, metric().share ? 1 : high * 1.05 || 1];
const open = (piece) => { location.href = pieces[piece].about; };
const leading = { size: (chart, labels) => 4 + 8 * Math.max(4, ...(labels ?? []).map(({ length }) => length)), space: 22 };

// A column a piece.

let ranked = [];
const pen = document.createElement("canvas").getContext("2d");
pen.font = FONT;
const named = (chart) => chart.over.clientWidth / ranked.length >= NAMED;
const shortened = ({ title }) => (title.length > LONGEST ? `${title.slice(0, LONGEST - 1)}…` : title);

/** Where the mean of a piece lies, over its column. */
function drawIntervals(chart) {
  const { ctx } = chart, wide = Math.min(Math.max(chart.bbox.width / ranked.length / 6, 1), 5);
  ctx.save();
  ctx.beginPath();
  ctx.rect(chart.bbox.left, chart.bbox.top, chart.bbox.width, chart.bbox.height);
  ctx.clip();
  ctx.beginPath();
  ctx.strokeStyle = css("--ink");
  ctx.lineWidth = devicePixelRatio;
  ranked.forEach((piece, i) => {
    const [low, high] = interval(piece);
    if (low === null) return;
    const x = chart.valToPos(i, "x", true), [from, to] = [low, high].map((end) => chart.valToPos(end, "y", true));
    ctx.moveTo(x, from);
    ctx.lineTo(x, to);
    for (const y of [from, to]) {
      ctx.moveTo(x - wide, y);
      ctx.lineTo(x + wide, y);
    }
  });
  ctx.stroke();
  ctx.restore();
}

const columns = createChart($("columns"), {
  ...EXPLAINED,
  hooks: { ...EXPLAINED.hooks, draw: [drawIntervals] },
  padding: [8, 8, 0, 0],
  scales: { x: { time: false, range: () => [-0.5, Math.max(ranked.length, 1) - 0.5] }, y: { range: upwards } },
  axes: [
    axis("number", {
      rotate: 90,
      gap: 6,
      size: (chart) => (named(chart) ? 10 + Math.max(...ranked.map((piece) => pen.measureText(shortened(pieces[piece])).width)) : 8),
      splits: (chart) => (named(chart) ? ranked.map((_, i) => i) : []),
      values: (chart, splits) => splits.map((i) => shortened(pieces[ranked[i]])),
      grid: { show: false },
    }),
    axis("number", leading),
  ],
  series: [
    { label: "piece", value: (chart, i) => (i === null ? "" : pieces[ranked[i]].title) },
    {
      label: "mean",
      width: 0,
      fill: () => css("--accent"),
      points: { show: false },
      paths: uPlot.paths.bars({ size: [0.76, 44] }),
      value: (chart, _, series, i) => (i === null ? "" : withInterval(ranked[i], chosen.agent)),
    },
  ],
}, [[], []]);

columns.over.addEventListener("click", () => { if (columns.cursor.idx !== null) open(ranked[columns.cursor.idx]); });
columns.over.addEventListener("keydown", ({ key }) => { if (key === "Enter" && columns.cursor.idx !== null) open(ranked[columns.cursor.idx]); });

function showColumns() {
  ranked = members().filter((piece) => value(piece) !== null).sort((a, b) => value(b) - value(a));
  $("columns-title").textContent = `Every piece: ${metric().title}${agents.length > 1 ? `, ${agents[chosen.agent]}` : ""}`;
  columns.over.setAttribute("aria-label", ranked.length ? `${metric().title} of ${ranked.length} pieces by ${agents[chosen.agent]}, from ${fixed(value(ranked[0]))} for ${pieces[ranked[0]].title} to ${fixed(value(ranked.at(-1)))} for ${pieces[ranked.at(-1)].title}` : "No piece");
  columns.setData([ranked.map((_, i) => i), ranked.map((piece) => value(piece))]);
}

// By difficulty.

let graded = [];
const scatter = createChart($("scatter"), {
  ...EXPLAINED,
  padding: [8, 20, 0, 0],
  scales: { x: { time: false, range: (chart, low, high) => [Math.floor(low ?? 1), Math.ceil((high ?? 10) + 0.01)] }, y: { range: upwards } },
  axes: [axis("number", { label: "difficulty", labelSize: 20, size: 24, space: 55 }), axis("number", leading)],
  series: [
    { label: "piece", value: (chart, _, series, i) => (i === null ? "" : `${pieces[graded[i]].title}, ${pieces[graded[i]].difficulty.toFixed(1)}`) },
    ...agents.map((name, agent) => ({
      label: name,
      class: `run${agent % 8}`,
      stroke: () => colour(agent),
      width: 0,
      paths: () => null,
      points: { show: true, size: 6, width: 0, fill: () => colour(agent) },
      value: (chart, _, series, i) => (i === null || value(graded[i], agent) === null ? "" : withInterval(graded[i], agent)),
    })),
  ],
}, [[], ...agents.map(() => [])]);

function showScatter() {
  const difficulty = (piece) => pieces[piece].difficulty;
  graded = members().filter((piece) => difficulty(piece) !== null && agents.some((_, agent) => value(piece, agent) !== null)).sort((a, b) => difficulty(a) - difficulty(b));
  $("scatter-title").textContent = `${metric().title} by difficulty`;
  $("scatter").hidden = !graded.length;
  $("scatter-words").textContent = graded.length ? "A dot is a piece. Difficulty is a grade from 1 to 10 of what makes a score hard for two hands." : "The difficulty of these pieces is not known.";
  scatter.over.setAttribute("aria-label", `${metric().title} of ${graded.length} pieces by difficulty`);
  let last = -Infinity; // no two may be at the same place
  const x = graded.map((piece) => (last = Math.max(difficulty(piece), last + 1e-4)));
  scatter.setData([x, ...agents.map((_, agent) => graded.map((piece) => value(piece, agent)))]);
}

function showProfile() {
  for (const profile of document.querySelectorAll(".profile")) {
    profile.hidden = profile.dataset.group !== String(chosen.group) || profile.dataset.metric !== String(chosen.metric);
  }
  $("profile-words").textContent = metric().share
    ? "The share of runs that are better than a value, every piece counting the same. The higher a line, the better."
    : "A profile is drawn of metrics from 0 to 1 only.";
}

// The table of pieces.

const inMinutes = (seconds) => `${Math.floor(Math.round(seconds) / 60)}:${String(Math.round(seconds) % 60).padStart(2, "0")}`;

/** What stands in the table: title, what is sorted by, and what is shown. */
function tableColumns() {
  const manyLibraries = new Set(pieces.map(({ library }) => library)).size > 1;
  const told = [
    { title: "Piece", key: "title", of: (piece) => pieces[piece].title, text: true },
    ...(manyLibraries ? [{ title: "Library", key: "library", of: (piece) => pieces[piece].library, text: true }] : []),
    { title: "Difficulty", key: "difficulty", of: (piece) => pieces[piece].difficulty, show: (number) => number.toFixed(1) },
    { title: "Length", key: "seconds", of: (piece) => pieces[piece].seconds, show: inMinutes },
    { title: "Notes", key: "notes", of: (piece) => pieces[piece].notes, show: (number) => number.toLocaleString("en") },
  ];
  const measured = columnsOf === "agents"
    ? agents.map((name, agent) => [name, agent, chosen.metric])
    : metrics.map(({ title }, of) => [title, chosen.agent, of]);
  return [...told, ...measured.map(([title, agent, of]) => ({
    title,
    key: `${agent} ${of}`,
    of: (piece) => value(piece, agent, of),
    show: (number) => fixed(number, metrics[of]),
    small: (piece) => { const [low, high] = interval(piece, agent, of); return low === null ? "" : `${fixed(low, metrics[of])}–${fixed(high, metrics[of])}`; },
    best: columnsOf === "agents" && metrics[of].share && agents.length > 1,
  }))];
}

function found() {
  const words = $("search").value.toLowerCase().split(/\s+/);
  return members().filter((piece) => {
    const { title, composer, library } = pieces[piece], text = `${title} ${composer} ${library}`.toLowerCase();
    return words.every((word) => text.includes(word));
  });
}

/** Those without a value come last, whichever way. */
function sorted(rows, { of, text }) {
  const known = rows.filter((piece) => of(piece) !== null), unknown = rows.filter((piece) => of(piece) === null);
  const compare = text ? (a, b) => LIKE_TEXT.compare(of(a), of(b)) : (a, b) => of(a) - of(b);
  known.sort(order.falling ? (a, b) => compare(b, a) : compare);
  return [...known, ...unknown];
}

function showTable() {
  const shownColumns = tableColumns(), table = $("pieces");
  const by = shownColumns.find(({ key }) => key === order.by) ?? shownColumns.find(({ key }) => key === `${chosen.agent} ${chosen.metric}`) ?? shownColumns[0];
  const rows = sorted(found(), by);
  $("found").textContent = rows.length === members().length ? `${rows.length} pieces` : `${rows.length} of ${members().length} pieces`;
  const heads = shownColumns.map((column) => {
    const button = make("button", column.title, { type: "button", "data-key": column.key });
    const sorting = column === by ? { "aria-sort": order.falling ? "descending" : "ascending" } : {};
    return make("th", button, { scope: "col", className: column.text ? "text" : "", ...sorting });
  });
  heads.push(make("th", "See and hear", { scope: "col", className: "page" }));
  table.replaceChildren(make("thead", make("tr", heads)), make("tbody", rows.map((piece) => tableRow(piece, shownColumns))));
}

function tableRow(piece, shownColumns) {
  const { title, composer, about, pages } = pieces[piece];
  const best = Math.max(...shownColumns.filter((column) => column.best).map(({ of }) => of(piece) ?? -Infinity));
  const cells = shownColumns.map(({ key, of, show, small, best: compared, text }) => {
    if (key === "title") return make("th", [make("a", title, { href: about }), ...(composer ? [" ", make("small", composer)] : [])], { scope: "row" });
    const known = of(piece), shown = known === null ? "–" : (show ?? String)(known), more = small?.(piece);
    const parts = [compared && known === best ? make("b", shown) : shown, ...(more ? [make("small", more)] : [])];
    return make("td", parts, { className: text ? "text" : "" });
  });
  const href = pages[chosen.agent], label = `${title}: piano roll and 3D of ${agents[chosen.agent]}`;
  const page = href ? make("a", "roll and 3D", { href, "aria-label": label }) : make("span", "no page");
  return make("tr", [...cells, make("td", page, { className: "page" })]);
}

$("pieces").addEventListener("click", ({ target }) => {
  const key = target.closest("button")?.dataset.key;
  if (key === undefined) return;
  const again = target.closest("th").hasAttribute("aria-sort");
  order.falling = again ? !order.falling : !["title", "library", "difficulty"].includes(key);
  order.by = key;
  showTable();
  $("pieces").querySelector(`[data-key="${key}"]`).focus();
});
$("search").addEventListener("input", showTable);
for (const button of document.querySelectorAll("[data-columns]")) {
  button.addEventListener("click", () => { columnsOf = button.dataset.columns; show(); });
}

function show() {
  for (const button of document.querySelectorAll("[data-columns]")) {
    button.setAttribute("aria-pressed", button.dataset.columns === columnsOf);
    button.parentElement.hidden = agents.length === 1;
  }
  showColumns();
  showScatter();
  showProfile();
  showTable();
}

for (const name of Object.keys(chosen)) {
  const select = $(name);
  chosen[name] = Number(select.value); // the browser may have kept it
  select.addEventListener("change", () => { chosen[name] = Number(select.value); show(); });
}
show();
