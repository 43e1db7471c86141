// A loop's indicators: the latest hour beside its shift, day and week, and how each went. Some need more than an hour: their names
// say of what they are, in every column.

import { get, loopPath, orNull } from "./api.js";
import { h, s, scroll } from "./dom.js";
import { lasting, percent, short, when } from "./format.js";

const OVER = ["hour", "shift", "day", "week"];
const SHARES = new Set(["service_factor", "at_limits", "swing", "stuck", "noise_share"]);
const WORDS = { score: "Score, whole record", service_factor: "In automatic", at_limits: "OP at a limit", error_sd: "Error, standard deviation", iae_per_s: "Error, mean size", harris: "Harris index, latest samples", swing: "Swing, whole record", period_s: "Period of the swing, whole record", travel_a_day: "Valve travel a day", reversals_a_day: "Reversals a day", stuck: "PV stands still", noise_share: "Noise", quantisation: "Step of PV", error_mean: "Error, mean", pv_mean: "PV, mean", ise_per_s: "Error, mean square", settling_s: "Settling of set-point steps, whole record", regularity: "Regularity of the swing, whole record", compression: "Compression of PV", harris_low: "Harris index, lower end of its interval", harris_high: "Harris index, upper end of its interval", harris_dead_time_s: "Harris index, dead time of the process" };
const WIDE = 220, HIGH = 26;

const value = (name, x) => (x === null ? "–" : SHARES.has(name) ? `${short(100 * x, 3)} %` : short(x, 3));

// The days, then the looks of the latest week, over time.
function line(points, at) {
  const known = points.map((point) => [Date.parse(point.time), point.values[at]]).filter(([, y]) => y !== null);
  if (known.length < 2) return null;
  const [from, to] = [known[0][0], known.at(-1)[0]], ys = known.map(([, y]) => y);
  const [low, high] = [Math.min(...ys), Math.max(...ys)], span = high - low || 1;
  const place = ([t, y]) => `${(((t - from) / (to - from || 1)) * (WIDE - 4) + 2).toFixed(1)},${(HIGH - 3 - ((y - low) / span) * (HIGH - 6)).toFixed(1)}`;
  const text = `from ${short(low, 3)} to ${short(high, 3)}, ${when(known[0][0])} to ${when(known.at(-1)[0])}`;
  return s("svg", { class: "spark", viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img", "aria-label": text }, s("title", null, text), s("polyline", { points: known.map(place).join(" ") }));
}

// Where OP stayed between its limits: a bar for each twentieth.
function stayed({ q05, q50, q95, histogram }) {
  const text = `5 % of the time below ${short(q05, 3)}, half of it below ${short(q50, 3)}, 95 % below ${short(q95, 3)}`;
  const most = Math.max(...histogram), step = WIDE / histogram.length;
  const bar = (share, i) => s("rect", { x: (i * step).toFixed(1), width: (step - 1).toFixed(1), y: (HIGH - (HIGH * share) / most).toFixed(1), height: ((HIGH * share) / most).toFixed(1) });
  return [s("svg", { class: "spark", viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img", "aria-label": `OP between its limits: ${text}` }, histogram.map(bar)), text];
}

// What the latest look found that is no number over time.
function beside({ harris, margins, settling, oscillations, op_distribution }) {
  const swing = (own) => `${lasting(own.period_s)} (${percent(own.share)} of its variance, regularity ${short(own.regularity_r, 3)})`;
  const dead = (own) => (own.dead_time_s === null ? "for a dead time of one sample" : `for a dead time of ${lasting(own.dead_time_s)} by the loop's model, and one sample`);
  const list = [
    harris && ["Harris index", [short(harris.index, 2), harris.ci95 && `(${short(harris.ci95[0], 2)} … ${short(harris.ci95[1], 2)})`, dead(harris)].filter(Boolean).join(" ")],
    margins && ["Margins", [margins.words, margins.period_s !== null && `gain crossover at ${lasting(margins.period_s)}`].filter(Boolean).join(", ")],
    oscillations.length && ["Swings of the error", oscillations.map(swing).join("; ")],
    settling && ["Set-point steps", `${settling.settled} of ${settling.steps} settled${settling.time_s === null ? "" : ` in ${lasting(settling.time_s)}`}, overshoot ${short(100 * settling.overshoot, 2)} %`],
    op_distribution && ["OP", stayed(op_distribution)],
  ];
  return h("dl", { class: "facts" }, list.filter(Boolean).map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value))));
}

/** Draws into a box; false where nothing is known yet. */
export async function health(id, box) {
  const found = await orNull(get(`${loopPath(id)}/indicators`));
  if (!found?.looks.length && !found?.days.length) return false;
  const week = found.looks.length ? Date.parse(found.looks[0].time) : Infinity;
  const points = [...found.days.filter((day) => Date.parse(day.time) < week), ...found.looks];
  const rows = found.names.map(({ name, unit, meaning }, at) => {
    if (OVER.every((over) => found.over[over][at] === null) && points.every((point) => point.values[at] === null)) return null;
    const shown = unit === "-" || SHARES.has(name) ? "" : ` (${unit})`;
    return h("tr", null, h("th", { scope: "row", title: meaning }, `${WORDS[name] ?? name}${shown}`), OVER.map((over) => h("td", { class: "number" }, value(name, found.over[over][at]))), h("td", null, line(points, at)));
  });
  const head = h("thead", null, h("tr", null, h("th", { scope: "col" }, "Indicator"), OVER.map((text) => h("th", { scope: "col", class: "number" }, text)), h("th", { scope: "col" }, "Over time")));
  // The latest look may be long ago, or have had too few samples.
  const last = points.findLast((point) => point.values.some((x) => x !== null));
  const stale = found.looks.length && last && found.over.hour.every((x) => x === null);
  const note = stale ? [h("p", { class: "note" }, `Nothing was measured in the latest hour. The last values are of ${when(last.time)}.`)] : [];
  box.replaceChildren(...note, scroll("Indicators", h("table", null, head, h("tbody", null, rows))), ...(found.latest ? [beside(found.latest)] : []));
  return true;
}
