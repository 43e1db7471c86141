//! A record of any sampling as a window on an equal grid: PV, OP and stem drawn through, set points held.
//!
//! ```text
//! x[k] = 1/ts · integral of x over t[k] - ts/2 … t[k] + ts/2        where the record is thinned
//! ```
//!
//! A value picked now and then would show a fast cycle as a slow one. The mean of a cell has no steps of its own any more, and a
//! cycle within a cell no travel: the steps of PV and the work of the valve are taken before.
//!
//! Unlike the diagnosis's gate it keeps the whole record, gaps and all: an oscillation is asked of all the time there is. What
//! good samples of PV and OP do not cover is marked as missing, so that what hardly anything was measured of has no values.
//! Mode and set point are known as long as they were sampled. A source that sends changes only repeats no value: its silence
//! says that nothing has changed, until it says that something is wrong. An OP that such a source sends stands still until its
//! next change.

use super::signs::held;
use super::{PlantLoop, is_moved};
use crate::indicators::noise;
use crate::indicators::travel::{Travel, path};
use crate::signal::{LARGEST_VALUE, Record, Row, Sample, Window, outages};
use crate::sysid::stats::{median, sd};

/// Fewest good samples.
const LEAST: usize = 60;
/// Samples a cell from which on it has their mean: fewer are drawn through.
const THINNED: f64 = 1.2;
/// Sampling intervals without a good sample from which on a tag is silent.
const SILENT: f64 = 10.0;
/// Median intervals between changes after which a change is late, and OP stood still before it: jitter of a poll is less than
/// half of one, a scan at which OP did not change is a whole one.
const LATE: f64 = 1.5;
/// Share of OP's standard deviation that its rows keep, below which its movement is not in them (-): of a cycle they keep half at
/// 1.7 rows a period.
const BLURRED: f64 = 0.5;

/// What thinning takes from PV, taken before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raw {
    /// Its step (PV unit); 0 where it has none.
    pub step: f64,
    /// Longest stretch in which it does not change, as a share of the samples.
    pub held: f64,
}

/// What a valve did from row to row, by the samples of the stem or of OP.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Work {
    /// Its way until each row begins, and until the last ends (OP unit).
    way: Vec<f64>,
    /// Its turns until then.
    turns: Vec<f64>,
}

impl Work {
    /// From the samples, over rows that begin and end at `edges` (s).
    fn of(points: &Points, edges: impl Iterator<Item = f64> + Clone) -> Self {
        let (mut way, mut turns, mut gone) = (Vec::new(), Vec::new(), 0.0);
        let mut before = points[0].1;
        for (count, (at, value)) in path(&values(points), mean_interval(points)).into_iter().enumerate() {
            let t = points[at].0;
            gone += (value - before).abs();
            before = value;
            way.push((t, gone));
            turns.push((t, count as f64));
        }
        // The last is the end of the samples, and no turn.
        turns.pop();
        Self { way: picked(&way, edges.clone(), false), turns: picked(&turns, edges, true) }
    }

    /// What it comes to in a day, where it was seen for so long (s).
    pub fn travel(&self, seen_s: f64) -> Travel {
        let over = |x: &[f64]| x.first().zip(x.last()).map_or(0.0, |(first, last)| last - first);
        Travel::new(over(&self.way), over(&self.turns), seen_s)
    }

    /// From a row on.
    fn tail(&self, from: usize) -> Self {
        let last = |x: &[f64]| x.get(from..).unwrap_or_default().to_vec();
        Self { way: last(&self.way), turns: last(&self.turns) }
    }
}

