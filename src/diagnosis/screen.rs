//! Screening: one Gram matrix of lagged columns that serves every structure at one stem position.
//!
//! Three fits read it. The *long ARX* regresses y on its own lags and the lags of `z = x - lag dir`; it needs no
//! choice of structure, so it is the yardstick along f. Its residual ê estimates the innovations. The
//! *Hannan–Rissanen* fit of a structure regresses y on `[y lags, z lags, ê lags, 1]` and starts the
//! prediction-error minimum. All structures share the same columns, so each fit is a sub-block; the columns of
//! one signal differ by two products, so a row of dot products fills a block.
//!
//! Source: Hannan & Rissanen, Biometrika 1982, 69, 81; Ljung, System Identification, 2nd ed., section 10.6.

use super::armax::{Fit, ORDER, Orders, Signals, Theta, splits};
use crate::signal::Row;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// Lags of y in the long ARX: more than the longest A has, because they stand for C, too.
pub const LONG_Y: usize = 8;
/// Longest delay that can be searched (samples): its columns, and those of a rival, fit into [`MOST_COLUMNS`].
pub const LONGEST_DELAY: usize = 30;
/// Lags of ê: as many as the longest C.
const E_LAGS: usize = ORDER - 2;

/// One structure's least-squares fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Orders.
    pub orders: Orders,
    /// Coefficients of the Hannan–Rissanen fit: the start of the prediction-error minimum.
    pub theta: Theta,
    /// Mean square of the least-squares residual, close to the loss at the minimum (PV unit²).
    pub loss: f64,
}

impl Candidate {
    /// The start of a minimisation, with a lag.
    pub fn start(&self, lag: f64) -> Fit {
        Fit { orders: self.orders, theta: Theta { lag, ..self.theta }, loss: self.loss, iterations: 0 }
    }
}

/// The long ARX at the lag that fits best.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LongFit {
    /// Mean square of the residual (PV unit²).
    pub loss: f64,
    /// Kinetic lag (S - J)/2 (OP unit).
    pub lag: f64,
}

/// The Gram matrix of the lagged columns, planned once for a record.
///
/// Columns: y lag 0..=LONG_Y, z lag 1..=nx, ê lag 1..=E_LAGS; beside them the products with dir.
#[derive(Clone, Debug)]
pub struct Screen {
    max_delay: usize,
    nx: usize,
    size: usize,
    /// Lagged products of y and z (lower triangle), then of ê.
    gram: Vec<f64>,
    sums: Vec<f64>,
    /// Products of x and dir with y (nx × (LONG_Y + 1)), x with x, x with dir, dir with dir (nx × nx each).
    xy: Vec<f64>,
    dy: Vec<f64>,
    xx: Vec<f64>,
    xd: Vec<f64>,
    dd: Vec<f64>,
    x_sums: Vec<f64>,
    d_sums: Vec<f64>,
    has_dir: bool,
    /// The lag that z is at now (OP unit).
    lag: f64,
    live: [bool; MOST_COLUMNS],
    rows: usize,
    scratch: Vec<f64>,
    solution: Vec<f64>,
    e: Vec<f64>,
}

impl Screen {
    /// Buffers for records of `n` samples and delays `1..=max_delay`, with y's own products computed.
    pub fn new(y: &[f64], counted: Counted<'_>, max_delay: usize) -> Self {
        let nx = Self::input_lags(max_delay);
        let size = 1 + LONG_Y + nx + E_LAGS;
        let mut screen = Self {
            max_delay,
            nx,
            size,
            gram: vec![0.0; size * size],
            sums: vec![0.0; size],
            xy: vec![0.0; nx * (LONG_Y + 1)],
            dy: vec![0.0; nx * (LONG_Y + 1)],
            xx: vec![0.0; nx * nx],
            xd: vec![0.0; nx * nx],
            dd: vec![0.0; nx * nx],
            x_sums: vec![0.0; nx],
            d_sums: vec![0.0; nx],
            has_dir: false,
            lag: 0.0,
            live: [true; MOST_COLUMNS],
            rows: counted.rows(y.len()),
            scratch: vec![0.0; MOST_COLUMNS * MOST_COLUMNS],
            solution: vec![0.0; MOST_COLUMNS],
            e: vec![0.0; y.len()],
        };
        let columns = Lags { v: y, from: 0, count: LONG_Y + 1 };
        sums(columns, counted, &mut screen.sums);
        products(columns, columns, counted, true, &mut screen.gram, size);
        screen
    }

