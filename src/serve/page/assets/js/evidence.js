// The plots behind a verdict, from what the API says the diagnosis saw.

import { h } from "./dom.js";
import { plot } from "./svg.js";
import { short } from "./format.js";
import { chart, charts } from "./trend.js";

const made = new WeakMap();

// Ends the chart in a box: the library holds each until then.
function ended(box) {
  made.get(box)?.destroy();
  made.delete(box);
}

/** Ends all charts of a page that is left. */
export const leaveEvidence = (boxes) => Object.values(boxes).forEach(ended);

function nothing(box, text) {
  ended(box);
  box.replaceChildren(text);
}

// Where nearly all values lie, with some air: a single stray one must not make all others small.
function bulk(...columns) {
  const sorted = columns.flat().filter((v) => v !== null).sort((a, b) => a - b), at = (share) => sorted[Math.round(share * (sorted.length - 1))];
  const [low, high] = [at(0.01), at(0.99)], air = 0.15 * (high - low) || 1;
  return sorted.length ? [low - air, high + air] : [0, 1];
}

const numbers = (column) => column.filter((v) => v !== null);

// What is drawn is not kept with a report.
const NOT_HERE = "There is nothing to draw: the data could not be used, or the diagnosis is from before the start or of another machine.";

export async function drawEvidence(boxes, { detail, report, evidence, runs, alarms }) {
  const unit = (tag) => detail.values.find((v) => v.tag === tag)?.unit;
  const label = (name, tag) => (unit(tag) ? `${name} [${unit(tag)}]` : name);
  const used = evidence?.window, band = evidence?.band;
  // A measured stem is drawn over the same axis, in whatever unit it is measured.
  const measured = used?.mv && unit("mv") !== unit("op") ? `, MV [${unit("mv") || "its own unit"}]` : "";
  if (used) {
    const text = band ? `The dead band plus stick band (2f) is ${short(2 * band.f_op, 3)} ${unit("op") || "OP units"} wide.` : "No band is drawn.";
    pvOp(boxes.pvop, used, band, { x: { label: label("OP", "op"), range: bulk(used.op) }, y: { label: label("PV", "pv"), range: bulk(used.pv) }, height: 340, label: `PV over OP. ${text}` });
    stemOp(boxes.stem, used, band, { x: { label: label("OP", "op"), range: bulk(used.op) }, y: { label: `stem [${unit("op") || "OP units"}]${measured}`, range: bulk(used.stem ?? [], used.mv ?? []) }, height: 340, label: `Stem over OP. ${text}` });
  } else for (const box of [boxes.pvop, boxes.stem]) nothing(box, NOT_HERE);
  curve(boxes.aic, report);
  months(boxes.months, detail, report, runs, alarms);
  await series(boxes, used, evidence?.residual, label, measured);
}

function pvOp(box, used, band, options) {
  const layers = [];
  if (band) layers.push({ kind: "band", corners: band.corners });
  layers.push({ kind: "line", class: "pv thin", x: used.op, y: used.pv });
  if (band?.follows && used.stem) layers.push({ kind: "line", class: "stem thin", x: used.op, y: followed(used, band) });
  plot(box, layers, options);
}

// PV as it would be if it followed the fitted stem at once, through the band's own corners.
function followed(used, band) {
  const [low, high] = band.stem_turns, from = band.corners[0][1], to = band.corners[2][1];
  return begun(used).map((x) => (x === null ? null : from + ((to - from) * (x - low)) / (high - low)));
}

// Before the first reversal nobody knows where the stem stands: it is taken to follow OP, and not drawn.
function begun(used) {
  const first = used.stem.findIndex((x, i) => x !== used.op[i]);
  return used.stem.map((x, i) => (i < first ? null : x));
}

function stemOp(box, used, band, options) {
  if (!used.stem) return nothing(box, "The stem cannot be estimated: f is not known.");
  const layers = [];
  if (band) {
    const [low, high] = band.op_turns, [down, up] = band.stem_turns, wide = 2 * band.f_op;
    layers.push({ kind: "band", corners: [[low, down], [low + wide, down], [high, up], [high - wide, up]] });
  }
  layers.push({ kind: "line", class: "stem thin", x: used.op, y: begun(used) });
  if (used.mv) layers.push({ kind: "line", class: "mv thin", x: used.op, y: used.mv });
  plot(box, layers, options);
}

function curve(box, report) {
  const found = report?.aic_curve;
  if (!found || !found.f.some((f) => f !== null)) return nothing(box, "No curve: the data cannot tell f.");
  // Far from the lowest point only the height matters less and less: the lower part is what tells.
  const layers = [{ kind: "line", class: "op", x: found.f, y: found.aic }];
  if (report.f_ci95) layers.unshift({ kind: "interval", from: report.f_ci95[0], to: report.f_ci95[1] });
  if (report.f !== null) layers.push({ kind: "upright", class: "alarm", at: report.f, text: `f = ${short(report.f, 3)} ${report.f_unit}` });
  plot(box, layers, { x: { label: `f [${report.f_unit}]` }, y: { label: "AIC above the best" }, height: 280, label: `AIC over f; the best f is ${short(report.f, 3)} ${report.f_unit}` });
}

