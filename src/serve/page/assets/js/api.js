// The REST API. Errors are problem details and come out as their sentence.

const API = "/api/v1";

export async function get(path, signal) {
  return answered(await fetch(API + path, { signal }));
}

export async function post(path, body) {
  const options = { method: "POST" };
  if (body) Object.assign(options, { body: JSON.stringify(body), headers: { "content-type": "application/json" } });
  return answered(await fetch(API + path, options));
}

async function answered(answer) {
  const body = await answer.json();
  if (answer.ok) return body;
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
export const events = (path) => new EventSource(API + path);
export const href = (path) => API + path;
