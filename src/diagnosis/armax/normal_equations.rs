//! The normal equations of one iteration, and the Levenberg–Marquardt step that they give within the bounds.
//!
//! ```text
//! (J'J + damping diag(J'J)) d = -J'e,    J = de/d(coefficients)
//! V(theta + d) ~ V(theta) + (2 (J'e)' d + d' J'J d) / N
//! bounds: every zero of C keeps |q| <= RHO (to first order), 0 <= lag <= max
//! ```

use super::model::{Lag, MAX_PARAMETERS, Orders, Theta};
use crate::sysid::armax::RHO;
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::zeros::{MARGIN, draw_inside, is_inside, outward, zeros};

/// Index of y among the signals of the columns.
const Y: usize = 0;
/// Index of z there.
const Z: usize = 1;
/// Index of e there.
const E: usize = 2;
/// Index of the constant there, which needs no signal.
pub(super) const CONSTANT: usize = 3;
/// Index of the derivative by the lag there.
const LAG: usize = 4;

/// One number for each coefficient, in the order a, b, c, c0, lag.
type Parameters = [f64; MAX_PARAMETERS];

/// Most bounds that a step can meet: one for each zero of C, and one of the lag.
const BOUNDS: usize = 5;

/// The normal equations at one model.
pub(super) struct NormalEquations {
    /// `J'J`, lower triangle.
    pub(super) jtj: [Parameters; MAX_PARAMETERS],
    /// `J'e`.
    pub(super) jte: Parameters,
    /// Signal and lag of each column of J.
    pub(super) columns: [(usize, usize); MAX_PARAMETERS],
    /// Number of columns.
    pub(super) size: usize,
    orders: Orders,
    /// Number N of rows that count.
    rows: f64,
}

/// A linear constraint on the step d: `row' d <= right`.
#[derive(Clone, Copy)]
struct Constraint {
    row: Parameters,
    right: f64,
}

impl NormalEquations {
    /// The columns for these orders; all products are 0 yet.
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

    /// Gives the columns their signs: e decreases with b, c and c0, and increases with a and the lag.
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

    /// The coefficients after the damped step from `theta`, and the decrease of V that the quadratic model predicts for it.
    ///
    /// A step that would leave the bounds goes to the minimum of the quadratic model on the bounds. If it were only shortened, the
    /// other coefficients would not reach their minimum.
    pub(super) fn step(&self, theta: &Theta, damping: f64, lag: Lag) -> (Theta, f64) {
        let n = self.size;
        let mut g = [0.0; MAX_PARAMETERS * MAX_PARAMETERS];
        for i in 0..n {
            g[i * MAX_PARAMETERS..=i * MAX_PARAMETERS + i].copy_from_slice(&self.jtj[i][..=i]);
            g[i * MAX_PARAMETERS + i] *= 1.0 + damping;
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, MAX_PARAMETERS, n, &mut live);
        let solve = |mut right: Parameters| {
            substitute(&g, MAX_PARAMETERS, &live, &mut right[..n]);
            right
        };
        let free = solve(self.jte.map(|g| -g));
        let next = self.moved(theta, &free);
        let range = if let Lag::Free { max } = lag { 0.0..=max } else { theta.lag..=theta.lag };
        if is_inside(&next.c[..self.orders.nc], RHO) && range.contains(&next.lag) {
            return (next, self.predicted_decrease(&free));
        }
        let mut constraints = [Constraint { row: [0.0; MAX_PARAMETERS], right: 0.0 }; BOUNDS + 1];
        let count = self.constraints(theta, lag, &mut constraints);
        let step = constrained_step(&free, &constraints[..count], n, solve);
        let mut next = self.moved(theta, &step);
        draw_inside(&mut next.c[..self.orders.nc], RHO);
        next.lag = next.lag.clamp(*range.start(), *range.end());
        (next, self.predicted_decrease(&step))
    }

