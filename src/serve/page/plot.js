// Line plots as SVG: axes with units, a legend, gaps drawn as gaps. Everything is made by createElementNS and
// textContent, so names from the plant are text and never markup.

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 58, RIGHT = 58, TOP = 22, BOTTOM = 40;

function add(parent, name, attributes, text) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  parent.append(node);
  return node;
}

// Round steps of 1, 2 or 5 times a power of ten: about `count` of them.
export function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const found = [];
  for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-9; t += step) found.push(Math.abs(t) < step * 1e-9 ? 0 : t);
  return found;
}

export const short = (value) => (value === null || value === undefined ? "–" : String(Number(Number(value).toPrecision(4))));

// Ticks as text with as many decimals as their step needs.
function labels(found) {
  const step = Math.abs(found[1] - found[0]), decimals = Math.ceil(-Math.log10(step) - 1e-9);
  const plain = step > 1e-7 && Math.abs(found[0]) < 1e7;
  return found.map((t) => (plain ? t.toFixed(Math.max(0, decimals)) : short(t)));
}

function range(values, margin) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (v !== null && Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
  if (low > high) return null;
  const pad = (high - low) * margin || Math.abs(high) * 0.05 || 1;
  return margin || low === high ? [low - pad, high + pad] : [low, high];
}

function path(xs, ys, x, y) {
  let d = "", pen = false;
  for (let i = 0; i < xs.length; i++) {
    const ok = Number.isFinite(xs[i]) && ys[i] !== null && Number.isFinite(ys[i]);
    if (ok) d += `${pen ? "L" : "M"}${x(xs[i]).toFixed(1)} ${y(ys[i]).toFixed(1)}`;
    pen = ok;
  }
  return d;
}

// Times [ms] at round local clock times: about six of them.
export function timeTicks([low, high]) {
  const seconds = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600, 43200, 86400];
  const days = Math.ceil((high - low) / 6 / 864e5) * 86400;
  const step = 1000 * (seconds.find((s) => s * 1000 >= (high - low) / 6) ?? days);
  const zone = new Date(low).getTimezoneOffset() * 60000, found = [];
  for (let t = Math.ceil((low - zone) / step) * step + zone; t <= high; t += step) found.push(t);
  return found;
}

// series: [{x, y, name, unit, kind, side}], side "right" for the second axis; options: width, height, xLabel, xText,
// xTicks, band, mark.
export function plot(box, series, options) {
  // On a narrow screen the plot is as narrow, so that its text stays as large.
  const W = Math.max(320, Math.min(options.width ?? 1100, box.clientWidth || Infinity)), H = options.height ?? 280, right = W - RIGHT, bottom = H - BOTTOM;
  box.replaceChildren();
  const xr = range(series.flatMap((s) => s.x), 0);
  const axes = { left: series.filter((s) => s.side !== "right"), right: series.filter((s) => s.side === "right") };
  if (!xr || !range(series.flatMap((s) => s.y), 0.05)) {
    box.textContent = "nothing to show yet";
    return;
  }
  const svg = add(box, "svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": series.map((s) => s.name).join(", ") });
  const x = (v) => LEFT + ((v - xr[0]) / (xr[1] - xr[0])) * (right - LEFT);
  if (options.band) {
    const [from, to] = options.band.map((v) => x(Math.min(Math.max(v, xr[0]), xr[1])));
    add(svg, "rect", { x: from, y: TOP, width: Math.max(to - from, 1), height: bottom - TOP, class: "band" });
  }
  add(svg, "path", { d: `M${LEFT} ${TOP}V${bottom}H${right}V${TOP}`, class: "axis" });
  const xTicks = options.xTicks?.(xr) ?? ticks(xr[0], xr[1], 6), xTexts = options.xText ? xTicks.map(options.xText) : labels(xTicks);
  for (const [i, t] of xTicks.entries()) {
    if (W < 500 && i % 2) continue;
    add(svg, "path", { d: `M${x(t)} ${bottom}v4`, class: "axis" });
    add(svg, "text", { x: x(t), y: bottom + 16, "text-anchor": "middle" }, xTexts[i]);
  }
  add(svg, "text", { x: (LEFT + right) / 2, y: H - 6, "text-anchor": "middle" }, options.xLabel);
  let legend = LEFT;
  for (const [side, members] of Object.entries(axes)) {
    const yr = range(members.flatMap((s) => s.y), 0.05);
    if (!yr) continue;
    const y = (v) => bottom - ((v - yr[0]) / (yr[1] - yr[0])) * (bottom - TOP);
    const yTicks = ticks(yr[0], yr[1], 5), yTexts = labels(yTicks);
    for (const [i, t] of yTicks.entries()) {
      const at = side === "left" ? { x: LEFT - 6, "text-anchor": "end" } : { x: right + 6, "text-anchor": "start" };
      add(svg, "text", { ...at, y: y(t) + 4 }, yTexts[i]);
    }
    for (const s of members) {
      if (s.bad) for (const t of s.bad) add(svg, "path", { d: `M${x(t)} ${bottom}v-6`, class: "gap" });
      add(svg, "path", { d: path(s.x, s.y, x, y), class: s.kind });
      const label = add(svg, "text", { x: legend, y: 14, class: s.kind }, `${s.name}${s.unit ? ` [${s.unit}]` : ""}${side === "right" ? " →" : ""}`);
      legend += 20 + (label.getComputedTextLength?.() || 90);
    }
  }
  if (options.mark !== undefined && options.mark !== null) {
    add(svg, "path", { d: `M${x(options.mark)} ${TOP}V${bottom}`, class: "mark" });
  }
}
