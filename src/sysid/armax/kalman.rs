//! The prediction errors where some samples do not count: the Kalman filter of the ARMAX model.
//!
//! The model in innovations form, with the state x of three entries:
//!
//! ```text
//! y[k] = known[k] + x1[k] + e[k]          x[k+1] = F x[k] - a known[k] + K e[k]
//! F = [-a1 1 0; -a2 0 1; -a3 0 0]         K = c - a,    h = [1 0 0]
//! S = P11 + 1,   L = (F P h' + K) / S,    P[k+1] = F P F' + K K' - L L' S
//! ```
//!
//! | symbol | what it is | unit |
//! |---|---|---|
//! | `known` | what the stem, the loads and the constant do to PV | PV |
//! | `P` | covariance of the error of the state | variance of e |
//! | `S` | variance of the prediction error | variance of e |
//! | `L` | gain of the filter | – |
//!
//! * Before anything is missing, `P = 0` and `L = K`: the errors are those of the plain recursion.
//! * A missing sample has no error. It adds `K K'` to P, and its prediction takes the place of PV.
//! * After it, `S > 1`. The error is divided by `sqrt S`, until P is 0 again.
//! * A sample with the right PV that must not count ([`IdData::known`]) hands on PV, but no error.
//!
//! Source: Harvey & Pierse, J. Am. Stat. Assoc. 1984, 79, 125.

use super::model::{Armax, ORDER};
use crate::sysid::iddata::IdData;

/// Variance of the state (variances of e) below which the state is known again.
const KNOWN: f64 = 1e-10;

/// What the filter found at each sample; empty where all samples count.
#[derive(Clone, Debug, Default)]
pub struct Gains {
    /// `a + L`: how the prediction error enters the next state. It is c where nothing is missing.
    gain: Vec<[f64; ORDER]>,
    /// `sqrt S`: standard deviation of the prediction error (standard deviations of e).
    pub root: Vec<f64>,
    /// The expectation of e given the prediction error: `(y - predicted) / S` (PV unit).
    pub likeliest: Vec<f64>,
}

/// The covariance P: full, symmetric, row by row.
type Covariance = [[f64; ORDER]; ORDER];

impl Gains {
    /// Whether all samples count.
    pub fn is_empty(&self) -> bool {
        self.gain.is_empty()
    }

    /// `sum of ln sqrt S` over the rows that count: half the logarithm of the determinant of the errors' covariance.
    ///
    /// The log-likelihood of the scaled errors is too large by it.
    pub fn half_log_det(&self, data: &IdData) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let rows = data.rows();
        rows.filter(|k| data.weight[*k] > 0.0).map(|k| self.root[k].ln()).sum()
    }

    /// The derivative of each prediction by a parameter, divided by `sqrt S`; 0 before `begin`.
    ///
    /// * `direct`: derivative of `known[k]` by the parameter.
    /// * `source`: entry (0..2) of the next state that the parameter enters, its sign, and the signal it multiplies.
    pub fn sensitivity(
        &self,
        begin: usize,
        direct: impl Fn(usize) -> f64,
        source: Option<(usize, f64, &[f64])>,
    ) -> Vec<f64> {
        let mut out = vec![0.0; self.gain.len()];
        let [mut x1, mut x2, mut x3] = [0.0; ORDER];
        for (k, out) in out.iter_mut().enumerate().skip(begin) {
            let value = direct(k) + x1;
            *out = value / self.root[k];
            let [g1, g2, g3] = self.gain[k];
            (x1, x2, x3) = (x2 - g1 * value, x3 - g2 * value, -g3 * value);
            if let Some((at, sign, source)) = source {
                let by = sign * source[k];
                match at {
                    0 => x1 += by,
                    1 => x2 += by,
                    _ => x3 += by,
                }
            }
        }
        out
    }
}

