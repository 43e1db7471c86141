// Trends over time on canvas, with uPlot: follow what arrives, zoom, pan, and fetch what the zoom shows.

import { AGAIN_MS, get, loopPath, mayPass, stream } from "./api.js";
import { colour, h } from "./dom.js";
import { lasting, ticked, when } from "./format.js";
import { line, longest, silences } from "./lines.js";
import { plantTime } from "./live.js";

const LOAD_MS = 20_000; // A host that lost its power never answers.
let library = null;

/** uPlot, once. */
export function charts() {
  library ??= new Promise((done, fail) => {
    const script = h("script", { src: "vendor/uplot.min.js" }), waiting = setTimeout(failed, LOAD_MS);
    function failed() {
      clearTimeout(waiting);
      library = null;
      // Of no answer, as far as it is known: it is tried again.
      fail(Object.assign(new Error("the chart library cannot be loaded"), { status: 0 }));
    }
    script.addEventListener("load", () => {
      clearTimeout(waiting);
      done(window.uPlot);
    });
    script.addEventListener("error", failed);
    document.head.append(h("link", { rel: "stylesheet", href: "vendor/uplot.min.css" }), script);
  });
  return library;
}

const LOOKS = { pv: ["--pv", 1.6], sp: ["--sp", 1.4, [6, 4]], op: ["--op", 1.6], mv: ["--mv", 1.4], stem: ["--stem", 1.4] };

/** A chart of columns over time (s): series are { name, unit, look, holds }, where `holds()` says whether a value holds until the
 * next. `onRange` hears of a selection (s). */
