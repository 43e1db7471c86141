// The REST API. Errors are problem details and come out as their sentence.

const API = "/api/v1";

/** So long after the last touch of the page it asks by itself, and its session counts as idle (ms). */
const ALONE_MS = 60000;
let touched = Date.now();
for (const kind of ["pointerdown", "keydown", "wheel"]) addEventListener(kind, () => (touched = Date.now()), { passive: true, capture: true });

/** What failed is tried again after so long (ms). */
export const AGAIN_MS = 5000;
// What was not answered after so long never is (ms): a host that lost its power says nothing.
const PATIENCE_MS = 30000;

export function get(path, patience = PATIENCE_MS) {
  const headers = Date.now() - touched > ALONE_MS ? { "x-stictiond-background": "1" } : {};
  return answered(fetch(API + path, { headers, signal: AbortSignal.timeout(patience) }));
}

/** Does something now, and again so long after it has ended (ms): what waits for its answer is not done twice at a time. Returns what
 * ends it. */
export function often(act, milliseconds) {
  let timer = null, over = false;
  async function next() {
    try {
      await act();
    } finally {
      if (!over) timer = setTimeout(next, milliseconds);
    }
  }
  next();
  return () => {
    over = true;
    clearTimeout(timer);
  };
}

/** A list in one piece, or the pages of its first `most` entries, one after the other. */
export async function all(path, { most = Infinity, patience } = {}) {
  const list = await get(path, patience);
  while (list.next && list.items.length < most) {
    const page = await get(`${path}${path.includes("?") ? "&" : "?"}after=${encodeURIComponent(list.next)}`, patience);
    list.items.push(...page.items);
    list.next = page.next;
  }
  return list;
}

/** What a change carries beside the cookie. */
export const credentials = { csrf: null };

async function change(method, path, body) {
  const options = { method, headers: credentials.csrf ? { "x-csrf-token": credentials.csrf } : {} };
  if (body) Object.assign(options, { body: JSON.stringify(body), headers: { ...options.headers, "content-type": "application/json" } });
  return answered(fetch(API + path, options));
}

export const post = (path, body) => change("POST", path, body);
export const remove = (path) => change("DELETE", path);

/** An error has the status of the answer, and 0 where none came; `told` says whether the daemon itself answered: a proxy before it has a
 * page of its own. */
const failed = (text, status, told = false) => Object.assign(new Error(text), { status, told });
const unanswered = (error) => Promise.reject(failed(error.name === "TimeoutError" ? "no answer in time" : error.message, 0));

/** Whether what failed may go well the next time: no answer, too many requests, a server in trouble. */
export const mayPass = ({ status }) => status === 0 || status === 429 || status >= 500;

// Undefined for what is no JSON.
function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return undefined;
  }
}

async function answered(asked) {
  const answer = await asked.catch(unanswered), text = await answer.text().catch(unanswered), body = parsed(text);
  if (answer.ok && (body !== undefined || text === "")) return body ?? null;
  // A session that has ended meanwhile: the shell asks for another.
  if (answer.status === 401 && body?.type?.endsWith(":log_in")) dispatchEvent(new Event("signed-out"));
  throw failed(body?.detail ?? `the daemon does not answer: ${answer.status} ${answer.statusText}`, answer.ok ? 0 : answer.status, body !== undefined);
}

/** Null where there is nothing (404); every other error goes on. */
export const orNull = (promise) =>
  promise.catch((error) => {
    if (error.status === 404) return null;
    throw error;
  });

export const loopPath = (id) => `/loops/${encodeURIComponent(id)}`;
export const alarmPath = (id, action) => `/alarms/${encodeURIComponent(id)}/${action}`;
export const receiverPath = (name, what) => `/notifications/${encodeURIComponent(name)}/${what}`;
export const href = (path) => API + path;

/** Hears a stream's events by name; `broken` hears that it broke. It opens itself again, and holds no connection while the page is
 * out of sight: a browser has few of them for one address. Returns what ends it. */
export function stream(path, heard, broken = () => {}) {
  let source = null, waiting = null, latest = 0;
  function open() {
    clearTimeout(waiting);
    source?.close();
    if (document.hidden) return;
    const own = (source = new EventSource(API + path));
    for (const [name, act] of Object.entries(heard))
      own.addEventListener(name, (event) => {
        latest = performance.now();
        clearTimeout(waiting);
        act(JSON.parse(event.data));
      });
    own.addEventListener("error", () => {
      if (own !== source) return;
      broken();
      clearTimeout(waiting);
      // An answer that is no stream closes it for good.
      if (own.readyState === EventSource.CLOSED) later(AGAIN_MS);
    });
  }
  function later(milliseconds) {
    clearTimeout(waiting);
    waiting = setTimeout(open, milliseconds);
  }
  // A host that lost its power breaks no stream, so one that has said nothing since may be dead. Not all pages ask at once.
  const again = ({ detail: since }) => source?.readyState === EventSource.OPEN && latest < since && later(Math.random() * AGAIN_MS);
  document.addEventListener("visibilitychange", open);
  addEventListener("answered-again", again);
  open();
  return () => {
    clearTimeout(waiting);
    source?.close();
    source = null;
    document.removeEventListener("visibilitychange", open);
    removeEventListener("answered-again", again);
  };
}
