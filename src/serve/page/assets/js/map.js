// A map of many loops: sites, their units, and a cell for each loop, worst first. Areas are numbers of loops.

import { colour, h } from "./dom.js";
import { kind } from "./states.js";

/** What the letters of the API mean, worst first. */
const LETTERS = { U: "unacknowledged", A: "acknowledged", S: "sticking", R: "returned", L: "latched", H: "shelved", X: "silent", N: "unknown", W: "waiting", O: "sound" };
const PAINT = { U: "--alarm", A: "--alarm", S: "--warn", R: "--warn", L: "--warn", H: "--faint", X: "--faint", N: "--faint", W: "--rule", O: "--rule" };
// Drawn as outlines: seen already, or nothing known.
const HOLLOW = new Set(["A", "R", "L", "N", "W"]);
const SITE_TITLE = 22, UNIT_TITLE = 16, GAP = 3, LEAST_TITLE = 60, MOST_CELL = 28, LEAST_HIGH = 150; // px
// The map is no higher than so many times what the largest cells take: a few loops do not leave it empty.
const ROOM = 3;

/** Loops of a unit by kind: `{ sticking: 3, … }`. */
export function counts(letters) {
  const found = {};
  for (const letter of letters) found[LETTERS[letter] ?? "other"] = (found[LETTERS[letter] ?? "other"] ?? 0) + 1;
  return found;
}

const told = (letters) => Object.entries(counts(letters)).map(([key, n]) => `${n} ${kind(key).label.toLowerCase()}`).join(", ");

/** `[site, unit]` of a group's name. */
export function placeOf(group) {
  const at = group.indexOf(" / ");
  return at < 0 ? [group || "no unit", ""] : [group.slice(0, at), group.slice(at + 3)];
}

// Rectangles whose areas are in proportion, near to squares: rows along the shorter side, each as long as it gets squarer.
// Bruls, Huizing & van Wijk, Squarified Treemaps, 2000.
export function squarified(items, box) {
  const all = items.reduce((sum, item) => sum + item.size, 0), placed = [];
  let { x, y, w, h: high } = box, rest = [...items].sort((a, b) => b.size - a.size);
  const scale = (w * high) / all;
  while (rest.length && w > 0 && high > 0) {
    const side = Math.min(w, high);
    let row = [], sum = 0, worst = Infinity;
    for (const item of rest) {
      const next = sum + item.size * scale, thick = next / side;
      const ratio = Math.max(...[...row, item].map((one) => (one.size * scale) / thick).map((long) => Math.max(long / thick, thick / long)));
      if (row.length && ratio > worst) break;
      [row, sum, worst] = [[...row, item], next, ratio];
    }
    const thick = sum / side;
    let along = 0;
    for (const item of row) {
      const long = (item.size * scale) / thick;
      placed.push({ item, box: w >= high ? { x, y: y + along, w: thick, h: long } : { x: x + along, y, w: long, h: thick } });
      along += long;
    }
    [x, y, w, high] = w >= high ? [x + thick, y, w - thick, high] : [x, y + thick, w, high - thick];
    rest = rest.slice(row.length);
  }
  return placed;
}

const inside = (box, top) => ({ x: box.x + GAP, y: box.y + top, w: Math.max(0, box.w - 2 * GAP), h: Math.max(0, box.h - top - GAP) });

/** What the cells of a map mean. */
export function legend() {
  const swatch = (letter) => h("i", { class: HOLLOW.has(letter) ? `${PAINT[letter].slice(2)} hollow` : PAINT[letter].slice(2) });
  return h("p", { class: "map-legend" }, ...["U", "A", "S", "L", "H", "N", "W", "O"].map((letter) => h("span", null, swatch(letter), { L: "Returned or latched", H: "Shelved or off" }[letter] ?? kind(LETTERS[letter]).label)));
}

