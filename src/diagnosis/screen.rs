//! Screening: the Hannan–Rissanen fit of every split and every delay from one Gram matrix.
//!
//! A long ARX of y on its own and the stem's lags gives an estimate ê of the innovations; then, for each
//! structure, ordinary least squares of y on `[y lags, x lags, ê lags, 1]`. All structures share the same lagged
//! columns, so one Gram matrix holds every normal equation as a sub-block; lagged columns of one signal differ
//! by two products, so a row of dot products fills it.
//!
//! Source: Hannan & Rissanen, Biometrika 1982, 69, 81; Ljung, System Identification, 2nd ed., section 10.6.

use super::armax::{ORDER, Orders, Signals, Theta, splits};
use super::linalg::{cholesky_solve, dot};

/// Lags of y in the long ARX.
const LONG_Y: usize = 8;
/// Lags of ê: as many as the longest C.
const E_LAGS: usize = ORDER - 2;

/// One structure's least-squares fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Orders.
    pub orders: Orders,
    /// Coefficients of the Hannan–Rissanen fit: the start of the prediction-error minimum.
    pub theta: Theta,
    /// Mean square of the least-squares residual, close to the loss at the minimum [PV unit²].
    pub loss: f64,
}

/// The Gram matrix of the lagged columns, planned once for a record.
#[derive(Clone, Debug)]
pub struct Screen {
    max_delay: usize,
    /// Lagged products; columns are y lag 0..=LONG_Y, x lag 1..=x_lags, ê lag 1..=E_LAGS.
    gram: Vec<f64>,
    sums: Vec<f64>,
    scratch: Vec<f64>,
    solution: Vec<f64>,
    e: Vec<f64>,
    y_done: bool,
}

impl Screen {
    /// Buffers for records of `n` samples and delays `1..=max_delay`.
    pub fn new(n: usize, max_delay: usize) -> Self {
        let size = 1 + LONG_Y + x_lags(max_delay) + E_LAGS;
        Self {
            max_delay,
            gram: vec![0.0; size * size],
            sums: vec![0.0; size],
            scratch: vec![0.0; size * size],
            solution: vec![0.0; size],
            e: vec![0.0; n],
            y_done: false,
        }
    }

    /// Samples before the first that counts: the longest lag plus the lags of ê.
    pub fn lead(max_delay: usize) -> usize {
        LONG_Y.max(x_lags(max_delay)) + E_LAGS + 1
    }

    /// Fills the Gram matrix for a stem position `s.x`; y's own block is kept from call to call, so `s.y`,
    /// `s.start` and `s.first` must not change between calls.
    ///
    /// Returns the loss of the long ARX [PV unit²].
    pub fn load(&mut self, s: &Signals<'_>) -> f64 {
        let ny = LONG_Y + 1;
        let nx = x_lags(self.max_delay);
        if !self.y_done {
            self.fill(s, (s.y, 0, 0, ny), (s.y, 0, 0, ny));
            self.y_done = true;
        }
        self.fill(s, (s.x, ny, 1, nx), (s.x, ny, 1, nx));
        self.fill(s, (s.x, ny, 1, nx), (s.y, 0, 0, ny));
        let loss = self.long_arx(s);
        let e = std::mem::take(&mut self.e);
        let at = ny + nx;
        self.fill(s, (&e, at, 1, E_LAGS), (&e, at, 1, E_LAGS));
        self.fill(s, (&e, at, 1, E_LAGS), (s.y, 0, 0, ny));
        self.fill(s, (&e, at, 1, E_LAGS), (s.x, ny, 1, nx));
        self.e = e;
        loss
    }

    /// The fit of one structure from the loaded Gram matrix.
    pub fn fit(&mut self, orders: Orders, rows: usize) -> Candidate {
        let mut columns = [0; ORDER];
        let x_at = LONG_Y + 1;
        let e_at = x_at + x_lags(self.max_delay);
        let wanted = (1..=orders.na)
            .chain((0..orders.nb).map(|j| x_at + orders.nk - 1 + j))
            .chain((0..orders.nc).map(|l| e_at + l));
        for (slot, column) in columns.iter_mut().zip(wanted) {
            *slot = column;
        }
        let mut theta = Theta::default();
        let mut solution = [0.0; ORDER];
        let loss = self.solve(&columns, rows, &mut solution);
        for (a, s) in theta.a.iter_mut().zip(&solution[..orders.na]) {
            *a = -s;
        }
        theta.b[..orders.nb].copy_from_slice(&solution[orders.na..orders.na + orders.nb]);
        theta.c[..orders.nc].copy_from_slice(&solution[orders.na + orders.nb..]);
        theta.c0 = self.sums[0];
        for (column, s) in columns.iter().zip(&solution) {
            theta.c0 -= s * self.sums[*column];
        }
        theta.c0 /= rows as f64;
        Candidate { orders, theta, loss }
    }

