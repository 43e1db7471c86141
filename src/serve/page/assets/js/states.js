// What a loop looks like: its class, its shape, its words. A state that is not known here is shown by its name.

export const VERDICTS = { stiction: "sticks", no_stiction: "no sticking", not_identifiable: "cannot be told" };

// Why nothing can be told of a valve, short enough for a tile. The plant's report has the same words, and a test compares them.
const REASONS = {
  too_short: "too little data", no_time_base: "no time base", gaps: "data missing", silent: "the source is silent", read_apart: "OP and PV read apart", compressed: "compressed by the archive", ts_too_short: "ts_s too short", flat_op: "OP stands still", flat_pv: "PV stands still",
  saturated: "OP at a limit", manual: "not in automatic", mode_unknown: "mode not readable", not_excited: "OP hardly reverses", hidden_friction: "sticking not excluded", undecided: "may stick, undecided", undersampled: "sampled too slowly",
  no_response: "PV hidden by loads", stem_not_followed: "sticks, or load jumps", compensated: "write-back hides it", out_of_scale: "values out of scale", deadline_exceeded: "took too long",
};

// What an alarm is about, as mails and reports call it; a test compares them with the reports.
const ALARMS = {
  stiction: "the valve sticks", f_rising: "friction rises", not_identifiable: "cannot be told", tag_bad: "a tag is bad", collector_down: "the collector is down",
  compensation_tripped: "write-back was closed by a fault", unexplained_residual: "much is unexplained",
};

/** The kinds of tile, worst first. `shape` is drawn by the style sheet: no kind is told by colour alone. */
export const KINDS = [
  { key: "unacknowledged", label: "Unacknowledged alarm", short: "ALARM", look: 3 },
  { key: "acknowledged", label: "Acknowledged alarm", short: "ACK", look: 2 },
  { key: "sticking", label: "Sticks, no alarm yet", short: "STICKS", look: 2 },
  { key: "returned", label: "Returned, not acknowledged", short: "RTN", look: 1 },
  { key: "latched", label: "Latched", short: "LATCHED", look: 1 },
  { key: "other", label: "Other alarm state", short: "", look: 1 },
  { key: "shelved", label: "Shelved", short: "SHELVED", look: 0 },
  { key: "silent", label: "Suppressed or out of service", short: "OFF", look: 0 },
  { key: "unknown", label: "Cannot be told", short: "?", look: 0 },
  { key: "waiting", label: "Not diagnosed yet", short: "…", look: 0 },
  { key: "sound", label: "No sticking shown", short: "", look: 0 },
];
const KIND = new Map(KINDS.map((kind, rank) => [kind.key, { ...kind, rank }]));

const BY_ALARM = { unacknowledged: "unacknowledged", acknowledged: "acknowledged", "returned-unacknowledged": "returned", "latched-unacknowledged": "latched", "latched-acknowledged": "latched", shelved: "shelved", "suppressed-by-design": "silent", "out-of-service": "silent" };
const BY_VERDICT = { stiction: "sticking", no_stiction: "sound", not_identifiable: "unknown" };

export function kindOf(item) {
  if (BY_ALARM[item.alarm]) return KIND.get(BY_ALARM[item.alarm]);
  if (item.alarm && item.alarm !== "normal") return { ...KIND.get("other"), label: words(item.alarm), short: words(item.alarm) };
  return KIND.get(BY_VERDICT[item.verdict] ?? "waiting");
}

/** What the API is to be asked for to find the loops of a kind, each beside the others; of no kind in particular, once for nothing. */
export function filtersOf(key) {
  const named = (map, filter) => Object.entries(map).filter(([, own]) => own === key).map(([name]) => filter(name));
  const found = [...named(BY_ALARM, (alarm) => ({ alarm })), ...named({ ...BY_VERDICT, none: "waiting" }, (verdict) => ({ alarm: "normal", verdict }))];
  return found.length ? found : [{}];
}

export const kind = (key) => KIND.get(key);

/** A name from the API as words. */
export const words = (name) => String(name ?? "").replaceAll(/[-_]/g, " ");

/** Why nothing can be told, by the code of the reason. */
export const whyNot = (code) => REASONS[code] ?? words(code);

/** What an alarm of a kind is about. */
export const alarmWords = (kind) => ALARMS[kind] ?? words(kind);

/** What an operator may ask for in a state; the daemon has the last word. */
export const mayAck = (state) => !["normal", "acknowledged", "latched-acknowledged", "shelved", "suppressed-by-design", "out-of-service"].includes(state);
export const mayReset = (state) => state === "latched-acknowledged";
export const mayShelve = (state) => !["normal", "out-of-service"].includes(state);
export const isOut = (state) => state === "out-of-service";
export const isShelved = (state) => state === "shelved";

/** Whether a collector brings samples: a connection may be open to a device that says nothing. */
export const isUp = ({ connected, down }) => connected && !down;
export const upWords = ({ connected, down }) => (!connected ? "no connection" : down ? "no good sample" : "connected");