    /// Lags of the stem position: the longest delay and the longest B behind it.
    pub fn input_lags(max_delay: usize) -> usize {
        max_delay + ORDER - 2
    }

    /// Samples before the first that counts: the longest lag, and the lags of ê behind it.
    pub fn lead(max_delay: usize) -> usize {
        LONG_Y.max(Self::input_lags(max_delay)) + E_LAGS + 1
    }

    /// Computes the products of a new stem position; those of its direction too when `with_dir`.
    pub fn load(&mut self, s: &Signals<'_>, with_dir: bool) {
        let y = Lags { v: s.y, from: 0, count: LONG_Y + 1 };
        let x = Lags { v: s.x, from: 1, count: self.nx };
        let d = Lags { v: s.dir, from: 1, count: self.nx };
        products(x, y, s.counted(), false, &mut self.xy, LONG_Y + 1);
        products(x, x, s.counted(), true, &mut self.xx, self.nx);
        sums(x, s.counted(), &mut self.x_sums);
        self.has_dir = with_dir;
        if with_dir {
            products(d, y, s.counted(), false, &mut self.dy, LONG_Y + 1);
            products(x, d, s.counted(), false, &mut self.xd, self.nx);
            products(d, d, s.counted(), true, &mut self.dd, self.nx);
            sums(d, s.counted(), &mut self.d_sums);
        }
        self.set_lag(0.0);
    }

    /// The long ARX with the lag in `0..=max` that fits best, by Gauss–Newton on the lag alone; the Gram matrix
    /// is left at that lag. `start` is where the lag is tried first.
    pub fn fit_lag(&mut self, start: f64, max: f64) -> LongFit {
        self.set_lag(0.0);
        let mut best = LongFit { loss: self.long_arx(), lag: 0.0 };
        if !self.has_dir || max <= 0.0 {
            return best;
        }
        let mut lag = start.clamp(0.0, max);
        for _ in 0..4 {
            if lag != 0.0 {
                self.set_lag(lag);
                let loss = self.long_arx();
                if loss < best.loss {
                    best = LongFit { loss, lag };
                } else if lag != start {
                    break;
                }
            }
            let next = (lag + self.lag_step()).clamp(0.0, max);
            if (next - lag).abs() <= 1e-3 * max {
                break;
            }
            lag = next;
        }
        self.set_lag(best.lag);
        best
    }

    /// Takes the long ARX's residual at `lag` as ê: what the first Hannan–Rissanen fits need.
    pub fn load_errors(&mut self, s: &Signals<'_>, lag: f64) {
        self.set_lag(lag);
        self.long_arx();
        self.long_residual(s, lag);
        self.multiply_errors(s, lag);
    }

    /// Takes the prediction errors of a fitted model as ê: a long ARX cannot follow a zero of C near the unit
    /// circle, and ranks the structures that have one too low.
    pub fn reload_errors(&mut self, s: &Signals<'_>, lag: f64, errors: &[f64]) {
        self.set_lag(lag);
        self.e.copy_from_slice(errors);
        self.multiply_errors(s, lag);
    }

    /// The lagged products of ê with every column.
    fn multiply_errors(&mut self, s: &Signals<'_>, lag: f64) {
        let (counted, at) = (s.counted(), 1 + LONG_Y + self.nx);
        let e = std::mem::take(&mut self.e);
        let columns = Lags { v: &e, from: 1, count: E_LAGS };
        let size = self.size;
        products(columns, columns, counted, true, &mut self.gram[at * size + at..], size);
        let y = Lags { v: s.y, from: 0, count: LONG_Y + 1 };
        products(columns, y, counted, false, &mut self.gram[at * size..], size);
        let x = Lags { v: s.x, from: 1, count: self.nx };
        products(columns, x, counted, false, &mut self.gram[at * size + 1 + LONG_Y..], size);
        if lag != 0.0 {
            let d = Lags { v: s.dir, from: 1, count: self.nx };
            let mut ed = [0.0; E_LAGS * MOST_COLUMNS];
            products(columns, d, counted, false, &mut ed, self.nx);
            for i in 0..E_LAGS {
                for j in 0..self.nx {
                    self.gram[(at + i) * size + 1 + LONG_Y + j] -= lag * ed[i * self.nx + j];
                }
            }
        }
        sums(columns, counted, &mut self.sums[at..]);
        self.e = e;
    }