export function chart(uPlot, box, series, options) {
  const faint = colour("--faint"), rule = colour("--rule");
  const axis = { stroke: faint, grid: { stroke: rule, width: 0.5 }, ticks: { stroke: rule, width: 1, size: 5 }, font: "12px system-ui, sans-serif" };
  const values = (_, found) => ticked(found.map((t) => 1000 * t)).map(([time, date]) => (date ? `${time}\n${date}` : time));
  const steps = uPlot.paths.stepped({ align: 1 }), straight = uPlot.paths.linear();
  const made = series.map(({ name, look, holds }) => {
    const [variable, width, dash] = LOOKS[look] ?? ["--stem", 1.4];
    return { label: name, stroke: colour(variable), width, dash, points: { show: false }, spanGaps: false, paths: (...asked) => (holds?.() ? steps : straight)(...asked) };
  });
  return new uPlot({
    width: Math.max(200, box.clientWidth), height: options.height ?? 200, padding: [8, 28, options.times === false ? 12 : 0, 0], legend: { show: false },
    cursor: { sync: options.sync ? { key: options.sync } : undefined, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, y: false },
    scales: { x: { time: true }, y: { range: (_, low, high) => (low === null ? [0, 1] : uPlot.rangeNum(low, high === low ? low + Math.abs(low || 1) * 0.01 : high, 0.08, true)) } },
    axes: [{ ...axis, values, space: 80, show: options.times !== false, size: options.times === false ? 8 : 48 }, { ...axis, size: 56, label: options.label, labelSize: 18, labelFont: "12px system-ui, sans-serif", labelGap: 0 }],
    series: [{}, ...made],
    hooks: { setSelect: [(u) => options.onRange && u.select.width > 4 && options.onRange(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"))], setCursor: [(u) => options.onCursor?.(u.cursor.idx)], ...(options.hooks ?? {}) },
  }, [[0], ...series.map(() => [null])], box);
}

const SPANS = [["10 min", 600], ["1 h", 3600], ["8 h", 28800]];
const SYNC = "trend";
const HIGH = [230, 200]; // px
const SET_BACK_S = 1; // Stamps that fall back by more are those of a clock that was set back.
const MANY = 12000; // A column that has grown longer is fetched anew, thinned.
const ENOUGH = 20; // Of fewer samples, which two silences may part, what is usual is not seen: it is taken from all that is remembered.
const TICK_MS = 1000; // How often the right edge moves on where nothing arrives.

const last = (time) => Date.parse(time.at(-1)) / 1000;

/** The trends of a loop in `box`; `period` (s) of its oscillation chooses the first span. Returns what ends it. */
export async function trend(box, id, period, onValues) {
  const uPlot = await charts();
  // By tag: times (s) and values; unit; time of the newest sample (s); the longest time between two samples that is usual (s), in what is
  // shown and in all that is remembered.
  const columns = new Map(), units = new Map(), latest = new Map(), usual = new Map(), usualOfAll = new Map();
  const changes = new Set(); // Tags whose source may send changes only.
  let span = period ? Math.max(60, 12 * period) : 1800, fixed = null, newest = 0, late = 0, drawn = 0, plots = [], shown = [], quiet = new Map(), asked = 0, busy = false, retry = null, over = false, oldest = null, waiting = [];
  const above = h("div"), below = h("div"), readout = h("p", { class: "note", "aria-live": "off" }, " ");
  const follow = h("button", { type: "button", on: { click: () => live() } }, "Live");
  const button = (text, label, act) => h("button", { type: "button", "aria-label": label, title: label, on: { click: act } }, text);
  const spans = [[period ? "12 swings" : "30 min", span], ...SPANS].map(([text, seconds]) => h("button", { type: "button", "data-span": seconds, on: { click: () => ((span = seconds), live()) } }, text));
  const tools = h("div", { class: "ranges", role: "toolbar", "aria-label": "Time range" }, follow, ...spans, button("All", "Everything that is remembered", whole),
    button("◀", "Earlier", () => pan(-0.4)), button("▶", "Later", () => pan(0.4)), button("+", "Zoom in", () => zoom(0.5)), button("−", "Zoom out", () => zoom(2)));
  const frame = h("div", { class: "trend", tabindex: "0", role: "group", "aria-label": "Trend: arrow keys move in time, plus and minus zoom, L follows what arrives" }, above, below);
  box.replaceChildren(tools, frame, readout);

  // A set point and a mode are known until they change, and so is what is sent by changes. A PV hardly ever stands still.
  const holds = (tag) => tag === "sp" || tag === "mode" || (tag !== "pv" && changes.has(tag));

  // The right edge of what is followed is now, so that what is silent is seen to be. What is stamped so late that it would be left of
  // the window is followed itself.
  function edge() {
    const now = plantTime();
    return now === null ? newest : Math.max(newest, late < span ? now : now - late);
  }
  const window_ = (to = edge()) => fixed ?? [to - span, to];
  function live() {
    fixed = null;
    reload();
  }
  function fix(from, to) {
    if (!(to > from)) return;
    fixed = [from, Math.max(to, from + 1)];
    paint();
    reload();
  }
  // What is remembered goes on while the page is open, at both ends.
  async function whole() {
    const mine = ++asked;
    await fetched(mine).catch(() => {});
    if (!over && mine === asked) fix(oldest ?? newest - span, newest);
  }
  const pan = (share) => (([from, to]) => fix(from + share * (to - from), to + share * (to - from)))(window_());
  const zoom = (factor, at = 0.5) => (([from, to]) => fix(from + (1 - factor) * at * (to - from), to - (1 - factor) * (1 - at) * (to - from)))(window_());

  // Where it fails it is tried again: until then what was missed is a gap.
  function reload() {
    clearTimeout(retry);
    retry = null;
    const loading = load(), mine = asked;
    loading.catch((error) => {
      if (!over && mine === asked && mayPass(error)) retry = setTimeout(reload, AGAIN_MS);
    });
  }

  async function load() {
    const mine = ++asked;
    busy = true;
    try {
      // What there is first, where nothing is known yet; then what the window shows.
      if (!newest && (!(await fetched(mine)) || !newest)) return;
      await fetched(mine, window_());
    } finally {
      if (mine === asked) {
        busy = false;
        paint();
      }
    }
  }

  /** Fetches what lies in a window, or everything; false where something else was asked for meanwhile. */
  async function fetched(mine, [from, to] = []) {
    const query = new URLSearchParams({ points: String(Math.max(600, 2 * Math.round(frame.clientWidth || 600))) });
    if (from !== undefined) query.set("from", new Date(1000 * from).toISOString());
    if (fixed && to !== undefined) query.set("to", new Date(1000 * to).toISOString());
    // What arrives while this is fetched comes after it.
    waiting = [];
    const { tags } = await get(`${loopPath(id)}/samples?${query}`);
    if (mine !== asked || over) return false;
    if (!fixed) for (const { tag } of tags) columns.delete(tag);
    else columns.clear();
    for (const { tag, time, found, before, by_changes } of tags) {
      if (by_changes) changes.add(tag);
      else changes.delete(tag);
      const known = holds(tag) && before && before.value !== null;
      columns.set(tag, known ? [[from], [before.value]] : [[], []]);
      const limit = longest(time.map((t) => Date.parse(t) / 1000));
      // What is fetched may be thinned.
      if (from === undefined) usualOfAll.set(tag, (limit * time.length) / found);
      const whole = usualOfAll.get(tag);
      usual.set(tag, time.length < ENOUGH && Number.isFinite(whole) ? whole : limit);
    }
    take(tags);
    reached(tags);
    if (!fixed) waiting.forEach(take);
    const starts = tags.map(({ time }) => Date.parse(time[0]) / 1000).filter(Number.isFinite);
    if (from === undefined && starts.length) oldest = Math.min(...starts);
    return true;
  }

  function take(tags) {
    for (const tag of tags) {
      units.set(tag.tag, tag.unit);
      const column = columns.get(tag.tag) ?? [[], []];
      columns.set(tag.tag, column);
      tag.time.forEach((time, i) => {
        const t = Date.parse(time) / 1000;
        if (column[0].length && t <= column[0].at(-1)) return;
        column[0].push(t);
        column[1].push(tag.value[i]);
      });
    }
  }

  // The newest sample there is. What is known of a silent tag is none: it may be of before a clock was set back.
  function reached(tags) {
    for (const { tag, time } of tags) {
      const t = last(time);
      if (!(t > (latest.get(tag) ?? 0))) continue;
      latest.set(tag, t);
      newest = Math.max(newest, t);
    }
  }

  // Whether the clock of a tag was set back: then what is newest is of before, too.
  function setBack(tags) {
    if (!tags.some(({ tag, time }) => last(time) < latest.get(tag) - SET_BACK_S)) return false;
    newest = 0;
    for (const { tag, time } of tags) if (time.length) latest.delete(tag);
    return true;
  }

  function build() {
    plots.forEach((plot) => plot.destroy());
    const has = (tag) => columns.has(tag);
    const named = (tag) => ({ name: tag.toUpperCase(), unit: units.get(tag), look: tag, tag, holds: () => holds(tag) });
    shown = [["pv", "sp"].filter(has).map(named), ["op", "mv"].filter(has).map(named)];
    const label = (some) => {
      const unit = (one) => (one.unit ? ` [${one.unit}]` : ""), same = some.every((one) => one.unit === some[0].unit);
      return some.map((one, i) => one.name + (same && i < some.length - 1 ? "" : unit(one))).join(", ");
    };
    plots = shown.map((some, i) => chart(uPlot, i ? below : above, some, { label: label(some), height: HIGH[i], sync: SYNC, times: i === 1, onRange: fix, onCursor: (at) => at !== null && at !== undefined && i === 0 && tell(at) }));
    plots.forEach((plot) => plot.over.addEventListener("dblclick", live));
    plots.forEach((plot) => plot.over.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(event.deltaY > 0 ? 1.25 : 0.8, (event.clientX - plot.over.getBoundingClientRect().left) / plot.over.clientWidth);
    }, { passive: false }));
  }

  function tell(at) {
    const time = plots[0]?.data[0][at];
    const value = (tag) => {
      const [xs, ys] = columns.get(tag) ?? [[], []];
      let i = xs.findLastIndex((x) => x <= time);
      // Before its first sample and in a silence nothing is known of a tag.
      if (i < 0 || quiet.get(tag)?.some(([from, to]) => from < time && time < to)) return "–";
      return ys[i] === null ? "bad" : `${Number(ys[i].toPrecision(5))} ${units.get(tag) ?? ""}`;
    };
    if (time) readout.textContent = `${when(1000 * time)}   ${shown.flat().map((one) => `${one.name} ${value(one.tag)}`).join("   ")}`;
  }

  // Finds the silences; returns when something was last heard. That a value which holds did not change is none: it is lost where
  // nothing at all was heard for longer than PV is usually silent.
  function listened() {
    const limit = (tag) => (Number.isFinite(usual.get(tag)) ? usual.get(tag) : longest(columns.get(tag)?.[0] ?? []));
    const times = [...columns.values()].flatMap(([own]) => own).sort((a, b) => a - b), together = silences(times, limit("pv"));
    quiet = new Map([...columns].map(([tag, [own]]) => [tag, holds(tag) ? together : silences(own, limit(tag))]));
    return times.at(-1);
  }

  function paint() {
    if (over || !columns.size) return;
    if (!plots.length) build();
    const [from, to] = window_();
    const end = Math.min(listened(), to);
    plots.forEach((plot, i) => {
      // A tag may have no sample in what is shown.
      const tables = shown[i].map(({ tag }) => (columns.has(tag) ? line(columns.get(tag), quiet.get(tag), holds(tag), end) : [[], []]));
      plot.batch(() => {
        // A break reaches from one sample to the next, whatever other tags have between them.
        plot.setData(uPlot.join(tables, tables.map(() => [2, 2])), false);
        plot.setScale("x", { min: from, max: to });
        plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      });
    });
    drawn = to;
    follow.setAttribute("aria-pressed", String(!fixed));
    spans.forEach((one) => one.setAttribute("aria-pressed", String(!fixed && Number(one.dataset.span) === span)));
    Object.assign(frame.dataset, { newest, from, to, points: Math.max(...[...columns.values()].map(([times]) => times.length)) });
    if (readout.textContent.trim() === "") readout.textContent = `${lasting(to - from)} shown; drag to zoom, double click to follow`;
  }

  frame.addEventListener("keydown", (event) => {
    const act = { ArrowLeft: () => pan(-0.25), ArrowRight: () => pan(0.25), "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), l: live, L: live }[event.key];
    // With these keys they are the browser's, as to make all larger.
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  });
  function samples(tags) {
    onValues?.(tags);
    const back = setBack(tags), before = newest, seen = late < span;
    reached(tags);
    if (newest !== before) late = Math.max(0, (plantTime() ?? newest) - newest);
    if (back && !fixed) {
      // What is drawn is of another time.
      columns.clear();
      reload();
      return;
    }
    waiting.push(tags);
    waiting.splice(0, waiting.length - 30);
    if (fixed) return;
    take(tags);
    // Where the window is another, or what is drawn has grown too long, it is fetched anew, and not before its time where that failed.
    if (!busy && retry === null && (seen !== late < span || [...columns.values()].some(([times]) => times.length > MANY))) reload();
    else paint();
  }
  // Opened anew, after a break or a time out of sight: what was missed is fetched.
  let opened = 0;
  const close = stream(`${loopPath(id)}/live`, { samples, hello: () => opened++ && !fixed && reload() });
  // Where nothing arrives the window moves on all the same, a pixel at a time.
  const moved = () => !fixed && !document.hidden && ((edge() - drawn) / span) * frame.clientWidth >= 1;
  const timer = setInterval(() => moved() && paint(), TICK_MS);
  const resize = new ResizeObserver(() => plots.forEach((plot, i) => plot.setSize({ width: Math.max(200, frame.clientWidth), height: HIGH[i] })));
  resize.observe(frame);
  const recolour = () => {
    // Before the first samples there is nothing to paint anew.
    if (!plots.length) return;
    build();
    paint();
  };
  addEventListener("recolour", recolour);
  function end() {
    over = true;
    clearTimeout(retry);
    clearInterval(timer);
    close();
    resize.disconnect();
    removeEventListener("recolour", recolour);
    plots.forEach((plot) => plot.destroy());
  }
  try {
    await load();
  } catch (error) {
    end();
    box.replaceChildren();
    throw error;
  }
  return end;
}
