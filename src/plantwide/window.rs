//! A record of any sampling as a window on an equal grid: PV and OP drawn through, set points held.
//!
//! Unlike the diagnosis's gate it keeps the whole record, gaps and all: an oscillation is asked of all the time there is.

use super::PlantLoop;
use crate::signal::{Record, Sample, Window};
use crate::sysid::stats::median;

/// Most samples of a window.
const MOST: f64 = 200_000.0;
/// Fewest good samples.
const LEAST: usize = 60;

/// The loop of a record.
///
/// # Errors
/// Why the record cannot be used.
pub fn of_record(name: &str, record: &Record) -> Result<PlantLoop, String> {
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
    let ts = median(&pv.windows(2).map(|w| w[1].0 - w[0].0).collect::<Vec<f64>>()).max((to - from) / MOST);
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
    Ok(PlantLoop { name: name.into(), window, op_limits: record.op_limits, upstream: Vec::new() })
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
        let of = of_record("FIC1", &record).expect("98 samples");
        assert_eq!((of.window.pv.len(), of.window.ts), (100, 1.0));
        assert!((of.window.pv[50] - 50.0).abs() < 1e-9 && (of.window.op[51] - 102.0).abs() < 1e-9);
        let sp = of.window.sp.expect("recorded");
        assert_eq!((sp[29], sp[30], sp[99]), (0.0, 30.0, 30.0));
        assert!(of_record("FIC1", &Record::default()).is_err());
    }
}
