//! Screening: the loss of every structure at one stem position by linear least squares, from one Gram matrix.
//!
//! ```text
//! long ARX:         y[k] = sum_{i=1}^{8} a_i y[k-i] + sum_{j=1}^{nx} b_j z[k-j] + c + ê[k],     z = x - lag dir
//! Hannan–Rissanen:  y[k] = -sum a_i y[k-i] + sum b_j z[k-nk-(j-1)] + sum c_l ê[k-l] + c0 + w[k]
//! ```
//!
//! * The *long ARX* needs no choice of orders or delay, so its loss is compared along f. Its residual ê estimates the errors e.
//! * The *Hannan–Rissanen* fit of a structure (orders and delay) is the start of its prediction-error fit.
//! * All structures share the columns, so the normal equations of each are a part of one Gram matrix.
//! * The products of two lagged columns differ from those of the lags before by two terms, so one row of dot products gives a
//!   block.
//!
//! Source: Hannan & Rissanen, Biometrika 1982, 69, 81; Ljung, System Identification, 2nd ed., section 10.6.

use super::armax::{Fit, ORDER, Orders, Signals, Theta, splits};
use super::lagged_products::{Counted, Lags, products, sums};
use crate::signal::Row;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};

/// Lags of y in the long ARX: more than the longest A has, because they stand for C, too.
pub const LONG_Y: usize = 8;
/// Longest delay that can be searched (samples): its columns, and those of a rival, fit into [`MOST_COLUMNS`].
pub const LONGEST_DELAY: usize = 30;
/// Lags of ê: as many as the longest C.
const E_LAGS: usize = ORDER - 2;

/// The least-squares fit of one structure.
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
    /// It as the start of a prediction-error fit, with this kinetic lag (OP unit).
    pub fn start(&self, lag: f64) -> Fit {
        Fit { orders: self.orders, theta: Theta { lag, ..self.theta }, loss: self.loss, iterations: 0 }
    }
}

/// The long ARX at its best kinetic lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LongFit {
    /// Mean square of the residual (PV unit²).
    pub loss: f64,
    /// Kinetic lag (S - J)/2 (OP unit).
    pub lag: f64,
}

/// The Gram matrix of the lagged columns, allocated once for a record.
///
/// Columns: y at lags 0..=LONG_Y, z at lags 1..=nx, ê at lags 1..=E_LAGS. The products with dir are beside them, so that another
/// kinetic lag needs no new products.
#[derive(Clone, Debug)]
pub struct Screen {
    max_delay: usize,
    /// Number of lags of z.
    nx: usize,
    /// Number of columns.
    size: usize,
    /// Gram matrix, lower triangle.
    gram: Vec<f64>,
    /// Sum of each column.
    sums: Vec<f64>,
    /// Products of x and dir with y (nx × (LONG_Y + 1)), x with x, x with dir, dir with dir (nx × nx each).
    xy: Vec<f64>,
    dy: Vec<f64>,
    xx: Vec<f64>,
    xd: Vec<f64>,
    dd: Vec<f64>,
    x_sums: Vec<f64>,
    d_sums: Vec<f64>,
    /// Whether the products with dir are those of the present stem.
    has_dir: bool,
    /// The kinetic lag of the present z (OP unit).
    lag: f64,
    live: [bool; MOST_COLUMNS],
    /// Number of rows that count.
    rows: usize,
    /// Cholesky factor of the last solution.
    scratch: Vec<f64>,
    /// Coefficients of the last solution.
    solution: Vec<f64>,
    /// ê, one value for each sample.
    e: Vec<f64>,
}

impl Screen {
    /// Allocates the buffers for PV `y` and delays `1..=max_delay`, and computes the products of the lags of y.
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

    /// Number of lags of the stem position: the longest delay with the longest B.
    pub fn input_lags(max_delay: usize) -> usize {
        max_delay + ORDER - 2
    }

    /// Number of samples between the start of the stem and the first that counts: the longest lag, and the lags of ê before it.
    pub fn lead(max_delay: usize) -> usize {
        LONG_Y.max(Self::input_lags(max_delay)) + E_LAGS + 1
    }

