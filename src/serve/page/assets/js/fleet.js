// A fleet: who is there, how far behind, whose clock is off; a map of all loops by site and unit, and a list that the server
// pages and searches, so that it is as quick with 100,000 loops as with ten.

import { all, get, often } from "./api.js";
import { h, redraw, scroll } from "./dom.js";
import { ago, costs, friction, short, when } from "./format.js";
import { isOld, since } from "./live.js";
import { legend, many, named, placeOf, plantMap, sitesOf } from "./map.js";
import { kindOf } from "./states.js";

const SKEW_S = 1; // A clock that is off by more is told: alarms and trends are stamped by it.
const ENDS_S = 30 * 86400; // A certificate that ends sooner is told.
const BEHIND_S = 60; // What waits for longer is told.
const EVERY_MS = 5000;
const PAGE = 50; // Loops that are listed at a time.
const MOST = 1000; // Loops that the server hands out at a time.
const FEW = 10; // Sites or units of the table before all are asked for.
const TYPING_MS = 200;

const PLACES = ["Site", "Unit", "Loops", "Alarms", "Acknowledged", "Sticks, no alarm yet", "Cannot be told", "No sticking shown", "Other"];
// Columns with a class: see app.css.
const ROOMY = "number roomy";
const LOOPS = ["Loop", "Description", "Unit", "State", "Friction", ["Score", ROOMY], ["Cost", ROOMY], "Diagnosed"];
const MACHINES = ["Site", "Machine", "Role", "Version", "State", "Loops", "Behind", "Clock", "Diagnoses", "Runs since", "Certificate until"];
// The kinds that have a column of their own.
const COUNTED = ["unacknowledged", "acknowledged", "sticking", "unknown", "sound"];

const seconds = (s) => (s === null ? "–" : s < 120 ? `${s.toFixed(1)} s` : `${(s / 60).toFixed(0)} min`);
const doubt = (bad, text) => (bad ? h("span", { class: "pill bad" }, text) : text);
const cells = (...values) => values.map((value) => h("td", null, value));
const table = (heads, body) => h("table", null, h("thead", null, h("tr", null, ...heads.map((head) => [head].flat()).map(([name, shape]) => h("th", { scope: "col", class: shape ?? null }, name)))), body);
const address = (wanted) => (wanted.length ? `#/fleet?${new URLSearchParams(wanted)}` : "#/fleet");

// What is urgent comes first, then what is first by name.
const urgent = ({ unacknowledged = 0, acknowledged = 0, sticking = 0 }) => 1e12 * unacknowledged + 1e6 * acknowledged + sticking;
const placeName = (own) => own.group ?? own.site;
const worst = (a, b) => urgent(b.of) - urgent(a.of) || (placeName(a) < placeName(b) ? -1 : 1);

function machine(own, now) {
  const state = own.silent ? doubt(true, `silent since ${when(own.heard)}`) : "here";
  const lag = doubt(own.lag_s > BEHIND_S, seconds(own.lag_s));
  const off = Math.round(100 * own.clock_offset_s) / 100 || 0; // No -0.00.
  const clock = doubt(Math.abs(off) > SKEW_S, own.clock_offset_s === null ? "–" : `${off > 0 ? "+" : ""}${off.toFixed(2)} s`);
  const soon = own.certificate_until && Date.parse(own.certificate_until) - now < ENDS_S * 1000;
  const certificate = own.certificate_until ? h("span", { title: own.certificate }, doubt(soon, when(own.certificate_until))) : "–";
  return h("tr", { "data-machine": own.name }, ...cells(own.site ?? "–", own.name, own.role, own.version, state, own.role === "worker" ? "–" : own.loops, lag, clock, own.diagnosed, when(own.since), certificate));
}