/** The map; `choose(group)` hears which unit was pressed. */
export function plantMap(choose) {
  const canvas = h("canvas", { class: "map", role: "img" });
  let units = [], latest = null, colours = {};

  function cells(paint, letters, box) {
    if (box.w < 2 || box.h < 2) return;
    // The largest squares that fit.
    let across = Math.ceil(Math.sqrt((letters.length * box.w) / box.h));
    if (Math.ceil(letters.length / across) * (box.w / across) > box.h) across += 1;
    const step = Math.min(box.w / across, MOST_CELL);
    if (step === MOST_CELL) across = Math.floor(box.w / step);
    const gap = step > 5 ? 1 : 0;
    [...letters].forEach((letter, at) => {
      const x = box.x + (at % across) * step, y = box.y + Math.floor(at / across) * step, side = step - gap;
      paint.fillStyle = paint.strokeStyle = colours[letter] ?? colours.X;
      if (HOLLOW.has(letter) && step > 5) paint.strokeRect(x + 0.5, y + 0.5, side - 1, side - 1);
      else paint.fillRect(x, y, side, side);
    });
  }

  function draw() {
    if (!latest || !canvas.isConnected) return;
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth;
    canvas.style.maxHeight = `${Math.max(LEAST_HIGH, (ROOM * latest.total * MOST_CELL ** 2) / width)}px`;
    const height = canvas.clientHeight;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const paint = canvas.getContext("2d");
    paint.scale(ratio, ratio);
    const title = (text, box, font, ink) => {
      if (box.w < LEAST_TITLE) return;
      paint.fillStyle = colour(ink);
      paint.font = font;
      paint.textBaseline = "middle";
      paint.save();
      paint.beginPath();
      paint.rect(box.x, box.y, box.w - 4, UNIT_TITLE + 6);
      paint.clip();
      paint.fillText(text, box.x + 4, box.y + 11);
      paint.restore();
    };
    const sites = new Map();
    for (const own of latest.groups) {
      const [site, unit] = placeOf(own.group), size = own.loops.length;
      (sites.get(site) ?? sites.set(site, []).get(site)).push({ ...own, unit, size });
    }
    const sized = [...sites].map(([site, own]) => ({ site, own, size: own.reduce((sum, unit) => sum + unit.size, 0) }));
    units = [];
    colours = Object.fromEntries(Object.entries(PAINT).map(([letter, name]) => [letter, colour(name)]));
    for (const { item, box } of squarified(sized, { x: 0, y: 0, w: width, h: height })) {
      paint.strokeStyle = colour("--rule");
      paint.fillStyle = colour("--sheet");
      paint.fillRect(box.x + 1, box.y + 1, box.w - 2, box.h - 2);
      paint.strokeRect(box.x + 0.5, box.y + 0.5, box.w - 1, box.h - 1);
      title(`${item.site}  ${item.size}`, box, "600 13px system-ui, sans-serif", "--ink");
      for (const { item: unit, box: place } of squarified(item.own, inside(box, SITE_TITLE))) {
        const named = unit.unit && place.w >= LEAST_TITLE && place.h > 3 * UNIT_TITLE;
        if (named) title(unit.unit, place, "12px system-ui, sans-serif", "--faint");
        cells(paint, unit.loops, inside(place, named ? UNIT_TITLE + 4 : GAP));
        units.push({ unit, place });
      }
    }
  }

  const at = (event) => {
    const [x, y] = [event.offsetX, event.offsetY];
    return units.find(({ place }) => x >= place.x && x < place.x + place.w && y >= place.y && y < place.y + place.h)?.unit;
  };
  canvas.addEventListener("mousemove", (event) => {
    const unit = at(event);
    canvas.style.cursor = unit ? "pointer" : "default";
    canvas.title = unit ? `${unit.group || "no unit"}: ${unit.size} loops\n${told(unit.loops)}` : "";
  });
  canvas.addEventListener("click", (event) => {
    const unit = at(event);
    if (unit) choose(unit.group);
  });
  const sizes = new ResizeObserver(draw);
  sizes.observe(canvas);
  addEventListener("recolour", draw);
  return {
    element: canvas,
    show(map) {
      latest = map;
      canvas.setAttribute("aria-label", `${map.total} loops of ${map.groups.length} units; the table below has the same in numbers`);
      draw();
    },
    end() {
      sizes.disconnect();
      removeEventListener("recolour", draw);
    },
  };
}