    /// Puts the constraints on a step from `theta` into `constraints`: the modulus of every zero of C, to first order, and the lag.
    ///
    /// Returns their number.
    fn constraints(&self, theta: &Theta, lag: Lag, constraints: &mut [Constraint; BOUNDS + 1]) -> usize {
        let Orders { na, nb, nc, .. } = self.orders;
        let mut count = 0;
        if let Lag::Free { max } = lag {
            for (sign, right) in [(-1.0, theta.lag), (1.0, max - theta.lag)] {
                let mut row = [0.0; MAX_PARAMETERS];
                row[self.size - 1] = sign;
                constraints[count] = Constraint { row, right };
                count += 1;
            }
        }
        let c = &theta.c[..nc];
        let Some(zeros) = zeros(c) else { return count };
        // One of two conjugate zeros is enough. The iteration leaves a real zero with an imaginary part of rounding size.
        for zero in zeros[..nc].iter().filter(|zero| zero.im > -1e-9 * zero.norm()) {
            let mut row = [0.0; MAX_PARAMETERS];
            outward(c, *zero, &mut row[na + nb..na + nb + nc]);
            if count <= BOUNDS && row.iter().all(|r| r.is_finite()) {
                constraints[count] = Constraint { row, right: RHO * (1.0 - MARGIN) - zero.norm() };
                count += 1;
            }
        }
        count
    }

    /// The decrease of V that the quadratic model predicts for a step d: `-(2 (J'e)'d + d'J'Jd)/N`, at least 0.
    fn predicted_decrease(&self, step: &Parameters) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.size {
            let row: f64 = self.jtj[i][..i].iter().zip(step).map(|(j, d)| j * d).sum();
            sum -= step[i] * (2.0 * (self.jte[i] + row) + self.jtj[i][i] * step[i]);
        }
        sum.max(0.0) / self.rows
    }

    /// `theta` plus a step.
    fn moved(&self, theta: &Theta, step: &Parameters) -> Theta {
        let Orders { na, nb, .. } = self.orders;
        let mut next = *theta;
        for (i, &(signal, _)) in self.columns[..self.size].iter().enumerate() {
            match signal {
                Y => next.a[i] += step[i],
                Z => next.b[i - na] += step[i],
                E => next.c[i - na - nb] += step[i],
                CONSTANT => next.c0 += step[i],
                _ => next.lag += step[i],
            }
        }
        next
    }
}

/// The minimum of the quadratic model under the constraints, by an active set: the constraint that is violated most becomes an
/// equality, until none is violated.
///
/// * `free`: the minimum without constraints, of `n` coefficients.
/// * `solve`: `G^-1` of the damped `G = J'J` times a vector.
fn constrained_step(
    free: &Parameters,
    constraints: &[Constraint],
    n: usize,
    solve: impl Fn(Parameters) -> Parameters,
) -> Parameters {
    let product = |a: &Parameters, b: &Parameters| a[..n].iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut step = *free;
    // The active constraints, and `G^-1` times their rows.
    let mut active: [(usize, Parameters); BOUNDS] = [(0, [0.0; MAX_PARAMETERS]); BOUNDS];
    for count in 0..BOUNDS {
        let excess = |i: usize| product(&constraints[i].row, &step) - constraints[i].right;
        let violated = (0..constraints.len())
            .filter(|i| active[..count].iter().all(|(known, _)| known != i) && excess(*i) > 1e-9);
        let Some(worst) = violated.max_by(|&a, &b| excess(a).total_cmp(&excess(b))) else { break };
        active[count] = (worst, solve(constraints[worst].row));
        let active = &active[..=count];
        let mut gram = [0.0; BOUNDS * BOUNDS];
        let mut multipliers = [0.0; BOUNDS];
        for (i, (at, _)) in active.iter().enumerate() {
            for (j, (_, column)) in active[..=i].iter().enumerate() {
                gram[i * BOUNDS + j] = product(&constraints[*at].row, column);
            }
            multipliers[i] = product(&constraints[*at].row, free) - constraints[*at].right;
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut gram, BOUNDS, active.len(), &mut live);
        substitute(&gram, BOUNDS, &live, &mut multipliers[..active.len()]);
        step = *free;
        for ((_, column), multiplier) in active.iter().zip(multipliers) {
            for (step, column) in step.iter_mut().zip(column) {
                *step -= multiplier * column;
            }
        }
    }
    step
}
