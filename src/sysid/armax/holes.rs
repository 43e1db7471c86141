//! Errors where some samples do not count: the Kalman filter of the ARMAX model.
//!
//! ```text
//! y[k] = known[k] + x1[k] + e[k]          x[k+1] = F x[k] - a known[k] + K e[k]
//! F = [-a1 1 0; -a2 0 1; -a3 0 0]         K = c - a,    h = [1 0 0]
//! S = P11 + 1,   L = (F P h' + K) / S,    P[k+1] = F P F' + K K' - L L' S
//! ```
//!
//! `known` is what OP and loads do, `P` what is not known of the state (errors' variance). Where nothing was ever missing P is 0
//! and L is K: the errors are those of the recursion. Behind a hole a prediction is less exact, `S > 1`: its error is divided
//! by `sqrt S`, and soon enough L has found the state again. A row that is right but says nothing passes PV on, not its error.
//!
//! Source: Harvey & Pierse, J. Am. Stat. Assoc. 1984, 79, 125.

use super::{Armax, ORDER};
use crate::sysid::iddata::IdData;

/// Variance of the state below which it is known again.
const KNOWN: f64 = 1e-10;

/// How an error passes on at each sample; empty where all samples count.
#[derive(Clone, Debug, Default)]
pub struct Gains {
    /// `a + L`: what the prediction takes of a disturbance, K + a = c where nothing is missing.
    gain: Vec<[f64; ORDER]>,
    /// `sqrt S`.
    pub root: Vec<f64>,
    /// The likeliest error of each sample, `(y - predicted) / S`.
    pub likeliest: Vec<f64>,
}

/// P, full and symmetric, row by row.
type Covariance = [[f64; ORDER]; ORDER];

impl Gains {
    /// Whether all samples count.
    pub fn is_empty(&self) -> bool {
        self.gain.is_empty()
    }

    /// `sum ln sqrt S` over the rows that count: what the likelihood loses.
    pub fn lost(&self, data: &IdData) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let rows = data.rows();
        rows.filter(|k| data.weight[*k] > 0.0).map(|k| self.root[k].ln()).sum()
    }

    /// What a change of `direct`, and of the state's entry `at` by `source`, does to the prediction of each sample, in its own
    /// standard deviation.
    pub fn through(
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
    /// The errors from `begin` on, each in its own standard deviation; PV is filled with its prediction where it is missing.
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
        // Before the recursion starts there are no errors, so that no change passes on.
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
                    .map(|p| self.observed(&p, &gain, s))
                    .filter(|p| p.iter().flatten().any(|v| v.abs() > KNOWN));
                (gain, s.sqrt())
            } else if data.known[k] {
                p = Some(self.passed(&p.unwrap_or_default()));
                (a.map(|a| -a), 1.0)
            } else {
                p = Some(self.unseen(&p.unwrap_or_default()));
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
    fn advanced(&self, p: &Covariance) -> Covariance {
        std::array::from_fn(|i| {
            std::array::from_fn(|j| p.get(i + 1).map_or(0.0, |next| next[j]) - self.a[i] * p[0][j])
        })
    }

    /// L and S.
    fn gain(&self, p: &Covariance) -> ([f64; ORDER], f64) {
        let (fp, s) = (self.advanced(p), p[0][0] + 1.0);
        (std::array::from_fn(|i| (fp[i][0] + self.c[i] - self.a[i]) / s), s)
    }

    /// P behind a sample that is missing: `F P F' + K K'`.
    fn unseen(&self, p: &Covariance) -> Covariance {
        let fp = self.advanced(p);
        let k: [f64; ORDER] = std::array::from_fn(|i| self.c[i] - self.a[i]);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                fp[i].get(j + 1).copied().unwrap_or(0.0) - self.a[j] * fp[i][0] + k[i] * k[j]
            })
        })
    }

    /// P behind one that counts.
    fn observed(&self, p: &Covariance, gain: &[f64; ORDER], s: f64) -> Covariance {
        let whole = self.unseen(p);
        std::array::from_fn(|i| std::array::from_fn(|j| whole[i][j] - gain[i] * gain[j] * s))
    }

    /// P behind one whose PV is right and whose error is left out: the state is shifted and lacks `c e`.
    fn passed(&self, p: &Covariance) -> Covariance {
        let c = self.c;
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let shifted = if i + 1 < ORDER && j + 1 < ORDER { p[i + 1][j + 1] } else { 0.0 };
                shifted + c[i] * c[j]
            })
        })
    }
}