/// The loop of a record, in at most `most` samples.
///
/// # Errors
/// Why the record cannot be used.
pub fn of_record(name: &str, record: &Record, most: usize) -> Result<PlantLoop, String> {
    let (op_tag, pv_tag) = (Tag::of(&record.op, Zero::DropOut), Tag::of(&record.pv, Zero::DropOut));
    let (op, pv) = (&op_tag.points, &pv_tag.points);
    if pv.len() < LEAST || op.is_empty() {
        return Err(format!("{} good samples of PV and {} of OP, {LEAST} are needed", pv.len(), op.len()));
    }
    let (from, to) = (pv[0].0, pv[pv.len() - 1].0);
    let ts = interval(pv).max((to - from) / most.max(2) as f64);
    let n = ((to - from) / ts) as usize + 1;
    let times = || (0..n).map(|k| from + k as f64 * ts);
    let is_thinned = |points: &Points| ts > THINNED * interval(points);
    let drawn = |points: &Points| -> Vec<f64> {
        if is_thinned(points) { averaged(points, times(), ts) } else { picked(points, times(), false) }
    };
    // OP that is sent by changes stood still until a late one.
    let output = |tag: &Tag| -> Vec<f64> {
        if !tag.by_changes {
            return drawn(&tag.points);
        }
        let points = stepped(&tag.points);
        if is_thinned(&tag.points) { averaged(&points, times(), ts) } else { picked(&points, times(), false) }
    };
    let kept = |series: &Option<Vec<Sample>>, zero: Zero| {
        series.as_deref().map(|series| Tag::of(series, zero)).filter(|tag| !tag.points.is_empty())
    };
    let set_point = |tag: &Tag| {
        // That of a cascade has to stay the same as its master's OP; a step by hand stays a step.
        let is_output = tag.points.len() > n && is_moved(&values(&tag.points));
        if is_output { output(tag) } else { picked(&tag.points, times(), true) }
    };
    let sp = kept(&record.sp, Zero::Value);
    // Of a stem that is hardly ever measured the travel is not known.
    let stem = kept(&record.mv, Zero::DropOut).filter(|mv| mv.points.len() >= LEAST);
    let sp_ends = sp.as_ref().and_then(|sp| sp.ends_before(to));
    let sp_known = sp_ends.map(|end| times().take_while(|t| *t <= end).count());
    // An OP that is sent by changes stands still in manual and at a limit; a PV hardly ever does.
    let op_covered = if op_tag.by_changes { op_tag.known(times(), to) } else { op_tag.near(times(), to) };
    let covered = pv_tag.near(times(), to).into_iter().zip(op_covered);
    let rows: Vec<Row> = covered.map(|(pv, op)| if pv && op { Row::Counts } else { Row::Missing }).collect();
    let window = Window {
        t0: from,
        ts,
        op: output(&op_tag),
        pv: drawn(pv),
        sp: sp.as_ref().map(set_point),
        mv: stem.as_ref().map(|mv| drawn(&mv.points)),
        // Empty where all count.
        rows: if rows.contains(&Row::Missing) { rows } else { Vec::new() },
        ..Window::default()
    };
    let raw = is_thinned(pv).then(|| {
        let pv = values(pv);
        Raw { step: noise::step(&pv), held: held(&pv) }
    });
    let moved = stem.as_ref().map_or(op, |mv| &mv.points);
    let edges = (0..=n).map(|k| from + (k as f64 - 0.5) * ts);
    let work = is_thinned(moved).then(|| Work::of(moved, edges));
    // Picked values alias a fast cycle, but spread as it does.
    let blurred = is_thinned(op) && sd(&window.op) < BLURRED * sd(&picked(&stepped(op), times(), false));
    let mode = kept(&record.mode, Zero::Value).map(|mode| {
        let held = picked(&mode.points, times(), true).into_iter().zip(mode.known(times(), to));
        held.map(|(mode, is_known)| if is_known { mode } else { f64::NAN }).collect()
    });
    let (name, op_limits) = (name.into(), record.op_limits);
    Ok(PlantLoop { name, window, mode, sp_known, op_limits, raw, work, blurred, ..PlantLoop::default() })
}

/// Which of PV and OP has been silent for too long at `now` (s), and since when (s): for more than a period of the looks and
/// more than ten of its sampling intervals. Nothing can be said of such a loop as it is now. An OP that is sent by changes is silent
/// once it is said to be bad.
pub fn silent_since(record: &Record, now: f64, period_s: f64) -> Option<(&'static str, f64)> {
    [("PV", &record.pv), ("OP", &record.op)].into_iter().find_map(|(name, series)| {
        let tag = Tag::of(series, Zero::DropOut);
        let last = tag.points.last()?.0;
        let stands = name == "OP" && tag.by_changes && tag.until(last, now) >= now;
        (!stands && now - last > period_s.max(tag.longest)).then_some((name, last))
    })
}

