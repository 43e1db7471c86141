// Whether what is measured is kept. A store that fails stands above every view, with why and what to do, until it works.

import { get } from "./api.js";
import { byId, h } from "./dom.js";
import { when } from "./format.js";

const EVERY_MS = 5000;

const lost = (records) => (records === 1 ? "1 record of an alarm or model is lost." : `${records} records of alarms and models are lost.`);

// What to do, as one paragraph each.
function advice(store) {
  if (!store.damaged) return ["What is new stays in memory, and the store is tried again until it works. Check that its disk is there and has room: what memory cannot hold is lost."];
  const repair = h("p", null, "Stop the daemon, look at ", h("code", null, "stictiond store check"), ", and run ", h("code", null, "stictiond store check --repair"), " with the store's folder: it makes a new store of what can be read, and keeps the damaged files.");
  return [store.lost_states > 0 ? lost(store.lost_states) : null, repair];
}

/** Looks again and again. */
export function watchStore() {
  const box = byId("store");
  let said = null;

  function draw(store) {
    const failing = store?.state === "failing" ? store : null;
    const words = JSON.stringify([failing?.damaged, failing?.lost_states, failing?.reason]);
    // A screen reader says it once, not each time it is asked for.
    if (words === said) return;
    said = words;
    const title = failing?.damaged ? "The store is damaged: nothing is written to it." : "The store fails: nothing is written to it.";
    const lines = failing ? [failing.since ? `Since ${when(failing.since)}: ${failing.reason}` : failing.reason, ...advice(failing)] : [];
    const parts = lines.filter(Boolean).map((line) => (typeof line === "string" ? h("p", null, line) : line));
    box.replaceChildren(...(failing ? [h("strong", null, title), ...parts] : []));
    box.hidden = !failing;
  }

  // While nobody answers, what was said last stands.
  const look = () => get("/healthz").then((health) => draw(health.store), () => {});
  look();
  setInterval(look, EVERY_MS);
}
