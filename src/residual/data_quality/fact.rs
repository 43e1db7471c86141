//! A fault of the data with its posterior, and what the search for each kind of fault shares.

use crate::residual::findings::{Described, Kind};
use crate::sysid::iddata::IdData;
use crate::sysid::student::FREEDOM;

/// Prior odds of one kind of fault or effect: there are fifteen, and none is likelier than another.
const PRIOR_ODDS: f64 = 1.0 / 15.0;
/// Posterior from which a fault is reported and repaired: it is likelier than not.
pub(super) const TOLD: f64 = 0.5;

/// `ln(Gamma(3) / (Gamma(5/2) sqrt(5 pi)))`: logarithm of the density of Student's t with 5 degrees of freedom, at 0 and scale 1.
const LOG_DENSITY: f64 = -0.968_619_589_054_724;

/// A fault of the data.
#[derive(Clone, Debug, PartialEq)]
pub struct Fact {
    /// Its kind.
    pub kind: Kind,
    /// Its posterior (0..1).
    pub posterior: f64,
    /// Its numbers, and the sentence that operators read.
    pub described: Described,
}

/// The samples of a signal at which PV was measured: a value in place of a missing one is not a multiple of the quantum.
pub(super) fn measured(data: &IdData, signal: &[f64]) -> Vec<f64> {
    (0..data.len()).filter(|k| is_measured(data, *k)).map(|k| signal[k]).collect()
}

/// Whether PV was measured at sample `k`, or is known although no sample was sent.
pub(in crate::residual) fn is_measured(data: &IdData, k: usize) -> bool {
    data.weight[k] > 0.0 || data.known[k]
}

/// The posterior (0..1) of a fault with these log odds before the prior.
pub(super) fn posterior(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds - PRIOR_ODDS.ln()).exp())
}

/// Logarithm of the density of Student's t for an error `e` at scale `s`.
pub(super) fn log_density(e: f64, s: f64) -> f64 {
    LOG_DENSITY - s.ln() - 0.5 * (FREEDOM + 1.0) * (e * e / (FREEDOM * s * s)).ln_1p()
}

/// Interpolates the samples `from..to` linearly between their neighbours.
pub(super) fn bridge(y: &mut [f64], from: usize, to: usize) {
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
