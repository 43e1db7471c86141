//! What the signals alone show, decided before any model of the process is asked: a coarse PV, a PV that stands still, clocks
//! that disagree, and single samples that are wrong. What is wrong is repaired, and no longer counts.

mod clock;
mod equations;
mod frozen;
mod outliers;
pub mod quantised;

use super::Kind;
use super::report::Described;
use crate::sysid::iddata::IdData;
use crate::sysid::student::FREEDOM;

/// Prior odds of one kind: there are fifteen, and each is as likely as any other.
const PRIOR_ODDS: f64 = 1.0 / 15.0;
/// Posterior from which on a fact is told and repaired: more likely than not.
const TOLD: f64 = 0.5;

/// `ln(Gamma(3) / (Gamma(5/2) sqrt(5 pi)))`: of Student's t the logarithm of the density at 0, at scale 1.
const LOG_DENSITY: f64 = -0.968_619_589_054_724;

/// A fact of the signals.
#[derive(Clone, Debug, PartialEq)]
pub struct Fact {
    /// Which.
    pub kind: Kind,
    /// How sure it is (0..1).
    pub posterior: f64,
    /// In numbers and in one sentence.
    pub described: Described,
}

/// Decides what the signals alone show, repairs PV and its weights, and tells.
///
/// `stem`: the best stem so far, of the data as they are by then: of clocks that were put right, it is another.
pub fn assess(data: &mut IdData, stem: &dyn Fn(&IdData) -> Vec<f64>) -> Vec<Fact> {
    let mut facts = Vec::new();
    // The step of PV belongs to PV as it was recorded: a repair puts other values in between.
    let step = quantised::step_of(&measured(data, &data.y));
    data.least_scale = quantised::error_of(step);
    // A coarse PV stands still by itself: where both are there, its steps are named first.
    facts.extend(quantised::assess(data));
    facts.extend(frozen::assess(data));
    // What PV's own past says of a sample means nothing where OP's is of another time.
    facts.extend(clock::assess(data, step));
    facts.extend(outliers::assess(data, stem, step));
    facts
}

/// Those of a signal's samples at which PV was measured: what stands in for a missing one has no steps.
fn measured(data: &IdData, signal: &[f64]) -> Vec<f64> {
    (0..data.len()).filter(|k| is_measured(data, *k)).map(|k| signal[k]).collect()
}

fn is_measured(data: &IdData, k: usize) -> bool {
    data.weight[k] > 0.0 || data.known[k]
}

/// The probability of what has these log-odds before its prior.
fn posterior(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds - PRIOR_ODDS.ln()).exp())
}

/// The logarithm of the density of an error at scale `s`.
fn log_density(e: f64, s: f64) -> f64 {
    LOG_DENSITY - s.ln() - 0.5 * (FREEDOM + 1.0) * (e * e / (FREEDOM * s * s)).ln_1p()
}

/// Puts a straight line between the neighbours of `from..to`.
fn bridge(y: &mut [f64], from: usize, to: usize) {
    let left = y[from.saturating_sub(1)];
    let right = y.get(to).copied().unwrap_or(left);
    let length = (to - from + 1) as f64;
    for k in from..to.min(y.len()) {
        y[k] = left + (right - left) * (k - from + 1) as f64 / length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bridge_is_a_straight_line() {
        let mut y = [0.0, 9.0, 9.0, 9.0, 4.0];
        bridge(&mut y, 1, 4);
        assert_eq!(y, [0.0, 1.0, 2.0, 3.0, 4.0]);
        let mut end = [2.0, 9.0];
        bridge(&mut end, 1, 2);
        assert_eq!(end, [2.0, 2.0]);
    }

    #[test]
    fn a_density_sums_to_one() {
        let sum: f64 = (-100_000..=100_000).map(|k| log_density(f64::from(k) * 1e-3, 0.3).exp() * 1e-3).sum();
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
    }

    #[test]
    fn even_odds_leave_the_prior() {
        assert!((posterior(0.0) - 1.0 / 16.0).abs() < 1e-12);
        assert!((posterior(15.0f64.ln()) - 0.5).abs() < 1e-12);
    }
}
