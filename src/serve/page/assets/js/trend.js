// Trends over time on canvas, with uPlot: follow what arrives, zoom, pan, and fetch what the zoom shows.

import { events, get, loopPath } from "./api.js";
import { colour, h } from "./dom.js";
import { clock, lasting } from "./format.js";

let library = null;

/** uPlot, once. */
export function charts() {
  library ??= new Promise((done, fail) => {
    const script = h("script", { src: "vendor/uplot.min.js" });
    script.addEventListener("load", () => done(window.uPlot));
    script.addEventListener("error", () => {
      library = null;
      fail(new Error("the chart library cannot be loaded"));
    });
    document.head.append(h("link", { rel: "stylesheet", href: "vendor/uplot.min.css" }), script);
  });
  return library;
}

const LOOKS = { pv: ["--pv", 1.6], sp: ["--sp", 1.4, [6, 4]], op: ["--op", 1.6], mv: ["--mv", 1.4], stem: ["--stem", 1.4] };

/** A chart of columns over time (s): series are { name, unit, look }. `onRange` hears of a selection (s). */
export function chart(uPlot, box, series, options) {
  const faint = colour("--faint"), rule = colour("--rule");
  const axis = { stroke: faint, grid: { stroke: rule, width: 0.5 }, ticks: { stroke: rule, width: 1, size: 5 }, font: "12px system-ui, sans-serif" };
  const values = (_, found) => found.map((t) => clock(1000 * t));
  const made = series.map(({ name, look }) => {
    const [variable, width, dash] = LOOKS[look] ?? ["--stem", 1.4];
    return { label: name, stroke: colour(variable), width, dash, points: { show: false }, spanGaps: false };
  });
  return new uPlot({
    width: Math.max(200, box.clientWidth), height: options.height ?? 200, padding: [8, 28, options.times === false ? 12 : 0, 0], legend: { show: false },
    cursor: { sync: options.sync ? { key: options.sync } : undefined, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, y: false },
    scales: { x: { time: true }, y: { range: (_, low, high) => (low === null ? [0, 1] : uPlot.rangeNum(low, high === low ? low + Math.abs(low || 1) * 0.01 : high, 0.08, true)) } },
    axes: [{ ...axis, values, space: 80, show: options.times !== false, size: options.times === false ? 8 : 34 }, { ...axis, size: 56, label: options.label, labelSize: 18, labelFont: "12px system-ui, sans-serif", labelGap: 0 }],
    series: [{}, ...made],
    hooks: { setSelect: [(u) => options.onRange && u.select.width > 4 && options.onRange(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"))], setCursor: [(u) => options.onCursor?.(u.cursor.idx)], ...(options.hooks ?? {}) },
  }, [[0], ...series.map(() => [null])], box);
}

const SPANS = [["10 min", 600], ["1 h", 3600], ["8 h", 28800]];
const SYNC = "trend";
const SET_BACK_S = 1; // Stamps that fall back by more are those of a clock that was set back.

const last = (time) => Date.parse(time.at(-1)) / 1000;

/** The trends of a loop in `box`; `period` (s) of its oscillation chooses the first span. Returns what ends it. */
export async function trend(box, id, period, onValues) {
  const uPlot = await charts();
  const columns = new Map();
  let span = period ? Math.max(60, 12 * period) : 1800, fixed = null, newest = 0, plots = [], shown = [], asked = 0, over = false, reach = null, waiting = [];
  const units = new Map();
  // Time of each tag's newest sample (s).
  const latest = new Map();
  const above = h("div"), below = h("div"), readout = h("p", { class: "note", "aria-live": "off" }, " ");
  const follow = h("button", { type: "button", on: { click: () => live() } }, "Live");
  const button = (text, label, act) => h("button", { type: "button", "aria-label": label, title: label, on: { click: act } }, text);
  const spans = [[period ? "12 swings" : "30 min", span], ...SPANS].map(([text, seconds]) => h("button", { type: "button", "data-span": seconds, on: { click: () => ((span = seconds), live()) } }, text));
  const tools = h("div", { class: "ranges", role: "toolbar", "aria-label": "Time range" }, follow, ...spans, button("All", "Everything that is remembered", () => fix(...(reach ?? [newest - span, newest]))),
    button("◀", "Earlier", () => pan(-0.4)), button("▶", "Later", () => pan(0.4)), button("+", "Zoom in", () => zoom(0.5)), button("−", "Zoom out", () => zoom(2)));
  const frame = h("div", { class: "trend", tabindex: "0", role: "group", "aria-label": "Trend: arrow keys move in time, plus and minus zoom, L follows what arrives" }, above, below);
  box.replaceChildren(tools, frame, readout);

  const window_ = () => fixed ?? [newest - span, newest];
  function live() {
    fixed = null;
    load();
  }
  function fix(from, to) {
    if (!(to > from)) return;
    fixed = [from, Math.max(to, from + 1)];
    paint();
    load();
  }
  const pan = (share) => (([from, to]) => fix(from + share * (to - from), to + share * (to - from)))(window_());
  const zoom = (factor, at = 0.5) => (([from, to]) => fix(from + (1 - factor) * at * (to - from), to - (1 - factor) * (1 - at) * (to - from)))(window_());

  async function load() {
    const mine = ++asked, first = !newest, [from, to] = window_();
    const query = new URLSearchParams({ points: String(Math.max(600, 2 * Math.round(frame.clientWidth || 600))) });
    if (!first) query.set("from", new Date(1000 * from).toISOString());
    if (!first && fixed) query.set("to", new Date(1000 * to).toISOString());
    // What arrives while this is fetched comes after it.
    waiting = [];
    const found = await get(`${loopPath(id)}/samples?${query}`);
    if (mine !== asked || over) return;
    if (!fixed) for (const tag of found.tags) columns.delete(tag.tag);
    else columns.clear();
    take(found.tags);
    reached(found.tags);
    if (!fixed) waiting.forEach(take);
    if (first) {
      const starts = found.tags.map((tag) => Date.parse(tag.time[0]) / 1000).filter(Number.isFinite);
      if (starts.length) reach = [Math.min(...starts), newest];
      if (newest) return load();
    }
    paint();
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

  // The right edge goes with what is new. What is known of a silent tag is not: it may be of before a clock was set back.
  function reached(tags) {
    for (const { tag, time } of tags) {
      const t = last(time);
      if (!(t > (latest.get(tag) ?? 0))) continue;
      latest.set(tag, t);
      newest = Math.max(newest, t);
    }
  }

  // Whether the clock of a tag was set back: then the right edge goes back, too.
  function setBack(tags) {
    if (!tags.some(({ tag, time }) => last(time) < latest.get(tag) - SET_BACK_S)) return false;
    newest = 0;
    for (const { tag, time } of tags) if (time.length) latest.delete(tag);
    return true;
  }

  function build() {
    plots.forEach((plot) => plot.destroy());
    const has = (tag) => columns.has(tag);
    const named = (tag) => ({ name: tag.toUpperCase(), unit: units.get(tag), look: tag, tag });
    shown = [["pv", "sp"].filter(has).map(named), ["op", "mv"].filter(has).map(named)];
    const label = (some) => some.map((one) => one.name).join(", ") + (some[0]?.unit ? ` [${some[0].unit}]` : "");
    plots = shown.map((some, i) => chart(uPlot, i ? below : above, some, { label: label(some), height: i ? 190 : 230, sync: SYNC, times: i === 1, onRange: fix, onCursor: (at) => at !== null && at !== undefined && i === 0 && tell(at) }));
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
      // Before its first sample nothing is known of a tag.
      return i < 0 ? "–" : ys[i] === null ? "bad" : `${Number(ys[i].toPrecision(5))} ${units.get(tag) ?? ""}`;
    };
    if (time) readout.textContent = `${clock(1000 * time)}   ${shown.flat().map((one) => `${one.name} ${value(one.tag)}`).join("   ")}`;
  }

  function paint() {
    if (over || !columns.size) return;
    if (!plots.length) build();
    const [from, to] = window_();
    plots.forEach((plot, i) => {
      // A tag may have no sample in what is shown.
      const tables = shown[i].map((one) => columns.get(one.tag) ?? [[], []]);
      plot.batch(() => {
        plot.setData(uPlot.join(tables), false);
        plot.setScale("x", { min: from, max: to });
        plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      });
    });
    follow.setAttribute("aria-pressed", String(!fixed));
    spans.forEach((one) => one.setAttribute("aria-pressed", String(!fixed && Number(one.dataset.span) === span)));
    frame.dataset.newest = String(newest);
    if (readout.textContent.trim() === "") readout.textContent = `${lasting(to - from)} shown; drag to zoom, double click to follow`;
  }

  frame.addEventListener("keydown", (event) => {
    const act = { ArrowLeft: () => pan(-0.25), ArrowRight: () => pan(0.25), "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), l: live, L: live }[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
  let stream = null;
  function heard(event) {
    const tags = JSON.parse(event.data);
    onValues?.(tags);
    const back = setBack(tags);
    reached(tags);
    if (back && !fixed) {
      // What is drawn is of another time.
      columns.clear();
      load();
      return;
    }
    waiting.push(tags);
    waiting.splice(0, waiting.length - 30);
    if (fixed) return;
    take(tags);
    // What has left the screen goes, now and then.
    for (const column of columns.values()) {
      if (column[0].length > 12000) column.forEach((values) => values.splice(0, 6000));
    }
    paint();
  }
  // Opened anew, after a break or a time out of sight: what was missed is fetched.
  let opened = 0;
  function open() {
    stream?.close();
    if (document.hidden) return;
    stream = events(`${loopPath(id)}/live`);
    stream.addEventListener("samples", heard);
    stream.addEventListener("hello", () => opened++ && !fixed && load());
  }
  document.addEventListener("visibilitychange", open);
  open();
  const resize = new ResizeObserver(() => plots.forEach((plot, i) => plot.setSize({ width: Math.max(200, frame.clientWidth), height: i ? 190 : 230 })));
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
    stream?.close();
    document.removeEventListener("visibilitychange", open);
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
