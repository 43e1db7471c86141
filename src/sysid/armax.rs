//! The model that decides: ARMAX of order 3 with Student-t errors, fitted by prediction error.
//!
//! ```text
//! A(q) y[k] = B(q) x[k-nk] + c0 + sum_m gamma_m phi_m[k] + C(q) e[k]
//! A = 1 + a1 q^-1 + a2 q^-2 + a3 q^-3,   B = b1 + b2 q^-1 + b3 q^-2,   C as A, zeros inside |q| = 0.98
//! ```
//!
//! `x` and the shapes `phi` may depend on parameters `theta` of the hypothesis in which the likelihood is smooth; they are
//! estimated with the coefficients. Where PV is missing its prediction takes its place: the row does not count, and those
//! behind it count for less until the state is known again (`holes`).
//!
//! Start: Hannan–Rissanen with the errors of the high-order ARX. Gradient: lags of y, x and e filtered by 1/C, so that one
//! pass of filters serves all coefficients. Minimisation: Levenberg–Marquardt on the reweighted errors.
//!
//! Source: Ljung, System Identification, 1999, sections 10.2 (start) and 10.3 (gradient); Hannan & Rissanen, Biometrika
//! 1982, 69, 81.

mod gradient;
mod holes;
mod start;

pub use start::{Start, hannan_rissanen};

use super::iddata::IdData;
use super::student;
use super::zeros::draw_inside;
use gradient::Normal;
pub use gradient::{Gradient, filtered};
use holes::Gains;

/// `na = nb = nc` of every model.
pub const ORDER: usize = 3;
/// Longest delay nk (samples).
pub const LONGEST_DELAY: usize = 12;
/// Largest modulus of a zero of C: beyond it the start of the record is never forgotten.
pub const RHO: f64 = 0.98;
/// Increase of the log-likelihood below which an iteration is the last: far below what any decision rests on.
const SETTLED: f64 = 0.02;
/// Damping at first, and the factor by which it grows and shrinks: bounds on effort, the optimum does not depend on them.
const DAMPING: (f64, f64) = (1e-3, 8.0);
/// Steps tried in one iteration.
const TRIES: usize = 5;

/// What a model is driven by at one value of its hypothesis' parameters.
#[derive(Clone, Debug, Default)]
pub struct Signals {
    /// The stem as the process sees it.
    pub x: Vec<f64>,
    /// Shapes of loads.
    pub shapes: Vec<Vec<f64>>,
    /// What PV shows beside the process' output: subtracted first; empty for nothing.
    pub offset: Vec<f64>,
}

/// A smooth parameter of a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smooth {
    /// Its value.
    pub value: f64,
    /// Step of a difference quotient.
    pub step: f64,
    /// Least and largest value.
    pub bounds: (f64, f64),
}

/// What is fitted: a stem and shapes that may depend on smooth parameters.
pub trait Input {
    /// The smooth parameters.
    fn smooth(&self) -> Vec<Smooth>;
    /// The signals at values of these parameters.
    fn signals(&self, theta: &[f64]) -> Signals;
}

/// A fitted model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Armax {
    /// Delay (samples).
    pub nk: usize,
    /// `a1..a3`.
    pub a: [f64; ORDER],
    /// `b1..b3`.
    pub b: [f64; ORDER],
    /// `c1..c3`.
    pub c: [f64; ORDER],
    /// Constant.
    pub c0: f64,
    /// Coefficients of the shapes.
    pub gamma: Vec<f64>,
    /// Smooth parameters of the hypothesis.
    pub theta: Vec<f64>,
    /// Scale of the errors.
    pub scale: f64,
    /// Their degrees of freedom (-).
    pub nu: f64,
    /// Log-likelihood of the fitted rows.
    pub log_likelihood: f64,
}

/// PV with its missing samples filled, and the errors.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// PV; its prediction where it is missing.
    pub y: Vec<f64>,
    /// Prediction errors, behind a hole in their own standard deviation; 0 before the recursion starts and where PV is missing.
    pub e: Vec<f64>,
    /// How they pass on.
    pub gains: Gains,
}

impl Errors {
    /// PV anew, less its offset, and no errors yet.
    fn restart(&mut self, y: &[f64], signals: &Signals, to: usize) {
        self.y.clear();
        self.y.extend_from_slice(&y[..to]);
        self.y.iter_mut().zip(&signals.offset).for_each(|(y, offset)| *y -= offset);
        self.e.clear();
        self.e.resize(to, 0.0);
    }
}

impl Armax {
    /// First sample whose error can be computed.
    pub fn begin(&self, data: &IdData) -> usize {
        data.start.index + 1 + self.nk + ORDER
    }

