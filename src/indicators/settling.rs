//! How PV follows a step of the set point: settling time and overshoot.
//!
//! ```text
//! settled from t on:  |pv - sp| <= max(0.05 |Δsp|, 2 noise) for all later samples up to the next step
//! overshoot = max((pv - sp) sign(Δsp)) / |Δsp|
//! ```
//!
//! Δsp is the step (PV unit), times are in seconds. Steps smaller than five times PV's noise are not looked at.
//! Source: Åström & Hägglund, Advanced PID Control, 2006, section 4.2.

use crate::diagnosis::denoise::noise_sd;
use crate::sysid::stats::median;

/// Band around the set point, as a share of the step.
const BAND: f64 = 0.05;
/// The band's least half width, and the least step, in noise standard deviations.
const NOISE: [f64; 2] = [2.0, 5.0];
/// Fewest samples between two steps.
const LEAST: usize = 10;

/// How the steps of a record were followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settling {
    /// Steps that were looked at.
    pub steps: usize,
    /// Those after which PV settled.
    pub settled: usize,
    /// Median settling time of these (s); none where no step settled.
    pub time_s: Option<f64>,
    /// Median overshoot (-).
    pub overshoot: f64,
}

/// Looks at every step of `sp` between samples at which it and PV are known; none where there is no step to look at.
pub fn settling(pv: &[f64], sp: &[f64], ts: f64, is_known: impl Fn(usize) -> bool) -> Option<Settling> {
    let n = pv.len().min(sp.len());
    let noise = noise_sd(&pv[..n]);
    let steps: Vec<usize> = (1..n).filter(|k| sp[*k] != sp[k - 1]).collect();
    let (mut times, mut overs, mut seen) = (Vec::new(), Vec::new(), 0);
    for (i, &at) in steps.iter().enumerate() {
        let end = steps.get(i + 1).copied().unwrap_or(n);
        let end = (at - 1..end).find(|k| !is_known(*k)).unwrap_or(end).max(at);
        let step = sp[at] - sp[at - 1];
        if end - at < LEAST || step.abs() < NOISE[1] * noise || !step.is_finite() {
            continue;
        }
        seen += 1;
        let band = (BAND * step.abs()).max(NOISE[0] * noise);
        let outside = (at..end).rev().find(|k| (pv[*k] - sp[at]).abs() > band);
        let settled = outside.map_or(0, |k| k + 1 - at);
        // Settled with the last sample alone is not settled.
        if at + settled + LEAST / 2 <= end {
            times.push(settled as f64 * ts);
        }
        let over = (at..end).map(|k| (pv[k] - sp[at]) * step.signum()).fold(0.0, f64::max);
        overs.push(over / step.abs());
    }
    (seen > 0).then(|| Settling {
        steps: seen,
        settled: times.len(),
        time_s: (!times.is_empty()).then(|| median(&times)),
        overshoot: median(&overs),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let sp: Vec<f64> = (0..60).map(|k| if k < 10 { 0.0 } else { 10.0 }).collect();
        // One above the set point at the step's fifth sample, within half a unit from the seventh on.
        let pv: Vec<f64> = (0..60)
            .map(|k| match k {
                0..10 => 0.0,
                10..14 => 5.0,
                14 | 15 => 11.0,
                _ => 10.2,
            })
            .collect();
        let found = settling(&pv, &sp, 2.0, |_| true).expect("one step");
        assert_eq!((found.steps, found.settled, found.time_s), (1, 1, Some(12.0)));
        assert!((found.overshoot - 0.1).abs() < 1e-12);
        assert_eq!(settling(&pv, &[3.0; 60], 1.0, |_| true), None);
        assert_eq!(settling(&[], &[], 1.0, |_| true), None);
        // When it came is not known where the samples before it are missing, and what came after it ends with them.
        assert_eq!(settling(&pv, &sp, 2.0, |k| k > 9), None);
        assert_eq!(settling(&pv, &sp, 2.0, |k| k < 40), Some(found));
        assert_eq!(settling(&pv, &sp, 2.0, |k| k < 15), None);
    }
}
