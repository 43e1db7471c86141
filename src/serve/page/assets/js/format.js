// Numbers and times as people read them.

/** Four significant digits; a dash for what does not exist. */
export const short = (value, digits = 4) =>
  value === null || value === undefined || !Number.isFinite(Number(value)) ? "–" : String(Number(Number(value).toPrecision(digits)));

/** The same beside the limits that it is judged by: with as many more digits as show on which side of each it is. */
export function beside(value, limits, digits) {
  const side = (told) => limits.map((limit) => (limit === null ? 0 : Math.sign(told - limit))).join();
  let text = short(value, digits);
  for (let more = digits + 1; more <= 12 && side(text) !== side(value); more++) text = short(value, more);
  return text;
}

/** A time in the reader's zone, to the second. */
export const when = (time) => (time ? new Date(time).toLocaleString("sv-SE") : "–");

export const clock = (milliseconds) => new Date(milliseconds).toLocaleTimeString("sv-SE");

/** Times (ms) on an axis, in order: of each the time of day and, at the first and wherever a day begins, its date; else no date. */
export function ticked(times) {
  const date = (t) => new Date(t).toLocaleDateString("sv-SE").slice(5);
  return times.map((t, i) => [clock(t), i > 0 && date(t) === date(times[i - 1]) ? "" : date(t)]);
}

/** A length of time (s) in its largest sensible unit. */
export function lasting(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "–";
  for (const [unit, size] of [["d", 86400], ["h", 3600], ["min", 60]]) if (seconds >= 2 * size) return `${short(seconds / size, 2)} ${unit}`;
  return `${short(seconds, seconds < 10 ? 2 : 3)} s`;
}

export const ago = (seconds) => (seconds === null || seconds === undefined ? "–" : seconds < 1 ? "now" : `${lasting(seconds)} ago`);

/** A probability in whole per cent, and never as certainty. */
export const percent = (value) => (value === null || value === undefined ? "–" : value > 0.99 ? "> 99 %" : value < 0.01 ? "< 1 %" : `${Math.round(100 * value)} %`);

export function bytes(count) {
  if (count === null || count === undefined) return "–";
  for (const [unit, size] of [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]]) if (count >= size) return `${short(count / size, 3)} ${unit}`;
  return `${count} B`;
}

// Whether no friction is needed, and the record could hide some.
const hidden = (item) => item.f === 0 && item.f_ci95?.[1] > 0;

/** What the swing of a loop, or of an order's loops, costs. */
export const costs = (item) => (item.cost === null ? "–" : `${short(item.cost, 3)} ${item.cost_unit}`);

/** f with its interval; without friction the upper end says what the record could have hidden. */
export function friction(item) {
  if (item.f === null || item.f === undefined) return "–";
  if (hidden(item)) return `f up to ${short(item.f_ci95[1], 3)} ${item.f_unit} could be hidden`;
  const interval = item.f_ci95 ? ` (${short(item.f_ci95[0], 3)} … ${short(item.f_ci95[1], 3)})` : "";
  return `${short(item.f, 3)} ${item.f_unit}${interval}`;
}

/** The same where nothing beside it says that it is f. */
export const frictionNamed = (item) => (hidden(item) ? friction(item) : `f = ${friction(item)}`);
