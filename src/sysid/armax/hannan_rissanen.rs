//! The starts of the fit by Hannan–Rissanen: linear least squares, with the errors of the high-order ARX in place of e.
//!
//! ```text
//! y[k] = -sum a_i y[k-i] + sum b_j x[k-nk-(j-1)] + sum c_i e_long[k-i] + c0 + sum gamma_m phi_m[k] + w[k]
//! ```
//!
//! All delays share one Gram matrix: it has the lags of x of every delay, and each delay solves a part of it.
//!
//! Source: Hannan & Rissanen, Biometrika 1982, 69, 81; Ljung, System Identification, 1999, section 10.2.

use super::model::{Armax, LONGEST_DELAY, ORDER, Signals};
use crate::sysid::arx::ArxFit;
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// A model to start from, and how well its regression fits.
#[derive(Clone, Debug)]
pub struct Start {
    /// The model. Its likelihood is not computed yet: minus infinity.
    pub model: Armax,
    /// Weighted mean square of the regression's residual (variances of PV).
    pub loss: f64,
}

/// A start for every delay `nk = 1..=LONGEST_DELAY`, the least loss first.
///
/// * `y`: PV (normalised).
/// * `signals`: the input at `theta`, the parameters of the hypothesis.
/// * `long`: the high-order ARX of the same signals; its errors and its weights omega are used.
pub fn hannan_rissanen(
    data: &IdData,
    y: &[f64],
    signals: &Signals,
    long: &ArxFit,
    theta: &[f64],
) -> Vec<Start> {
    let regression = Regression::new(data, y, signals, long);
    let start = |nk: usize| {
        let (coefficients, loss) = regression.solve(nk);
        let fixed = regression.fixed;
        let three = |from: usize| [coefficients[from], coefficients[from + 1], coefficients[from + 2]];
        let model = Armax {
            nk,
            a: three(0),
            c: three(ORDER),
            c0: coefficients[2 * ORDER],
            gamma: coefficients[2 * ORDER + 1..fixed].to_vec(),
            b: three(fixed),
            theta: theta.to_vec(),
            scale: long.scale,
            nu: long.nu,
            log_likelihood: f64::NEG_INFINITY,
        };
        Start { model, loss }
    };
    let mut starts: Vec<Start> = (1..=LONGEST_DELAY).map(start).collect();
    starts.sort_by(|a, b| a.loss.total_cmp(&b.loss));
    starts
}

/// The weighted normal equations of all delays.
///
/// Columns: lags 1..3 of -y, lags 1..3 of e, 1, the shapes, then all lags of x that any delay has.
struct Regression {
    /// Columns before those of x, which all delays share.
    fixed: usize,
    /// Number of columns.
    size: usize,
    /// Gram matrix, lower triangle; the products of two lags of x that no delay has together are not computed.
    gram: Vec<f64>,
    /// Products of the columns with y.
    right: Vec<f64>,
    /// Weighted sum of squares of y.
    power: f64,
    /// Sum of the weights.
    count: f64,
}

impl Regression {
    fn new(data: &IdData, y: &[f64], signals: &Signals, long: &ArxFit) -> Self {
        let rows = data.rows();
        let mut e = vec![0.0; data.split];
        e[rows.clone()].copy_from_slice(&long.e);
        let root: Vec<f64> = long.omega.iter().map(|omega| omega.sqrt()).collect();
        let lagged = |v: &[f64], lag: usize, sign: f64| -> Vec<f64> {
            rows.clone().zip(&root).map(|(k, root)| sign * root * v[k - lag]).collect()
        };
        let mut columns: Vec<Vec<f64>> = (1..=ORDER).map(|lag| lagged(y, lag, -1.0)).collect();
        columns.extend((1..=ORDER).map(|lag| lagged(&e, lag, 1.0)));
        columns.push(root.clone());
        columns.extend(signals.shapes.iter().map(|shape| lagged(shape, 0, 1.0)));
        let fixed = columns.len();
        columns.extend((1..LONGEST_DELAY + ORDER).map(|lag| lagged(&signals.x, lag, 1.0)));
        columns.push(lagged(y, 0, 1.0));
        let all: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let size = all.len() - 1;
        let (mut gram, mut right) = (vec![0.0; size * size], vec![0.0; size]);
        lower(&all[..fixed], &mut gram, size);
        // A model has three neighbouring lags of x, so products of lags farther apart are not needed.
        for (at, few) in all[fixed..size].chunks(4).enumerate() {
            let at = fixed + 4 * at;
            products(few, &all[..fixed], |i, j, sum| gram[(at + i) * size + j] = sum);
            let near = fixed.max(at - (ORDER - 1).min(at));
            products(few, &all[near..at + few.len()], |i, j, sum| gram[(at + i) * size + near + j] = sum);
        }
        products(&all[size..], &all[..size], |_, i, sum| right[i] = sum);
        let power = dot(all[size], all[size]);
        let count: f64 = long.omega.iter().sum::<f64>().max(1.0);
        Self { fixed, size, gram, right, power, count }
    }

    /// The coefficients with delay `nk`, those of B last, and the weighted mean square of the residual.
    fn solve(&self, nk: usize) -> (Vec<f64>, f64) {
        let Self { fixed, size, ref gram, ref right, .. } = *self;
        let which: Vec<usize> = (0..fixed).chain((0..ORDER).map(|j| fixed + nk - 1 + j)).collect();
        let order = which.len();
        let mut part = vec![0.0; order * order];
        for (i, &row) in which.iter().enumerate() {
            for (j, &column) in which[..=i].iter().enumerate() {
                part[i * order + j] = gram[row * size + column];
            }
        }
        let own: Vec<f64> = which.iter().map(|i| right[*i]).collect();
        let mut coefficients = own.clone();
        let mut live = [true; MOST_COLUMNS];
        factor(&mut part, order, order, &mut live);
        substitute(&part, order, &live, &mut coefficients);
        let loss = (self.power - dot(&own, &coefficients)).max(0.0) / self.count;
        (coefficients, loss)
    }
}
