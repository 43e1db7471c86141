// Alarms: what stands now, what can be done about it, and what was before. States are shown as the API names them.

import { acknowledge, shelve, unshelve } from "./actions.js";
import { get } from "./api.js";
import { h, scroll } from "./dom.js";
import { short, when } from "./format.js";
import { listen, loops } from "./live.js";
import { may } from "./session.js";
import { isShelved, kindOf, mayAck, mayShelve, words } from "./states.js";

const TABS = { standing: "Standing", history: "History" };

export function alarmsView(main, _parts, query) {
  let over = false, pending = null;
  const tab = query.get("show") in TABS ? query.get("show") : "standing";
  const table = (columns, body) => scroll(TABS[tab], h("table", null, h("thead", null, h("tr", null, columns.map((text) => h("th", { scope: "col", class: text === "f" ? "number" : null }, text)))), body));
  const rows = h("tbody"), past = h("tbody"), summary = h("p", { class: "summary", role: "status" }, "loading …");
  const tabs = h("nav", { "aria-label": "Alarms" }, Object.entries(TABS).map(([key, text]) => h("a", { href: key === "standing" ? "#/alarms" : `#/alarms?show=${key}`, "aria-current": key === tab ? "page" : null }, text)));
  const columns = { standing: ["Alarm", "State", "Since", "f", "By, remark", "Shelved until", ""], history: ["Time", "Alarm", "From", "To", "Cause", "By, remark"] };
  main.append(h("h1", null, "Alarms"), tabs, summary, h("section", { class: "card", "aria-label": TABS[tab] }, table(columns[tab], tab === "standing" ? rows : past)));

  // An alarm has its loop's name, unless it says which loop it is of.
  const loopOf = (item) => item.loop ?? item.id;
  const link = (item) => h("a", { href: `#/loop/${encodeURIComponent(loopOf(item))}` }, item.id);
  const said = (item) => [item.by, item.comment].filter(Boolean).join(": ");

  function standing(item) {
    const loop = loops.get(loopOf(item)), kind = kindOf({ ...loop, alarm: item.state });
    const button = (text, act) => may("operator") && h("button", { type: "button", "data-act": `${text} ${item.id}`, "aria-label": `${text} ${item.id}`, on: { click: async () => (await act(item.id)) && show() } }, text);
    return h("tr", { "data-kind": kind.key, "data-id": item.id }, h("td", null, h("span", { class: "mark" }), link(item), " ", h("small", null, loop?.description ?? "")), h("td", null, words(item.state)), h("td", { class: "time" }, when(item.since)),
      h("td", { class: "number" }, loop?.f ? `${short(loop.f, 3)} ${loop.f_unit}` : "–"), h("td", null, said(item)), h("td", { class: "time" }, item.shelved_until ? when(item.shelved_until) : ""),
      h("td", { class: "act" }, mayAck(item.state) && button("Acknowledge", acknowledge), isShelved(item.state) ? button("Unshelve", unshelve) : mayShelve(item.state) && button("Shelve", shelve)));
  }

  const change = (item) => h("tr", null, h("td", { class: "time" }, when(item.time)), h("td", null, link(item)), h("td", null, words(item.from)), h("td", null, words(item.to)), h("td", null, words(item.cause)), h("td", null, said(item)));

  async function show() {
    pending = null;
    try {
      if (tab === "history") {
        const { items } = await get("/alarms/history?limit=500");
        if (over) return;
        past.replaceChildren(...items.map(change));
        summary.textContent = items.length ? `${items.length} changes, newest first` : "No alarm has changed since the start.";
        return;
      }
      const { items } = await get("/alarms");
      if (over) return;
      const rank = (item) => kindOf({ ...loops.get(loopOf(item)), alarm: item.state }).rank;
      items.sort((a, b) => rank(a) - rank(b) || (b.since ?? "").localeCompare(a.since ?? ""));
      const focused = document.activeElement?.dataset?.act;
      rows.replaceChildren(...items.map(standing));
      if (focused) (rows.querySelector(`[data-act="${CSS.escape(focused)}"]`) ?? rows.querySelector("button"))?.focus();
      const open = items.filter((item) => mayAck(item.state)).length;
      summary.textContent = items.length ? `${items.length} alarms, ${open} to acknowledge` : "No alarms.";
    } catch (error) {
      if (!over) summary.textContent = `the alarms cannot be fetched: ${error.message}`;
    }
  }

  const end = listen((name) => ["alarm", "loops"].includes(name) && (pending ??= setTimeout(show, 300)));
  show();
  return () => {
    over = true;
    clearTimeout(pending);
    end();
  };
}
