// A map of many loops: sites, their units, and a cell for each loop, worst first. Areas are numbers of loops, but for what would
// be too small to be seen.

import { colour, h } from "./dom.js";
import { kind } from "./states.js";

/** What the letters of the API mean, worst first. */
const LETTERS = { U: "unacknowledged", A: "acknowledged", S: "sticking", R: "returned", L: "latched", H: "shelved", X: "silent", N: "unknown", W: "waiting", O: "sound" };
const PAINT = { U: "--alarm", A: "--alarm", S: "--warn", R: "--warn", L: "--warn", H: "--faint", X: "--faint", N: "--faint", W: "--rule", O: "--rule" };
// Drawn as outlines: seen already, or nothing known. A cell that is too small for an outline is drawn faintly instead.
const HOLLOW = new Set(["A", "R", "L", "N", "W"]);
const LEAST_OUTLINE = 3, FAINT = 0.45; // px, opacity
const SITE_TITLE = 22, UNIT_TITLE = 16, GAP = 3, LEAST_TITLE = 60, MOST_CELL = 28, LEAST_HIGH = 150; // px
// A gap takes no larger share of a box: a unit of a single loop among very many still shows its cell.
const GAP_SHARE = 1 / 12;
// What has less than this share of the mean number of loops is far smaller than the others …
const FAR = 1 / 4;
// … and stands in a strip at least so wide (px), unless that is more than this share of the box.
const STRIP = 8, STRIP_SHARE = 1 / 12;
// A box has a title where it is so many times as high.
const TITLED = 3;
// The map is no higher than so many times what the largest cells take: a few loops do not leave it empty.
const ROOM = 3;
// What stands between a site and its unit in a group's name.
const BETWEEN = " / ";

/** Loops by kind: `{ sticking: 3, … }`. */
function counts(letters) {
  const found = {};
  for (const letter of letters) found[LETTERS[letter] ?? "other"] = (found[LETTERS[letter] ?? "other"] ?? 0) + 1;
  return found;
}

const told = (of) => Object.entries(of).map(([key, n]) => `${n} ${kind(key).label.toLowerCase()}`).join(", ");

/** `3 loops`, `1 loop`. */
export const many = (n, what) => `${n} ${what}${n === 1 ? "" : "s"}`;

/** A site, a unit or a group as people read it; its name may be empty. */
export const named = (name) => name || "no unit";

/** Site and unit of a group's name; empty where there is none. */
export function placeOf(group) {
  const at = group.indexOf(BETWEEN);
  return at < 0 ? { site: group, unit: "" } : { site: group.slice(0, at), unit: group.slice(at + BETWEEN.length) };
}

/** The sites of a map and their units, each with its number of loops (`size`), by kind too (`of`). */
export function sitesOf(groups) {
  const sites = new Map();
  for (const { group, loops } of groups) {
    const { site, unit } = placeOf(group), size = loops.length, of = counts(loops);
    if (!sites.has(site)) sites.set(site, { site, units: [], size: 0, of: {} });
    const own = sites.get(site);
    own.units.push({ site, group, unit, loops, size, of });
    own.size += size;
    for (const [key, n] of Object.entries(of)) own.of[key] = (own.of[key] ?? 0) + n;
  }
  return [...sites.values()];
}

