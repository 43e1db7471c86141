//! The normal equations of one iteration, and the step they give.

use super::super::linalg::{MOST_COLUMNS, factor, substitute};
use super::super::zeros::draw_inside;
use super::{Lag, MAX_PARAMETERS, Orders, RHO, Theta};

/// Signals of a column: y, z, e, the constant, and the derivative by the lag.
const Y: usize = 0;
const Z: usize = 1;
const E: usize = 2;
pub(super) const CONSTANT: usize = 3;
const LAG: usize = 4;

type Parameters = [f64; MAX_PARAMETERS];

/// `J'J` and `J'e`.
pub(super) struct Normal {
    /// Lower triangle.
    pub(super) jtj: [Parameters; MAX_PARAMETERS],
    pub(super) jte: Parameters,
    /// (signal, lag) of each column, in the order a, b, c, c0, lag.
    pub(super) columns: [(usize, usize); MAX_PARAMETERS],
    pub(super) size: usize,
    orders: Orders,
    rows: f64,
}

impl Normal {
    pub(super) fn new(orders: Orders, free_lag: bool, rows: usize) -> Self {
        let mut columns = [(Y, 0); MAX_PARAMETERS];
        let wanted = (1..=orders.na)
            .map(|i| (Y, i))
            .chain((0..orders.nb).map(|j| (Z, orders.nk + j)))
            .chain((1..=orders.nc).map(|l| (E, l)))
            .chain([(CONSTANT, 0)])
            .chain(free_lag.then_some((LAG, 0)));
        let mut size = 0;
        for (slot, column) in columns.iter_mut().zip(wanted) {
            *slot = column;
            size += 1;
        }
        let jtj = [[0.0; MAX_PARAMETERS]; MAX_PARAMETERS];
        Self { jtj, jte: [0.0; MAX_PARAMETERS], columns, size, orders, rows: rows as f64 }
    }

    /// e falls with b, c and c0 and grows with a and the lag.
    pub(super) fn apply_signs(&mut self) {
        let sign = |signal: usize| if matches!(signal, Z | E | CONSTANT) { -1.0 } else { 1.0 };
        for i in 0..self.size {
            let si = sign(self.columns[i].0);
            self.jte[i] *= si;
            for j in 0..=i {
                self.jtj[i][j] *= si * sign(self.columns[j].0);
            }
        }
    }

    /// The damped step d and the decrease of V that the quadratic model promises for it, at least `-gᵀd/N`.
    pub(super) fn step(&self, damping: f64) -> (Parameters, f64) {
        let mut right = self.jte.map(|g| -g);
        let all: [usize; MAX_PARAMETERS] = std::array::from_fn(|i| i);
        self.solve(&all[..self.size], damping, &mut right);
        let linear: f64 = (0..self.size).map(|i| -self.jte[i] * right[i]).sum();
        (right, linear.max(0.0) / self.rows)
    }

    /// `theta` one step on, kept within its bounds.
    pub(super) fn apply(&self, theta: &Theta, step: &Parameters, damping: f64, lag: Lag) -> Theta {
        let Orders { na, nb, nc, .. } = self.orders;
        let mut next = *theta;
        let c = &mut next.c[..nc];
        for (c, step) in c.iter_mut().zip(&step[na + nb..]) {
            *c += step;
        }
        let wanted = next.c;
        draw_inside(&mut next.c[..nc], RHO);
        let mut step = *step;
        if next.c != wanted {
            self.follow(theta, &next, damping, &mut step);
        }
        for (i, &(signal, _)) in self.columns[..self.size].iter().enumerate() {
            match signal {
                Y => next.a[i] += step[i],
                Z => next.b[i - na] += step[i],
                CONSTANT => next.c0 += step[i],
                LAG => {
                    if let Lag::Free { max } = lag {
                        next.lag = (next.lag + step[i]).clamp(0.0, max);
                    }
                }
                _ => {}
            }
        }
        next
    }

    /// The step of the other coefficients where C does not move as the step wants but to that of `next`: with C held by
    /// its bound the rest of the step would go to where no minimum is.
    fn follow(&self, theta: &Theta, next: &Theta, damping: f64, step: &mut Parameters) {
        let from = self.orders.na + self.orders.nb;
        let mut free = [0; MAX_PARAMETERS];
        let mut right = [0.0; MAX_PARAMETERS];
        let mut count = 0;
        for i in (0..self.size).filter(|&i| self.columns[i].0 != E) {
            let moved = (0..self.orders.nc).map(|l| self.product(i, from + l) * (next.c[l] - theta.c[l]));
            right[count] = -self.jte[i] - moved.sum::<f64>();
            free[count] = i;
            count += 1;
        }
        self.solve(&free[..count], damping, &mut right);
        for (&i, value) in free[..count].iter().zip(right) {
            step[i] = value;
        }
    }

    /// An element of `J'J`, of either triangle.
    fn product(&self, i: usize, j: usize) -> f64 {
        self.jtj[i.max(j)][i.min(j)]
    }

    /// Solves the damped equations of the parameters `of`, in place.
    fn solve(&self, of: &[usize], damping: f64, right: &mut Parameters) {
        let mut g = [0.0; MAX_PARAMETERS * MAX_PARAMETERS];
        for (row, &i) in of.iter().enumerate() {
            for (column, &j) in of[..=row].iter().enumerate() {
                g[row * MAX_PARAMETERS + column] = self.jtj[i][j];
            }
            g[row * MAX_PARAMETERS + row] *= 1.0 + damping;
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, MAX_PARAMETERS, of.len(), &mut live);
        substitute(&g, MAX_PARAMETERS, &live, &mut right[..of.len()]);
    }
}
