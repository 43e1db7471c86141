//! A record of any sampling as a window on an equal grid: PV, OP and stem drawn through, set points held.
//!
//! ```text
//! x[k] = 1/ts · integral of x over t[k] - ts/2 … t[k] + ts/2        where the record is thinned
//! ```
//!
//! A value picked now and then would show a fast cycle as a slow one. The mean of a cell has no steps of its own any more, so
//! those of PV are taken before.
//!
//! Unlike the diagnosis's gate it keeps the whole record, gaps and all: an oscillation is asked of all the time there is. What
//! good samples of PV and OP do not cover is marked as missing, so that what hardly anything was measured of has no values.
//! Mode and set point are known as long as they were sampled. A source that sends changes only repeats no value: its silence
//! says that nothing has changed, until it says that something is wrong.

use super::signs::held;
use super::{PlantLoop, is_moved};
use crate::indicators::noise;
use crate::signal::{Record, Row, Sample, Window};
use crate::sysid::stats::median;

/// Fewest good samples.
const LEAST: usize = 60;
/// Samples a cell from which on it has their mean: fewer are drawn through.
const THINNED: f64 = 1.2;
/// Sampling intervals without a good sample from which on a tag is silent.
const SILENT: f64 = 10.0;

/// What thinning takes from PV, taken before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raw {
    /// Its step (PV unit); 0 where it has none.
    pub step: f64,
    /// Longest stretch in which it does not change, as a share of the samples.
    pub held: f64,
}

/// The loop of a record, in at most `most` samples.
///
/// # Errors
/// Why the record cannot be used.
pub fn of_record(name: &str, record: &Record, most: usize) -> Result<PlantLoop, String> {
    let (op_tag, pv_tag) = (Tag::of(&record.op), Tag::of(&record.pv));
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
    let kept =
        |series: &Option<Vec<Sample>>| series.as_deref().map(Tag::of).filter(|tag| !tag.points.is_empty());
    let set_point = |points: &Points| {
        // That of a cascade has to stay the same as its master's OP; a step by hand stays a step.
        let is_output = points.len() > n && is_moved(&values(points));
        if is_output { drawn(points) } else { picked(points, times(), true) }
    };
    let sp = kept(&record.sp);
    let sp_ends = sp.as_ref().and_then(|sp| sp.ends_before(to));
    let sp_known = sp_ends.map(|end| times().take_while(|t| *t <= end).count());
    // An OP that is sent by changes stands still in manual and at a limit; a PV hardly ever does.
    let op_covered = if op_tag.by_changes { op_tag.known(times(), to) } else { op_tag.near(times(), to) };
    let covered = pv_tag.near(times(), to).into_iter().zip(op_covered);
    let rows: Vec<Row> = covered.map(|(pv, op)| if pv && op { Row::Counts } else { Row::Missing }).collect();
    let window = Window {
        t0: from,
        ts,
        op: drawn(op),
        pv: drawn(pv),
        sp: sp.map(|sp| set_point(&sp.points)),
        // Of a stem that is hardly ever measured the travel is not known.
        mv: kept(&record.mv).filter(|mv| mv.points.len() >= LEAST).map(|mv| drawn(&mv.points)),
        // Empty where all count.
        rows: if rows.contains(&Row::Missing) { rows } else { Vec::new() },
        ..Window::default()
    };
    let raw = is_thinned(pv).then(|| {
        let pv = values(pv);
        Raw { step: noise::step(&pv), held: held(&pv) }
    });
    let mode = kept(&record.mode).map(|mode| {
        let held = picked(&mode.points, times(), true).into_iter().zip(mode.known(times(), to));
        held.map(|(mode, is_known)| if is_known { mode } else { f64::NAN }).collect()
    });
    let (name, op_limits) = (name.into(), record.op_limits);
    Ok(PlantLoop { name, window, mode, sp_known, op_limits, raw, ..PlantLoop::default() })
}