// Rectangles whose areas are in proportion, near to squares: rows along the shorter side, each as long as it gets squarer.
// Bruls, Huizing & van Wijk, Squarified Treemaps, 2000.
function squarified(items, box) {
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

// The same, but what is far smaller than the others stands in a strip of its own: beside a large one it would be a sliver.
function laidOut(items, box) {
  const sum = (some) => some.reduce((all, item) => all + item.size, 0), total = sum(items), least = (FAR * total) / items.length;
  const small = items.filter((item) => item.size < least);
  if (!small.length) return squarified(items, box);
  const flat = box.w >= box.h, long = flat ? box.w : box.h;
  const strip = Math.max((long * sum(small)) / total, Math.min(STRIP, STRIP_SHARE * long));
  const [main, side] = flat ? [{ ...box, w: long - strip }, { ...box, x: box.x + long - strip, w: strip }] : [{ ...box, h: long - strip }, { ...box, y: box.y + long - strip, h: strip }];
  return [...squarified(items.filter((item) => item.size >= least), main), ...laidOut(small, side)];
}

// What is left of a box inside its gap, and below its title where it has one.
function inside(box, title) {
  const across = Math.min(GAP, GAP_SHARE * box.w), down = Math.min(GAP, GAP_SHARE * box.h), top = title || down;
  return { x: box.x + across, y: box.y + top, w: box.w - 2 * across, h: box.h - top - down };
}

/** What the cells of a map mean. */
export function legend() {
  const swatch = (letter) => h("i", { class: HOLLOW.has(letter) ? `${PAINT[letter].slice(2)} hollow` : PAINT[letter].slice(2) });
  return h("p", { class: "map-legend" }, ...["U", "A", "S", "L", "H", "N", "W", "O"].map((letter) => h("span", null, swatch(letter), { L: "Returned or latched", H: "Shelved or off" }[letter] ?? kind(LETTERS[letter]).label)));
}

function title(paint, text, box, font, ink) {
  paint.fillStyle = ink;
  paint.font = font;
  paint.textBaseline = "middle";
  paint.save();
  paint.beginPath();
  paint.rect(box.x, box.y, box.w - 4, SITE_TITLE);
  paint.clip();
  paint.fillText(text, box.x + 4, box.y + SITE_TITLE / 2);
  paint.restore();
}

function cells(paint, colours, letters, box) {
  // The largest squares that fit.
  let across = Math.ceil(Math.sqrt((letters.length * box.w) / box.h));
  while (Math.ceil(letters.length / across) * (box.w / across) > box.h) across += 1;
  const step = Math.min(box.w / across, MOST_CELL), side = step > 5 ? step - 1 : step;
  if (step === MOST_CELL) across = Math.floor(box.w / step);
  let before = null;
  [...letters].forEach((letter, at) => {
    const x = box.x + (at % across) * step, y = box.y + Math.floor(at / across) * step, hollow = HOLLOW.has(letter);
    // Equal letters follow each other, and to set a colour takes longer than to fill a cell.
    if (letter !== before) {
      paint.fillStyle = paint.strokeStyle = colours[letter] ?? colours.X;
      paint.globalAlpha = hollow && step <= LEAST_OUTLINE ? FAINT : 1;
      before = letter;
    }
    if (hollow && step > LEAST_OUTLINE) paint.strokeRect(x + 0.5, y + 0.5, side - 1, side - 1);
    else paint.fillRect(x, y, side, side);
  });
  paint.globalAlpha = 1;
}

/** The map; `choose(site, group)` hears which unit was pressed, or which site, whose group is null. */
export function plantMap(choose) {
  const canvas = h("canvas", { class: "map", role: "img", "aria-label": "loading …" });
  let sites = null, frames = [], places = [];

  function draw() {
    if (!sites || !canvas.isConnected) return;
    const ratio = devicePixelRatio || 1, width = canvas.clientWidth, total = sites.reduce((sum, own) => sum + own.size, 0);
    canvas.style.maxHeight = `${Math.max(LEAST_HIGH, (ROOM * total * MOST_CELL ** 2) / width)}px`;
    const height = canvas.clientHeight;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const paint = canvas.getContext("2d"), colours = Object.fromEntries(Object.entries(PAINT).map(([letter, name]) => [letter, colour(name)]));
    const [rule, sheet, ink, faint] = ["--rule", "--sheet", "--ink", "--faint"].map(colour);
    paint.scale(ratio, ratio);
    [frames, places] = [[], []];
    for (const { item: own, box } of laidOut(sites, { x: 0, y: 0, w: width, h: height })) {
      if (Math.min(box.w, box.h) > 2 * GAP) {
        [paint.strokeStyle, paint.fillStyle] = [rule, sheet];
        paint.fillRect(box.x + 1, box.y + 1, box.w - 2, box.h - 2);
        paint.strokeRect(box.x + 0.5, box.y + 0.5, box.w - 1, box.h - 1);
      }
      frames.push({ own, box });
      const above = box.w >= LEAST_TITLE && box.h > TITLED * SITE_TITLE;
      if (above) title(paint, `${named(own.site)}  ${own.size}`, box, "600 13px system-ui, sans-serif", ink);
      for (const { item: unit, box: place } of laidOut(own.units, inside(box, above ? SITE_TITLE : 0))) {
        const over = unit.unit && place.w >= LEAST_TITLE && place.h > TITLED * UNIT_TITLE;
        if (over) title(paint, unit.unit, place, "12px system-ui, sans-serif", faint);
        cells(paint, colours, unit.loops, inside(place, over ? UNIT_TITLE + 4 : 0));
        places.push({ own: unit, box: place });
      }
    }
  }

  const under = (some, { offsetX: x, offsetY: y }) => some.find(({ box }) => x >= box.x && x < box.x + box.w && y >= box.y && y < box.y + box.h)?.own;
  // A unit, or a site by its title.
  const at = (event) => under(places, event) ?? under(frames, event);
  canvas.addEventListener("mousemove", (event) => {
    const own = at(event);
    canvas.style.cursor = own ? "pointer" : "default";
    canvas.title = own ? `${named(own.group ?? own.site)}: ${many(own.size, "loop")}\n${told(own.of)}` : "";
  });
  canvas.addEventListener("click", (event) => {
    const own = at(event);
    if (own) choose(own.site, own.group ?? null);
  });
  // Drawing sets the height, and who changes what is observed has to wait for the next frame.
  const sizes = new ResizeObserver(() => requestAnimationFrame(draw));
  sizes.observe(canvas);
  addEventListener("recolour", draw);
  return {
    element: canvas,
    /** Draws these sites. */
    show(some) {
      sites = some;
      const sum = (count) => some.reduce((all, own) => all + count(own), 0);
      canvas.setAttribute("aria-label", `${many(sum((own) => own.size), "loop")} of ${many(sum((own) => own.units.length), "unit")}; the table below has the same in numbers`);
      draw();
    },
    end() {
      sizes.disconnect();
      removeEventListener("recolour", draw);
    },
  };
}
