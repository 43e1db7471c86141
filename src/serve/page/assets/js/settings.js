// The daemon: what it is, how it is, where its data comes from, and what it was told. Read-only.

import { all, get, often } from "./api.js";
import { h, scroll } from "./dom.js";
import { ago, bytes, lasting, short, when } from "./format.js";
import { isUp, upWords, words } from "./states.js";

export function settingsView(main) {
  let over = false;
  const card = (title, size, ...children) => h("section", { class: `card ${size}`, "aria-label": title }, h("header", null, h("h2", null, title)), ...children);
  const facts = h("dl", { class: "facts" }), runs = h("dl", { class: "facts" }), devices = scroll("Collectors"), told = h("div", { class: "told" }), wrong = h("p", { role: "status" });
  main.append(h("h1", null, "Settings"), wrong, h("div", { class: "cards" }, card("The daemon", "half", facts), card("Diagnoses", "half", runs), card("Collectors", "", devices),
    card("Configuration", "", h("p", { class: "note" }, "As it is in force; it is changed in the file. Secrets are not shown."), told)));
  const pairs = (list) => list.map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, String(value))));

  function drawDevices(items) {
    const names = [...new Set(items.flatMap((item) => Object.keys(item.counters)))];
    const head = h("tr", null, ["Device", "Connection", "Last good sample"].map((text) => h("th", { scope: "col" }, text)), names.map((name) => h("th", { scope: "col", class: "number" }, words(name))));
    const row = (item) => h("tr", null, h("td", null, item.name), h("td", null, h("span", { class: isUp(item) ? "pill good" : "pill bad" }, upWords(item))), h("td", { class: "time", title: when(item.last_good) }, ago(item.age_s)), names.map((name) => h("td", { class: "number" }, String(item.counters[name] ?? "–"))));
    devices.replaceChildren(h("table", null, h("thead", null, head), h("tbody", null, items.map(row))));
  }

  async function show() {
    try {
      const [system, list] = await Promise.all([get("/system"), all("/collectors")]);
      if (over) return;
      const s = system.scheduler;
      facts.replaceChildren(...pairs([["version", system.build], ["write-back", system.writeback_built_in ? "built in" : "not built in: this binary only reads"], ["running since", when(system.started)], ["memory", bytes(system.memory_bytes)], ["of it, samples", bytes(system.history_bytes)], ["loops", system.loops], ["tags", system.tags], ["places for listeners left", system.event_places_left]]));
      runs.replaceChildren(...pairs([["waiting", s.queued], ["under way", s.running], ["done", s.diagnosed], ["skipped", s.skipped], ["too late", s.deadline_exceeded], ["failed inside", s.panicked], ["time spent", lasting(s.busy_s)], ["on average", s.diagnosed ? `${short(s.busy_s / s.diagnosed, 3)} s` : "–"]]));
      drawDevices(list.items);
      const sections = Map.groupBy ? Map.groupBy(system.settings, (one) => one.section) : new Map([["", system.settings]]);
      told.replaceChildren(...[...sections].map(([name, some]) => h("div", { class: "card" }, h("h3", null, name), h("dl", { class: "facts" }, pairs(some.map((one) => [one.key, one.value]))))));
      wrong.textContent = "";
    } catch (error) {
      if (!over) wrong.textContent = `cannot be fetched: ${error.message}`;
    }
  }

  const end = often(show, 3000);
  return () => {
    over = true;
    end();
  };
}
