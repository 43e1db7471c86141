// Alarms: what stands now, what can be done about it, what was before, and who is told. States are shown as the API names them.

import { acknowledge, giveBack, reset, shelve, takeOut, unshelve } from "./actions.js";
import { AGAIN_MS, all, get, mayPass } from "./api.js";
import { h, scroll } from "./dom.js";
import { short, when } from "./format.js";
import { listen, loops } from "./live.js";
import { receivers } from "./receivers.js";
import { may } from "./session.js";
import { alarmWords, isOut, isShelved, kindOf, mayAck, mayReset, mayShelve, words } from "./states.js";

const TABS = { standing: "Standing", history: "History", receivers: "Receivers" };
const COLUMNS = { standing: ["Alarm", "Kind", "Priority", "State", "Since", "f", "What", "By, remark", ""], history: ["Time", "Alarm", "Kind", "Priority", "From", "To", "Cause", "What", "By, remark"] };
const PRIORITIES = ["high", "medium", "low"];
const PAGE = 200;

export function alarmsView(main, _parts, query) {
  let over = false, pending = null, wanted = PAGE, drawn = null, shown = new Set();
  const tab = query.get("show") in TABS ? query.get("show") : "standing";
  const tabs = h("nav", { "aria-label": "Alarms" }, Object.entries(TABS).map(([key, text]) => h("a", { href: key === "standing" ? "#/alarms" : `#/alarms?show=${key}`, "aria-current": key === tab ? "page" : null }, text)));
  const told = (items) => {
    const failing = items.filter((item) => item.state === "failing").length;
    tabs.lastChild.textContent = failing ? `${TABS.receivers}: ${failing} failing` : TABS.receivers;
    tabs.lastChild.classList.toggle("bad", failing > 0);
  };
  main.append(h("h1", null, "Alarms"), tabs);
  if (tab === "receivers") return receivers(main, told);
  // Without it the tab has its plain name.
  get("/notifications").then(({ items }) => told(items), () => {});

  const rows = h("tbody"), grouped = h("tbody"), past = h("tbody"), summary = h("p", { class: "summary", role: "status" }, "loading …");
  const table = (label, body) => scroll(label, h("table", { class: tab === "standing" ? "stack" : null }, h("thead", null, h("tr", null, COLUMNS[tab].map((text) => h("th", { scope: "col", class: text === "f" ? "number" : null }, text)))), body));
  const head = h("summary"), flood = h("details", { class: "flood", hidden: true }, head, tab === "standing" ? table("Grouped", grouped) : null);
  const more = h("button", { type: "button", hidden: true, on: { click: () => ((wanted += PAGE), show()) } }, "Older changes");
  main.append(summary, h("section", { class: "card", "aria-label": TABS[tab] }, flood, table(TABS[tab], tab === "standing" ? rows : past), more));

  // An alarm has its loop's name, unless it says which loop it is of.
  const loopOf = (item) => (item.kind ? item.loop : item.loop ?? item.id);
  const nameOf = (item) => loopOf(item) ?? item.device ?? item.id.split("/")[0];
  const link = (item) => (loopOf(item) ? h("a", { href: `#/loop/${encodeURIComponent(loopOf(item))}` }, nameOf(item)) : h("span", null, nameOf(item)));
  const said = (item) => [item.by, item.comment].filter(Boolean).join(": ");
  const kindWords = (item) => alarmWords(item.kind ?? "stiction");
  const ofStiction = (item) => (item.kind ?? "stiction") === "stiction";

  function standing(item) {
    const loop = loops.get(loopOf(item)), kind = kindOf({ alarm: item.state });
    // Names of buttons say which alarm they are for; that of a loop's stiction is the loop's own.
    const name = ofStiction(item) ? nameOf(item) : `${nameOf(item)} ${kindWords(item)}`;
    const button = (text, act, role = "operator") => may(role) && h("button", { type: "button", "data-act": `${text} ${name}`, "aria-label": `${text} ${name}`, on: { click: async () => (await act(item.id, name, loopOf(item))) && show() } }, text);
    const flags = ["chattering", "stale", "one_shot"].filter((flag) => item[flag]).map((flag) => words(flag === "one_shot" ? "once" : flag));
    const acts = isOut(item.state) ? [button("Back in service", giveBack, "engineer")] : [mayAck(item.state) && button("Acknowledge", acknowledge), mayReset(item.state) && button("Reset", reset), isShelved(item.state) ? button("Unshelve", unshelve) : mayShelve(item.state) && button("Shelve", shelve), button("Out of service", takeOut, "engineer")];
    return h("tr", { "data-kind": kind.key, "data-id": loopOf(item) ?? item.id, "data-alarm": item.id }, h("td", null, h("span", { class: "mark" }), link(item), " ", h("small", null, loop?.description ?? "")), h("td", null, kindWords(item)), h("td", { class: `priority ${item.priority ?? ""}` }, item.priority ?? "–"),
      h("td", null, words(item.state), flags.length ? h("small", null, ` ${flags.join(", ")}`) : null, item.shelved_until ? h("small", null, ` until ${when(item.shelved_until)}`) : null), h("td", { class: "time" }, when(item.since)), h("td", { class: "number" }, ofStiction(item) && loop?.f ? `${short(loop.f, 3)} ${loop.f_unit}` : "–"), h("td", { class: "what" }, item.detail ?? ""), h("td", null, said(item)), h("td", { class: "act" }, acts));
  }

  const change = (item) => h("tr", null, h("td", { class: "time" }, when(item.time)), h("td", null, link(item)), h("td", null, kindWords(item)), h("td", { class: `priority ${item.priority ?? ""}` }, item.priority ?? "–"), h("td", null, words(item.from)), h("td", null, words(item.to)), h("td", null, words(item.cause)), h("td", { class: "what" }, item.detail ?? ""), h("td", null, said(item)));

  async function history() {
    const items = [];
    let next = null;
    do {
      const page = await get(`/alarms/history?limit=${Math.min(PAGE, wanted - items.length)}${next === null ? "" : `&after=${next}`}`);
      items.push(...page.items);
      next = page.next ?? null;
    } while (next !== null && items.length < wanted);
    if (over) return;
    past.replaceChildren(...items.map(change));
    more.hidden = next === null;
    summary.textContent = items.length ? `${items.length} changes, newest first` : "No alarm has changed yet.";
  }

  function groups(list) {
    const apart = list.items.filter((item) => item.grouped && mayAck(item.state));
    const kinds = new Map();
    for (const item of apart) kinds.set(kindWords(item), (kinds.get(kindWords(item)) ?? 0) + 1);
    flood.hidden = apart.length === 0;
    head.textContent = `${list.flood?.since ? "A flood of alarms: " : "Raised in a flood: "}${apart.length} grouped (${[...kinds].map(([kind, count]) => `${kind}: ${count}`).join(", ")})`;
    grouped.replaceChildren(...apart.map(standing));
    return new Set(apart);
  }

  // What is the same is not drawn anew: somebody may be reading it, or press a button of it. What has the focus keeps it.
  function draw(list) {
    const of = ({ description, f, f_unit: unit } = {}) => [description, f, unit];
    const now = JSON.stringify([list.flood?.since, list.items.map((item) => [item, of(loops.get(loopOf(item)))])]);
    if (now === drawn) return;
    drawn = now;
    const focused = main.contains(document.activeElement) ? document.activeElement : null, act = focused?.dataset.act, row = focused?.closest("tr")?.dataset.alarm;
    const apart = groups(list);
    rows.replaceChildren(...list.items.filter((item) => !apart.has(item)).map(standing));
    if (act) (main.querySelector(`[data-act="${CSS.escape(act)}"]`) ?? rows.querySelector("button"))?.focus();
    else if (row !== undefined) main.querySelector(`tr[data-alarm="${CSS.escape(row)}"] a`)?.focus({ preventScroll: true });
  }

  async function show() {
    pending = null;
    try {
      if (tab === "history") return await history();
      const list = await all("/alarms");
      if (over) return;
      const rank = (item) => kindOf({ alarm: item.state }).rank * 10 + (PRIORITIES.indexOf(item.priority) + 10) % 10;
      list.items.sort((a, b) => rank(a) - rank(b) || (b.since ?? "").localeCompare(a.since ?? ""));
      shown = new Set(list.items.map(loopOf));
      draw(list);
      const open = list.items.filter((item) => mayAck(item.state)).length;
      summary.textContent = list.items.length ? `${list.items.length} ${list.items.length === 1 ? "alarm" : "alarms"}, ${open} to acknowledge` : "No alarms.";
    } catch (error) {
      if (over) return;
      summary.textContent = `the alarms cannot be fetched: ${error.message}`;
      if (mayPass(error)) soon(AGAIN_MS);
    }
  }

  function soon(milliseconds) {
    pending ??= setTimeout(show, milliseconds);
  }
  // Of a loop its description and its f are shown: where very many loops are diagnosed most of them are of no alarm. All of them where
  // nobody knows what was missed.
  const concerns = (name, data) => name === "alarm" || (name === "loops" && (data === null || [...data].some((id) => shown.has(id))));
  const end = listen((name, data) => concerns(name, data) && soon(300));
  show();
  return () => {
    over = true;
    clearTimeout(pending);
    end();
  };
}
