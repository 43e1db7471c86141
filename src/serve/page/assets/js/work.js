// The work list: what to do, source before victims, what to do perhaps, which loops are not at rest for an unknown cause, and what became
// of it.

import { workAct } from "./actions.js";
import { get, href, often } from "./api.js";
import { h, redraw, scroll } from "./dom.js";
import { costs, percent, short, when } from "./format.js";
import { loops } from "./live.js";
import { may } from "./session.js";

const COLUMNS = ["Loop", "State", "Cause", "Why", "May calm down with it", "Cost", "By, remark", ""];
// A row of a state has the mark of a tile that is as urgent.
const MARKS = { open: "unacknowledged", ordered: "acknowledged", repaired: "sticking", watched: "waiting", unexplained: "waiting", verified: "sound", calmed: "sound", dismissed: "silent" };
const MAY = { watched: ["order", "dismiss"], unexplained: ["order", "dismiss"], open: ["order", "repaired", "dismiss"], ordered: ["repaired", "dismiss"], repaired: ["reopen"], verified: ["reopen"], calmed: ["reopen"], dismissed: ["reopen"] };
const VERBS = { order: "Order", repaired: "Done", dismiss: "Dismiss", reopen: "Reopen" };
const PAGE = 100, VICTIMS = 6;
// The parts of the list, each with what its loops have in common.
const PARTS = {
  first: ["What to do first", ""],
  perhaps: ["Perhaps", ": less likely than 80 %, or nothing to gain: look before you order work"],
  unknown: ["Not at rest, cause unknown", ": nothing to order yet"],
  watched: ["Suspected, not for long enough yet", ""],
  over: ["Over", ""],
};
const partOf = ({ part, state }) => part ?? (state === "watched" ? "watched" : "over");

const link = (id) => h("a", { href: `#/loop/${encodeURIComponent(id)}` }, id);

function victims(list) {
  const names = (some) => some.flatMap((id, i) => [i ? ", " : "", link(id)]);
  if (list.length <= VICTIMS) return names(list);
  return [...names(list.slice(0, VICTIMS)), h("details", null, h("summary", null, `and ${list.length - VICTIMS} more`), names(list.slice(VICTIMS)))];
}

// An order may be open again for long, and somebody may open it before a look has decided.
function changed({ state, before, after }) {
  if (!before || before.error_sd === null) return null;
  const sd = (own) => short(own.error_sd, 3), then = after ? `, ${sd(after)} after it` : state === "repaired" ? "; a later look decides" : "";
  return h("small", null, ` Error's standard deviation ${sd(before)} before the repair${then}.`);
}

export function workView(main, _parts, query) {
  let over = false, wanted = PAGE, list = null, drawn = null;
  const all = query.get("show") === "all";
  const tabs = h("nav", { "aria-label": "Work" }, h("a", { href: "#/work", "aria-current": all ? null : "page" }, "To do"), h("a", { href: "#/work?show=all", "aria-current": all ? "page" : null }, "All, watched and over too"), h("a", { href: "#/groups" }, "Groups that swing together"));
  const summary = h("p", { class: "summary", role: "status" }, "loading …"), rows = h("tbody");
  const more = h("button", { type: "button", hidden: true, on: { click: extend } }, "More");
  const acts = h("div", { class: "acts" }, h("a", { class: "button", href: href("/work.csv"), download: "work.csv" }, "CSV"), h("a", { class: "button", href: href("/work.html"), target: "_blank", rel: "noopener" }, "Print"));
  const head = h("thead", null, h("tr", null, COLUMNS.map((text) => h("th", { scope: "col", class: text === "Cost" ? "number" : null }, text))));
  main.append(h("h1", null, "Work list"), tabs, h("div", { class: "head" }, summary, acts), h("section", { class: "card", "aria-label": "Work list" }, scroll("Work list", h("table", { class: "stack" }, head, rows)), more));

  function row(item) {
    const button = (action) => {
      const name = `${VERBS[action]} ${item.id}`;
      return h("button", { type: "button", "data-act": name, "aria-label": name, on: { click: async () => (await workAct(item.id, action)) && show() } }, VERBS[action]);
    };
    const sure = item.probability !== null ? h("small", null, ` ${percent(item.probability)}`) : null;
    return h("tr", { "data-kind": MARKS[item.state] ?? "other", "data-id": item.id },
      h("td", null, h("span", { class: "mark" }), link(item.id), " ", h("small", null, loops.get(item.id)?.description ?? "")),
      h("td", null, item.state, h("small", null, ` since ${when(item.since)}`), item.reopened ? h("small", null, `, ${item.reopened} ${item.reopened === 1 ? "repair" : "repairs"} did not help`) : null),
      h("td", null, item.cause ?? "–", sure), h("td", { class: "what" }, item.why, changed(item)), h("td", { class: "what" }, victims(item.victims)),
      h("td", { class: "number" }, costs(item)), h("td", null, [item.by, item.note].filter(Boolean).join(": ")),
      h("td", { class: "act" }, may("operator") ? (MAY[item.state] ?? []).map(button) : null));
  }

  const heading = ([name, note]) => h("tr", { class: "part" }, h("th", { scope: "colgroup", colspan: COLUMNS.length }, h("strong", null, name), note));

  // The rows of some items, with a heading where a part begins.
  function lines(from, to) {
    const begins = (item, at) => at === 0 || partOf(list.items[at - 1]) !== partOf(item);
    return list.items.slice(from, to).flatMap((item, i) => [...(begins(item, from + i) ? [heading(PARTS[partOf(item)])] : []), row(item)]);
  }

  // The rows that are there stay: only those to come are made.
  function extend() {
    rows.append(...lines(wanted, wanted + PAGE));
    wanted += PAGE;
    more.hidden = list.items.length <= wanted;
  }

  async function show() {
    try {
      const fresh = await get(`/work?all=${all}`);
      if (over) return;
      list = fresh;
      // What is the same is not drawn anew: somebody may be reading it, or press a button of it.
      const now = JSON.stringify(list.items.map((item) => [item, loops.get(item.id)?.description]));
      if (now !== drawn) redraw(rows, lines(0, wanted), "id");
      drawn = now;
      more.hidden = list.items.length <= wanted;
      const watched = list.watched ? `; ${list.watched} suspected, not for long enough yet` : "";
      const many = (part) => list.items.filter((item) => item.part === part).length, [first, perhaps, unknown] = ["first", "perhaps", "unknown"].map(many);
      const todo = [first && `${first} to do`, perhaps && `${perhaps} to do perhaps`].filter(Boolean).join(", ") || "There is nothing to do";
      summary.textContent = `${todo}${unknown ? `; ${unknown} not at rest for an unknown cause` : ""}${watched}.`;
    } catch (error) {
      if (!over) summary.textContent = `the work list cannot be fetched: ${error.message}`;
    }
  }

  const end = often(show, 15000);
  return () => {
    over = true;
    end();
  };
}
