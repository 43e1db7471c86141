//! By how much errors on held-out samples fall short of those on samples that chose nothing.
//!
//! ```text
//! optimism = ln(after / before) on the continuation - ln(after / before) on the held-out samples
//!          = ln(after: continuation / held out)     - ln(before: continuation / held out)
//! ```
//!
//! No effect was chosen for the declared model, and only its f comes from all samples of the record. So what it loses on the
//! continuation is taken for what the loop does there, and what the model with the effects loses beyond that is optimism: above 0
//! the published gain of the effects is too large. The continuation is farther from the fitted samples than the held-out ones are,
//! and what that costs a model with wrong effects is in this number, too.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use stictiond_numerics::detectors::tally::quantile;

/// Resamples of a bootstrap interval: the standard error of its ends, `sqrt(0.025 0.975 / 4000) / 0.058` = 0.04 standard errors of
/// the mean, is a hundredth of its width.
const RESAMPLES: usize = 4000;

/// One-step errors of one record (PV unit): of the declared model, and of the model with the effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// On the held-out samples, as they are published.
    pub held_out: [f64; 2],
    /// On the samples behind the record's end.
    pub continued: [f64; 2],
}

impl Errors {
    /// Whether all of them have a logarithm.
    pub fn are_positive(&self) -> bool {
        self.held_out.iter().chain(&self.continued).all(|error| error.is_finite() && *error > 0.0)
    }

    /// `ln(continuation / held out)` of the declared model, and of the model with the effects.
    pub fn grown(&self) -> [f64; 2] {
        [0, 1].map(|model| (self.continued[model] / self.held_out[model]).ln())
    }

    /// `ln(after / before)` on the held-out samples, and on the continuation.
    pub fn gains(&self) -> [f64; 2] {
        [self.held_out, self.continued].map(|[before, after]| (after / before).ln())
    }

    /// See the head of this file.
    pub fn optimism(&self) -> f64 {
        let [held_out, continued] = self.gains();
        continued - held_out
    }
}

/// The mean of some values, and its 95 % interval by the bootstrap of their quantiles; `None` without values.
///
/// Source: Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13.
pub fn mean_with_interval(values: &[f64]) -> Option<(f64, [f64; 2])> {
    if values.is_empty() {
        return None;
    }
    let n = values.len();
    let mut draw = Pcg64Mcg::seed_from_u64(1);
    let mut mean = || (0..n).map(|_| values[draw.random_range(0..n)]).sum::<f64>() / n as f64;
    let means: Vec<f64> = (0..RESAMPLES).map(|_| mean()).collect();
    Some((values.iter().sum::<f64>() / n as f64, [quantile(&means, 0.025)?, quantile(&means, 0.975)?]))
}