    /// Computes the products of a new stem position, and with `with_dir` those of its direction.
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

    /// The long ARX with the best kinetic lag in `0..=max` (OP unit), by Gauss–Newton on the lag alone.
    ///
    /// * `start`: the lag that is tried first.
    ///
    /// The Gram matrix is left at the best lag.
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

    /// Takes the residual of the long ARX at the kinetic lag `lag` as ê, for the Hannan–Rissanen fits.
    pub fn load_errors(&mut self, s: &Signals<'_>, lag: f64) {
        self.set_lag(lag);
        self.long_arx();
        self.long_residual(s, lag);
        self.multiply_errors(s, lag);
    }

    /// Takes the prediction errors of a fitted ARMAX model with the kinetic lag `lag` as ê.
    ///
    /// The long ARX cannot follow a zero of C near the unit circle, so with its residual structures with such a zero rank too low.
    pub fn reload_errors(&mut self, s: &Signals<'_>, lag: f64, errors: &[f64]) {
        self.set_lag(lag);
        self.e.copy_from_slice(errors);
        self.multiply_errors(s, lag);
    }

    /// Computes the products of the lags of ê with every column.
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

    /// Calls `each` with every structure and its loss; [`Screen::fit`] gives the coefficients.
    ///
    /// Structures that begin with the same columns share the first rows of their Cholesky factor. The loss needs the forward
    /// substitution alone.
    pub fn rank_all(&self, mut each: impl FnMut(Orders, f64)) {
        let (x_at, e_at) = (LONG_Y + 1, LONG_Y + 1 + self.nx);
        let per_row = 1.0 / self.rows as f64;
        let total = self.gram[0] - self.sums[0] * self.sums[0] * per_row;
        let mut rows = FactorRows::default();
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

    /// Calls `each` with the fit of every structure.
    pub fn fit_all(&mut self, mut each: impl FnMut(Candidate)) {
        for nk in 1..=self.max_delay {
            for orders in splits(nk) {
                let candidate = self.fit(orders);
                each(candidate);
            }
        }
    }

    /// Computes the products of `z = x - lag dir` from those of x and dir.
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

    /// Fits the long ARX; returns the mean square of its residual (PV unit²).
    fn long_arx(&mut self) -> f64 {
        let mut columns = [0; MOST_COLUMNS];
        let count = LONG_Y + self.nx;
        for (i, c) in columns[..count].iter_mut().enumerate() {
            *c = i + 1;
        }
        self.solve(&columns[..count])
    }

    /// Regresses y on its own lags alone; returns the mean square of the residual (PV unit²).
    pub fn without_input(&mut self) -> f64 {
        let columns: [usize; LONG_Y] = std::array::from_fn(|i| i + 1);
        self.solve(&columns)
    }

    /// The Gauss–Newton step of the kinetic lag at the last long ARX (OP unit).
    ///
    /// It is the least-squares coefficient of the residual on the column `-B(q) dir`, made orthogonal to the other columns.
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

    /// Puts the residual of the last long ARX into ê; it is 0 where a sample does not count.
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
        let left_out = s.rows.worth.iter().enumerate().filter(|(_, worth)| **worth != Row::Counts);
        left_out.for_each(|(k, _)| self.e[k] = 0.0);
    }

    /// Least squares of column 0 (y) on `columns`, all less their means, as with a free constant. Returns the mean square of the
    /// residual.
    ///
    /// The coefficients are left in `self.solution`, the Cholesky factor in `self.scratch`.
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

/// The rows of a Cholesky factor of columns less their means, and the forward substitution of y beside them.
#[derive(Default)]
struct FactorRows {
    columns: [usize; ORDER],
    l: [[f64; ORDER]; ORDER],
    right: [f64; ORDER],
    live: [bool; ORDER],
}

impl FactorRows {
    /// Computes row `i` for `column`; the rows before it stay, those after it are void.
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

#[cfg(test)]
mod tests;
