// Whether what is measured is kept, and what is changed is put on record. What fails stands above every view, with why and what to do, until it works.

import { get, often } from "./api.js";
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

// What is said of a store that fails.
function ofStore(store) {
  const title = store.damaged ? "The store is damaged: nothing is written to it." : "The store fails: nothing is written to it.";
  return [title, store.since ? `Since ${when(store.since)}: ${store.reason}` : store.reason, ...advice(store)];
}

// What is said of an audit log that takes no entries.
function ofAudit(audit) {
  if (!audit.damaged) return ["Changes are refused: they cannot be put on record.", audit.reason, "Monitoring goes on."];
  const renew = h("p", null, "Monitoring goes on. Find out who changed the log. Then stop the daemon and run ", h("code", null, "stictiond audit renew"), " with the log's file: it keeps the damaged log beside the new one, which says so.");
  return ["The audit log is damaged: changes are refused.", audit.reason, renew];
}

// A box that stands above every view while its part fails.
function banner(id, say) {
  const box = byId(id);
  let said = null;
  return (part) => {
    const failing = part?.state === "failing" ? part : null;
    const words = JSON.stringify([failing?.damaged, failing?.lost_states, failing?.reason]);
    // A screen reader says it once, not each time it is asked for.
    if (words === said) return;
    said = words;
    const [title, ...lines] = failing ? say(failing) : [];
    const parts = lines.filter(Boolean).map((line) => (typeof line === "string" ? h("p", null, line) : line));
    box.replaceChildren(...(failing ? [h("strong", null, title), ...parts] : []));
    box.hidden = !failing;
  };
}

/** Looks again and again. */
export function watchStore() {
  const store = banner("store", ofStore), record = banner("record", ofAudit);
  // While nobody answers, what was said last stands.
  const look = () => get("/healthz").then((health) => { store(health.store); record(health.audit); }, () => {});
  often(look, EVERY_MS);
}
