// The plant: every loop a tile, worst first; counts, search, filters.

import { AGAIN_MS, get, href } from "./api.js";
import { Board } from "./board.js";
import { byId, h } from "./dom.js";
import { listen, loops, state } from "./live.js";
import { filtersOf, KINDS, kindOf } from "./states.js";
import { forget } from "./tiles.js";

const UNKNOWN = 101; // Behind every score.
const byName = (a, b) => (a.id < b.id ? -1 : a.id > b.id ? 1 : 0);
const byF = (a, b) => (b.f ?? -1) - (a.f ?? -1) || byName(a, b);
const SORTS = {
  severity: ["Severity", (a, b) => kindOf(a).rank - kindOf(b).rank || byF(a, b)],
  f: ["Friction f", byF],
  score: ["Score", (a, b) => (a.score ?? UNKNOWN) - (b.score ?? UNKNOWN) || byName(a, b)],
  cost: ["Cost", (a, b) => (b.cost ?? -1) - (a.cost ?? -1) || byName(a, b)],
  id: ["Name", byName],
  time: ["Latest diagnosis", (a, b) => (b.time ?? "").localeCompare(a.time ?? "") || byName(a, b)],
};
const ARRANGEMENTS = { none: "No groups", group: "By unit" };
// Kinds that need no count while there are none of them.
const RARE = ["other", "latched", "returned", "shelved", "silent", "waiting"];
const AGE_MS = 60_000; // How often tiles are looked at for what has grown old.
const MOST = 1000; // Loops of one kind that the daemon is asked for: the worst of them.
const TYPING_MS = 200;

// How many loops there are of each kind.
function counted(items) {
  const of = {};
  for (const item of items) of[kindOf(item).key] = (of[kindOf(item).key] ?? 0) + 1;
  return of;
}

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

  let over = false, asked = 0, waiting = null, whole = null;

  const question = () => JSON.stringify([wanted.q.trim(), wanted.group, wanted.kind]);

  // Where there are more loops than are held here the daemon counts them, and finds what is looked for.
  function soon(milliseconds) {
    if (state.part) waiting ??= setTimeout(ask, milliseconds);
  }

  async function ask() {
    waiting = null;
    const mine = ++asked, named = question(), narrow = Object.entries({ q: wanted.q.trim(), group: wanted.group }).filter(([, value]) => value);
    const each = narrow.length || wanted.kind ? filtersOf(wanted.kind) : [];
    try {
      const [{ sitesOf }, { groups }, ...pages] = await Promise.all([import("./map.js"), get("/map"), ...each.map((filter) => get(`/loops?${new URLSearchParams([["limit", String(MOST)], ...narrow, ...Object.entries(filter)])}`))]);
      if (over || mine !== asked) return;
      const of = {};
      for (const site of sitesOf(groups)) for (const [key, n] of Object.entries(site.of)) of[key] = (of[key] ?? 0) + n;
      const sum = (count) => pages.reduce((all, page) => all + count(page), 0);
      whole = { of, units: groups.map(({ group }) => group), question: named, found: each.length ? { items: pages.flatMap((page) => page.items), total: sum((page) => page.total) } : null };
      show();
    } catch {
      if (!over && mine === asked) soon(AGAIN_MS);
    }
  }

  function set(name, value) {
    wanted[name] = value;
    const kept = Object.entries(wanted).filter(([key, v]) => v && !(key === "sort" && v === "severity") && !(key === "by" && v === "none"));
    history.replaceState(null, "", kept.length ? `#/?${new URLSearchParams(kept)}` : "#/");
    show();
    clearTimeout(waiting);
    waiting = null;
    soon(TYPING_MS);
  }

  function units(all, settled) {
    const names = [...new Set(all.filter(Boolean))].sort(), box = form.elements.group;
    if (box.options.length === names.length + 1 && names.every((name, i) => box.options[i + 1].value === name)) return;
    box.replaceChildren(option("", "all"), ...names.map((name) => option(name, name)));
    box.value = wanted.group;
    if (box.value !== wanted.group && settled) wanted.group = box.value = "";
  }

  function show() {
    const held = [...loops.values()], { part } = state, known = part ? whole : null;
    // What is held, until the daemon has found what is looked for.
    const found = known?.question === question() ? known.found : null;
    const { items, total } = found ? { ...found, items: found.items.map((item) => loops.get(item.id) ?? item) } : { items: held, total: part ? state.total : held.length };
    const shown = new Set(items.map((item) => item.id));
    forget({ has: (id) => loops.has(id) || shown.has(id) });
    units(known ? known.units : held.map((item) => item.group), state.complete && (!part || known));
    const of = part ? known?.of : counted(held);
    for (const [key, button] of buttons) {
      const count = of?.[key] ?? 0;
      button.children[1].textContent = of ? String(count) : "…";
      button.hidden = count === 0 && RARE.includes(key) && wanted.kind !== key;
      button.classList.toggle("none", count === 0);
      button.setAttribute("aria-pressed", String(wanted.kind === key));
    }
    const needle = wanted.q.trim().toLowerCase(), holds = (item) => !needle || [item.id, item.description, item.group].some((text) => text.toLowerCase().includes(needle));
    const passing = items.filter((item) => (found || holds(item)) && (!wanted.group || item.group === wanted.group) && (!wanted.kind || kindOf(item).key === wanted.kind) && (!wanted.doubt || item.doubtful));
    passing.sort(SORTS[wanted.sort][1]);
    const all = part ? state.total : held.length, rest = total > items.length ? ` among the worst ${items.length} of ${total}` : "";
    const some = passing.length === all ? `${all} loops` : `${passing.length} of ${all} loops${rest && ","}${rest}`;
    const none = !state.complete ? "loading …" : all ? `No loop is like this${rest || "."}` : "No loops are configured.";
    summary.replaceChildren(passing.length ? some : none, ...(rest ? [": ", h("a", { href: "#/fleet" }, "all are on the page of the fleet")] : []));
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
  soon(0);
  const end = listen((name) => {
    if (name !== "loops") return;
    show();
    soon(whole ? AGAIN_MS : 0);
  });
  const timer = setInterval(show, AGE_MS);
  return () => {
    over = true;
    clearInterval(timer);
    clearTimeout(waiting);
    end();
    board.end();
  };
}
