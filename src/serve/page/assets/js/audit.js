// The audit log: who changed what, from where, and with what result. Read-only, newest first.

import { AGAIN_MS, get, mayPass } from "./api.js";
import { h, scroll } from "./dom.js";
import { when } from "./format.js";
import { words } from "./states.js";

const PAGE = 100;

export function auditView(main) {
  let over = false, next = null, retry = null;
  const rows = h("tbody"), summary = h("p", { class: "summary", role: "status" }, "loading …");
  const older = h("button", { type: "button", hidden: true, on: { click: () => show() } }, "Older");
  const columns = ["Time", "What", "Who", "From", "Asked", "Result", "No."];
  const table = h("table", null, h("thead", null, h("tr", null, columns.map((text) => h("th", { scope: "col", class: text === "No." ? "number" : null }, text)))), rows);
  main.append(h("h1", null, "Audit"), summary, h("section", { class: "card", "aria-label": "Audit log" }, scroll("Audit log", table), older));

  // What has no column of its own is said in the words of the log.
  const OWN = new Set(["who", "by", "from", "asked", "result"]);
  function row(item) {
    const { who, from, asked, result } = item.fields;
    const rest = Object.entries(item.fields).filter(([key, value]) => !OWN.has(key) && value !== "").map(([key, value]) => `${key}: ${value}`);
    return h("tr", { "data-event": item.event }, h("td", { class: "time" }, when(item.time)), h("td", null, words(item.event)), h("td", null, who || "–"), h("td", null, from ?? "–"),
      h("td", null, [asked, ...rest].filter(Boolean).join(" · ")), h("td", null, result ?? ""), h("td", { class: "number", title: `#${item.hash}` }, String(item.n)));
  }

  async function show() {
    clearTimeout(retry);
    older.disabled = true;
    try {
      const page = await get(`/audit?limit=${PAGE}${next === null ? "" : `&before=${next}`}`);
      if (over) return;
      rows.append(...page.items.map(row));
      next = page.next;
      older.hidden = next === null;
      summary.textContent = rows.children.length ? `${rows.children.length} entries, newest first` : "Nothing was changed yet.";
    } catch (error) {
      if (over) return;
      summary.textContent = `the audit log cannot be fetched: ${error.message}`;
      if (mayPass(error)) retry = setTimeout(show, AGAIN_MS);
    } finally {
      older.disabled = false;
    }
  }

  show();
  return () => {
    over = true;
    clearTimeout(retry);
  };
}
