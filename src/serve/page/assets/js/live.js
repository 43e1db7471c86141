// The loops as the daemon knows them, kept fresh by server-sent events. Many events ask for one refresh.

import { events, get, loopPath, orNull } from "./api.js";

/** By name. */
export const loops = new Map();
export const state = { time: null, timeAt: 0, link: "connecting", complete: false, total: 0 };
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

function noted(list) {
  state.time = list.time ? Date.parse(list.time) : null;
  state.timeAt = performance.now();
}

/** How long ago a time is (s), by the plant's clock; null while nobody has told what that says. */
export const since = (time) => (time && state.time !== null ? Math.max(0, (state.time + performance.now() - state.timeAt - Date.parse(time)) / 1000) : null);

// Few changes are fetched one by one, many as pages; the first page is small, so that the worst loops show at once.
// Of very many only the worst are held: the page of the fleet lists all of them.
const FEW = 12, FIRST = 300, PAGE = 1000, MOST = 5000;
// From this severity on a loop is to be looked at.
const LOOK = 2;

async function refresh() {
  pending = null;
  if (working) return soon();
  working = true;
  const whole = all || changed.size > FEW;
  let names = [...changed];
  all = false;
  changed.clear();
  try {
    if (whole) await pages();
    else {
      const items = await Promise.allSettled(names.map((id) => orNull(get(loopPath(id)))));
      const came = (id, i) => items[i].status === "fulfilled";
      names.forEach((id, i) => came(id, i) && keep(id, items[i].value));
      tell("loops", new Set(names.filter(came)));
      // What did not come is asked for again.
      names = names.filter((id, i) => !came(id, i));
      if (names.length) throw items.find((item) => item.status === "rejected").reason;
    }
  } catch (error) {
    all ||= whole;
    names.forEach((id) => changed.add(id));
    tell("failed", error);
    soon(5000);
  } finally {
    working = false;
  }
}

// What gets to be one of the worst is held from then on; the next whole list lets go of what no longer is.
function keep(id, item) {
  if (!item) loops.delete(id);
  else if (loops.has(id) || item.severity >= LOOK) loops.set(id, item);
}

async function pages() {
  const seen = new Set();
  let after = null;
  do {
    const query = new URLSearchParams({ limit: String(after || state.complete ? PAGE : FIRST) });
    if (after) query.set("after", after);
    const list = await get(`/loops?${query}`);
    noted(list);
    for (const item of list.items) {
      loops.set(item.id, item);
      seen.add(item.id);
    }
    after = seen.size < MOST ? list.next : null;
    state.total = list.total;
    if (!state.complete) tell("loops", null);
  } while (after);
  for (const id of loops.keys()) if (!seen.has(id)) loops.delete(id);
  state.complete = true;
  tell("loops", null);
}

function link(text) {
  state.link = text;
  tell("link", text);
}

let stream = null;

// A page out of sight holds no connection: a browser has few of them for one address.
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) begin();
  else stream?.close();
});

/** Opens the stream; it opens itself again when it breaks. */
export function begin() {
  stream?.close();
  const own = (stream = events("/events"));
  const heard = (name, act) => own.addEventListener(name, (event) => act(JSON.parse(event.data)));
  heard("hello", (data) => {
    link("live");
    // What was missed follows, where the daemon still knows it.
    all ||= !data.resumed;
    soon(0);
  });
  for (const name of ["diagnosis", "alarm", "writeback"]) {
    heard(name, (data) => {
      // A collector's alarm is of no loop.
      if (data.loop) changed.add(data.loop);
      tell(name, data);
      soon();
    });
  }
  for (const name of ["reloaded", "lagged", "reset"]) {
    heard(name, () => {
      all = true;
      soon();
    });
  }
  own.addEventListener("error", () => {
    link("lost");
    if (own.readyState === EventSource.CLOSED) setTimeout(() => own === stream && !document.hidden && begin(), 5000);
  });
}

/** An action of this page on a loop: what it changed is fetched at once. */
export function touch(id) {
  changed.add(id);
  clearTimeout(pending);
  pending = null;
  soon(0);
}
