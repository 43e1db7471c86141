// One loop as a tile. Tiles live as long as their loops; a refresh changes what changed.

import { h } from "./dom.js";
import { ago, costs, friction, frictionNamed, short, when } from "./format.js";
import { isOld, since } from "./live.js";
import { kindOf, whyNot, words } from "./states.js";

// The bar in a tile is full at this f (% OP): more is as bad. In other units nobody knows what is bad, and there is none.
const FULL = 5, PERCENT = "% OP";

const made = new Map();

function make(id) {
  const part = (kind) => h("span", { class: kind });
  const tile = { mark: part("mark"), name: part("name"), tag: part("tag"), text: part("text"), value: part("value"), bar: h("i") };
  tile.link = h("a", { class: "tile", href: `#/loop/${encodeURIComponent(id)}`, tabindex: "-1", "data-id": id },
    tile.mark, tile.name, tile.tag, tile.text, tile.value, h("span", { class: "bar", "aria-hidden": "true" }, tile.bar));
  tile.name.textContent = id;
  return tile;
}

function valueOf(item) {
  if (!item.verdict) return "waiting for data";
  if (item.verdict === "not_identifiable") return whyNot(item.reason_code);
  if (item.verdict === "stiction") return `f ${short(item.f, 3)} ${item.f_unit}`;
  // That such an f could be hidden is said in the title: there is no room for it.
  return item.f_ci95?.[1] > 0 ? `f up to ${short(item.f_ci95[1], 2)} ${item.f_unit}` : "f 0";
}

/** The tile of a loop, as it is now. */
export function tileOf(item) {
  let tile = made.get(item.id);
  if (!tile) made.set(item.id, (tile = make(item.id)));
  const old = isOld(item), age = old ? ago(since(item.time)) : null;
  if (tile.item === item && tile.age === age) return tile.link;
  Object.assign(tile, { item, age });
  const kind = kindOf(item), sticks = item.verdict === "stiction" && item.f !== null;
  tile.link.dataset.kind = kind.key;
  tile.link.toggleAttribute("data-old", old);
  tile.tag.textContent = [kind.short, item.failure && "run failed", old && "OLD"].filter(Boolean).join(" ");
  tile.text.textContent = item.description || item.group;
  tile.value.textContent = valueOf(item);
  tile.bar.style.width = sticks && item.f_unit === PERCENT ? `${Math.min(100, (100 * item.f) / FULL)}%` : "0";
  const lines = [`${item.id}: ${kind.label}`, item.description, item.group, item.words, item.verdict && item.verdict !== "not_identifiable" && frictionNamed(item), item.score !== null && `score ${short(item.score, 3)} of 100`, item.cost !== null && `its swing costs ${costs(item)}`, item.doubtful && "other methods contradict this", item.failure && `latest run: ${words(item.failure)}`, item.time && `diagnosed ${when(item.time)}`, old && `that is ${age}: it should have been diagnosed again`];
  tile.link.title = lines.filter(Boolean).join("\n");
  tile.link.setAttribute("aria-label", [item.id, kind.label, sticks && `f ${friction(item)}`, old && "old", item.description, item.group].filter(Boolean).join(", "));
  return tile.link;
}

/** Lets go of the tiles of loops that are no longer there. */
export function forget(known) {
  for (const id of made.keys()) if (!known.has(id)) made.delete(id);
}
