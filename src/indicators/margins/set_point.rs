//! How well the moves of the set point alone tell the process of a closed loop.
//!
//! ```text
//! e = A yF - B uF,   yF = y/C, uF = u/C, rF = r/C       u OP, y PV, r set point, less their means
//! psi[k] = (-yF[k-1] …, uF[k-nk] …)                     derivatives of the prediction by A and B
//! zeta[k] = (rF[k-1], …, rF[k-m]),   m = nk + 20
//! M = W' S^-1 W,   W = Z' Psi, S = Z' Z                 cov(a, b) = s² M^-1,   s² = var e
//! ```
//!
//! That is the covariance of a two-stage least-squares estimate with the set point as the instrument. It is larger than that of the
//! fitted model, which counts what the noise of the loop tells as well: in a closed loop that is the controller as much as the process.
//! The set point must explain PV beyond chance: an F of 10 or more for its newest column.
//!
//! Source: Söderström & Stoica, System Identification, 1989, chapter 8 (instrumental variables); Staiger & Stock, Econometrica 1997,
//! 65, 557 (weak instruments, and the bound on F).

use crate::diagnosis::Model;
use crate::signal::{Row, Window};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::stats::mean;

/// Lags of the set point beyond the dead time of the process: a step is still seen when a loop of the usual speed has settled.
const LAGS: usize = 20;
/// Fewest rows for a lag: with fewer, so many lags would explain PV by chance.
const ROWS_A_LAG: usize = 5;
/// Least F by which the set point explains PV (-): Staiger & Stock.
const LEAST_F: f64 = 10.0;

/// What the set point tells of the coefficients of A and B.
pub struct Told {
    /// Cholesky factor of M.
    information: Vec<f64>,
    live: [bool; MOST_COLUMNS],
    /// Variance of the prediction errors (PV unit²).
    variance: f64,
}

impl Told {
    /// Of a window and the model that was fitted to it; none where the set point is not known, does not move enough, or moves in a way
    /// that does not tell all coefficients.
    pub fn of(window: &Window, model: &Model) -> Option<Self> {
        let n = window.len();
        let sp = window.sp.as_ref().filter(|sp| sp.len() == n && window.pv.len() == n)?;
        let lags = model.nk + LAGS;
        let size = model.a.len() + model.b.len();
        // Most set points rest, and need no regression.
        let rests = sp.windows(2).all(|two| two[0] == two[1]);
        if rests || lags > MOST_COLUMNS || size == 0 || model.a.len() > LAGS || model.b.len() > LAGS {
            return None;
        }
        let [u, y, r] = [&window.op, &window.pv, sp].map(|signal| filtered(signal, &model.c));
        // What the filter begins with has died away.
        let rows: Vec<usize> = (2 * lags..n).filter(|k| window.row(*k) == Row::Counts).collect();
        if rows.len() < ROWS_A_LAG * lags {
            return None;
        }
        let column = |signal: &[f64], lag: usize| -> Vec<f64> {
            let values: Vec<f64> = rows.iter().map(|k| signal[k - lag]).collect();
            let level = mean(&values);
            values.iter().map(|value| value - level).collect()
        };
        let instruments: Vec<Vec<f64>> = (1..=lags).map(|lag| column(&r, lag)).collect();
        let of_y = (1..=model.a.len()).map(|lag| column(&y, lag).iter().map(|y| -y).collect::<Vec<f64>>());
        let of_u = (0..model.b.len()).map(|lag| column(&u, model.nk + lag));
        let psi: Vec<Vec<f64>> = of_y.chain(of_u).collect();
        let (mut information, of_first) = explained(&instruments, &psi);
        let rest = (dot(&psi[0], &psi[0]) - of_first).max(0.0) / (rows.len() - lags) as f64;
        if of_first.is_nan() || of_first <= 0.0 || of_first / (lags as f64) < LEAST_F * rest {
            return None;
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut information, size, size, &mut live);
        // Of a coefficient that is not told nothing is known, and not everything.
        if live[..size].contains(&false) {
            return None;
        }
        let coefficients: Vec<f64> = model.a.iter().chain(&model.b).copied().collect();
        let newest = column(&y, 0);
        let told = |k: usize| psi.iter().zip(&coefficients).map(|(psi, c)| c * psi[k]).sum::<f64>();
        let errors: Vec<f64> = (0..rows.len()).map(|k| newest[k] - told(k)).collect();
        let variance = dot(&errors, &errors) / (rows.len() - size) as f64;
        Some(Self { information, live, variance })
    }

    /// Standard error of a number that changes by so much with each coefficient of A and then of B.
    pub fn error(&self, change: &[f64]) -> f64 {
        let mut solved = change.to_vec();
        substitute(&self.information, change.len(), &self.live, &mut solved);
        (self.variance * dot(change, &solved)).sqrt()
    }
}

/// M, and its first element: the sum of squares of the first column that the instruments explain.
fn explained(instruments: &[Vec<f64>], psi: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let (lags, size) = (instruments.len(), psi.len());
    let mut gram = vec![0.0; lags * lags];
    for (i, a) in instruments.iter().enumerate() {
        for (j, b) in instruments[..=i].iter().enumerate() {
            gram[i * lags + j] = dot(a, b);
        }
    }
    let mut live = [true; MOST_COLUMNS];
    factor(&mut gram, lags, lags, &mut live);
    let with = |psi: &Vec<f64>| -> Vec<f64> { instruments.iter().map(|own| dot(own, psi)).collect() };
    let common: Vec<Vec<f64>> = psi.iter().map(with).collect();
    let solved = |common: &Vec<f64>| {
        let mut solved = common.clone();
        substitute(&gram, lags, &live, &mut solved);
        solved
    };
    let solved: Vec<Vec<f64>> = common.iter().map(solved).collect();
    let information: Vec<f64> =
        (0..size * size).map(|at| dot(&common[at / size], &solved[at % size])).collect();
    let first = information.first().copied().unwrap_or_default();
    (information, first)
}

/// `(signal - mean) / C(q)`, from rest.
fn filtered(signal: &[f64], c: &[f64]) -> Vec<f64> {
    let level = mean(signal);
    let mut out: Vec<f64> = Vec::with_capacity(signal.len());
    for value in signal {
        let past: f64 = c.iter().zip(out.iter().rev()).map(|(c, past)| c * past).sum();
        out.push(value - level - past);
    }
    out
}