// What a fleet is, in a sentence.
function said(fleet) {
  if (fleet.role === "alone") return "This machine is alone: it is no part of a fleet.";
  const silent = fleet.machines.filter((own) => own.silent).length;
  const sites = new Set(fleet.machines.map((own) => own.site).filter(Boolean)).size;
  const is = `${fleet.name} is ${fleet.role === "edge" ? "an edge" : `a ${fleet.role}`}${fleet.connected ? "" : " and reaches no NATS server"}.`;
  const tells = fleet.tells ? "It is this machine's turn to tell people of alarms, where it has receivers." : "It is not this machine's turn to tell people of alarms.";
  const here = fleet.role === "centre" ? `${many(sites, "site")}, ${many(fleet.machines.length, "machine")}${silent ? `, ${silent} silent` : ""}.` : "";
  return `${is} ${tells} ${here}`;
}

function listed(item) {
  const link = h("a", { href: `#/loop/${encodeURIComponent(item.id)}` }, item.id);
  const diagnosed = isOld(item) ? doubt(true, `${when(item.time)}, ${ago(since(item.time))}`) : when(item.time);
  return h("tr", { "data-id": item.id }, ...cells(link, item.description || "–", item.group || "–", kindOf(item).label, item.verdict && item.f !== null ? friction(item) : "–"),
    h("td", { class: ROOMY }, short(item.score, 3)), h("td", { class: ROOMY }, costs(item)), h("td", null, diagnosed));
}

