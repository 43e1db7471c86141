// A loop's indicators: the latest hour beside its shift, day and week, and how each went. Some need more than an hour: their names
// say of what they are, in every column.

import { get, loopPath, orNull } from "./api.js";
import { h, s, scroll } from "./dom.js";
import { short, when } from "./format.js";

const OVER = ["hour", "shift", "day", "week"];
const SHARES = new Set(["service_factor", "at_limits", "swing", "stuck", "noise_share"]);
const WORDS = { score: "Score, whole record", service_factor: "In automatic", at_limits: "OP at a limit", error_sd: "Error, standard deviation", iae_per_s: "Error, mean size", harris: "Harris index, latest samples", swing: "Swing, whole record", period_s: "Period of the swing, whole record", travel_a_day: "Valve travel a day", reversals_a_day: "Reversals a day", stuck: "PV stands still", noise_share: "Noise", quantisation: "Step of PV", error_mean: "Error, mean", pv_mean: "PV, mean" };
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
  box.replaceChildren(...note, scroll("Indicators", h("table", null, head, h("tbody", null, rows))));
  return true;
}
