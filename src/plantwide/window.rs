//! A record of any sampling as a window on an equal grid: PV and OP drawn through, set points held.
//!
//! Unlike the diagnosis's gate it keeps the whole record, gaps and all: an oscillation is asked of all the time there is.

use super::PlantLoop;
use crate::signal::{Record, Sample, Window};
use crate::sysid::stats::median;

/// Fewest good samples.
const LEAST: usize = 60;

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
    let ts = median(&pv.windows(2).map(|w| w[1].0 - w[0].0).collect::<Vec<f64>>())
        .max((to - from) / most.max(2) as f64);
    let n = ((to - from) / ts) as usize + 1;
    let grid = |points: &[(f64, f64)], held: bool| -> Vec<f64> {
        let mut at = 0;
        (0..n)
            .map(|k| {
                let t = from + k as f64 * ts;
                while at + 1 < points.len() && points[at + 1].0 <= t {
                    at += 1;
                }
                let (a, b) = (points[at], points[(at + 1).min(points.len() - 1)]);
                let part = if held || b.0 <= a.0 { 0.0 } else { ((t - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) };
                a.1 + part * (b.1 - a.1)
            })
            .collect()
    };
    let sp = record.sp.as_deref().map(good).filter(|sp| !sp.is_empty()).map(|sp| grid(&sp, true));
    let window = Window { t0: from, ts, op: grid(&op, false), pv: grid(&pv, false), sp, ..Window::default() };
    let mode = record.mode.as_deref().map(good).filter(|mode| !mode.is_empty()).map(|mode| grid(&mode, true));
    let (name, op_limits) = (name.into(), record.op_limits);
    Ok(PlantLoop { name, window, mode, op_limits, ..PlantLoop::default() })
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
        ..Window::default()
    };
    let (name, mode) = (of.name.clone(), of.mode.as_ref().map(last));
    PlantLoop { name, window, mode, op_limits: of.op_limits, ..PlantLoop::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
