// What the published methods say beside the verdict: a line for each, its pictures on request.

import { get, loopPath } from "./api.js";
import { h, s } from "./dom.js";
import { beside, short } from "./format.js";
import { plot } from "./svg.js";

const SAYS = { sticks: "sticks", sound: "sound", cannot_tell: "cannot tell" };
// How marks of each meaning look: their class, and the word of the key.
const TONES = { data: "pv", beside: "mv", sticks: "stem", sound: "op", mark: "alarm" };
const WIDE = 160, HIGH = 22;

const told = ({ index, threshold }) => beside(index, threshold ? [threshold.sound, threshold.sticks] : [], 3);

// The index on a bar whose zones are its thresholds: sound on the left, sticks on the right, between them nothing is said.
function bullet({ index, threshold }) {
  if (index === null || !threshold) return h("span", { class: "bullet" });
  const { sound, sticks } = threshold, floor = Math.min(0, index, sound ?? 0), beyond = Math.max(sticks - floor, 1e-9);
  const top = Math.max(index, sticks + 0.6 * beyond), x = (v) => ((v - floor) / (top - floor)) * WIDE;
  const zone = (from, to, kind) => s("rect", { class: kind, x: x(from), y: 6, width: Math.max(0, x(to) - x(from)), height: HIGH - 12 });
  const at = Math.min(Math.max(x(index), 2), WIDE - 2);
  const text = `index ${told({ index, threshold })}; ${sound === null ? "no index clears a valve" : `sound up to ${short(sound, 3)}`}, sticks above ${short(sticks, 3)}`;
  return s("svg", { class: "bullet", viewBox: `0 0 ${WIDE} ${HIGH}`, role: "img", "aria-label": text }, s("title", null, text),
    sound === null ? "" : zone(floor, sound, "sound"), zone(sound ?? floor, sticks, "between"), zone(sticks, top, "sticks"),
    s("path", { class: "at", d: `M${at} 2V${HIGH - 2}` }));
}

// How many methods say that the valve sticks, and how many of them agree with a verdict where there is one.
function said({ sticks, could_tell: told, agree }, verdict) {
  if (told === 0) return "No method could tell.";
  if (told === 1) return `The only method that could tell says that the valve ${sticks ? "sticks" : "does not stick"}.`;
  const agrees = verdict ? `, ${agree} agree${agree === 1 ? "s" : ""} with the verdict.` : ".";
  return `${sticks} of ${told} methods that could tell say${sticks === 1 ? "s" : ""} that the valve sticks${agrees}`;
}

const range = (axis) => {
  const air = 0.03 * (axis.to - axis.from);
  return [axis.from - air, axis.to + air];
};

function layerOf(one) {
  const look = TONES[one.tone] ?? "pv";
  switch (one.mark) {
    case "line": return { kind: "line", class: `${look}${one.tone === "data" ? " thin" : ""}`, x: one.x, y: one.y };
    case "dots": return { kind: "points", class: look, size: one.tone === "data" ? 1.6 : one.x.length > 12 ? 2.6 : 4.5, x: one.x, y: one.y };
    case "bars": return { kind: "columns", class: look, wide: one.size[0], x: one.x, y: one.y };
    case "level": return { kind: "level", class: `${look} dash thin`, at: one.at };
    case "upright": return { kind: "upright", class: `${look} dash`, at: one.at };
    case "cells": return { kind: "cells", ...one };
    default: return { kind: "" };
  }
}

function figure(picture) {
  const box = h("div"), names = new Map(picture.layers.map((one) => [one.name, one]));
  const keys = h("div", { class: "keys" }, [...names.values()].filter((one) => one.mark !== "level" || one.name !== "0").map((one) => h("span", { class: TONES[one.tone] ?? "pv" }, one.name)));
  const draw = () => plot(box, picture.layers.map(layerOf), { x: { label: picture.x.label, range: range(picture.x) }, y: { label: picture.y.label, range: range(picture.y) }, height: 280, width: 760, label: picture.title });
  return { element: h("figure", null, h("figcaption", null, picture.title), box, keys), draw };
}

/** The panel of one loop; `box` is filled. */
export function opinionsPanel(id, box) {
  const open = new Map();

  async function load(opinion, target) {
    delete target.dataset.failed;
    target.replaceChildren("loading …");
    try {
      const { pictures } = await get(`${loopPath(id)}/opinions/${opinion.method}`);
      const figures = pictures.map(figure);
      target.replaceChildren(...(figures.length ? figures.map((one) => one.element) : [h("p", { class: "note" }, "There is nothing to draw: the method does not apply here, or the diagnosis is from before the start or of another machine.")]));
      const draw = () => figures.forEach((one) => one.draw());
      draw();
      if (open.has(opinion.method)) open.set(opinion.method, draw);
    } catch (error) {
      target.dataset.failed = "";
      target.replaceChildren(h("p", { class: "note" }, error.message));
    }
  }

  function row(opinion) {
    const target = h("div", { class: "pictures" }), { quantity } = opinion;
    const measured = quantity ? `${quantity.measures} ${short(quantity.value, 3)} ${quantity.unit}` : "";
    const summary = h("summary", null, h("span", { class: "who" }, opinion.title || opinion.method), h("span", { class: `says ${opinion.says}` }, SAYS[opinion.says] ?? opinion.says), bullet(opinion),
      h("span", { class: "index" }, opinion.index === null ? "" : told(opinion)), h("span", { class: "why" }, [opinion.why, measured].filter(Boolean).join("; ")));
    const details = h("details", { "data-method": opinion.method, open: open.has(opinion.method) }, summary, target);
    details.addEventListener("toggle", () => {
      if (!details.open) return open.delete(opinion.method);
      if (!open.has(opinion.method)) open.set(opinion.method, () => {});
      if (!target.childNodes.length || "failed" in target.dataset) load(opinion, target);
    });
    return h("li", null, details);
  }

  return {
    /** Shows what a report says; false where it has no opinions. */
    show(report, notes) {
      if (!report?.opinions?.length) return false;
      const focused = box.contains(document.activeElement) ? document.activeElement.closest("details")?.dataset.method : null;
      const { agreement } = report;
      const line = !agreement ? "" : said(agreement, report.verdict !== "not_identifiable");
      box.replaceChildren(h("p", { class: report.doubtful ? "agreement doubtful" : "agreement" }, report.doubtful ? h("strong", null, "Doubtful. ") : "", line, report.doubtful && notes?.length ? ` ${notes.at(-1)}` : ""),
        h("ol", { class: "opinions" }, report.opinions.map(row)));
      if (focused) box.querySelector(`details[data-method="${CSS.escape(focused)}"] summary`)?.focus();
      return true;
    },
    /** Draws the open pictures again, as wide as they may be now. */
    redraw: () => [...open.values()].forEach((draw) => draw()),
  };
}