export function fleetView(main, _parts, query) {
  let over = false, typing = null, asked = 0, busy = false, count = PAGE, listing = null, answeredFor = null, sites = [], drawn = null, most = FEW;
  // Null asks for nothing; the name of a site or a unit may be empty. A unit's group says of which site it is.
  const group = query.get("group");
  const wanted = { q: query.get("q") || null, site: group === null ? query.get("site") : placeOf(group).site, group };
  // What the server is asked for, and what the page's address keeps.
  const filters = () => Object.entries({ q: wanted.q, site: wanted.group === null ? wanted.site : null, group: wanted.group }).filter(([, value]) => value !== null);
  const button = (text, act) => h("button", { type: "button", hidden: true, on: { click: act } }, text);

  const summary = h("p", { class: "summary", role: "status" }, "loading …"), machines = h("tbody"), places = h("tbody"), found = h("tbody");
  const map = plantMap((site, group) => choose(site, isWhole() ? null : group));
  const heading = h("h2", null, "Sites and units"), back = button("All sites", () => choose(null, null)), box = scroll("Sites and units", table(PLACES, places));
  const every = button("", () => {
    most = Infinity;
    arrange();
    box.focus({ preventScroll: true });
  });
  const search = h("input", { type: "search", name: "q", maxlength: "100", placeholder: "loop, description or unit" });
  const only = button("", out), shown = h("p", { class: "summary", role: "status" }), more = button("More", () => {
    count += PAGE;
    find();
  });
  const list = h("section", { class: "card wide", "aria-label": "Loops" }, h("h2", null, "Loops"), h("form", { class: "tools", role: "search", on: { submit: (event) => event.preventDefault() } }, h("label", null, "Find", search), only), shown, scroll("Loops that were found", table(LOOPS, found)), more);
  main.append(h("div", { class: "head" }, h("h1", null, "Fleet")), summary,
    h("section", { class: "card wide", "aria-label": "Map" }, h("header", null, heading, back), map.element, legend(), box, every),
    list, h("section", { class: "card wide", "aria-label": "Machines" }, h("h2", null, "Machines"), scroll("Machines", table(MACHINES, machines))));
  search.value = wanted.q ?? "";

  // Whether the map shows sites to go into.
  const isWhole = () => wanted.site === null && sites.length > 1;

  // Goes to a site, to a group of it, or with null to all of them. The browser's way back leads here again.
  function choose(site, group) {
    const moves = site !== wanted.site;
    Object.assign(wanted, { site, group });
    const to = address(filters());
    if (to !== location.hash) history.pushState(null, "", to);
    if (moves) {
      most = FEW;
      arrange();
      // What had the focus may be gone.
      box.focus({ preventScroll: true });
    }
    // Also where a fleet has one site: its units are pressed at once.
    if (group !== null) list.scrollIntoView({ block: "nearest" });
    ask();
  }

  // One step out: from a unit to its site, from there to all.
  function out() {
    const units = sites.find((own) => own.site === wanted.site)?.units.length ?? 0;
    choose(wanted.group !== null && units > 1 ? wanted.site : null, null);
  }

  function row(own) {
    const [site, group] = [own.site, own.group ?? null];
    const open = (event) => {
      // To another tab the browser goes by itself.
      if (event.ctrlKey || event.metaKey || event.shiftKey) return;
      event.preventDefault();
      choose(site, group);
    };
    const link = (text) => h("a", { href: address(group === null ? [["site", site]] : [["group", group]]), on: { click: open } }, text);
    const place = group === null ? [link(named(site)), many(own.units.length, "unit")] : [named(site), link(named(own.unit))];
    const known = COUNTED.map((key) => own.of[key] ?? 0), other = own.size - known.reduce((sum, n) => sum + n, 0);
    return h("tr", { "data-place": placeName(own) }, ...cells(...place, own.size, ...[...known, other].map((n) => n || "–")));
  }

  // The map and the table: all sites, or the units of one.
  function arrange() {
    const chosen = wanted.site === null ? sites : sites.filter((own) => own.site === wanted.site);
    const rows = (isWhole() ? [...chosen] : chosen.flatMap((own) => own.units)).sort(worst);
    heading.textContent = wanted.site === null ? "Sites and units" : `Units of ${named(wanted.site)}`;
    back.hidden = wanted.site === null;
    map.show(chosen);
    redraw(places, rows.slice(0, most).map(row), "place");
    every.hidden = rows.length <= most;
    every.textContent = `All ${many(rows.length, isWhole() ? "site" : "unit")}`;
  }

  // Another question begins with its worst loops.
  function ask() {
    count = PAGE;
    find();
  }

  /** Fetches the first `count` loops that are asked for; rows are drawn anew only where others come. */
  async function find() {
    const mine = ++asked, wants = filters(), question = JSON.stringify(wants), asking = new URLSearchParams([["limit", String(Math.min(count, MOST))], ...wants]);
    busy = true;
    only.hidden = wanted.site === null;
    only.textContent = `only ${named(wanted.group ?? wanted.site)} ✕`;
    try {
      const { items, total, next } = await all(`/loops?${asking}`, { most: count });
      if (over || mine !== asked) return;
      // Far down the server hands out more at a time.
      count = Math.max(count, items.length);
      const now = JSON.stringify(items.map((item) => [{ ...item, age_s: null }, isOld(item) && ago(since(item.time))]));
      if (now !== listing) redraw(found, items.map(listed), "id");
      [listing, answeredFor] = [now, question];
      const none = wants.length ? "No loop is like this." : "There are no loops yet.";
      shown.textContent = total ? `${items.length} of ${many(total, "loop")}, worst first` : none;
      more.hidden = !next;
    } catch (error) {
      if (over || mine !== asked) return;
      shown.textContent = `the loops cannot be fetched: ${error.message}`;
      // What was found by this question stays.
      if (question === answeredFor) return;
      found.replaceChildren();
      listing = null;
      more.hidden = true;
    } finally {
      if (mine === asked) busy = false;
    }
  }

  async function show() {
    if (!busy) find();
    try {
      const [fleet, plant] = await Promise.all([get("/fleet"), get("/map")]);
      if (over) return;
      summary.textContent = said(fleet);
      machines.replaceChildren(...fleet.machines.map((own) => machine(own, Date.parse(fleet.time))));
      // What is the same is not drawn anew.
      const now = JSON.stringify(plant.groups);
      if (now === drawn) return;
      drawn = now;
      sites = sitesOf(plant.groups);
      arrange();
    } catch (error) {
      if (!over) summary.textContent = `the fleet cannot be fetched: ${error.message}`;
    }
  }

  search.addEventListener("input", () => {
    clearTimeout(typing);
    typing = setTimeout(() => {
      wanted.q = search.value.trim() || null;
      history.replaceState(null, "", address(filters()));
      ask();
    }, TYPING_MS);
  });
  const end = often(show, EVERY_MS);
  return () => {
    over = true;
    end();
    clearTimeout(typing);
    map.end();
  };
}