/// Which of PV and OP has been silent for too long at `now` (s), and since when (s): for more than a period of the looks and
/// more than ten of its sampling intervals. Nothing can be said of such a loop as it is now. An OP that is sent by changes is silent
/// once it is said to be bad.
pub fn silent_since(record: &Record, now: f64, period_s: f64) -> Option<(&'static str, f64)> {
    [("PV", &record.pv), ("OP", &record.op)].into_iter().find_map(|(name, series)| {
        let tag = Tag::of(series);
        let last = tag.points.last()?.0;
        let stands = name == "OP" && tag.by_changes && tag.until(last, now) >= now;
        (!stands && now - last > period_s.max(tag.longest)).then_some((name, last))
    })
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
    fn of(series: &[Sample]) -> Self {
        let is_good = |s: &Sample| s.quality.is_good() && s.value.is_finite() && s.t.is_finite();
        let good = series.iter().filter(|s| is_good(s));
        let mut points: Vec<(f64, f64)> = good.map(|s| (s.t, s.value)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.dedup_by(|a, b| a.0 == b.0);
        let bad = series.iter().filter(|s| !is_good(s) && s.t.is_finite());
        let mut marks: Vec<f64> = bad.map(|s| s.t).collect();
        marks.sort_by(f64::total_cmp);
        // After a mark the same value counts again, also where changes only are sent.
        let repeats = |w: &[Sample]| is_good(&w[0]) && is_good(&w[1]) && w[0].value == w[1].value;
        let by_changes = !series.windows(2).any(|w| repeats(w) && w[0].t < w[1].t);
        let length = points.first().zip(points.last()).map_or(0.0, |(first, last)| last.0 - first.0);
        let longest = SILENT * length / points.len().saturating_sub(1).max(1) as f64;
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
    let (op_limits, dead_time_s, raw, silent_s) = (of.op_limits, of.dead_time_s, of.raw, of.silent_s);
    let sp_known = of.sp_known.map(|known| known.saturating_sub(from));
    PlantLoop { name, window, mode, sp_known, silent_s, op_limits, dead_time_s, raw, ..PlantLoop::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};
    use crate::sysid::stats::sd;
    use std::f64::consts::TAU;

    #[test]
    fn what_is_missing_is_drawn_through_and_set_points_are_held() {
        let series =
            |at: &[f64], f: &dyn Fn(f64) -> f64| at.iter().map(|t| Sample::good(*t, f(*t))).collect();
        let times: Vec<f64> = (0..100).map(f64::from).filter(|t| *t != 50.0 && *t != 51.0).collect();
        let record = Record {
            op: series(&times, &|t| 2.0 * t),
            pv: series(&times, &|t| t),
            sp: Some(series(&[0.0, 30.0], &|t| t)),
            ..Record::default()
        };
        let of = of_record("FIC1", &record, 1000).expect("98 samples");
        assert_eq!((of.window.pv.len(), of.window.ts), (100, 1.0));
        assert!((of.window.pv[50] - 50.0).abs() < 1e-9 && (of.window.op[51] - 102.0).abs() < 1e-9);
        let sp = of.window.sp.expect("recorded");
        assert_eq!((sp[29], sp[30], sp[99]), (0.0, 30.0, 30.0));
        assert!(of_record("FIC1", &Record::default(), 1000).is_err());
        let last = tail(&of_record("FIC1", &record, 1000).expect("98 samples"), 9.5);
        assert_eq!(
            (last.window.t0, last.window.pv.len(), last.window.sp.map(|sp| sp.len())),
            (90.0, 10, Some(10))
        );
        // One that is longer than allowed is thinned, over the same time.
        let thin = of_record("FIC1", &record, 10).expect("98 samples").window;
        assert!((thin.ts - 9.9).abs() < 1e-9 && thin.pv.len() == 11, "{thin:?}");
    }

    /// A day of samples every 10 s.
    fn day(f: impl Fn(f64) -> f64) -> Vec<Sample> {
        (0..8640).map(|k| 10.0 * f64::from(k)).map(|t| Sample::good(t, f(t))).collect()
    }

    /// A sample that is not good.
    fn bad(t: f64) -> Sample {
        Sample { quality: Quality::Bad(BadReason::Timeout), ..Sample::good(t, f64::NAN) }
    }

    #[test]
    fn mode_and_set_point_are_known_no_longer_than_they_were_sampled() {
        let pv = day(|t| (0.001 * t).sin());
        let of = |sp: Vec<Sample>, mode: Vec<Sample>| {
            let (op, pv) = (pv.clone(), pv.clone());
            let record = Record { op, pv, sp: Some(sp), mode: Some(mode), ..Record::default() };
            of_record("FIC1", &record, 10_000).expect("a day")
        };
        let known = |of: &PlantLoop| {
            let mode = of.mode.as_ref().expect("recorded").iter().filter(|mode| mode.is_finite());
            (of.sp_known, mode.count())
        };
        let all = of(day(|_| 5.0), day(|_| 1.0));
        assert_eq!(known(&all), (None, 8640));
        // Both died after 6,000 samples, without a word.
        let first = |x: f64| day(|_| x).into_iter().take(6000).collect::<Vec<Sample>>();
        let dead = of(first(5.0), first(1.0));
        assert_eq!(known(&dead), (Some(6000), 6000));
        let hour = tail(&dead, 3600.0);
        assert_eq!(known(&hour), (Some(0), 0));
        // A source that sends changes only has said nothing since, until it says that something is wrong.
        let once = vec![Sample::good(0.0, 1.0)];
        assert_eq!(known(&of(once.clone(), once.clone())), (None, 8640));
        let lost = vec![Sample::good(0.0, 1.0), bad(40_000.0)];
        assert_eq!(known(&of(lost.clone(), lost)), (Some(4001), 4001));
        let back = vec![Sample::good(0.0, 1.0), bad(40_000.0), Sample::good(80_000.0, 1.0)];
        assert_eq!(known(&of(once, back)), (None, 4001 + 640), "from 80,000 s on it is known again");
    }

    #[test]
    fn what_is_drawn_through_a_gap_is_missing() {
        let mut gap = day(|t| (0.001 * t).sin());
        gap.drain(1000..7000);
        let record =
            |op: &[Sample], pv: &[Sample]| Record { op: op.to_vec(), pv: pv.to_vec(), ..Record::default() };
        let whole = day(|t| (0.001 * t).sin());
        let missing = |record: &Record| of_record("FIC1", record, 10_000).expect("a day").window.missing();
        assert_eq!(missing(&record(&whole, &whole)), 0.0);
        // OP repeats its values, so that its source does not send changes only.
        let polled = day(|t| (10.0 * (0.001 * t).sin()).round());
        let mut hole = polled.clone();
        hole.drain(1000..7000);
        for of in [record(&hole, &gap), record(&polled, &gap), record(&hole, &whole)] {
            assert!((missing(&of) - 6000.0 / 8640.0).abs() < 1e-3, "{}", missing(&of));
        }
        // One that is sent by changes stands where it was, until it is bad.
        assert_eq!(missing(&record(&gap, &whole)), 0.0);
        gap.insert(1000, bad(10_000.0));
        assert!((missing(&record(&gap, &whole)) - 6000.0 / 8640.0).abs() < 1e-3);
        gap.remove(1000);
        // The last hour is there, and of an hour in which OP has died two thirds are not.
        let of = of_record("FIC1", &record(&whole, &gap), 10_000).expect("a day");
        assert_eq!(tail(&of, 3600.0).window.missing(), 0.0);
        let of = of_record("FIC1", &record(&polled[..8400], &whole), 10_000).expect("a day");
        assert!((tail(&of, 3600.0).window.missing() - 240.0 / 360.0).abs() < 0.01);
        // A window that ended half an hour ago has the other half of the latest hour.
        let late = PlantLoop { silent_s: 1800.0, ..of };
        assert_eq!(tail(&late, 3600.0).window.pv.len(), 180);
    }

    #[test]
    fn a_tag_is_silent_after_a_period_of_looks_and_ten_intervals() {
        let record = |op: Vec<Sample>| Record { op, pv: day(|t| t), ..Record::default() };
        let last = 86_390.0;
        let whole = record(day(|t| t));
        assert_eq!(silent_since(&whole, last + 3600.0, 3600.0), None);
        assert_eq!(silent_since(&whole, last + 3601.0, 3600.0), Some(("PV", last)));
        assert_eq!(silent_since(&whole, last + 99.0, 60.0), None, "ten intervals of 10 s");
        assert_eq!(silent_since(&whole, last + 101.0, 60.0), Some(("PV", last)));
        // Bad samples are no life.
        let mut dying: Vec<Sample> = day(|t| t).into_iter().take(100).collect();
        dying.extend((100..8640).map(|k| bad(10.0 * f64::from(k))));
        assert_eq!(silent_since(&record(dying), last, 3600.0), Some(("OP", 990.0)));
        // One that is sent by changes may stand still, and one that repeats its values may not.
        let first = |f: fn(f64) -> f64| day(f).into_iter().take(100).collect::<Vec<Sample>>();
        assert_eq!(silent_since(&record(first(|t| t)), last, 3600.0), None);
        assert_eq!(silent_since(&record(first(|_| 5.0)), last, 3600.0), Some(("OP", 990.0)));
        assert_eq!(silent_since(&Record::default(), 0.0, 60.0), None, "there never was one");
    }

    #[test]
    fn a_cycle_that_is_faster_than_the_grid_does_not_show_as_a_slow_one() {
        let (fast, slow) = (|t: f64| (TAU * t / 30.0).sin(), |t: f64| (TAU * t / 3600.0).sin());
        let record = Record { op: day(slow), pv: day(fast), sp: Some(day(slow)), ..Record::default() };
        let of = of_record("FIC1", &record, 3000).expect("a day").window;
        assert!((of.ts - 28.8).abs() < 0.01, "{}", of.ts);
        assert!(sd(&of.pv) < 0.1, "{}", sd(&of.pv));
        // What is slow stays where it is, and a set point stays its master's output.
        let late = (0..of.op.len()).map(|k| of.op[k] - slow(k as f64 * of.ts)).map(f64::abs);
        assert!(late.fold(0.0, f64::max) < 0.03);
        assert_eq!(of.sp, Some(of.op));
        // A level stays level, and a gap in the record is drawn through.
        let mut gap = day(|_| 1e5 / 3.0);
        gap.drain(2000..4000);
        let record = Record { op: gap.clone(), pv: gap, ..Record::default() };
        let of = of_record("FIC1", &record, 3000).expect("most of a day").window;
        assert!(of.pv.iter().all(|x| *x == 1e5 / 3.0));
    }

    #[test]
    fn steps_and_stretches_of_pv_outlive_the_thinning() {
        let coarse = |t: f64| if t < 43_200.0 { 5.0 } else { (8.0 * (TAU * t / 3600.0).sin()).round() * 0.5 };
        let record = Record { op: day(coarse), pv: day(coarse), ..Record::default() };
        let of = of_record("FIC1", &record, 1000).expect("a day");
        let raw = of.raw.expect("it is thinned");
        assert!((raw.step - 0.5).abs() < 1e-9 && (raw.held - 0.5).abs() < 0.01, "{raw:?}");
        assert_eq!(tail(&of, 3600.0).raw, Some(raw));
        assert_eq!(of_record("FIC1", &record, 10_000).expect("a day").raw, None);
    }

    #[test]
    fn a_measured_stem_goes_with_the_window() {
        let record =
            Record { op: day(|t| t), pv: day(|t| t), mv: Some(day(|t| 2.0 * t)), ..Record::default() };
        let of = of_record("FIC1", &record, 10_000).expect("a day");
        let stem = of.window.mv.as_ref().expect("measured");
        assert!((stem[100] - 2000.0).abs() < 1e-9);
        assert_eq!(tail(&of, 3600.0).window.mv.map(|mv| mv.len()), Some(360));
        let hardly = Record { mv: Some(day(|t| t).split_off(8600)), ..record };
        assert_eq!(of_record("FIC1", &hardly, 10_000).expect("a day").window.mv, None);
    }
}
