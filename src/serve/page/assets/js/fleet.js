// A fleet: who is there, how far behind, whose clock is off; a map of all loops by site and unit, and a list that the server
// pages and searches, so that it is as quick with 100,000 loops as with ten.

import { get } from "./api.js";
import { h, scroll } from "./dom.js";
import { friction, when } from "./format.js";
import { counts, legend, placeOf, plantMap } from "./map.js";
import { kindOf } from "./states.js";

const SKEW_S = 1; // A clock that is off by more is told: alarms and trends are stamped by it.
const ENDS_S = 30 * 86400; // A certificate that ends sooner is told.
const BEHIND_S = 60; // What waits for longer is told.
const EVERY_MS = 5000;
const PAGE = 50; // Loops that are listed at a time.
const UNITS = 10; // Units of the table; the others are on the map.
const TYPING_MS = 200;

const seconds = (s) => (s === null ? "–" : s < 120 ? `${s.toFixed(1)} s` : `${(s / 60).toFixed(0)} min`);
const doubt = (bad, text) => (bad ? h("span", { class: "pill bad" }, text) : text);
const cells = (...values) => values.map((value) => h("td", null, value));
const table = (heads, body) => h("table", null, h("thead", null, h("tr", null, ...heads.map((name) => h("th", { scope: "col" }, name)))), body);

function machine(own) {
  const state = own.silent ? doubt(true, `silent since ${when(own.heard)}`) : "here";
  const lag = doubt(own.lag_s > BEHIND_S, seconds(own.lag_s));
  const off = Math.round(100 * own.clock_offset_s) / 100 || 0; // No -0.00.
  const clock = doubt(Math.abs(off) > SKEW_S, own.clock_offset_s === null ? "–" : `${off > 0 ? "+" : ""}${off.toFixed(2)} s`);
  const soon = own.certificate_until && Date.parse(own.certificate_until) - Date.now() < ENDS_S * 1000;
  const certificate = own.certificate_until ? h("span", { title: own.certificate }, doubt(soon, when(own.certificate_until))) : "–";
  return h("tr", { "data-machine": own.name }, ...cells(own.site ?? "–", own.name, own.role, own.version, state, own.role === "worker" ? "–" : own.loops, lag, clock, own.diagnosed, when(own.since), certificate));
}

