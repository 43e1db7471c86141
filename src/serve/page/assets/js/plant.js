// The plant: every loop a tile, worst first; counts, search, filters.

import { href } from "./api.js";
import { Board } from "./board.js";
import { byId, h } from "./dom.js";
import { listen, loops, state } from "./live.js";
import { KINDS, kindOf } from "./states.js";
import { forget } from "./tiles.js";

const byName = (a, b) => (a.id < b.id ? -1 : a.id > b.id ? 1 : 0);
const byF = (a, b) => (b.f ?? -1) - (a.f ?? -1) || byName(a, b);
const SORTS = {
  severity: ["Severity", (a, b) => kindOf(a).rank - kindOf(b).rank || byF(a, b)],
  f: ["Friction f", byF],
  id: ["Name", byName],
  time: ["Latest diagnosis", (a, b) => (b.time ?? "").localeCompare(a.time ?? "") || byName(a, b)],
};
const ARRANGEMENTS = { none: "No groups", group: "By unit" };
// Kinds that need no count while there are none of them.
const RARE = ["other", "latched", "returned", "shelved", "silent", "waiting"];

export function plantView(main, _parts, query) {
  const known = (name, among, otherwise) => (query.get(name) in among ? query.get(name) : otherwise);
  const wanted = { q: query.get("q") ?? "", group: query.get("group") ?? "", kind: query.get("kind") ?? "", sort: known("sort", SORTS, "severity"), by: known("by", ARRANGEMENTS, "none"), doubt: query.get("doubt") === "yes" ? "yes" : "" };
  const option = (value, text) => h("option", { value }, text);
  const select = (name, label, options) => h("label", null, label, h("select", { name }, options));
  const buttons = new Map(KINDS.map((kind) => [kind.key, h("button", { type: "button", "data-kind": kind.key, "aria-pressed": "false", on: { click: () => set("kind", wanted.kind === kind.key ? "" : kind.key) } },
    h("span", { class: "mark" }), h("b"), h("span", null, kind.label))]));
  const counts = h("div", { class: "counts", role: "group", "aria-label": "Loops by state; press one to show only these" }, ...buttons.values());
  const form = h("form", { class: "tools", role: "search" },
    h("label", null, "Find", h("input", { id: "q", name: "q", type: "search", maxlength: "100", placeholder: "loop, description or unit  ( / )" })),
    select("group", "Unit", [option("", "all")]),
    select("doubt", "Opinions", [option("", "all"), option("yes", "contradict the verdict")]),
    select("sort", "Sort by", Object.entries(SORTS).map(([value, [text]]) => option(value, text))),
    select("by", "Arrange", Object.entries(ARRANGEMENTS).map(([value, text]) => option(value, text))),
    h("a", { class: "button", href: href("/report.html"), target: "_blank", rel: "noopener" }, "Report"));
  const summary = h("p", { class: "summary", role: "status" }), board = new Board();
  main.append(h("h1", { class: "hidden" }, "Plant"), counts, form, summary, board.element);
  for (const [name, value] of Object.entries(wanted)) if (form.elements[name]) form.elements[name].value = value;

  function set(name, value) {
    wanted[name] = value;
    const kept = Object.entries(wanted).filter(([key, v]) => v && !(key === "sort" && v === "severity") && !(key === "by" && v === "none"));
    history.replaceState(null, "", kept.length ? `#/?${new URLSearchParams(kept)}` : "#/");
    show();
  }

  function units(items) {
    const names = [...new Set(items.map((item) => item.group).filter(Boolean))].sort(), box = form.elements.group;
    if (box.options.length === names.length + 1 && names.every((name, i) => box.options[i + 1].value === name)) return;
    box.replaceChildren(option("", "all"), ...names.map((name) => option(name, name)));
    box.value = wanted.group;
    if (box.value !== wanted.group && state.complete) wanted.group = box.value = "";
  }

  function show() {
    const items = [...loops.values()], needle = wanted.q.trim().toLowerCase();
    forget(loops);
    units(items);
    const number = new Map(KINDS.map((kind) => [kind.key, 0]));
    for (const item of items) number.set(kindOf(item).key, number.get(kindOf(item).key) + 1);
    for (const [key, button] of buttons) {
      const count = number.get(key);
      button.children[1].textContent = String(count);
      button.hidden = count === 0 && RARE.includes(key) && wanted.kind !== key;
      button.classList.toggle("none", count === 0);
      button.setAttribute("aria-pressed", String(wanted.kind === key));
    }
    const found = (item) => !needle || [item.id, item.description, item.group].some((text) => text.toLowerCase().includes(needle));
    const passing = items.filter((item) => found(item) && (!wanted.group || item.group === wanted.group) && (!wanted.kind || kindOf(item).key === wanted.kind) && (!wanted.doubt || item.doubtful));
    passing.sort(SORTS[wanted.sort][1]);
    const shown = passing.length === items.length ? `${items.length} loops` : `${passing.length} of ${items.length} loops`;
    const none = state.complete ? (items.length ? "No loop is like this." : "No loops are configured.") : "loading …";
    const held = state.complete && state.total > items.length;
    summary.replaceChildren(passing.length ? shown : none, held ? `, the worst of ${state.total}: ` : "", held ? h("a", { href: "#/fleet" }, "all are on the page of the fleet") : "");
    board.show(arranged(passing));
  }

  function arranged(items) {
    if (wanted.by === "none") return [{ title: "", note: "", items }];
    const by = new Map();
    for (const item of items) (by.get(item.group) ?? by.set(item.group, []).get(item.group)).push(item);
    const worst = (some) => Math.min(...some.map((item) => kindOf(item).rank));
    const order = (a, b) => (wanted.sort === "severity" ? worst(a[1]) - worst(b[1]) : 0) || (a[0] < b[0] ? -1 : 1);
    const look = (some) => some.filter((item) => kindOf(item).look >= 2).length;
    return [...by].sort(order).map(([name, some]) => ({ title: name || "no unit", note: look(some) ? `${look(some)} to look at of ${some.length}` : `${some.length} loops`, items: some }));
  }

  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("input", (event) => set(event.target.name, event.target.value));
  byId("q").addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      event.target.value = "";
      set("q", "");
    }
    if ((event.key === "Enter" || event.key === "ArrowDown") && board.home) {
      event.preventDefault();
      board.focus(board.sections.find((section) => section.items.length).items[0].id);
    }
  });
  show();
  const end = listen((name) => name === "loops" && show());
  return () => {
    end();
    board.end();
  };
}
