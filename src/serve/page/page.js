// The overview: loops by severity, one loop in detail, live by server-sent events. Data only ever becomes textContent.

import { plot, short, timeTicks } from "./plot.js";

const api = "/api/v1";
const $ = (id) => document.getElementById(id);
let chosen = null, limit = 200, asked = 0, pending = null;

const WORDS = { stiction: "stiction", no_stiction: "no stiction", not_identifiable: "cannot be told" };

async function fetched(path, options) {
  const answer = await fetch(api + path, options);
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.detail ?? answer.statusText);
  return body;
}

function cell(row, text, kind) {
  const td = row.insertCell();
  td.textContent = text;
  if (kind) td.className = kind;
  return td;
}

const interval = (item) => (item.f_ci95 ? ` (${short(item.f_ci95[0])} … ${short(item.f_ci95[1])})` : "");
// Without stiction f is 0 and the upper end says what the record could have hidden.
const friction = (item) => {
  if (item.f === null) return "–";
  if (item.verdict === "no_stiction" && item.f_ci95) return `0, hides up to ${short(item.f_ci95[1])} ${item.f_unit}`;
  return `${short(item.f)}${interval(item)} ${item.f_unit}`;
};
const when = (text) => (text ? new Date(text).toLocaleString("sv-SE") : "–");

function rowOf(item) {
  const row = document.createElement("tr");
  row.className = item.severity === 5 || item.severity === 3 ? "look" : item.severity >= 2 ? "seen" : "";
  if (item.id === chosen) row.classList.add("chosen");
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = item.id;
  button.title = [item.description, item.group].filter(Boolean).join(" · ");
  button.addEventListener("click", () => choose(item.id));
  row.insertCell().append(button);
  cell(row, WORDS[item.verdict] ?? "not diagnosed yet", "mark");
  cell(row, friction(item), "number");
  cell(row, short(item.delta_aic), "number");
  cell(row, item.alarm === "normal" ? "" : item.alarm, "mark");
  cell(row, item.failure ? `latest run: ${item.failure}` : item.reason ?? "", "why");
  cell(row, when(item.time), "time");
  return row;
}

async function showLoops() {
  const mine = ++asked;
  const query = new URLSearchParams({ limit: String(Math.min(limit, 1000)) });
  for (const name of ["q", "verdict"]) if ($(name).value) query.set(name, $(name).value);
  try {
    const list = await fetched(`/loops?${query}`);
    if (mine !== asked) return;
    $("loops").replaceChildren(...list.items.map(rowOf));
    const look = list.items.filter((item) => item.severity >= 3).length;
    $("summary").textContent = `${list.total} loops, ${look} to look at, plant time ${when(list.time)}`;
    $("more").hidden = list.next === null || limit >= 1000;
  } catch (error) {
    $("summary").textContent = `the loops cannot be fetched: ${error.message}`;
  }
}

// Many events ask for one refresh.
function refresh() {
  pending ??= setTimeout(() => {
    pending = null;
    showLoops();
  }, 500);
}

async function choose(id) {
  chosen = id;
  history.replaceState(null, "", `#${encodeURIComponent(id)}`);
  for (const row of $("loops").rows) row.classList.toggle("chosen", row.cells[0].textContent === id);
  $("detail").hidden = false;
  $("done").textContent = "";
  await showDetail();
  $("detail").scrollIntoView({ block: "nearest" });
}

const path = (id) => `/loops/${encodeURIComponent(id)}`;

async function showDetail() {
  const id = chosen;
  try {
    const missing = () => null;
    const [detail, report, samples] = await Promise.all([
      fetched(path(id)), fetched(`${path(id)}/diagnosis`).catch(missing), fetched(`${path(id)}/samples?points=1500`),
    ]);
    if (id !== chosen) return;
    $("name").textContent = [detail.id, detail.description, detail.group].filter(Boolean).join(" · ");
    $("reason").textContent = report ? `${WORDS[report.verdict]}: ${report.reason}` : "not diagnosed yet";
    $("ack").hidden = !["unacknowledged", "returned-unacknowledged"].includes(detail.alarm);
    showFacts(detail, report);
    await showTrend(id, report, samples);
    if (id !== chosen) return;
    await showWindow(id, report, samples);
    showCurve(report);
  } catch (error) {
    $("reason").textContent = `the loop cannot be fetched: ${error.message}`;
  }
}