    /// Fits every split at every delay and hands each to `each`.
    pub fn fit_all(&mut self, rows: usize, mut each: impl FnMut(Candidate)) {
        for nk in 1..=self.max_delay {
            for orders in splits(nk) {
                let candidate = self.fit(orders, rows);
                each(candidate);
            }
        }
    }

    /// Lagged products of two runs of columns `(signal, first column, first lag, count)` into the lower triangle.
    fn fill(
        &mut self,
        s: &Signals<'_>,
        rows: (&[f64], usize, usize, usize),
        cols: (&[f64], usize, usize, usize),
    ) {
        let size = self.sums.len();
        let n = s.y.len();
        let (a, row0, lag_a, count_a) = rows;
        let (b, col0, lag_b, count_b) = cols;
        let same = row0 == col0;
        for i in 0..count_a {
            let li = lag_a + i;
            let ai = &a[s.first - li..n - li];
            if same {
                self.sums[row0 + i] = ai.iter().sum();
            }
            let last = if same { i + 1 } else { count_b };
            for j in 0..last {
                let lj = lag_b + j;
                let at = (row0 + i) * size + col0 + j;
                self.gram[at] = if i > 0 && j > 0 {
                    self.gram[at - size - 1] + a[s.first - li] * b[s.first - lj] - a[n - li] * b[n - lj]
                } else {
                    dot(ai, &b[s.first - lj..n - lj])
                };
            }
        }
    }

    /// Regresses y on all y and x lags, leaves the residual in `self.e`, returns its mean square.
    fn long_arx(&mut self, s: &Signals<'_>) -> f64 {
        let nx = x_lags(self.max_delay);
        let count = LONG_Y + nx;
        let columns: Vec<usize> = (1..=count).collect();
        let n = s.y.len();
        let rows = n - s.first;
        let mut solution = std::mem::take(&mut self.solution);
        let loss = self.solve(&columns, rows, &mut solution);
        let mean = (self.sums[0]
            - solution
                .iter()
                .zip(&self.sums[1..=count])
                .map(|(c, sum)| c * sum)
                .sum::<f64>())
            / rows as f64;
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
            for (e, x) in e.iter_mut().zip(&s.x[begin - 1 - j..]) {
                *e -= c * x;
            }
        }
        self.solution = solution;
        loss
    }

    /// Least squares of column 0 on `columns`, all centred (which is what a free constant does).
    fn solve(&mut self, columns: &[usize], rows: usize, solution: &mut [f64]) -> f64 {
        let size = self.sums.len();
        let n = columns.len();
        let per_row = 1.0 / rows as f64;
        for (i, &ci) in columns.iter().enumerate() {
            for (j, &cj) in columns[..=i].iter().enumerate() {
                let (hi, lo) = if ci >= cj { (ci, cj) } else { (cj, ci) };
                self.scratch[i * size + j] =
                    self.gram[hi * size + lo] - self.sums[ci] * self.sums[cj] * per_row;
            }
            solution[i] = self.gram[ci * size] - self.sums[ci] * self.sums[0] * per_row;
        }
        let mut right = [0.0; 64];
        right[..n].copy_from_slice(&solution[..n]);
        cholesky_solve(&mut self.scratch, size, n, &mut solution[..n]);
        let total = self.gram[0] - self.sums[0] * self.sums[0] * per_row;
        let explained: f64 = solution[..n].iter().zip(&right).map(|(c, r)| c * r).sum();
        (total - explained).max(0.0) * per_row
    }
}

/// Lags of the stem position in the Gram matrix: the longest delay and the longest B behind it.
fn x_lags(max_delay: usize) -> usize {
    max_delay + ORDER - 2
}
