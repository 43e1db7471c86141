//! ARMAX of order 3 with Student-t errors, fitted by maximum likelihood. Every hypothesis of tracing is fitted with it.
//!
//! ```text
//! A(q) (y[k] - o[k]) = B(q) x[k-nk] + c0 + sum_m gamma_m phi_m[k] + C(q) e[k]
//! A = 1 + a1 q^-1 + a2 q^-2 + a3 q^-3,   B = b1 + b2 q^-1 + b3 q^-2,   C as A, zeros inside |q| = 0.98
//! ```
//!
//! | symbol | what it is |
//! |---|---|
//! | `y`, `o` | PV, and an offset that PV shows beside the output of the process |
//! | `x` | the stem as it acts on the process |
//! | `phi`, `gamma` | shapes of loads, and their coefficients |
//! | `nk` | dead time (samples) |
//! | `e` | prediction errors: independent, of Student's t ([`super::student`]) |
//!
//! All signals are normalised: deviations from their means, in standard deviations.
//! `x`, `phi` and `o` may depend on parameters `theta` of the hypothesis, which are estimated with the coefficients.
//! Where PV is missing, its prediction takes its place, and the row does not count (`kalman`).
//!
//! * Model (`model`): orders, coefficients, and the signals of a hypothesis.
//! * Errors (`errors`): the one-step predictions, and the likelihood.
//! * Start (`hannan_rissanen`): least squares with the errors of the high-order ARX in place of e.
//! * Gradient (`gradient`): lags of y, x and e, each filtered by 1/C.
//! * Maximisation: Levenberg–Marquardt on the reweighted errors.
//!
//! Source: Ljung, System Identification, 1999, sections 10.2 (start) and 10.3 (gradient); Hannan & Rissanen, Biometrika
//! 1982, 69, 81.

mod errors;
mod gradient;
mod hannan_rissanen;
mod kalman;
mod model;

pub use errors::Errors;
pub use gradient::{Gradient, filtered, filtered_all};
pub use hannan_rissanen::{Start, hannan_rissanen};
pub use model::{Armax, Input, LONGEST_DELAY, ORDER, RHO, Signals, Smooth};

use super::iddata::IdData;
use super::zeros::draw_inside;
use gradient::NormalEquations;

/// Increase of the log-likelihood below which the iterations end: far below what any decision rests on.
const SETTLED: f64 = 0.02;
/// First damping of Levenberg–Marquardt, and the factor by which it grows and shrinks. The optimum does not depend on them.
const DAMPING: (f64, f64) = (1e-3, 8.0);
/// Most steps tried in one iteration, each with a larger damping than the one before.
const TRIES: usize = 5;

impl Armax {
    /// Maximises the likelihood from this model on by Levenberg–Marquardt, in at most `most` iterations.
    ///
    /// * `y`: PV (normalised).
    /// * `input`: the hypothesis; where this model has another number of `theta`, they start at its values.
    ///
    /// The log-likelihood of the result is minus infinity where the errors overflow.
    pub fn fit(mut self, data: &IdData, y: &[f64], input: &dyn Input, most: usize) -> Self {
        draw_inside(&mut self.c, RHO);
        let smooth = input.smooth();
        if self.theta.len() != smooth.len() {
            self.theta = smooth.iter().map(|s| s.value).collect();
        }
        let mut signals = input.signals(&self.theta);
        self.gamma.resize(signals.shapes.len(), 0.0);
        let mut errors = self.errors(data, y, &signals, data.split);
        // nu is estimated where a fit begins and where it ends, and kept in between.
        self.update_likelihood(data, &errors, true);
        let mut trial = Errors::default();
        let mut damping = DAMPING.0;
        for _ in 0..most {
            let normal = NormalEquations::new(data, &self, &smooth, &signals, input, &errors);
            let mut gained = 0.0;
            for _ in 0..TRIES {
                let mut next = normal.step(&self, &smooth, damping);
                draw_inside(&mut next.c, RHO);
                let moved = next.theta != self.theta;
                let moved_signals = moved.then(|| input.signals(&next.theta));
                let next_signals = moved_signals.as_ref().unwrap_or(&signals);
                trial.reset(y, next_signals, data.split);
                next.errors_into(data, next_signals, &mut trial);
                // A start that diverges has no estimate of nu.
                next.update_likelihood(data, &trial, !self.log_likelihood.is_finite());
                if next.log_likelihood > self.log_likelihood {
                    gained = next.log_likelihood - self.log_likelihood;
                    self = next;
                    signals = moved_signals.unwrap_or(signals);
                    std::mem::swap(&mut errors, &mut trial);
                    damping = (damping / DAMPING.1).max(1e-9);
                    break;
                }
                damping *= DAMPING.1;
            }
            if gained < SETTLED {
                break;
            }
        }
        // A model that explains outliers leaves lighter tails than the start had.
        self.update_likelihood(data, &errors, true);
        self
    }
}

#[cfg(test)]
mod tests;
