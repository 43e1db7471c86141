// The REST API. Errors are problem details and come out as their sentence.

const API = "/api/v1";

/** So long after the last touch of the page it asks by itself, and its session counts as idle (ms). */
const ALONE_MS = 60000;
let touched = Date.now();
for (const kind of ["pointerdown", "keydown", "wheel"]) addEventListener(kind, () => (touched = Date.now()), { passive: true, capture: true });

export async function get(path, signal) {
  const headers = Date.now() - touched > ALONE_MS ? { "x-stictiond-background": "1" } : {};
  return answered(await reached(fetch(API + path, { signal, headers })));
}

/** A list in one piece: its pages, one after the other. */
export async function all(path) {
  const list = await get(path);
  for (let next = list.next; next; ) {
    const page = await get(`${path}?after=${encodeURIComponent(next)}`);
    list.items.push(...page.items);
    next = page.next;
  }
  return list;
}

/** What a change carries beside the cookie. */
export const credentials = { csrf: null };

async function change(method, path, body) {
  const options = { method, headers: credentials.csrf ? { "x-csrf-token": credentials.csrf } : {} };
  if (body) Object.assign(options, { body: JSON.stringify(body), headers: { ...options.headers, "content-type": "application/json" } });
  return answered(await reached(fetch(API + path, options)));
}

export const post = (path, body) => change("POST", path, body);
export const remove = (path) => change("DELETE", path);

/** An error without an answer has the status 0. */
const reached = (promise) => promise.catch((error) => Promise.reject(Object.assign(error, { status: 0 })));

async function answered(answer) {
  if (answer.status === 204) return null;
  const body = await answer.json();
  if (answer.ok) return body;
  // A session that has ended meanwhile: the shell asks for another.
  if (answer.status === 401 && body.type?.endsWith(":log_in")) dispatchEvent(new Event("signed-out"));
  const error = new Error(body.detail ?? answer.statusText);
  error.status = answer.status;
  throw error;
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
export const events = (path) => new EventSource(API + path);
export const href = (path) => API + path;
