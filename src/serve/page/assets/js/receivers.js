// Those who are told of alarms: how each of them is, and what never reached them. Dead letters are for who may send them again.

import { get, often, orNull, post, receiverPath } from "./api.js";
import { h, scroll, toast } from "./dom.js";
import { when } from "./format.js";
import { may } from "./session.js";

const COLUMNS = ["Receiver", "Kind", "State", "Last taken", "Waiting", "Taken", "Attempts failed", "Changes dropped", "Dead letters", ""];
const LETTERS = ["Made", "Dead since", "Attempts", "Why", "Message", ""];
const NUMBERS = new Set(["Waiting", "Taken", "Attempts failed", "Changes dropped", "Dead letters", "Attempts"]);
const MOST_SHOWN = 100;

const head = (columns) => h("thead", null, h("tr", null, columns.map((text) => h("th", { scope: "col", class: NUMBERS.has(text) ? "number" : null }, text))));
const number = (value) => h("td", { class: "number" }, String(value));
const count = (letters) => (letters === 1 ? "1 dead letter" : `${letters} dead letters`);
// A message is JSON or plain text.
function readable(body) {
  try {
    return JSON.stringify(JSON.parse(body), null, 2);
  } catch {
    return body;
  }
}

/** Draws them below what is there; `told` hears of each list. Returns what ends it. */
export function receivers(main, told) {
  let over = false, open = null, drawn = null;
  const rows = h("tbody"), summary = h("p", { class: "summary", role: "status" }, "loading …"), list = scroll("Receivers", h("table", null, head(COLUMNS), rows));
  const dead = h("section", { class: "card", "aria-label": "Dead letters", hidden: true });
  main.append(summary, h("section", { class: "card", "aria-label": "Receivers" }, list), dead);

  // What has the focus keeps it, or hands it to what is nearest.
  function redraw(draw, nearest) {
    const act = main.contains(document.activeElement) && document.activeElement.dataset.act;
    draw();
    if (act) (main.querySelector(`[data-act="${CSS.escape(act)}"]`) ?? nearest()).focus();
  }

  function state(item) {
    if (item.state !== "working") return [h("span", { class: "pill bad" }, item.state), h("small", null, ` since ${when(item.since)}: ${item.reason}`)];
    return h("span", { class: "pill good" }, item.sent + item.failed ? item.state : "nothing sent yet");
  }

  function row(item) {
    const look = () => {
      open = open === item.name ? null : item.name;
      drawn = null;
      show();
    };
    const name = `Dead letters of ${item.name}`;
    const button = h("button", { type: "button", "data-act": name, "aria-label": name, "aria-expanded": String(open === item.name), on: { click: look } }, open === item.name ? "Close" : "Look");
    return h("tr", { "data-name": item.name, "data-state": item.state }, h("td", null, item.name), h("td", null, item.kind), h("td", { class: "what" }, state(item)), h("td", { class: "time" }, when(item.last_sent)),
      [item.queue, item.sent, item.failed, item.dropped, item.dead_letters].map(number), h("td", { class: "act" }, item.dead_letters > 0 && may("engineer") && button));
  }

  async function again(receiver, id) {
    try {
      const { replayed } = await post(receiverPath(receiver, "replay"), id ? { id } : {});
      toast(`${replayed === 1 ? "1 message waits" : `${replayed} messages wait`} to be sent to ${receiver} again`);
    } catch (error) {
      toast(error.message, true);
    }
    show();
  }

  function letter(receiver, item) {
    const name = `Send ${item.id} again`;
    return h("tr", { "data-letter": item.id }, h("td", { class: "time" }, when(item.made)), h("td", { class: "time" }, when(item.dead_since)), number(item.attempts), h("td", { class: "what" }, item.reason),
      h("td", null, h("details", null, h("summary", null, item.id), h("pre", null, readable(item.body)))), h("td", { class: "act" }, h("button", { type: "button", "data-act": name, "aria-label": name, on: { click: () => again(receiver, item.id) } }, "Send again")));
  }

  async function letters() {
    const receiver = open;
    // A receiver may be gone after a reload.
    const items = (receiver && (await orNull(get(receiverPath(receiver, "dead-letters"))))?.items) || [];
    if (over || receiver !== open) return;
    // Drawn anew only when others are there: somebody may be reading one.
    const names = items.map((item) => item.id).join();
    if (items.length === 0) open = null;
    if (drawn === names) return;
    drawn = names;
    const all = h("button", { type: "button", "data-act": "Send all again", on: { click: () => again(receiver) } }, items.length === 1 ? "Send it again" : `Send all ${items.length} again`);
    const rest = items.length - MOST_SHOWN;
    const table = h("table", null, head(LETTERS), h("tbody", null, items.slice(0, MOST_SHOWN).map((item) => letter(receiver, item))));
    const more = rest > 0 ? h("p", { class: "note" }, `${rest} younger ones are not shown.`) : "";
    const card = [h("header", null, h("h2", null, `${count(items.length)} of ${receiver}`), all), scroll("Dead letters", table), more];
    redraw(() => {
      dead.replaceChildren(...(items.length ? card : []));
      dead.hidden = items.length === 0;
    }, () => (items.length ? all : list));
  }

  async function show() {
    try {
      const { items } = await get("/notifications");
      if (over) return;
      told(items);
      const failing = items.filter((item) => item.state === "failing").length, lost = items.reduce((sum, item) => sum + item.dead_letters, 0);
      summary.textContent = items.length ? `${items.length} ${items.length === 1 ? "receiver" : "receivers"}, ${failing} failing, ${count(lost)}` : "This machine tells nobody of alarms: its configuration has no [notify].";
      await letters();
      if (!over) redraw(() => rows.replaceChildren(...items.map(row)), () => list);
    } catch (error) {
      if (!over) summary.textContent = `who is told cannot be fetched: ${error.message}`;
    }
  }

  const end = often(show, 3000);
  return () => {
    over = true;
    end();
  };
}