export function fleetView(main, _parts, query) {
  let over = false, typing = null, asked = 0;
  // Null asks for nothing; the unit of loops without one is "".
  const wanted = { q: query.get("q") || null, group: query.get("group") };
  const filters = () => Object.entries(wanted).filter(([, v]) => v !== null);
  const summary = h("p", { class: "summary", role: "status" }, "loading …"), machines = h("tbody"), units = h("tbody"), found = h("tbody");
  const choose = (group) => {
    set("group", group);
    list.scrollIntoView({ block: "nearest" });
  };
  const map = plantMap(choose), further = h("p", { class: "summary" });
  const search = h("input", { type: "search", name: "q", maxlength: "100", placeholder: "loop or description" });
  const only = h("button", { type: "button", hidden: true, on: { click: () => set("group", null) } });
  const shown = h("p", { class: "summary", role: "status" }), more = h("button", { type: "button", hidden: true }, "More");
  const list = h("section", { class: "card wide", "aria-label": "Loops" }, h("h2", null, "Loops"), h("form", { class: "tools", role: "search", on: { submit: (event) => event.preventDefault() } }, h("label", null, "Find", search), only), shown,
    scroll("Loops that were found", table(["Loop", "Description", "Unit", "State", "Friction", "Diagnosed"], found)), more);
  main.append(h("div", { class: "head" }, h("h1", null, "Fleet")), summary,
    h("section", { class: "card wide", "aria-label": "Map" }, h("h2", null, "Sites and units"), map.element, legend(), scroll("Units", table(["Site", "Unit", "Loops", "Alarms", "Acknowledged", "Sticks, no alarm yet", "Cannot be told", "No sticking shown"], units)), further),
    list, h("section", { class: "card wide", "aria-label": "Machines" }, h("h2", null, "Machines"), scroll("Machines", table(["Site", "Machine", "Role", "Version", "State", "Loops", "Behind", "Clock", "Diagnoses", "Runs since", "Certificate until"], machines))));
  search.value = wanted.q ?? "";

  function set(name, value) {
    wanted[name] = value;
    const kept = filters();
    history.replaceState(null, "", kept.length ? `#/fleet?${new URLSearchParams(kept)}` : "#/fleet");
    find(null);
  }

  async function find(after) {
    const mine = ++asked;
    only.hidden = wanted.group === null;
    only.textContent = `only ${wanted.group || "no unit"} ✕`;
    const asking = new URLSearchParams({ limit: String(PAGE), ...Object.fromEntries(filters()) });
    if (after) asking.set("after", after);
    try {
      const page = await get(`/loops?${asking}`);
      if (over || mine !== asked) return;
      const rows = page.items.map((item) => h("tr", { "data-id": item.id }, ...cells(h("a", { href: `#/loop/${encodeURIComponent(item.id)}` }, item.id), item.description || "–", item.group || "–", kindOf(item).label, item.verdict && item.f !== null ? friction(item) : "–", item.time ? when(item.time) : "–")));
      if (after) found.append(...rows);
      else found.replaceChildren(...rows);
      shown.textContent = page.total ? `${found.children.length} of ${page.total} loops, worst first` : "No loop is like this.";
      more.hidden = !page.next;
      more.onclick = () => find(page.next);
    } catch (error) {
      if (!over && mine === asked) shown.textContent = `the loops cannot be fetched: ${error.message}`;
    }
  }

  function unit(own) {
    const [site, name] = placeOf(own.group), of = counts(own.loops), n = (key) => of[key] || "–";
    const open = (event) => {
      event.preventDefault();
      choose(own.group);
    };
    const link = h("a", { href: `#/fleet?${new URLSearchParams({ group: own.group })}`, on: { click: open } }, name || "all");
    return h("tr", { "data-unit": own.group }, ...cells(site, link, own.loops.length, n("unacknowledged"), n("acknowledged"), n("sticking"), n("unknown"), n("sound")));
  }

  async function show() {
    try {
      const [fleet, plant] = await Promise.all([get("/fleet"), get("/map")]);
      if (over) return;
      const silent = fleet.machines.filter((own) => own.silent).length;
      const sites = new Set(fleet.machines.map((own) => own.site).filter(Boolean)).size;
      const told = fleet.tells ? "It is this machine's turn to tell people of alarms, where it has receivers." : "It is not this machine's turn to tell people of alarms.";
      const here = `${sites} ${sites === 1 ? "site" : "sites"}, ${fleet.machines.length} machines${silent ? `, ${silent} silent` : ""}.`;
      summary.textContent = fleet.role === "alone" ? "This machine is alone: it is no part of a fleet." : `${fleet.name} is ${fleet.role === "edge" ? "an edge" : `a ${fleet.role}`}${fleet.connected ? "" : " and reaches no NATS server"}. ${told} ${fleet.role === "centre" ? here : ""}`;
      machines.replaceChildren(...fleet.machines.map(machine));
      map.show(plant);
      const look = (own) => 1e6 * (counts(own.loops).unacknowledged ?? 0) + 1e3 * (counts(own.loops).acknowledged ?? 0) + (counts(own.loops).sticking ?? 0);
      const worst = [...plant.groups].sort((a, b) => look(b) - look(a) || (a.group < b.group ? -1 : 1));
      units.replaceChildren(...worst.slice(0, UNITS).map(unit));
      further.textContent = worst.length > UNITS ? `${worst.length - UNITS} further units are on the map: press one.` : "";
    } catch (error) {
      if (!over) summary.textContent = `the fleet cannot be fetched: ${error.message}`;
    }
  }

  search.addEventListener("input", () => {
    clearTimeout(typing);
    typing = setTimeout(() => set("q", search.value.trim() || null), TYPING_MS);
  });
  show();
  find(null);
  const timer = setInterval(show, EVERY_MS);
  return () => {
    over = true;
    clearInterval(timer);
    clearTimeout(typing);
    map.end();
  };
}