    /// The Hannan–Rissanen fit of one structure; [`Screen::load_errors`] comes first.
    pub fn fit(&mut self, orders: Orders) -> Candidate {
        let mut columns = [0; ORDER];
        let x_at = LONG_Y + 1;
        let e_at = x_at + self.nx;
        let wanted = (1..=orders.na)
            .chain((0..orders.nb).map(|j| x_at + orders.nk - 1 + j))
            .chain((0..orders.nc).map(|l| e_at + l));
        for (slot, column) in columns.iter_mut().zip(wanted) {
            *slot = column;
        }
        let loss = self.solve(&columns);
        let solution = &self.solution;
        let mut theta = Theta::default();
        for (a, s) in theta.a.iter_mut().zip(&solution[..orders.na]) {
            *a = -s;
        }
        theta.b[..orders.nb].copy_from_slice(&solution[orders.na..orders.na + orders.nb]);
        theta.c[..orders.nc].copy_from_slice(&solution[orders.na + orders.nb..ORDER]);
        theta.c0 = self.sums[0];
        for (column, s) in columns.iter().zip(solution) {
            theta.c0 -= s * self.sums[*column];
        }
        theta.c0 /= self.rows as f64;
        Candidate { orders, theta, loss }
    }

    /// The loss of every split at every delay, to `each`; [`Screen::fit`] gives the coefficients of those wanted.
    ///
    /// Structures that begin with the same columns share the rows of their Cholesky factor, and the loss needs the
    /// forward substitution alone.
    pub fn rank_all(&self, mut each: impl FnMut(Orders, f64)) {
        let (x_at, e_at) = (LONG_Y + 1, LONG_Y + 1 + self.nx);
        let per_row = 1.0 / self.rows as f64;
        let total = self.gram[0] - self.sums[0] * self.sums[0] * per_row;
        let mut rows = Rows::default();
        for na in 1..ORDER {
            rows.append(self, na - 1, na);
            for nk in 1..=self.max_delay {
                for nb in 1..=ORDER - na {
                    rows.append(self, na + nb - 1, x_at + nk + nb - 2);
                    let nc = ORDER - na - nb;
                    for l in 0..nc {
                        rows.append(self, na + nb + l, e_at + l);
                    }
                    let explained: f64 = rows.right.iter().map(|r| r * r).sum();
                    each(Orders { na, nb, nc, nk }, (total - explained).max(0.0) * per_row);
                }
            }
        }
    }

    /// Fits every split at every delay and hands each to `each`.
    pub fn fit_all(&mut self, mut each: impl FnMut(Candidate)) {
        for nk in 1..=self.max_delay {
            for orders in splits(nk) {
                let candidate = self.fit(orders);
                each(candidate);
            }
        }
    }

    /// Puts the products of `z = x - lag dir` in place.
    fn set_lag(&mut self, lag: f64) {
        let (nx, ny, size, at) = (self.nx, LONG_Y + 1, self.size, LONG_Y + 1);
        self.lag = lag;
        for i in 0..nx {
            let row = &mut self.gram[(at + i) * size..(at + i) * size + at + i + 1];
            row[..ny].copy_from_slice(&self.xy[i * ny..(i + 1) * ny]);
            row[at..].copy_from_slice(&self.xx[i * nx..i * nx + i + 1]);
            self.sums[at + i] = self.x_sums[i];
            if lag == 0.0 {
                continue;
            }
            self.sums[at + i] -= lag * self.d_sums[i];
            for (g, d) in row[..ny].iter_mut().zip(&self.dy[i * ny..]) {
                *g -= lag * d;
            }
            for j in 0..=i {
                let cross = self.xd[i * nx + j] + self.xd[j * nx + i];
                row[at + j] += lag * (lag * self.dd[i * nx + j] - cross);
            }
        }
    }

    /// Regresses y on all its lags and those of z; returns the mean square of the residual.
    fn long_arx(&mut self) -> f64 {
        let mut columns = [0; MOST_COLUMNS];
        let count = LONG_Y + self.nx;
        for (i, c) in columns[..count].iter_mut().enumerate() {
            *c = i + 1;
        }
        self.solve(&columns[..count])
    }

    /// Regresses y on its own lags alone; returns the mean square of the residual.
    pub fn without_input(&mut self) -> f64 {
        let columns: [usize; LONG_Y] = std::array::from_fn(|i| i + 1);
        self.solve(&columns)
    }

