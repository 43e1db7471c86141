// The loops as the daemon knows them, kept fresh by server-sent events. Many events ask for one refresh.

import { AGAIN_MS, get, loopPath, orNull, stream } from "./api.js";

/** By name. */
export const loops = new Map();
/** `part` says whether there are more loops than are held. */
export const state = { time: null, timeAt: 0, link: "connecting", complete: false, part: false, total: 0 };
const listeners = new Set();
const changed = new Set();
let all = true, pending = null, working = false;

/** Hears of: `loops` (a set of names, or null for all), `alarm`, `diagnosis`, `writeback` (the data), `link`. Returns what ends it. */
export function listen(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

const tell = (name, data) => listeners.forEach((listener) => listener(name, data));

function soon(milliseconds = 400) {
  pending ??= setTimeout(refresh, milliseconds);
}

/** Takes what the plant's clock says. */
export function noted(time) {
  state.time = time ? Date.parse(time) : null;
  state.timeAt = performance.now();
}

/** What the plant's clock says now (s); null while nobody has told. */
export const plantTime = () => (state.time === null ? null : (state.time + performance.now() - state.timeAt) / 1000);

/** How long ago a time is (s), by the plant's clock; null while nobody has told what that says. */
export function since(time) {
  const now = plantTime();
  return time && now !== null ? Math.max(0, now - Date.parse(time) / 1000) : null;
}

// A diagnosis that is older than so many periods is overdue.
const OVERDUE = 3;

/** Whether a loop should long have been diagnosed again: what is said of it is of before. */
export const isOld = ({ time, period_s: period }) => period > 0 && since(time) > OVERDUE * period;

// Few changes are fetched one by one, many as pages; the first page is small, so that the worst loops show at once.
// Of very many only the worst are held: the page of the fleet lists all of them.
const FEW = 12, FIRST = 300, PAGE = 1000, MOST = 5000;
// From this severity on a loop is to be looked at.
const LOOK = 2;

async function refresh() {
  pending = null;
  if (working) return soon();
  working = true;
  const every = all, whole = every || changed.size > FEW;
  let names = [...changed];
  all = false;
  changed.clear();
  try {
    if (whole) {
      await pages();
      tell("loops", every ? null : new Set(names));
    } else {
      const items = await Promise.allSettled(names.map((id) => orNull(get(loopPath(id)))));
      const came = (id, i) => items[i].status === "fulfilled";
      names.forEach((id, i) => came(id, i) && keep(id, items[i].value));
      tell("loops", new Set(names.filter(came)));
      // What did not come is asked for again.
      names = names.filter((id, i) => !came(id, i));
      if (names.length) throw items.find((item) => item.status === "rejected").reason;
    }
  } catch (error) {
    all ||= every;
    names.forEach((id) => changed.add(id));
    tell("failed", error);
    soon(AGAIN_MS);
  } finally {
    working = false;
  }
}

// What gets to be one of the worst is held from then on, and what a page of the list may have missed while there is room; the next
// whole list lets go of what no longer is.
function keep(id, item) {
  if (!item) loops.delete(id);
  else if (loops.has(id) || loops.size < MOST || item.severity >= LOOK) loops.set(id, item);
}

async function pages() {
  const seen = new Set();
  let after = null, next = null;
  do {
    const query = new URLSearchParams({ limit: String(after || state.complete ? PAGE : FIRST) });
    if (after) query.set("after", after);
    const list = await get(`/loops?${query}`);
    noted(list.time);
    for (const item of list.items) {
      loops.set(item.id, item);
      seen.add(item.id);
    }
    next = list.next;
    after = seen.size < MOST ? next : null;
    state.total = list.total;
    if (!state.complete) tell("loops", null);
  } while (after);
  for (const id of loops.keys()) if (!seen.has(id)) loops.delete(id);
  Object.assign(state, { complete: true, part: next !== null });
}

function link(text) {
  state.link = text;
  tell("link", text);
}

// When the stream was last heard, and when the latest question was asked that nobody answered since (ms).
let heard = 0, unanswered = null;

/** Hears whether the daemon answered what the shell asked at a time (ms). Once it does again, `answered-again` tells since when it may not
 * have. */
export function answered(does, asked) {
  if (!does) {
    unanswered = asked;
    // What the stream has said since is news.
    if (heard < asked) link("lost");
  } else if (unanswered !== null) {
    dispatchEvent(new CustomEvent("answered-again", { detail: unanswered }));
    unanswered = null;
  }
}

/** Opens the stream. */
export function begin() {
  const change = (name) => (data) => {
    // A collector's alarm is of no loop.
    if (data.loop) changed.add(data.loop);
    tell(name, data);
    soon();
  };
  const anew = () => {
    all = true;
    soon();
  };
  const hello = (data) => {
    // What was missed follows, where the daemon still knows it.
    all ||= !data.resumed;
    soon(0);
  };
  const acts = { hello, diagnosis: change("diagnosis"), alarm: change("alarm"), writeback: change("writeback"), reloaded: anew, lagged: anew, reset: anew };
  const hear = (act) => (data) => {
    heard = performance.now();
    if (state.link !== "live") link("live");
    act(data);
  };
  stream("/events", Object.fromEntries(Object.entries(acts).map(([name, act]) => [name, hear(act)])), () => link("lost"));
}

/** An action of this page on a loop: what it changed is fetched at once. */
export function touch(id) {
  changed.add(id);
  clearTimeout(pending);
  pending = null;
  soon(0);
}
