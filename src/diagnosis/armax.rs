//! The ARMAX model of the declared diagnosis, with free orders, fitted by least squares of the prediction errors.
//!
//! ```text
//! A(q) y[k] = B(q) z[k] + c0 + C(q) e[k]
//! A(q) = 1 + a1 q^-1 + … + a_na q^-na
//! B(q) = b1 q^-nk + … + b_nb q^-(nk+nb-1)
//! C(q) = 1 + c1 q^-1 + … + c_nc q^-nc        zeros inside |q| = RHO
//! z[k] = x[k] - lag dir[k]                    stem position; lag = 0 is the paper's element
//! ```
//!
//! `y` is PV, `x` the stem of the friction element, `dir` the direction of its last move, `lag` the kinetic lag (S - J)/2.
//! The loss is `V = mean of e²`. Levenberg–Marquardt minimises it from a Hannan–Rissanen start ([`super::screen`]).
//! The gradient has lags of y, z and e, each filtered by 1/C, so each iteration filters once and forms one Gram matrix
//! (`normal_equations`).
//!
//! Tracing fits another ARMAX, of fixed orders and with Student-t errors: [`crate::sysid::armax`].
//!
//! Source: Ljung, System Identification, 2nd ed., sections 10.3 and 7.4.

mod filters;
mod model;
mod normal_equations;

pub use model::{Lag, MAX_PARAMETERS, ORDER, Orders, Theta, splits};

use super::lagged_products::Counted;
use crate::signal::Row;
pub use crate::sysid::armax::RHO;
use crate::sysid::least_squares::{dot_long, total};
pub use crate::sysid::zeros::{draw_inside, is_inside};
use filters::{add_scaled, combine, filter4, whiten};
use normal_equations::{CONSTANT, NormalEquations};

/// Smallest loss relative to var(y): below it rounding decides, not the data.
pub const LOSS_FLOOR: f64 = 1e-13;

/// The signals of one fit, all of one length.
#[derive(Clone, Copy, Debug)]
pub struct Signals<'a> {
    /// PV.
    pub y: &'a [f64],
    /// Stem position of the friction element (OP unit).
    pub x: &'a [f64],
    /// Direction of the last move of the stem, +1 or -1.
    pub dir: &'a [f64],
    /// First sample at which `x` is valid.
    pub start: usize,
    /// First sample that counts in the loss; at least `start + 1 +` the longest lag.
    pub first: usize,
    /// Which samples after `first` do not count.
    pub rows: Rows<'a>,
}

/// The samples that do not count in the loss.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rows<'a> {
    /// Their indices from `first` on, in order.
    pub left_out: &'a [usize],
    /// The kind of every sample; empty where all count. Where y is missing, its prediction takes its place.
    pub worth: &'a [Row],
}

impl<'a> Signals<'a> {
    /// The samples that count.
    pub fn counted(&self) -> Counted<'a> {
        Counted { first: self.first, left_out: self.rows.left_out }
    }
}

/// The result of a fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// Orders.
    pub orders: Orders,
    /// Coefficients at the minimum.
    pub theta: Theta,
    /// Loss `V = mean e²` (PV unit²).
    pub loss: f64,
    /// Iterations used.
    pub iterations: usize,
}

/// Buffers of the prediction-error minimisation, allocated once for a record and used by every fit.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    /// `x - lag dir`.
    z: Vec<f64>,
    /// `A y - B z - c0`.
    w: Vec<f64>,
    /// Prediction errors `w / C`.
    e: Vec<f64>,
    /// y of the last evaluation, with its predictions where it is missing.
    filled: Vec<f64>,
    /// y, z, e and dir, each divided by C.
    filtered: [Vec<f64>; 4],
    /// The derivative of e by the lag.
    lag_column: Vec<f64>,
}

impl Workspace {
    /// Buffers for records of `n` samples.
    pub fn new(n: usize) -> Self {
        let buffer = || vec![0.0; n];
        Self {
            z: buffer(),
            w: buffer(),
            e: buffer(),
            filled: buffer(),
            filtered: std::array::from_fn(|_| buffer()),
            lag_column: buffer(),
        }
    }

    /// The prediction errors e of the last evaluation, one for each sample; 0 before the recursion starts.
    pub fn errors(&self) -> &[f64] {
        &self.e
    }

    /// Sets the stem position to `z = x - lag dir`.
    pub(super) fn load_stem(&mut self, s: &Signals<'_>, lag: f64) {
        for ((z, &x), &dir) in self.z.iter_mut().zip(s.x).zip(s.dir) {
            *z = x - lag * dir;
        }
    }

    /// `y / C` and `z / C`, for the z of the last [`Workspace::load_stem`].
    pub(super) fn divide_by_c(&mut self, s: &Signals<'_>, c: &[f64]) -> [&[f64]; 2] {
        self.filled[..s.y.len()].copy_from_slice(s.y);
        self.filter_all(s, c);
        let [y, z, ..] = &self.filtered;
        [y, z]
    }