impl Armax {
    /// Runs the filter from sample `begin` on.
    ///
    /// * `known`: what the stem, the loads and the constant do to PV (PV unit).
    /// * `y`: PV; a missing sample receives its prediction.
    /// * `e`: receives the prediction errors, each divided by its `sqrt S`; it must come filled with 0.
    /// * `gains`: receives what [`Gains`] lists.
    pub(super) fn filter(
        &self,
        data: &IdData,
        known: &[f64],
        begin: usize,
        y: &mut [f64],
        e: &mut [f64],
        gains: &mut Gains,
    ) {
        let (a, c, to) = (self.a, self.c, y.len());
        let steady: [f64; ORDER] = std::array::from_fn(|i| c[i] - a[i]);
        gains.gain.clear();
        // There are no errors before the recursion starts, so the gain is 0 there.
        gains.gain.resize(to, [0.0; ORDER]);
        gains.root.clear();
        gains.root.resize(to, 1.0);
        gains.likeliest.clear();
        gains.likeliest.resize(to, 0.0);
        let [y1, y2, y3] = [1, 2, 3].map(|lag| y[begin - lag]);
        let mut x = [-(a[0] * y1 + a[1] * y2 + a[2] * y3), -(a[1] * y1 + a[2] * y2), -a[2] * y1];
        let mut p: Option<Covariance> = None;
        for k in begin..to {
            let predicted = known[k] + x[0];
            let counts = data.weight[k] > 0.0;
            if !(counts || data.known[k]) {
                y[k] = predicted;
            }
            let error = y[k] - predicted;
            let (gain, root) = if counts {
                let (gain, s) = p.as_ref().map_or((steady, 1.0), |p| self.gain(p));
                (e[k], gains.likeliest[k]) = (error / s.sqrt(), error / s);
                p = p
                    .map(|p| self.covariance_after_counted(&p, &gain, s))
                    .filter(|p| p.iter().flatten().any(|v| v.abs() > KNOWN));
                (gain, s.sqrt())
            } else if data.known[k] {
                p = Some(self.covariance_after_known(&p.unwrap_or_default()));
                (a.map(|a| -a), 1.0)
            } else {
                p = Some(self.covariance_after_missing(&p.unwrap_or_default()));
                ([0.0; ORDER], 1.0)
            };
            gains.root[k] = root;
            gains.gain[k] = std::array::from_fn(|i| a[i] + gain[i]);
            x = std::array::from_fn(|i| {
                x.get(i + 1).copied().unwrap_or(0.0) - a[i] * predicted + gain[i] * error
            });
        }
    }

    /// `F P`.
    fn f_times(&self, p: &Covariance) -> Covariance {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| p.get(i + 1).map_or(0.0, |next| next[j]) - self.a[i] * p[0][j])
        })
    }

    /// The gain L and the variance S of the prediction error.
    fn gain(&self, p: &Covariance) -> ([f64; ORDER], f64) {
        let (fp, s) = (self.f_times(p), p[0][0] + 1.0);
        (std::array::from_fn(|i| (fp[i][0] + self.c[i] - self.a[i]) / s), s)
    }

    /// P after a missing sample: `F P F' + K K'`.
    fn covariance_after_missing(&self, p: &Covariance) -> Covariance {
        let fp = self.f_times(p);
        let k: [f64; ORDER] = std::array::from_fn(|i| self.c[i] - self.a[i]);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                fp[i].get(j + 1).copied().unwrap_or(0.0) - self.a[j] * fp[i][0] + k[i] * k[j]
            })
        })
    }

    /// P after a sample that counts: `F P F' + K K' - L L' S`.
    fn covariance_after_counted(&self, p: &Covariance, gain: &[f64; ORDER], s: f64) -> Covariance {
        let whole = self.covariance_after_missing(p);
        std::array::from_fn(|i| std::array::from_fn(|j| whole[i][j] - gain[i] * gain[j] * s))
    }

    /// P after a sample whose PV is right and whose error is left out.
    ///
    /// The next state is then `x_i[k+1] = x_{i+1}[k] - a_i y[k] + c_i e[k]` with an unknown e: P is shifted and grows by `c c'`.
    fn covariance_after_known(&self, p: &Covariance) -> Covariance {
        let c = self.c;
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let shifted = if i + 1 < ORDER && j + 1 < ORDER { p[i + 1][j + 1] } else { 0.0 };
                shifted + c[i] * c[j]
            })
        })
    }
}
