//! The linear part: `A(q) y[k] = B(q) z[k] + c0 + C(q) e[k]` fitted by prediction error.
//!
//! ```text
//! A(q) = 1 + a1 q^-1 + … + a_na q^-na
//! B(q) = b1 q^-nk + … + b_nb q^-(nk+nb-1)
//! C(q) = 1 + c1 q^-1 + … + c_nc q^-nc        zeros inside |q| = RHO
//! z[k] = x[k] - lag dir[k]                    stem position; lag = 0 is the paper's element
//! ```
//!
//! `e` is the prediction error, `V = mean e²` the loss, minimised by Levenberg–Marquardt from a
//! Hannan–Rissanen start ([`super::screen`]). The gradient signals are lags of y, z and e filtered by 1/C, so
//! one pass of filters and one Gram matrix of lagged products serve a whole iteration.
//!
//! Source: Ljung, System Identification, 2nd ed., section 10.3 and 7.4.

mod normal;

use super::screen::Counted;
use crate::signal::Row;
use crate::sysid::least_squares::{dot, total};
pub use crate::sysid::zeros::{draw_inside, is_inside};
use normal::{CONSTANT, Normal};

/// Largest modulus a zero of C may have; beyond it the start of the record is never forgotten.
pub const RHO: f64 = 0.98;
/// Most coefficients in one fit: six of A, B, C, then c0 and the lag.
pub const MAX_PARAMETERS: usize = 8;
/// `na + nb + nc` of every model, the paper's choice.
pub const ORDER: usize = 6;
/// Smallest loss relative to var(y): below it rounding decides, not the data.
pub const LOSS_FLOOR: f64 = 1e-13;

/// The orders of one ARMAX model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Orders {
    /// Order of A.
    pub na: usize,
    /// Number of coefficients of B.
    pub nb: usize,
    /// Order of C.
    pub nc: usize,
    /// Delay (samples), at least 1.
    pub nk: usize,
}

/// Every split `na + nb + nc = 6` with `na, nb >= 1`, for one delay: fifteen of them.
pub fn splits(nk: usize) -> impl Iterator<Item = Orders> {
    (1..ORDER).flat_map(move |na| (1..=ORDER - na).map(move |nb| Orders { na, nb, nc: ORDER - na - nb, nk }))
}

/// The signals one fit works on, all of one length.
#[derive(Clone, Copy, Debug)]
pub struct Signals<'a> {
    /// Process variable.
    pub y: &'a [f64],
    /// Stem position of the one-parameter element.
    pub x: &'a [f64],
    /// Direction of the last stem movement, +1 or -1.
    pub dir: &'a [f64],
    /// First index where `x` is valid.
    pub start: usize,
    /// First index that counts in the loss; at least `start + 1 +` the longest lag.
    pub first: usize,
    /// The others, where some do not count.
    pub rows: Rows<'a>,
}

/// Samples that do not count in the loss.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rows<'a> {
    /// Their indices from `first` on, in order.
    pub left_out: &'a [usize],
    /// What each sample is worth, where some do not count: the prediction takes the place of y where it is missing. Else empty.
    pub worth: &'a [Row],
}

impl<'a> Signals<'a> {
    /// The samples that count.
    pub fn counted(&self) -> Counted<'a> {
        Counted { first: self.first, left_out: self.rows.left_out }
    }
}

/// Coefficients of one model; unused places are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Theta {
    /// `a1..`.
    pub a: [f64; ORDER],
    /// `b1..`.
    pub b: [f64; ORDER],
    /// `c1..`.
    pub c: [f64; ORDER],
    /// Constant.
    pub c0: f64,
    /// Kinetic lag (S - J)/2 of the stem behind OP (OP unit).
    pub lag: f64,
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

/// Whether the lag is estimated too, and within what bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lag {
    /// Held at its start value.
    Fixed,
    /// Estimated in `0..=max` (OP unit).
    Free {
        /// Upper bound, f.
        max: f64,
    },
}