/// What a zero far from a tag's other values is.
#[derive(Clone, Copy, PartialEq)]
enum Zero {
    /// No measurement: that of a signal which was lost, as OP, PV and the stem are.
    DropOut,
    /// A value like any other, as those of set point and mode are.
    Value,
}

/// The good samples of a tag, and what tells for how long each of them stands.
struct Tag {
    points: Vec<(f64, f64)>,
    /// Times of the samples that are not good, in order (s).
    marks: Vec<f64>,
    /// Whether its source sends changes only.
    by_changes: bool,
    /// The longest time between two good samples that is no silence (s). By the mean interval: of an archive, which leaves out
    /// what is on a line, the median is far shorter than most of the time.
    longest: f64,
}

impl Tag {
    fn of(series: &[Sample], zero: Zero) -> Self {
        let is_number = |s: &Sample| {
            s.quality.is_good() && s.t.is_finite() && s.value.is_finite() && s.value.abs() < LARGEST_VALUE
        };
        let numbers: Vec<Sample> = series.iter().filter(|s| is_number(s)).copied().collect();
        // What is written where nothing was measured, as the gate of the diagnosis drops it.
        let mut none = outages(&numbers);
        none.retain(|value| zero == Zero::DropOut || *value != 0.0);
        let is_good = |s: &Sample| is_number(s) && !none.contains(&s.value);
        let good = numbers.iter().filter(|s| is_good(s));
        let mut points: Vec<(f64, f64)> = good.map(|s| (s.t, s.value)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.dedup_by(|a, b| a.0 == b.0);
        let bad = series.iter().filter(|s| !is_good(s) && s.t.is_finite());
        let mut marks: Vec<f64> = bad.map(|s| s.t).collect();
        marks.sort_by(f64::total_cmp);
        // After a mark the same value counts again, also where changes only are sent.
        let repeats = |w: &[Sample]| is_good(&w[0]) && is_good(&w[1]) && w[0].value == w[1].value;
        let by_changes = !series.windows(2).any(|w| repeats(w) && w[0].t < w[1].t);
        let longest = SILENT * mean_interval(&points);
        Self { points, marks, by_changes, longest }
    }

    /// Of each time whether `holds` does, for it and the times of the good samples before and after it, the last of which is
    /// `end`; of a time before all of them for it and the first.
    fn around(
        &self,
        times: impl Iterator<Item = f64>,
        end: f64,
        holds: impl Fn(f64, f64, f64) -> bool,
    ) -> Vec<bool> {
        let mut at = 0;
        times
            .map(|t| {
                while at + 1 < self.points.len() && self.points[at + 1].0 <= t {
                    at += 1;
                }
                let after = self.points.get(at + 1).map_or(end, |next| next.0);
                holds(t, self.points[at].0, after)
            })
            .collect()
    }

    /// Which of the times lie between good samples that are near each other.
    fn near(&self, times: impl Iterator<Item = f64>, end: f64) -> Vec<bool> {
        self.around(times, end, |t, before, after| {
            let silence = if t < before { before - t } else { after - before };
            t == before || silence <= self.longest
        })
    }

    /// At which of the times a value that is held is known.
    fn known(&self, times: impl Iterator<Item = f64>, end: f64) -> Vec<bool> {
        self.around(times, end, |t, before, after| {
            // What changed first may have been anything before.
            if t < before {
                !self.by_changes && before - t <= self.longest
            } else {
                t <= self.until(before, after)
            }
        })
    }

    /// Until when a value of the time `before` stands, of which the next comes at `after` (s).
    fn until(&self, before: f64, after: f64) -> f64 {
        if self.by_changes {
            let mark = self.marks.get(self.marks.partition_point(|t| *t <= before));
            mark.copied().unwrap_or(f64::INFINITY)
        } else if after - before <= self.longest {
            f64::INFINITY
        } else {
            before
        }
    }

    /// Until when the last good sample stands (s), where that is not until `end`.
    fn ends_before(&self, end: f64) -> Option<f64> {
        let until = self.until(self.points.last()?.0, end);
        (until < end).then_some(until)
    }
}

/// Times and values, in order.
type Points = [(f64, f64)];

fn values(points: &Points) -> Vec<f64> {
    points.iter().map(|point| point.1).collect()
}

/// Median time between two; 0 of fewer.
fn interval(points: &Points) -> f64 {
    median(&points.windows(2).map(|w| w[1].0 - w[0].0).collect::<Vec<f64>>())
}

/// Mean time between two; 0 of fewer.
fn mean_interval(points: &Points) -> f64 {
    let length = points.first().zip(points.last()).map_or(0.0, |(first, last)| last.0 - first.0);
    length / points.len().saturating_sub(1).max(1) as f64
}

/// The points with a corner before each late change, up to which the value before it stood.
fn stepped(points: &Points) -> Vec<(f64, f64)> {
    let late = LATE * interval(points);
    let mut out = Vec::with_capacity(2 * points.len());
    let mut last: Option<(f64, f64)> = None;
    for &point in points {
        let corner = last.filter(|last| point.0 - last.0 > late).map(|last| (point.0, last.1));
        out.extend(corner.into_iter().chain([point]));
        last = Some(point);
    }
    out
}

/// The value of the line from the point at `at` to the next, at a time between them; before and after all of them it is level.
fn on_line(points: &Points, at: usize, t: f64, is_held: bool) -> f64 {
    let (a, b) = (points[at], points[(at + 1).min(points.len() - 1)]);
    let part = if is_held || b.0 <= a.0 { 0.0 } else { ((t - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) };
    a.1 + part * (b.1 - a.1)
}

/// The values at the times, between the points or those before.
fn picked(points: &Points, times: impl Iterator<Item = f64>, is_held: bool) -> Vec<f64> {
    let mut at = 0;
    times
        .map(|t| {
            while at + 1 < points.len() && points[at + 1].0 <= t {
                at += 1;
            }
            on_line(points, at, t, is_held)
        })
        .collect()
}

/// The means of the line through the points over `ts` around each time, of the part that the points cover.
fn averaged(points: &Points, times: impl Iterator<Item = f64>, ts: f64) -> Vec<f64> {
    let (first, last) = (points[0].0, points[points.len() - 1].0);
    let mut at = 0;
    times
        .map(|t| {
            let (mut from, to) = ((t - 0.5 * ts).clamp(first, last), (t + 0.5 * ts).clamp(first, last));
            while at + 1 < points.len() && points[at + 1].0 <= from {
                at += 1;
            }
            // About the first value, so that a signal that does not move stays so to the last digit.
            let (begin, level, mut sum, mut i) = (from, on_line(points, at, from, false), 0.0, at);
            while from < to && i + 1 < points.len() {
                let until = points[i + 1].0.min(to);
                let ends = [from, until].map(|t| on_line(points, i, t, false) - level);
                sum += 0.5 * (ends[0] + ends[1]) * (until - from);
                (from, i) = (until, i + 1);
            }
            if to > begin { level + sum / (to - begin) } else { level }
        })
        .collect()
}

/// The last `length_s` of a loop, up to now: less of its window where that ended before.
pub fn tail(of: &PlantLoop, length_s: f64) -> PlantLoop {
    let n = of.window.pv.len();
    let from = n.saturating_sub(((length_s - of.silent_s) / of.window.ts).ceil().max(1.0) as usize);
    let last = |x: &Vec<f64>| x.get(from..).unwrap_or_default().to_vec();
    let w = &of.window;
    let window = Window {
        t0: w.t0 + from as f64 * w.ts,
        ts: w.ts,
        op: last(&w.op),
        pv: last(&w.pv),
        sp: w.sp.as_ref().map(last),
        mv: w.mv.as_ref().map(last),
        rows: w.rows.get(from..).unwrap_or_default().to_vec(),
        ..Window::default()
    };
    let (name, mode) = (of.name.clone(), of.mode.as_ref().map(last));
    let (op_limits, raw, silent_s) = (of.op_limits, of.raw, of.silent_s);
    let sp_known = of.sp_known.map(|known| known.saturating_sub(from));
    let (work, blurred) = (of.work.as_ref().map(|work| work.tail(from)), of.blurred);
    PlantLoop {
        name,
        window,
        mode,
        sp_known,
        silent_s,
        op_limits,
        raw,
        work,
        blurred,
        ..PlantLoop::default()
    }
}

#[cfg(test)]
mod tests;