function showFacts(detail, report) {
  const facts = detail.values.map((v) => [v.tag, `${short(v.value)} ${v.unit} (${v.quality})`]);
  if (report) {
    const { window: used, oscillation: swing, model } = report;
    facts.push(["f, 95 % interval", friction(report)], ["evidence", short(report.delta_aic)]);
    facts.push(["window", `${used.n} samples, ${short(used.ts_s)} s apart, ${used.quality}`]);
    if (swing) facts.push(["oscillation", `${short(swing.period_s)} s, regularity ${short(swing.regularity_r)}`]);
    if (model) facts.push(["model", `na ${model.na}, nb ${model.nb}, nc ${model.nc}, delay ${model.nk}`]);
  }
  $("facts").replaceChildren(...facts.map(([name, value]) => {
    const box = document.createElement("div");
    for (const [kind, text] of [["dt", name], ["dd", value]]) {
      const node = document.createElement(kind);
      node.textContent = text;
      box.append(node);
    }
    return box;
  }));
}

function columns(samples, tag) {
  const found = samples.tags.find((t) => t.tag === tag);
  return found && { name: tag.toUpperCase(), unit: found.unit, kind: tag, x: found.time.map(Date.parse), y: found.value };
}

const clock = (t) => new Date(t).toLocaleTimeString("sv-SE");

// The latest oscillations, which all that is remembered would hide.
const OSCILLATIONS = 20;

async function showTrend(id, report, all) {
  let samples = all;
  const period = report?.oscillation?.period_s, times = all.tags.find((t) => t.tag === "pv")?.time ?? [];
  if (period && times.length) {
    const from = Date.parse(times[times.length - 1]) - 1000 * OSCILLATIONS * period;
    if (from > Date.parse(times[0])) {
      const query = new URLSearchParams({ from: new Date(from).toISOString(), points: "3000" });
      samples = await fetched(`${path(id)}/samples?${query}`);
      if (id !== chosen) return;
    }
  }
  const series = ["pv", "sp", "op"].map((tag) => columns(samples, tag)).filter(Boolean);
  for (const s of series) {
    s.bad = s.x.filter((_, i) => s.y[i] === null);
    if (s.kind === "op") s.side = "right";
  }
  plot($("trend"), series, { xLabel: "time (red marks: bad samples)", xText: clock, xTicks: timeTicks });
}

async function showWindow(id, report, samples) {
  let used = samples;
  if (report?.window_start && report.window_end) {
    const query = new URLSearchParams({ from: report.window_start, to: report.window_end, points: "20000" });
    used = await fetched(`${path(id)}/samples?${query}`);
    if (id !== chosen) return;
  }
  const op = columns(used, "op"), pv = columns(used, "pv");
  if (!op || !pv) return;
  // Each PV sample beside the latest OP sample before it.
  const x = [], y = [];
  let at = 0;
  for (let i = 0; i < pv.x.length; i++) {
    while (at + 1 < op.x.length && op.x[at + 1] <= pv.x[i]) at++;
    x.push(op.y[at] ?? NaN);
    y.push(pv.y[i]);
  }
  plot($("ellipse"), [{ x, y, name: "PV", unit: pv.unit, kind: "line" }], { xLabel: `OP [${op.unit || "–"}]`, width: 560, height: 320 });
}

function showCurve(report) {
  const curve = report?.aic_curve;
  if (!curve) {
    $("aic").textContent = "no curve: the data cannot tell";
    return;
  }
  const series = [{ x: curve.f, y: curve.aic, name: "AIC", unit: "", kind: "line" }];
  plot($("aic"), series, { xLabel: `f [${report.f_unit}]`, band: report.f_ci95, mark: report.f, width: 560, height: 320 });
}

async function act(path, message) {
  $("done").textContent = "…";
  try {
    const answer = await fetched(path, { method: "POST" });
    $("done").textContent = answer.state === "running" ? "begun; the result follows" : message;
    await Promise.all([showLoops(), showDetail()]);
  } catch (error) {
    $("done").textContent = error.message;
  }
}

function listen() {
  const events = new EventSource(`${api}/events`);
  events.addEventListener("hello", () => {
    $("link").textContent = "live";
    $("link").className = "";
    refresh();
  });
  events.addEventListener("diagnosis", (event) => {
    refresh();
    if (JSON.parse(event.data).loop === chosen) showDetail();
  });
  for (const name of ["alarm", "reloaded", "lagged"]) events.addEventListener(name, refresh);
  events.addEventListener("error", () => {
    $("link").textContent = "no connection: what is shown is old";
    $("link").className = "lost";
    if (events.readyState === EventSource.CLOSED) setTimeout(listen, 5000);
  });
}

$("filter").addEventListener("submit", (event) => event.preventDefault());
$("filter").addEventListener("input", refresh);
$("more").addEventListener("click", () => {
  limit = 1000;
  showLoops();
});
$("run").addEventListener("click", () => act(`${path(chosen)}/diagnosis`, "done"));
$("ack").addEventListener("click", () => act(`/alarms/${encodeURIComponent(chosen)}/ack`, "acknowledged"));
showLoops();
listen();
if (location.hash.length > 1) choose(decodeURIComponent(location.hash.slice(1)));