    /// The loss V at `theta` (PV unit²); the prediction errors are in [`Workspace::errors`] after it.
    ///
    /// It is infinite where the recursion overflows, so that such a step is refused.
    pub fn evaluate(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta) -> f64 {
        self.load_stem(s, theta.lag);
        self.loss(s, orders, theta)
    }

    /// [`Workspace::evaluate`] for the z of the last [`Workspace::load_stem`].
    fn loss(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta) -> f64 {
        let n = s.y.len();
        let begin = s.start + 1 + orders.na.max(orders.nk + orders.nb - 1);
        self.e[..begin].fill(0.0);
        if s.rows.worth.is_empty() {
            self.errors_of_complete(s, orders, theta, begin);
        } else {
            self.errors_with_missing(s, orders, theta, begin);
        }
        let counted = &self.e[s.first..n];
        let left_out: f64 = s.rows.left_out.iter().map(|k| self.e[*k] * self.e[*k]).sum();
        let loss = (dot_long(counted, counted) - left_out) / (counted.len() - s.rows.left_out.len()) as f64;
        if loss.is_finite() { loss.max(0.0) } else { f64::INFINITY }
    }

    /// The errors from sample `begin` on, where every sample counts.
    fn errors_of_complete(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta, begin: usize) {
        let n = s.y.len();
        let c = &theta.c[..orders.nc];
        let w = if c.is_empty() { &mut self.e[begin..n] } else { &mut self.w[begin..n] };
        combine(w, orders, theta, |lag| &s.y[begin - lag..n - lag], |lag| &self.z[begin - lag..n - lag]);
        let (w, e) = (&self.w[begin..n], &mut self.e[begin..n]);
        match *c {
            [] => {}
            [c1] => whiten([c1], w, e),
            [c1, c2] => whiten([c1, c2], w, e),
            [c1, c2, c3] => whiten([c1, c2, c3], w, e),
            [c1, c2, c3, c4, ..] => whiten([c1, c2, c3, c4], w, e),
        }
    }

    /// The errors from sample `begin` on, where some samples do not count: their error is 0.
    fn errors_with_missing(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta, begin: usize) {
        let n = s.y.len();
        let Self { filled: y, z, e, .. } = self;
        y[..n].copy_from_slice(s.y);
        let (a, b, c) = (&theta.a[..orders.na], &theta.b[..orders.nb], &theta.c[..orders.nc]);
        for k in begin..n {
            let past = |gains: &[f64], v: &[f64], lag: usize| -> f64 {
                // Terms before the first sample are left out. Errors before the recursion starts are 0.
                gains
                    .iter()
                    .zip(v[..(k + 1).saturating_sub(lag)].iter().rev())
                    .map(|(gain, v)| gain * v)
                    .sum()
            };
            let predicted = theta.c0 - past(a, y, 1) + past(b, z, orders.nk) + past(c, e, 1);
            // A silent row has the right y, but its error says nothing of the process: it must not enter later predictions.
            match s.rows.worth[k] {
                Row::Counts => e[k] = y[k] - predicted,
                Row::Silent => e[k] = 0.0,
                Row::Missing => (y[k], e[k]) = (predicted, 0.0),
            }
        }
    }

    /// Minimises the loss V from `start` by Levenberg–Marquardt.
    ///
    /// It ends when the quadratic model predicts a relative decrease of V below `tolerance`, after `most` iterations, or when no
    /// damping finds a decrease.
    pub fn minimise(
        &mut self,
        s: &Signals<'_>,
        orders: Orders,
        start: Theta,
        lag: Lag,
        tolerance: f64,
        most: usize,
    ) -> Fit {
        let mut theta = start;
        draw_inside(&mut theta.c[..orders.nc], RHO);
        let mut loss = self.evaluate(s, orders, &theta);
        let mut loaded_lag = theta.lag;
        let mut damping = 1e-4;
        let mut iterations = 0;
        while iterations < most {
            iterations += 1;
            let normal = self.normal_equations(s, orders, &theta, lag);
            let mut improved = false;
            for _ in 0..8 {
                let (candidate, predicted) = normal.step(&theta, damping, lag);
                if predicted <= tolerance * loss {
                    return Fit { orders, theta, loss, iterations };
                }
                if candidate.lag != loaded_lag {
                    self.load_stem(s, candidate.lag);
                    loaded_lag = candidate.lag;
                }
                let tried = self.loss(s, orders, &candidate);
                if tried < loss {
                    let gain = loss - tried;
                    theta = candidate;
                    loss = tried;
                    damping = if gain > 0.5 * predicted { damping * 0.1 } else { damping };
                    improved = gain > tolerance * loss;
                    break;
                }
                damping = (damping * 10.0).max(1e-6);
            }
            if !improved {
                break;
            }
        }
        Fit { orders, theta, loss, iterations }
    }

