//! A record of any sampling as a window on an equal grid: PV, OP and stem drawn through, set points held.
//!
//! ```text
//! x[k] = 1/ts · integral of x over t[k] - ts/2 … t[k] + ts/2        where the record is thinned
//! ```
//!
//! A value picked now and then would show a fast cycle as a slow one. The mean of a cell has no steps of its own any more, so
//! those of PV are taken before.
//!
//! Unlike the diagnosis's gate it keeps the whole record, gaps and all: an oscillation is asked of all the time there is.

use super::signs::held;
use super::{PlantLoop, is_moved};
use crate::indicators::noise;
use crate::signal::{Record, Sample, Window};
use crate::sysid::stats::median;

/// Fewest good samples.
const LEAST: usize = 60;
/// Samples a cell from which on it has their mean: fewer are drawn through.
const THINNED: f64 = 1.2;

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
    let good = |series: &[Sample]| -> Vec<(f64, f64)> {
        let good = series.iter().filter(|s| s.quality.is_good() && s.value.is_finite() && s.t.is_finite());
        let mut good: Vec<(f64, f64)> = good.map(|s| (s.t, s.value)).collect();
        good.sort_by(|a, b| a.0.total_cmp(&b.0));
        good.dedup_by(|a, b| a.0 == b.0);
        good
    };
    let (op, pv) = (good(&record.op), good(&record.pv));
    if pv.len() < LEAST || op.is_empty() {
        return Err(format!("{} good samples of PV and {} of OP, {LEAST} are needed", pv.len(), op.len()));
    }
    let (from, to) = (pv[0].0, pv[pv.len() - 1].0);
    let ts = interval(&pv).max((to - from) / most.max(2) as f64);
    let n = ((to - from) / ts) as usize + 1;
    let times = || (0..n).map(|k| from + k as f64 * ts);
    let is_thinned = |points: &Points| ts > THINNED * interval(points);
    let drawn = |points: &Points| -> Vec<f64> {
        if is_thinned(points) { averaged(points, times(), ts) } else { picked(points, times(), false) }
    };
    let kept = |series: &Option<Vec<Sample>>| series.as_deref().map(good).filter(|points| !points.is_empty());
    let set_point = |points: Vec<(f64, f64)>| {
        // That of a cascade has to stay the same as its master's OP; a step by hand stays a step.
        let is_output = points.len() > n && is_moved(&values(&points));
        if is_output { drawn(&points) } else { picked(&points, times(), true) }
    };
    let window = Window {
        t0: from,
        ts,
        op: drawn(&op),
        pv: drawn(&pv),
        sp: kept(&record.sp).map(set_point),
        // Of a stem that is hardly ever measured the travel is not known.
        mv: kept(&record.mv).filter(|mv| mv.len() >= LEAST).map(|mv| drawn(&mv)),
        ..Window::default()
    };
    let raw = is_thinned(&pv).then(|| {
        let pv = values(&pv);
        Raw { step: noise::step(&pv), held: held(&pv) }
    });
    let mode = kept(&record.mode).map(|mode| picked(&mode, times(), true));
    let (name, op_limits) = (name.into(), record.op_limits);
    Ok(PlantLoop { name, window, mode, op_limits, raw, ..PlantLoop::default() })
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

/// The last `length_s` of a loop.
pub fn tail(of: &PlantLoop, length_s: f64) -> PlantLoop {
    let n = of.window.pv.len();
    let from = n.saturating_sub((length_s / of.window.ts).ceil().max(1.0) as usize);
    let last = |x: &Vec<f64>| x.get(from..).unwrap_or_default().to_vec();
    let w = &of.window;
    let window = Window {
        t0: w.t0 + from as f64 * w.ts,
        ts: w.ts,
        op: last(&w.op),
        pv: last(&w.pv),
        sp: w.sp.as_ref().map(last),
        mv: w.mv.as_ref().map(last),
        ..Window::default()
    };
    let (name, mode) = (of.name.clone(), of.mode.as_ref().map(last));
    let (op_limits, dead_time_s, raw) = (of.op_limits, of.dead_time_s, of.raw);
    PlantLoop { name, window, mode, op_limits, dead_time_s, raw, ..PlantLoop::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
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
