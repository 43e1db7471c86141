//! The prediction errors of an ARMAX model, and its likelihood at them.
//!
//! ```text
//! e[k] = A(q) (y[k] - o[k]) - B(q) x[k-nk] - c0 - sum_m gamma_m phi_m[k] - c1 e[k-1] - c2 e[k-2] - c3 e[k-3]
//! ```
//!
//! Where samples do not count, the Kalman filter takes the place of this recursion (`kalman`).

use super::kalman::Gains;
use super::model::{Armax, ORDER, Signals};
use crate::sysid::iddata::IdData;
use crate::sysid::student;

/// PV with its missing samples filled, and the prediction errors.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    /// PV less the offset; where PV is missing, its prediction.
    pub y: Vec<f64>,
    /// Prediction errors `e / sqrt S` (standard deviations of PV); 0 before the recursion starts and where PV does not count.
    pub e: Vec<f64>,
    /// What the Kalman filter found, with `sqrt S`; empty where all samples count, because S is 1 then.
    pub gains: Gains,
}

impl Errors {
    /// Takes the first `to` samples of PV, less the offset, and sets the errors to 0.
    pub(super) fn reset(&mut self, y: &[f64], signals: &Signals, to: usize) {
        self.y.clear();
        self.y.extend_from_slice(&y[..to]);
        self.y.iter_mut().zip(&signals.offset).for_each(|(y, offset)| *y -= offset);
        self.e.clear();
        self.e.resize(to, 0.0);
    }
}

impl Armax {
    /// The first sample whose error can be computed: all of its lags lie after the start of the stem.
    pub fn begin(&self, data: &IdData) -> usize {
        data.start.index + 1 + self.nk + ORDER
    }

    /// The errors of the one-step prediction, `e = (A (y - o) - B x - c0 - sum gamma phi) / C`, of the first `to` samples.
    ///
    /// * `y`: PV (normalised).
    /// * `signals`: the input at the parameters of this model.
    pub fn errors(&self, data: &IdData, y: &[f64], signals: &Signals, to: usize) -> Errors {
        let mut out = Errors::default();
        out.reset(y, signals, to);
        self.errors_into(data, signals, &mut out);
        out
    }

    /// The same into `out`, which holds PV already ([`Errors::reset`]).
    pub(super) fn errors_into(&self, data: &IdData, signals: &Signals, out: &mut Errors) {
        let Errors { y, e, gains } = out;
        let begin = self.begin(data);
        let to = y.len();
        let known = self.input_terms(signals, begin, to);
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
            // The newest error is subtracted last, because it is the last to be computed.
            *e = *e - c3 * e3 - c2 * e2 - c1 * e1;
            (e1, e2, e3) = (*e, e1, e2);
        }
    }

    /// The terms without y and e: `B(q) x[k-nk] + c0 + sum gamma_m phi_m[k]` of the first `to` samples, B from sample `begin` on.
    fn input_terms(&self, signals: &Signals, begin: usize, to: usize) -> Vec<f64> {
        let x = &signals.x;
        let mut known = vec![self.c0; to];
        for (j, b) in self.b.iter().enumerate() {
            let lag = self.nk + j;
            known[begin..].iter_mut().zip(&x[begin - lag..]).for_each(|(known, x)| *known += b * x);
        }
        for (gamma, shape) in self.gamma.iter().zip(&signals.shapes) {
            known.iter_mut().zip(shape).for_each(|(known, shape)| *known += gamma * shape);
        }
        known
    }

    /// Estimates the scale s for these errors and takes the log-likelihood at it; with `estimate_nu` nu is estimated as well.
    pub(super) fn update_likelihood(&mut self, data: &IdData, errors: &Errors, estimate_nu: bool) {
        let rows = data.rows();
        let (e, weight) = (&errors.e[rows.clone()], &data.weight[rows]);
        let half_log_det = errors.gains.half_log_det(data);
        if !e.iter().all(|e| e.is_finite() && e.abs() < 1e9) {
            self.log_likelihood = f64::NEG_INFINITY;
            return;
        }
        let guess = if self.scale > 0.0 { self.scale } else { student::first_scale(e, weight) };
        if estimate_nu {
            (self.scale, self.nu, self.log_likelihood) =
                student::tails(e, weight, (guess, self.nu), data.least_scale);
            self.log_likelihood -= half_log_det;
            return;
        }
        self.scale = student::scale(e, weight, guess, self.nu, data.least_scale);
        self.log_likelihood = student::log_likelihood(e, weight, self.scale, self.nu) - half_log_det;
    }
}
