// How samples become lines: a value that holds until the next is a step, and where nothing was heard there is no line.

// So many mean intervals without a sample are a silence, as in a look at the plant. The median would not do: where a source leaves out
// what stands still, it is far shorter than the usual pauses.
const SILENT = 10;
// Of fewer samples nobody knows what is usual.
const FEW = 3;
// How long before a mark a value that held until then ends (s).
const HAIR = 0.001;

/** The longest time (s) between two samples that is no silence, by the times (s) of samples in order. An interval that is so much longer
 * than the mean of the others is a silence, and says nothing of what is usual. */
export function longest(times) {
  const intervals = times.slice(1).map((t, i) => t - times[i]).filter((interval) => interval > 0).sort((a, b) => a - b);
  if (intervals.length < FEW - 1) return Infinity;
  let n = intervals.length, sum = intervals.reduce((all, interval) => all + interval, 0);
  for (; n > 1 && intervals[n - 1] > (SILENT * (sum - intervals[n - 1])) / (n - 1); n--) sum -= intervals[n - 1];
  return (SILENT * sum) / n;
}

/** The silences [from, to] (s) that are longer than `limit` (s) between samples at these times (s), in order. */
export const silences = (times, limit) => times.flatMap((t, i) => (i > 0 && t - times[i - 1] > limit ? [[times[i - 1], t]] : []));

/** What is drawn of a tag, as times (s) and values: null where it breaks, by a mark or a silence. A value that holds goes on until the
 * next, a mark, or the end (s), also after a silence: if it had changed, that would have been heard with the rest. */
export function line([times, values], silent, holds, end) {
  const x = [], y = [];
  let next = 0, known = null;
  const put = (t, value) => {
    x.push(t);
    y.push(value);
  };
  const hold = (t) => holds && x.length && y.at(-1) !== null && x.at(-1) < t && put(t, y.at(-1));
  const until = (t) => {
    for (; next < silent.length && silent[next][1] <= t; next++) {
      const [from, to] = silent[next];
      if (!x.length) continue;
      hold(from);
      put((from + to) / 2, null);
      if (holds && known !== null && to < t) put(to, known);
    }
  };
  times.forEach((t, i) => {
    until(t);
    if (values[i] === null) hold(t - HAIR);
    put(t, values[i]);
    known = values[i];
  });
  until(end);
  hold(end);
  return [x, y];
}