    /// `J'J` and `J'e` at `theta`, which must be the one evaluated last.
    fn normal_equations(
        &mut self,
        s: &Signals<'_>,
        orders: Orders,
        theta: &Theta,
        lag: Lag,
    ) -> NormalEquations {
        self.filter_all(s, &theta.c[..orders.nc]);
        let free_lag = matches!(lag, Lag::Free { .. });
        if free_lag {
            self.lag_gradient(s, orders, theta);
        }
        let n = s.y.len();
        let mut normal = NormalEquations::new(orders, free_lag, n - s.first - s.rows.left_out.len());
        // 1/C of a constant, once its start is forgotten. Its products are sums of the other columns times this number.
        let constant = 1.0 / (1.0 + theta.c[..orders.nc].iter().sum::<f64>());
        self.multiply_columns(s, constant, &mut normal);
        self.subtract_left_out(s, constant, &mut normal);
        normal.apply_signs();
        normal
    }

    /// The signals of the columns of [`NormalEquations`], by their place there; the constant needs none.
    fn column_signals(&self) -> [&[f64]; 5] {
        let [yf, zf, ef, _] = &self.filtered;
        [yf, zf, ef, yf, &self.lag_column]
    }

    /// The products of all columns with each other and with e, over all rows from the first that counts on, without signs.
    ///
    /// * `constant`: the value of the constant's column.
    fn multiply_columns(&self, s: &Signals<'_>, constant: f64, normal: &mut NormalEquations) {
        let n = s.y.len();
        let signals = self.column_signals();
        let columns = normal.columns;
        for i in 0..normal.size {
            let (signal_i, lag_i) = columns[i];
            let ci = signals[signal_i];
            for j in 0..=i {
                let (signal_j, lag_j) = columns[j];
                let cj = signals[signal_j];
                let (enters, leaves) = (s.first - lag_j, n - lag_j);
                let follows_j = j > 0 && columns[j - 1] == (signal_j, lag_j.wrapping_sub(1));
                normal.jtj[i][j] = if signal_i == CONSTANT {
                    if j == i {
                        constant * constant * (n - s.first) as f64
                    } else if follows_j {
                        normal.jtj[i][j - 1] + constant * (cj[enters] - cj[leaves])
                    } else {
                        constant * total(&cj[enters..leaves])
                    }
                } else if signal_j == CONSTANT {
                    constant * total(&ci[s.first - lag_i..n - lag_i])
                } else if follows_j && i > 0 && columns[i - 1] == (signal_i, lag_i.wrapping_sub(1)) {
                    // The product of two columns with a lag more each differs from that of the columns before them by two terms.
                    normal.jtj[i - 1][j - 1] + ci[s.first - lag_i] * cj[enters] - ci[n - lag_i] * cj[leaves]
                } else {
                    dot_long(&ci[s.first - lag_i..n - lag_i], &cj[enters..leaves])
                };
            }
            normal.jte[i] = if signal_i == CONSTANT {
                constant * total(&self.e[s.first..n])
            } else {
                dot_long(&ci[s.first - lag_i..n - lag_i], &self.e[s.first..n])
            };
        }
    }

    /// Takes the rows that do not count out of what [`Workspace::multiply_columns`] computed.
    fn subtract_left_out(&self, s: &Signals<'_>, constant: f64, normal: &mut NormalEquations) {
        let signals = self.column_signals();
        let columns = normal.columns;
        for &k in s.rows.left_out {
            let at = |i: usize| {
                let (signal, lag) = columns[i];
                if signal == CONSTANT { constant } else { signals[signal][k - lag] }
            };
            for i in 0..normal.size {
                for j in 0..=i {
                    normal.jtj[i][j] -= at(i) * at(j);
                }
                normal.jte[i] -= at(i) * self.e[k];
            }
        }
    }

    /// y, z, e and dir, each divided by C.
    fn filter_all(&mut self, s: &Signals<'_>, c: &[f64]) {
        let n = s.y.len();
        let from = s.start;
        let [yf, zf, ef, df] = &mut self.filtered;
        let y = if s.rows.worth.is_empty() { s.y } else { &self.filled };
        let inputs = [&y[from..n], &self.z[from..n], &self.e[from..n], &s.dir[from..n]];
        let outputs = [&mut yf[from..n], &mut zf[from..n], &mut ef[from..n], &mut df[from..n]];
        match *c {
            [] => outputs.into_iter().zip(inputs).for_each(|(output, input)| output.copy_from_slice(input)),
            [c1] => filter4([c1], inputs, outputs),
            [c1, c2] => filter4([c1, c2], inputs, outputs),
            [c1, c2, c3] => filter4([c1, c2, c3], inputs, outputs),
            [c1, c2, c3, c4, ..] => filter4([c1, c2, c3, c4], inputs, outputs),
        }
    }

    /// The derivative of e by the lag: `B(q)/C(q) dir`.
    fn lag_gradient(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta) {
        let n = s.y.len();
        self.lag_column[..n].fill(0.0);
        let begin = s.first;
        for (j, &b) in theta.b[..orders.nb].iter().enumerate() {
            add_scaled(&mut self.lag_column[begin..n], b, &self.filtered[3][begin - orders.nk - j..n]);
        }
    }
}

#[cfg(test)]
mod tests;