    /// One-step errors up to sample `to`.
    pub fn errors(&self, data: &IdData, y: &[f64], signals: &Signals, to: usize) -> Errors {
        let mut out = Errors::default();
        out.restart(y, signals, to);
        self.errors_into(data, signals, &mut out);
        out
    }

    fn errors_into(&self, data: &IdData, signals: &Signals, out: &mut Errors) {
        let Errors { y, e, gains } = out;
        let x = &signals.x;
        let begin = self.begin(data);
        let to = y.len();
        // What no error enters, by passes that become vectors; then the recursion.
        let mut known = vec![self.c0; to];
        for (j, b) in self.b.iter().enumerate() {
            let lag = self.nk + j;
            known[begin..].iter_mut().zip(&x[begin - lag..]).for_each(|(known, x)| *known += b * x);
        }
        for (gamma, shape) in self.gamma.iter().zip(&signals.shapes) {
            known.iter_mut().zip(shape).for_each(|(known, shape)| *known += gamma * shape);
        }
        if data.weight[..to].contains(&0.0) {
            self.filter(data, &known, begin, y, e, gains);
            return;
        }
        let ([a1, a2, a3], [c1, c2, c3]) = (self.a, self.c);
        for (k, e) in e.iter_mut().enumerate().take(to).skip(begin) {
            *e = y[k] + a1 * y[k - 1] + a2 * y[k - 2] + a3 * y[k - 3] - known[k];
        }
        let (mut e1, mut e2, mut e3) = (0.0, 0.0, 0.0);
        for e in &mut e[begin..to] {
            // The newest error comes last: the processor has the other terms by then.
            *e = *e - c3 * e3 - c2 * e2 - c1 * e1;
            (e1, e2, e3) = (*e, e1, e2);
        }
    }

    /// The log-likelihood of these errors at the scale that is likeliest; `anew`: nu is estimated, too.
    fn rate(&mut self, data: &IdData, errors: &Errors, anew: bool) {
        let rows = data.rows();
        let (e, weight, lost) = (&errors.e[rows.clone()], &data.weight[rows], errors.gains.lost(data));
        if !e.iter().all(|e| e.is_finite() && e.abs() < 1e9) {
            self.log_likelihood = f64::NEG_INFINITY;
            return;
        }
        let guess = if self.scale > 0.0 { self.scale } else { student::first_scale(e, weight) };
        if anew {
            (self.scale, self.nu, self.log_likelihood) =
                student::tails(e, weight, (guess, self.nu), data.least_scale);
            self.log_likelihood -= lost;
            return;
        }
        self.scale = student::scale(e, weight, guess, self.nu, data.least_scale);
        self.log_likelihood = student::log_likelihood(e, weight, self.scale, self.nu) - lost;
    }

    /// Maximises the likelihood from this model on, in at most `most` iterations.
    pub fn fit(mut self, data: &IdData, y: &[f64], input: &dyn Input, most: usize) -> Self {
        draw_inside(&mut self.c, RHO);
        let smooth = input.smooth();
        if self.theta.len() != smooth.len() {
            self.theta = smooth.iter().map(|s| s.value).collect();
        }
        let mut signals = input.signals(&self.theta);
        self.gamma.resize(signals.shapes.len(), 0.0);
        let mut at = self.errors(data, y, &signals, data.split);
        // The tails are estimated anew where a fit begins.
        self.rate(data, &at, true);
        let mut trial = Errors::default();
        let mut damping = DAMPING.0;
        for _ in 0..most {
            let normal = Normal::new(data, &self, &smooth, &signals, input, &at);
            let mut gained = 0.0;
            for _ in 0..TRIES {
                let mut next = normal.step(&self, &smooth, damping);
                draw_inside(&mut next.c, RHO);
                let moved = next.theta != self.theta;
                let other = moved.then(|| input.signals(&next.theta));
                let with = other.as_ref().unwrap_or(&signals);
                trial.restart(y, with, data.split);
                next.errors_into(data, with, &mut trial);
                // From a start that diverges nu is not known yet.
                next.rate(data, &trial, !self.log_likelihood.is_finite());
                if next.log_likelihood > self.log_likelihood {
                    gained = next.log_likelihood - self.log_likelihood;
                    self = next;
                    signals = other.unwrap_or(signals);
                    std::mem::swap(&mut at, &mut trial);
                    damping = (damping / DAMPING.1).max(1e-9);
                    break;
                }
                damping *= DAMPING.1;
            }
            if gained < SETTLED {
                break;
            }
        }
        // What explains outliers leaves lighter tails than the start had.
        self.rate(data, &at, true);
        self
    }
}

#[cfg(test)]
mod tests;