/// Buffers of the prediction-error minimisation, planned once for a record and reused by every fit.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    z: Vec<f64>,
    w: Vec<f64>,
    e: Vec<f64>,
    /// y with its predictions where it is missing, of the last evaluation.
    filled: Vec<f64>,
    filtered: [Vec<f64>; 4],
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

    /// The prediction errors of the last evaluation, one per sample; 0 before the recursion starts.
    pub fn errors(&self) -> &[f64] {
        &self.e
    }

    /// Takes `z = x - lag dir` for the stem position.
    pub(super) fn load_stem(&mut self, s: &Signals<'_>, lag: f64) {
        for ((z, &x), &dir) in self.z.iter_mut().zip(s.x).zip(s.dir) {
            *z = x - lag * dir;
        }
    }

    /// y and the loaded z, each divided by C.
    pub(super) fn divide(&mut self, s: &Signals<'_>, c: &[f64]) -> [&[f64]; 2] {
        self.filled[..s.y.len()].copy_from_slice(s.y);
        self.filter_all(s, c);
        let [y, z, ..] = &self.filtered;
        [y, z]
    }

    /// The loss of `theta`, leaving the prediction errors in [`Workspace::errors`].
    ///
    /// Infinite when the recursion overflows, so that a bad step is refused like any other.
    pub fn evaluate(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta) -> f64 {
        self.load_stem(s, theta.lag);
        self.loss(s, orders, theta)
    }

    /// The same for the stem position that is loaded.
    fn loss(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta) -> f64 {
        let n = s.y.len();
        let begin = s.start + 1 + orders.na.max(orders.nk + orders.nb - 1);
        self.e[..begin].fill(0.0);
        if s.rows.worth.is_empty() {
            self.whole(s, orders, theta, begin);
        } else {
            self.with_holes(s, orders, theta, begin);
        }
        let counted = &self.e[s.first..n];
        let left_out: f64 = s.rows.left_out.iter().map(|k| self.e[*k] * self.e[*k]).sum();
        let loss = (dot(counted, counted) - left_out) / (counted.len() - s.rows.left_out.len()) as f64;
        if loss.is_finite() { loss.max(0.0) } else { f64::INFINITY }
    }

    /// The errors from `begin` on where every y is there.
    fn whole(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta, begin: usize) {
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

    /// The same where some are missing: their predictions take their places, with no error.
    fn with_holes(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta, begin: usize) {
        let n = s.y.len();
        let Self { filled: y, z, e, .. } = self;
        y[..n].copy_from_slice(s.y);
        let (a, b, c) = (&theta.a[..orders.na], &theta.b[..orders.nb], &theta.c[..orders.nc]);
        for k in begin..n {
            let past = |gains: &[f64], v: &[f64], lag: usize| -> f64 {
                // Before the first sample there is none, and before the first error it is 0.
                gains
                    .iter()
                    .zip(v[..(k + 1).saturating_sub(lag)].iter().rev())
                    .map(|(gain, v)| gain * v)
                    .sum()
            };
            let predicted = theta.c0 - past(a, y, 1) + past(b, z, orders.nk) + past(c, e, 1);
            // An error that is none of the process' own must not go through the filter.
            match s.rows.worth[k] {
                Row::Counts => e[k] = y[k] - predicted,
                Row::Silent => e[k] = 0.0,
                Row::Missing => (y[k], e[k]) = (predicted, 0.0),
            }
        }
    }

    /// Minimises the loss from `start` by Levenberg–Marquardt.
    ///
    /// Stops when the step promises less than `tolerance` of relative decrease, after `most` iterations, or
    /// when no damping finds a decrease.
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
        let mut loaded = theta.lag;
        let mut damping = 1e-4;
        let mut iterations = 0;
        while iterations < most {
            iterations += 1;
            let normal = self.normal_equations(s, orders, &theta, lag);
            let mut improved = false;
            for _ in 0..8 {
                let (candidate, promised) = normal.step(&theta, damping, lag);
                if promised <= tolerance * loss {
                    return Fit { orders, theta, loss, iterations };
                }
                if candidate.lag != loaded {
                    self.load_stem(s, candidate.lag);
                    loaded = candidate.lag;
                }
                let tried = self.loss(s, orders, &candidate);
                if tried < loss {
                    let gain = loss - tried;
                    theta = candidate;
                    loss = tried;
                    damping = if gain > 0.5 * promised { damping * 0.1 } else { damping };
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

    /// `JᵀJ` and `Jᵀe` at `theta`, which must be the one evaluated last.
    fn normal_equations(&mut self, s: &Signals<'_>, orders: Orders, theta: &Theta, lag: Lag) -> Normal {
        self.filter_all(s, &theta.c[..orders.nc]);
        let free_lag = matches!(lag, Lag::Free { .. });
        if free_lag {
            self.lag_gradient(s, orders, theta);
        }
        let n = s.y.len();
        let mut normal = Normal::new(orders, free_lag, n - s.first - s.rows.left_out.len());
        // The constant behind 1/C, once its start is forgotten; its products are then sums of the other columns.
        let constant = 1.0 / (1.0 + theta.c[..orders.nc].iter().sum::<f64>());
        let [yf, zf, ef, _] = &self.filtered;
        let signals = [yf, zf, ef, yf, &self.lag_column];
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
                    // Two columns one lag further on share all but two products with their predecessors.
                    normal.jtj[i - 1][j - 1] + ci[s.first - lag_i] * cj[enters] - ci[n - lag_i] * cj[leaves]
                } else {
                    dot(&ci[s.first - lag_i..n - lag_i], &cj[enters..leaves])
                };
            }
            normal.jte[i] = if signal_i == CONSTANT {
                constant * total(&self.e[s.first..n])
            } else {
                dot(&ci[s.first - lag_i..n - lag_i], &self.e[s.first..n])
            };
        }
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
        normal.apply_signs();
        normal
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

/// `w = A(q) y - B(q) z - c0`, two lags at a time so that w is written seldom.
#[inline]
fn combine<'v>(
    w: &mut [f64],
    orders: Orders,
    theta: &Theta,
    y: impl Fn(usize) -> &'v [f64],
    z: impl Fn(usize) -> &'v [f64],
) {
    let (a, b, nk) = (&theta.a[..orders.na], &theta.b[..orders.nb], orders.nk);
    for (((w, y0), y1), z) in w.iter_mut().zip(y(0)).zip(y(1)).zip(z(nk)) {
        *w = y0 - theta.c0 + a[0] * y1 - b[0] * z;
    }
    let mut rest = [(0.0, y(0)); ORDER];
    let mut count = 0;
    let lagged = (1..a.len()).map(|i| (a[i], y(i + 1))).chain((1..b.len()).map(|j| (-b[j], z(nk + j))));
    for (slot, term) in rest.iter_mut().zip(lagged) {
        *slot = term;
        count += 1;
    }
    let mut pairs = rest[..count].chunks_exact(2);
    for pair in &mut pairs {
        let [(gain, v), (other_gain, other)] = [pair[0], pair[1]];
        for ((w, v), other) in w.iter_mut().zip(v).zip(other) {
            *w += gain * v + other_gain * other;
        }
    }
    for &(gain, v) in pairs.remainder() {
        add_scaled(w, gain, v);
    }
}

/// `w += gain * v`.
#[inline]
fn add_scaled(w: &mut [f64], gain: f64, v: &[f64]) {
    for (w, v) in w.iter_mut().zip(v) {
        *w += gain * v;
    }
}

/// Coefficients of `e[k+1]` on the errors before `e[k]`: two samples then wait for one product, not each for its own.
#[inline]
fn ahead<const P: usize>(c: [f64; P]) -> [f64; P] {
    std::array::from_fn(|l| c[0] * c[l] - c.get(l + 1).copied().unwrap_or(0.0))
}

/// `out = w / C` from rest, four samples at a time: each waits for the four before, not for its neighbour.
#[inline]
fn whiten<const P: usize>(c: [f64; P], w: &[f64], out: &mut [f64]) {
    // What an input, and what each past error, adds to this and the next three.
    let mut pulse = [1.0, 0.0, 0.0, 0.0];
    let mut echo = [[0.0; 4]; P];
    for k in 0..4 {
        let carried = |before: &[f64; 4]| (0..P.min(k)).map(|l| c[l] * before[k - 1 - l]).sum::<f64>();
        if k > 0 {
            pulse[k] = -carried(&pulse);
        }
        for (p, echo) in echo.iter_mut().enumerate() {
            echo[k] = -carried(echo) - c.get(p + k).copied().unwrap_or(0.0);
        }
    }
    let [_, p1, p2, p3] = pulse;
    let mut past = [0.0; P];
    let (blocks, last) = w.as_chunks::<4>();
    let (out_blocks, out_last) = out[..w.len()].as_chunks_mut::<4>();
    for (&[w0, w1, w2, w3], out) in blocks.iter().zip(out_blocks) {
        let mut e = [w0, w1 + p1 * w0, w2 + (p1 * w1 + p2 * w0), (w3 + p1 * w2) + (p2 * w1 + p3 * w0)];
        // The newest error comes last so that the chain from one block to the next is a single operation.
        for l in (0..P).rev() {
            for (e, echo) in e.iter_mut().zip(echo[l]) {
                *e += echo * past[l];
            }
        }
        for (l, past) in past.iter_mut().enumerate() {
            *past = e[3 - l];
        }
        *out = e;
    }
    for (w, out) in last.iter().zip(out_last) {
        let e = (0..P).rev().fold(*w, |e, l| e - c[l] * past[l]);
        past.rotate_right(1);
        past[0] = e;
        *out = e;
    }
}

/// Four signals, each divided by C from rest, side by side: four independent chains.
fn filter4<const P: usize>(c: [f64; P], inputs: [&[f64]; 4], outputs: [&mut [f64]; 4]) {
    let n = inputs[0].len();
    let [i0, i1, i2, i3] = inputs.map(|v| &v[..n]);
    let [o0, o1, o2, o3] = outputs.map(|v| &mut v[..n]);
    let ahead = ahead(c);
    let mut past = [[0.0; 4]; P];
    let mut k = 0;
    while k + 1 < n {
        let now = [i0[k], i1[k], i2[k], i3[k]];
        let next = [i0[k + 1], i1[k + 1], i2[k + 1], i3[k + 1]];
        let mut e0 = now;
        let mut e1: [f64; 4] = std::array::from_fn(|lane| next[lane] - c[0] * now[lane]);
        for l in (0..P).rev() {
            for lane in 0..4 {
                e0[lane] -= c[l] * past[l][lane];
                e1[lane] += ahead[l] * past[l][lane];
            }
        }
        for l in (2..P).rev() {
            past[l] = past[l - 2];
        }
        if P > 1 {
            past[1] = e0;
        }
        past[0] = e1;
        [o0[k], o1[k], o2[k], o3[k]] = e0;
        [o0[k + 1], o1[k + 1], o2[k + 1], o3[k + 1]] = e1;
        k += 2;
    }
    if k < n {
        let now = [i0[k], i1[k], i2[k], i3[k]];
        [o0[k], o1[k], o2[k], o3[k]] =
            std::array::from_fn(|lane| (0..P).rev().fold(now[lane], |e, l| e - c[l] * past[l][lane]));
    }
}

#[cfg(test)]
mod tests;