    /// The Gauss–Newton step of the lag from the last long ARX solution: least squares of the residual on the
    /// column `-B(q) dir`, made orthogonal to the regressors.
    fn lag_step(&mut self) -> f64 {
        let (nx, ny) = (self.nx, LONG_Y + 1);
        let count = LONG_Y + nx;
        let mut b = [0.0; MOST_COLUMNS];
        b[..nx].copy_from_slice(&self.solution[LONG_Y..count]);
        let b = &b[..nx];
        let per_row = 1.0 / self.rows as f64;
        let d_sum = dot(b, &self.d_sums);
        // Products of v = B(q) dir with y, with every regressor, and with itself.
        let with_y = |lag: usize| -> f64 { (0..nx).map(|j| b[j] * self.dy[j * ny + lag]).sum() };
        let symmetric = |i: usize, j: usize| self.dd[i.max(j) * nx + i.min(j)];
        let lag = self.lag;
        let mut right = [0.0; MOST_COLUMNS];
        let vy = with_y(0) - d_sum * self.sums[0] * per_row;
        for (k, r) in right[..count].iter_mut().enumerate() {
            let product: f64 = if k < LONG_Y {
                with_y(k + 1)
            } else {
                let i = k - LONG_Y;
                (0..nx).map(|j| b[j] * (self.xd[i * nx + j] - lag * symmetric(i, j))).sum()
            };
            *r = product - d_sum * self.sums[k + 1] * per_row;
        }
        let vv: f64 =
            (0..nx).map(|i| b[i] * (0..nx).map(|j| b[j] * symmetric(i, j)).sum::<f64>()).sum::<f64>()
                - d_sum * d_sum * per_row;
        let residual_product: f64 =
            vy - self.solution[..count].iter().zip(&right).map(|(t, r)| t * r).sum::<f64>();
        let mut projected = right;
        substitute(&self.scratch, MOST_COLUMNS, &self.live, &mut projected[..count]);
        let remaining = vv - right[..count].iter().zip(&projected).map(|(a, b)| a * b).sum::<f64>();
        if remaining > 1e-9 * vv && vv > 0.0 { -residual_product / remaining } else { 0.0 }
    }

    fn long_residual(&mut self, s: &Signals<'_>, lag: f64) {
        let n = s.y.len();
        let count = LONG_Y + self.nx;
        let solution = &self.solution;
        let mean = (self.sums[0]
            - solution[..count].iter().zip(&self.sums[1..=count]).map(|(c, sum)| c * sum).sum::<f64>())
            / self.rows as f64;
        let begin = s.first - E_LAGS;
        let e = &mut self.e[begin..n];
        for (e, y) in e.iter_mut().zip(&s.y[begin..]) {
            *e = y - mean;
        }
        for (i, &c) in solution[..LONG_Y].iter().enumerate() {
            for (e, y) in e.iter_mut().zip(&s.y[begin - 1 - i..]) {
                *e -= c * y;
            }
        }
        for (j, &c) in solution[LONG_Y..count].iter().enumerate() {
            let at = begin - 1 - j;
            for ((e, x), d) in e.iter_mut().zip(&s.x[at..]).zip(&s.dir[at..]) {
                *e -= c * (x - lag * d);
            }
        }
        let not = s.rows.worth.iter().enumerate().filter(|(_, worth)| **worth != Row::Counts);
        not.for_each(|(k, _)| self.e[k] = 0.0);
    }

    /// Least squares of column 0 on `columns`, all centred (which is what a free constant does); the solution
    /// is left in `self.solution`, the factor in `self.scratch`. Returns the mean square of the residual.
    fn solve(&mut self, columns: &[usize]) -> f64 {
        let n = columns.len();
        let per_row = 1.0 / self.rows as f64;
        let mut right = [0.0; MOST_COLUMNS];
        for (i, &ci) in columns.iter().enumerate() {
            let row = &mut self.scratch[i * MOST_COLUMNS..i * MOST_COLUMNS + i + 1];
            let gram = &self.gram[ci * self.size..ci * self.size + ci + 1];
            let centre = self.sums[ci] * per_row;
            for (g, &cj) in row.iter_mut().zip(columns) {
                *g = gram[cj] - centre * self.sums[cj];
            }
            right[i] = gram[0] - centre * self.sums[0];
        }
        self.solution[..n].copy_from_slice(&right[..n]);
        factor(&mut self.scratch, MOST_COLUMNS, n, &mut self.live);
        substitute(&self.scratch, MOST_COLUMNS, &self.live, &mut self.solution[..n]);
        let total = self.gram[0] - self.sums[0] * self.sums[0] * per_row;
        (total - dot(&self.solution[..n], &right[..n])).max(0.0) * per_row
    }
}