function months(box, detail, report, runs, alarms) {
  // A share of the span and OP's own unit do not fit on one axis: an f of another unit is from before the span was changed.
  const unit = report?.f_unit ?? detail.f_unit ?? "% OP", timed = runs.filter((run) => run.time).toReversed(), isOther = (run) => run.f !== null && run.f_unit !== unit;
  const told = timed.filter((run) => !isOther(run)), others = timed.filter(isOther);
  if (!timed.length) return nothing(box, "No diagnosis yet.");
  if (told.length) course(box, detail, unit, told, alarms);
  else box.replaceChildren();
  if (others.length) box.append(h("p", { class: "note" }, `${others.length === 1 ? "One diagnosis has" : `${others.length} diagnoses have`} f in ${[...new Set(others.map((run) => run.f_unit))].join(", ")} and ${others.length === 1 ? "is" : "are"} not drawn.`));
}

// f of these runs over time, with the changes of the alarm.
function course(box, detail, unit, told, alarms) {
  const limit = (side) => told.map((run) => (run.f_ci95 ? run.f_ci95[side] : null));
  const layers = [{ kind: "dots", x: told.map((run) => Date.parse(run.time)), y: told.map((run) => run.f), low: limit(0), high: limit(1) }];
  if (detail.f_threshold !== null) layers.unshift({ kind: "level", class: "alarm dash thin", at: detail.f_threshold, text: `threshold ${short(detail.f_threshold)}` });
  const flags = alarms.filter((one) => one.time).map((one) => ({ x: Date.parse(one.time), raised: one.cause === "raised", text: `${one.cause.replaceAll("_", " ")}: ${one.from} to ${one.to}, ${new Date(one.time).toLocaleString("sv-SE")}${one.by ? `, ${one.by}` : ""}` }));
  layers.push({ kind: "flags", at: flags });
  const [first, last] = [Date.parse(told[0].time), Date.parse(told.at(-1).time)], air = Math.max(600_000, 0.02 * (last - first));
  const highest = Math.max(detail.f_threshold ?? 0, ...limit(1).map((v) => v ?? 0), ...told.map((run) => run.f ?? 0));
  plot(box, layers, { x: { label: "time", time: true, range: [first - air, last + air] }, y: { label: `f [${unit}]`, range: [0, 1.15 * highest || 1] }, height: 280, label: `f over ${told.length} diagnoses` });
}

function timeline(box, columns, series, options) {
  ended(box);
  box.replaceChildren();
  return charts().then((uPlot) => {
    // The page may have been left meanwhile.
    if (!box.isConnected) return;
    ended(box);
    const one = chart(uPlot, box, series, { ...options, onRange: (from, to) => one.setScale("x", { min: from, max: to }) });
    one.over.addEventListener("dblclick", () => one.setScale("x", { min: columns[0][0], max: columns[0].at(-1) }));
    one.setData(columns, false);
    one.setScale("x", { min: options.from ?? columns[0][0], max: columns[0].at(-1) });
    made.set(box, one);
  });
}

const times = (start, period, n) => Array.from({ length: n }, (_, k) => Date.parse(start) / 1000 + k * period);

async function series(boxes, used, residual, label, measured) {
  if (used?.stem) {
    const t = times(used.start, used.ts_s, used.op.length), columns = [t, used.op, used.stem], looks = [{ name: "OP", look: "op" }, { name: "stem", look: "stem" }];
    if (used.mv) {
      columns.push(used.mv);
      looks.push({ name: "MV", look: "mv" });
    }
    // A few swings show the steps; the rest is a zoom away.
    await timeline(boxes.position, columns, looks, { label: label("OP, stem", "op") + measured, height: 210, from: t[Math.max(0, t.length - 300)] });
  } else nothing(boxes.position, used ? "The stem cannot be estimated: f is not known." : NOT_HERE);
  if (!residual) {
    for (const name of ["series", "spectrum", "acf", "ccf"]) nothing(boxes[name], used ? "Nothing was traced." : NOT_HERE);
    return;
  }
  const t = times(residual.start, residual.ts_s, residual.before.length);
  await timeline(boxes.series, [t, residual.before, residual.after], [{ name: "before", look: "sp" }, { name: "after", look: "op" }], { label: label("PV − model", "pv"), height: 230 });
  const pair = (before, after, layer) => [{ class: "sp", ...layer(before, -1.6) }, { class: "op", ...layer(after, 1.6) }];
  const total = numbers(residual.power_before).reduce((sum, p) => sum + p, 0) || 1, share = (power) => power.map((p) => (100 * p) / total);
  const powers = [share(residual.power_before), share(residual.power_after)];
  plot(boxes.spectrum, pair(...powers, (y) => ({ kind: "line", x: residual.period_s, y })), { x: { label: "period [s]", log: true }, y: { label: "% of variance before", range: [0, 1.05 * Math.max(...powers.flat(), 1e-9)] }, height: 250, label: "Spectrum of the residual before and after" });
  for (const [name, first, text] of [["acf", 1, "its own past"], ["ccf", 0, "past OP"]]) {
    const before = residual[`${name}_before`], after = residual[`${name}_after`], limit = residual.limit;
    if (!before.length) {
      nothing(boxes[name], "The windows do not overlap.");
      continue;
    }
    const x = before.map((_, i) => (i + first) * residual.ts_s), top = Math.max(2 * limit, ...[...before, ...after].map((v) => Math.abs(v ?? 0))) * 1.1;
    const layers = [{ kind: "level", class: "sp thin", at: 0 }, { kind: "level", class: "alarm dash thin", at: limit }, { kind: "level", class: "alarm dash thin", at: -limit }, ...pair(before, after, (y, shift) => ({ kind: "bars", x, y, shift }))];
    plot(boxes[name], layers, { x: { label: "lag [s]", air: 0.03 }, y: { label: "correlation", range: [-top, top] }, height: 220, label: `Correlation of the residual with ${text}` });
  }
}
