// Plots of one thing over another as SVG: sharp on every screen and on paper, and made of elements and text only.

import { s } from "./dom.js";
import { short, ticked } from "./format.js";

const LEFT = 56, RIGHT = 14, TOP = 12, BOTTOM = 40;

// Round steps of 1, 2 or 5 times a power of ten: about `count` of them.
function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((step) => step >= raw * 0.999);
  const found = [];
  for (let t = Math.ceil(low / step - 1e-9) * step; t <= high + step * 1e-9; t += step) found.push(Math.abs(t) < step * 1e-9 ? 0 : t);
  const decimals = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9));
  return found.map((t) => [t, decimals < 8 && Math.abs(t) < 1e7 ? t.toFixed(decimals) : short(t)]);
}

// 1, 2 and 5 of every decade, or the decades alone.
function logTicks(low, high) {
  const found = [];
  const few = Math.log10(high / low) > 2.5;
  for (let decade = Math.floor(Math.log10(low)); decade <= Math.log10(high); decade++) for (const m of few ? [1] : [1, 2, 5]) found.push(m * 10 ** decade);
  return found.filter((t) => t >= low * 0.999 && t <= high * 1.001).map((t) => [t, short(t)]);
}

const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600, 43200, 86400];

// The time (ms) at which clocks here show what those of UTC show at another, to the hour.
function shownHere(utc) {
  const own = new Date(utc);
  return new Date(own.getUTCFullYear(), own.getUTCMonth(), own.getUTCDate(), own.getUTCHours()).getTime();
}

// Times (ms) at round local clock times, also behind a change to or from summer time. Steps of an hour and less stay round by themselves.
function timeTicks(low, high, count) {
  const raw = (high - low) / count / 1000, step = 1000 * (STEPS.find((seconds) => seconds >= raw) ?? Math.ceil(raw / 86400) * 86400);
  const zone = new Date(low).getTimezoneOffset() * 60000, found = [];
  for (let utc = Math.ceil((low - zone) / step) * step; ; utc += step) {
    const t = step > 36e5 ? shownHere(utc) : utc + zone;
    if (!(t <= high)) break;
    if (t >= low) found.push(t);
  }
  const text = ([time, date]) => (date && (step >= 864e5 || time === "00:00:00") ? date : `${date} ${time.slice(0, step >= 60000 ? 5 : 8)}`.trim());
  return ticked(found).map((own, i) => [found[i], text(own)]);
}

function range(values, air) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (v !== null && Number.isFinite(v)) [low, high] = [Math.min(low, v), Math.max(high, v)];
  if (low > high) return null;
  const pad = (high - low) * air || (low === high ? Math.abs(high) * 0.05 || 1 : 0);
  return [low - pad, high + pad];
}

function path(xs, ys, x, y) {
  let d = "", pen = false;
  for (let i = 0; i < xs.length; i++) {
    const ok = ys[i] !== null && xs[i] !== null && Number.isFinite(xs[i]) && Number.isFinite(ys[i]);
    if (ok) d += `${pen ? "L" : "M"}${x(xs[i]).toFixed(1)} ${y(ys[i]).toFixed(1)}`;
    pen = ok;
  }
  return d;
}

/**
 * layers: { kind: "line" | "area" | "band" | "interval" | "upright" | "level" | "dots" | "points" | "bars" | "columns" | "cells" | "flags", … }, drawn in order.
 * options: { x: {label, log, time, range}, y: {label, log, range, air}, width, height, label }.
 */