/// The rows of a Cholesky factor of centred columns, and the forward substitution beside them.
#[derive(Default)]
struct Rows {
    columns: [usize; ORDER],
    l: [[f64; ORDER]; ORDER],
    right: [f64; ORDER],
    live: [bool; ORDER],
}

impl Rows {
    /// Puts `column` in row `i`, behind those that stand there.
    #[inline]
    fn append(&mut self, screen: &Screen, i: usize, column: usize) {
        self.columns[i] = column;
        let gram = &screen.gram[column * screen.size..=column * screen.size + column];
        let centre = screen.sums[column] / screen.rows as f64;
        let (above, rest) = self.l.split_at_mut(i);
        let row = &mut rest[0];
        let mut right = gram[0] - centre * screen.sums[0];
        let diagonal = gram[column] - centre * screen.sums[column];
        let mut pivot = diagonal;
        for (j, above) in above.iter().enumerate() {
            let mut value = gram[self.columns[j]] - centre * screen.sums[self.columns[j]];
            for (a, b) in row[..j].iter().zip(above) {
                value -= a * b;
            }
            row[j] = if self.live[j] { value / above[j] } else { 0.0 };
            pivot -= row[j] * row[j];
            right -= row[j] * self.right[j];
        }
        self.live[i] = pivot > 1e-13 * diagonal && pivot > 0.0;
        row[i] = if self.live[i] { pivot.sqrt() } else { 1.0 };
        self.right[i] = if self.live[i] { right / row[i] } else { 0.0 };
    }
}

/// A run of lagged columns of one signal: lags `from..from + count`.
#[derive(Clone, Copy)]
pub(super) struct Lags<'a> {
    pub(super) v: &'a [f64],
    pub(super) from: usize,
    pub(super) count: usize,
}

/// Samples that count: from the first on, but those left out.
#[derive(Clone, Copy, Debug)]
pub struct Counted<'a> {
    /// The first.
    pub first: usize,
    /// Those behind it that do not count, in order.
    pub left_out: &'a [usize],
}

impl Counted<'_> {
    /// How many of `n` samples count.
    pub fn rows(&self, n: usize) -> usize {
        n - self.first - self.left_out.len()
    }
}

/// `out[i][j] = sum over k that count of a[k - lag_i] b[k - lag_j]`, the lower triangle only when `same`.
pub(super) fn products(
    a: Lags<'_>,
    b: Lags<'_>,
    counted: Counted<'_>,
    same: bool,
    out: &mut [f64],
    stride: usize,
) {
    let (n, first) = (a.v.len(), counted.first);
    for i in 0..a.count {
        let li = a.from + i;
        let ai = &a.v[first - li..n - li];
        for j in 0..if same { i + 1 } else { b.count } {
            let lj = b.from + j;
            out[i * stride + j] = if i > 0 && j > 0 {
                out[(i - 1) * stride + j - 1] + a.v[first - li] * b.v[first - lj] - a.v[n - li] * b.v[n - lj]
            } else {
                dot(ai, &b.v[first - lj..n - lj])
            };
        }
    }
    for &k in counted.left_out {
        for i in 0..a.count {
            let value = a.v[k - a.from - i];
            for j in 0..if same { i + 1 } else { b.count } {
                out[i * stride + j] -= value * b.v[k - b.from - j];
            }
        }
    }
}

/// The sum of each lagged column.
pub(super) fn sums(a: Lags<'_>, counted: Counted<'_>, out: &mut [f64]) {
    let (n, first) = (a.v.len(), counted.first);
    let mut sum: f64 = a.v[first - a.from..n - a.from].iter().sum();
    for (lag, out) in (a.from..a.from + a.count).zip(out) {
        *out = sum - counted.left_out.iter().map(|k| a.v[k - lag]).sum::<f64>();
        // One lag further on the run starts one sample earlier.
        if first > lag {
            sum += a.v[first - lag - 1] - a.v[n - lag - 1];
        }
    }
}

#[cfg(test)]
mod tests;
