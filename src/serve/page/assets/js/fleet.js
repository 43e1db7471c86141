// The machines of a fleet: who is there, how far behind, whose clock is off.

import { get } from "./api.js";
import { h } from "./dom.js";
import { when } from "./format.js";

const SKEW_S = 1; // A clock that is off by more is told: alarms and trends are stamped by it.
const BEHIND_S = 60; // What waits for longer is told.

const seconds = (s) => (s === null ? "–" : s < 120 ? `${s.toFixed(1)} s` : `${(s / 60).toFixed(0)} min`);
const doubt = (bad, text) => (bad ? h("span", { class: "pill bad" }, text) : text);

function row(own) {
  const state = own.silent ? doubt(true, `silent since ${when(own.heard)}`) : "here";
  const lag = doubt(own.lag_s > BEHIND_S, seconds(own.lag_s));
  const clock = doubt(Math.abs(own.clock_offset_s) > SKEW_S, own.clock_offset_s === null ? "–" : `${own.clock_offset_s > 0 ? "+" : ""}${own.clock_offset_s.toFixed(2)} s`);
  return h("tr", { "data-machine": own.name }, ...[own.site ?? "–", own.name, own.role, own.version, state, own.role === "worker" ? "–" : own.loops, lag, clock, own.diagnosed, when(own.since)].map((cell) => h("td", null, cell)));
}

export function fleetView(main) {
  let over = false;
  const summary = h("p", { class: "summary", role: "status" }, "loading …"), body = h("tbody");
  const head = ["Site", "Machine", "Role", "Version", "State", "Loops", "Behind", "Clock", "Diagnoses", "Runs since"];
  const table = h("table", null, h("thead", null, h("tr", null, ...head.map((name) => h("th", { scope: "col" }, name)))), body);
  main.append(h("div", { class: "head" }, h("h1", null, "Fleet")), summary, h("section", { class: "card wide", tabindex: 0, role: "region", "aria-label": "Machines" }, table));

  async function show() {
    try {
      const fleet = await get("/fleet");
      if (over) return;
      const silent = fleet.machines.filter((own) => own.silent).length;
      const sites = new Set(fleet.machines.map((own) => own.site).filter(Boolean)).size;
      const told = fleet.tells ? "This machine tells people of alarms." : "Another machine tells people of alarms.";
      const here = `${sites} ${sites === 1 ? "site" : "sites"}, ${fleet.machines.length} machines${silent ? `, ${silent} silent` : ""}.`;
      summary.textContent = fleet.role === "alone" ? "This machine is alone: it is no part of a fleet." : `${fleet.name} is ${fleet.role === "edge" ? "an edge" : `a ${fleet.role}`}${fleet.connected ? "" : " and reaches no NATS server"}. ${told} ${fleet.role === "centre" ? here : ""}`;
      body.replaceChildren(...fleet.machines.map(row));
    } catch (error) {
      if (!over) summary.textContent = `the fleet cannot be fetched: ${error.message}`;
    }
  }

  show();
  const timer = setInterval(show, 5000);
  return () => {
    over = true;
    clearInterval(timer);
  };
}