export function plot(box, layers, options) {
  const W = Math.max(300, Math.min(options.width ?? 1400, box.clientWidth || 600)), H = options.height ?? 300, right = W - RIGHT, bottom = H - BOTTOM;
  const curves = layers.filter((layer) => layer.x && layer.y);
  const xr = options.x.range ?? range(curves.flatMap((layer) => layer.x), options.x.air ?? 0);
  const yr = options.y.range ?? range(layers.flatMap((layer) => [...(layer.y ?? []), ...(layer.low ?? []), ...(layer.high ?? []), ...(layer.kind === "level" ? [layer.at] : [])]), options.y.air ?? 0.05);
  if (!xr || !yr) {
    box.replaceChildren("nothing to show yet");
    return null;
  }
  const scale = (axis, [low, high], from, to) => {
    const f = axis.log ? Math.log : (v) => v;
    return (v) => from + ((f(v) - f(low)) / (f(high) - f(low))) * (to - from);
  };
  const x = scale(options.x, xr, LEFT, right), y = scale(options.y, yr, bottom, TOP);
  const root = s("svg", { class: "plot", viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": options.label ?? "" });
  const wide = Math.max(3, Math.floor(W / (options.x.time ? 95 : 80)));
  const xTicks = options.x.time ? timeTicks(...xr, wide) : options.x.log ? logTicks(...xr) : ticks(...xr, wide);
  for (const [t, text] of xTicks) root.append(s("path", { class: "grid", d: `M${x(t)} ${TOP}V${bottom}` }), s("text", { x: x(t), y: bottom + 16, "text-anchor": "middle" }, text));
  for (const [t, text] of options.y.log ? logTicks(...yr) : ticks(...yr, Math.max(3, Math.floor(H / 55)))) root.append(s("path", { class: "grid", d: `M${LEFT} ${y(t)}H${right}` }), s("text", { x: LEFT - 6, y: y(t) + 4, "text-anchor": "end" }, text));
  root.append(s("path", { class: "axis", d: `M${LEFT} ${TOP}V${bottom}H${right}` }));
  root.append(s("text", { x: (LEFT + right) / 2, y: H - 5, "text-anchor": "middle" }, options.x.label));
  root.append(s("text", { transform: `translate(12 ${(TOP + bottom) / 2}) rotate(-90)`, "text-anchor": "middle" }, options.y.label));
  const area = { x, y, top: TOP, bottom, left: LEFT, right, xr, yr };
  // What lies outside of the frame is cut off; dots and bars at its edge are not.
  const id = `frame${++frames}`;
  root.append(s("clipPath", { id }, s("rect", { x: LEFT - 1, y: TOP - 1, width: right - LEFT + 2, height: bottom - TOP + 2 })));
  root.append(s("g", { "clip-path": `url(#${id})` }, layers.flatMap((layer) => KINDS[layer.kind]?.(layer, area) ?? [])));
  box.replaceChildren(root);
  return root;
}

let frames = 0;
const inside = (v, [low, high]) => Math.min(Math.max(v, low), high);

const KINDS = {
  line: (layer, a) => [s("path", { class: `line ${layer.class}`, d: path(layer.x, layer.y, a.x, a.y) })],
  // A closed shape by its corners.
  band: (layer, a) => [s("polygon", { class: "band", "data-layer": "stick-band", points: layer.corners.map(([px, py]) => `${a.x(px).toFixed(1)},${a.y(py).toFixed(1)}`).join(" ") })],
  // From one x to another, over the whole height.
  interval(layer, a) {
    const [from, to] = [layer.from, layer.to].map((v) => a.x(inside(v, a.xr)));
    return [s("rect", { class: "interval", "data-layer": "interval", x: from, y: a.top, width: Math.max(1.5, to - from), height: a.bottom - a.top })];
  },
  upright(layer, a) {
    if (layer.at < a.xr[0] || layer.at > a.xr[1]) return [];
    const at = a.x(layer.at), flip = at > (a.left + a.right) * 0.6;
    return [s("path", { class: `line ${layer.class}`, d: `M${at} ${a.top}V${a.bottom}` }), layer.text ? s("text", { class: "label strong", x: at + (flip ? -5 : 5), y: a.top + 14, "text-anchor": flip ? "end" : "start" }, layer.text) : ""];
  },
  level(layer, a) {
    if (layer.at < a.yr[0] || layer.at > a.yr[1]) return [];
    return [s("path", { class: `line ${layer.class}`, d: `M${a.left} ${a.y(layer.at)}H${a.right}` }), layer.text ? s("text", { class: "label", x: a.right - 4, y: a.y(layer.at) - 5, "text-anchor": "end" }, layer.text) : ""];
  },
  // Dots with the whiskers of their interval.
  dots: (layer, a) =>
    layer.x.flatMap((at, i) => {
      if (layer.y[i] === null) return [s("path", { class: "axis", d: `M${a.x(at)} ${a.bottom}v-7` })];
      const out = [s("circle", { class: "dot", cx: a.x(at), cy: a.y(layer.y[i]), r: 3 })];
      if (layer.low?.[i] !== null && layer.low) out.unshift(s("path", { class: "line thin op", d: `M${a.x(at)} ${a.y(layer.low[i])}V${a.y(layer.high[i])}` }));
      return out;
    }),
  // Points on their own.
  points: (layer, a) => layer.x.map((at, i) => s("circle", { class: `point ${layer.class}`, cx: a.x(at).toFixed(1), cy: a.y(layer.y[i]).toFixed(1), r: layer.size })),
  // Bars as wide as they stand for.
  columns: (layer, a) => layer.x.map((at, i) => s("rect", { class: `column ${layer.class}`, x: a.x(at - layer.wide / 2), y: a.y(layer.y[i]), width: Math.max(1, a.x(at + layer.wide / 2) - a.x(at - layer.wide / 2) - 1), height: Math.max(0, a.y(0) - a.y(layer.y[i])) })),
  // A map: the darker, the larger.
  cells: (layer, a) =>
    layer.values.flatMap((value, i) => {
      if (value === null) return [];
      const [wide, high] = layer.size, left = layer.from[0] + (i % layer.columns) * wide, below = layer.from[1] + Math.floor(i / layer.columns) * high;
      return [s("rect", { class: "cell", "fill-opacity": (0.06 + 0.94 * value).toFixed(2), x: a.x(left), y: a.y(below + high), width: a.x(left + wide) - a.x(left) + 0.3, height: a.y(below) - a.y(below + high) + 0.3 })];
    }),
  bars: (layer, a) => layer.x.map((at, i) => s("path", { class: `line ${layer.class}`, "stroke-width": layer.size ?? 3, d: `M${a.x(at) + (layer.shift ?? 0)} ${a.y(0)}V${a.y(layer.y[i])}` })),
  // Marks at the top, with a line down.
  flags: (layer, a) =>
    layer.at.filter((flag) => flag.x >= a.xr[0] && flag.x <= a.xr[1]).flatMap((flag) => {
      const at = a.x(flag.x);
      return [s("path", { class: `line thin dash ${flag.raised ? "alarm" : "sp"}`, d: `M${at} ${a.top}V${a.bottom}` }), s("path", { class: `flag ${flag.raised ? "" : "done"}`, d: `M${at - 6} ${a.top + 10}h12l-6 -10z` }, s("title", null, flag.text))];
    }),
};
