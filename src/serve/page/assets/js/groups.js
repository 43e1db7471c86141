// Groups of loops that swing together: the list, and one group with its pictures.

import { get, often, orNull, post } from "./api.js";
import { h, s, toast } from "./dom.js";
import { percent, when } from "./format.js";
import { may } from "./session.js";

const link = (id) => h("a", { href: `#/loop/${encodeURIComponent(id)}` }, id);
const names = (list) => list.flatMap((id, i) => [i ? ", " : "", link(id)]);

// Pictures are made by the daemon and taken element by element: nothing but shapes and text comes through.
const SHAPES = new Set(["svg", "g", "path", "polyline", "rect", "text", "title", "defs", "marker"]);
const ATTRIBUTES = new Set(["viewBox", "d", "points", "x", "y", "width", "height", "rx", "opacity", "class", "role", "aria-label", "id", "text-anchor", "transform", "marker-end", "refX", "refY", "markerWidth", "markerHeight", "orient"]);

function copied(node) {
  if (node.nodeType === Node.TEXT_NODE) return node.data;
  if (!SHAPES.has(node.nodeName)) return null;
  const kept = [...node.attributes].filter(({ name }) => ATTRIBUTES.has(name)).map(({ name, value }) => [name, value]);
  return s(node.nodeName, Object.fromEntries(kept), ...[...node.childNodes].map(copied));
}

function picture({ svg, caption }) {
  const made = new DOMParser().parseFromString(svg.replace(/^<svg /, '<svg xmlns="http://www.w3.org/2000/svg" '), "image/svg+xml").documentElement;
  return h("figure", { class: "swing" }, h("div", null, copied(made)), h("figcaption", null, caption));
}

function suspects(list) {
  // Below one half it is as well another one: nobody is suspected.
  const role = (own, i) => (i === 0 ? (own.probability >= 0.5 ? "Suspected source " : "Likeliest source ") : i === 1 ? "Runner-up " : "");
  const line = (own, i) => h("li", null, h("strong", null, role(own, i), link(own.id), `, ${percent(own.probability)}`), h("span", null, own.evidence.join("; ")));
  return h("ul", { class: "effects" }, list.slice(0, 3).map(line));
}

// How many of some loops are in a group (0..1).
const share = (some, group) => some.filter((id) => group.includes(id)).length / some.length;

// A group of another look that has more of its loops is the same one: no loop is in two groups of a look, so no other can have as many.
const SAME = 0.5;

export function groupsView(main, [number]) {
  let over = false, seen = null, said = null, members = null;
  const summary = h("p", { class: "summary", role: "status" }, "loading …"), cards = h("div", { class: "cards" });
  const look = may("operator") && h("button", { type: "button", on: { click: ask } }, "Look at the plant now");
  const back = number ? h("a", { class: "back", href: "#/groups" }, "← Groups") : h("a", { class: "back", href: "#/work" }, "← Work list");
  const title = h("h1", null, number ? `Group ${number}` : "Groups that swing together");
  main.append(h("div", { class: "head" }, back, title, number ? null : look || null), summary, cards);

  async function ask() {
    look.disabled = true;
    try {
      await post("/groups");
      toast("the plant is looked at; this takes some seconds");
      for (let i = 0; i < 60 && !over; i++) {
        await new Promise((done) => setTimeout(done, 1000));
        if (await show()) break;
      }
    } catch (error) {
      toast(error.message, true);
    } finally {
      look.disabled = false;
    }
  }

  const card = (item) => h("section", { class: "card", "data-group": item.number }, h("header", null, h("h2", null, h("a", { href: `#/groups/${item.number}` }, `Group ${item.number}`))), h("p", null, item.words), suspects(item.suspects), h("p", { class: "note" }, names(item.members)));

  const passed = (list) => h("section", { class: "card" }, h("details", null, h("summary", null, "Loops that could not be looked at"), h("ul", null, list.slice(0, 100).map(({ id, why }) => h("li", null, link(id), `: ${why}`)))));

  // Each look numbers the groups anew: what is open is the group of these loops, whatever its number is by now. Null where there is
  // nothing new.
  async function find() {
    if (!members) return orNull(get(`/groups/${encodeURIComponent(number)}`));
    const { time, items } = await get("/groups");
    if (!time || time === seen) return null;
    const same = items.find((item) => share(members, item.members) > SAME);
    if (!same) return { time, gone: true };
    const found = await orNull(get(`/groups/${same.number}`));
    // Another look may have come in between: the next time it is found there.
    return found && share(members, found.members) > SAME ? found : null;
  }

  function say(text) {
    summary.textContent = said = text;
  }

  function drawGroup(found) {
    if (found.gone) {
      say(`This group is not found any more by the look of ${when(found.time)}: what is shown is of the look before.`);
      return;
    }
    if (members && String(found.number) !== number) {
      number = String(found.number);
      title.textContent = `Group ${number}`;
      document.title = `${number} · stictiond`;
      history.replaceState(null, "", `#/groups/${number}`);
    }
    members = found.members;
    say(`${found.words} Looked at ${when(found.time)}.`);
    cards.replaceChildren(h("section", { class: "card" }, suspects(found.suspects), h("p", { class: "note" }, names(found.members))), h("section", { class: "card" }, h("div", { class: "swings" }, found.pictures.map(picture))));
  }

  function drawAll(found) {
    const skipped = found.skipped.length ? `; ${found.skipped.length} could not be looked at` : "";
    say(`${found.items.length ? `${found.items.length} ${found.items.length === 1 ? "group" : "groups"}` : "No loops swing together"}, by a look at ${found.looked_at} loops at ${when(found.time)}${skipped}.`);
    cards.replaceChildren(...found.items.slice(0, 100).map(card), ...(found.skipped.length ? [passed(found.skipped)] : []));
  }

  /** True when another look is shown than before. */
  async function show() {
    try {
      const found = await (number ? find() : orNull(get("/groups")));
      if (over) return true;
      // A daemon that was started again has not looked yet. What was said before a fetch failed stands again.
      if (seen !== null && (!found?.time || found.time === seen)) {
        summary.textContent = said;
        return false;
      }
      if (!found?.time) {
        summary.textContent = number ? `There is no group ${number}: each look at the plant numbers the groups anew.` : "The plant has not been looked at yet.";
        return false;
      }
      const another = seen !== null;
      seen = found.time;
      if (number) drawGroup(found);
      else drawAll(found);
      return another;
    } catch (error) {
      if (!over) summary.textContent = `the groups cannot be fetched: ${error.message}`;
      return false;
    }
  }

  const end = often(show, 15000);
  return () => {
    over = true;
    end();
  };
}
