//! The normal equations of one iteration, and the step they give within the bounds.

use super::{Lag, MAX_PARAMETERS, Orders, RHO, Theta};
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::zeros::{MARGIN, draw_inside, is_inside, outward, zeros};

/// Place of y among the signals of a column.
const Y: usize = 0;
/// Place of z there.
const Z: usize = 1;
/// Place of e there.
const E: usize = 2;
/// Place of the constant there, which needs no signal.
pub(super) const CONSTANT: usize = 3;
/// Place of the derivative by the lag there.
const LAG: usize = 4;

type Parameters = [f64; MAX_PARAMETERS];

/// Most bounds that a step can meet: a zero of C each, and the lag.
const BOUNDS: usize = 5;

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

/// A step must keep `row' d <= right`.
#[derive(Clone, Copy)]
struct Bound {
    row: Parameters,
    right: f64,
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

    /// Where the damped step leads from `theta`, and the decrease of V that the quadratic model promises there.
    ///
    /// A step that would leave the bounds goes to where the quadratic model is least on them: to stop short at them would
    /// leave the other coefficients where no minimum is.
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
            return (next, self.promised(&free));
        }
        let mut bounds = [Bound { row: [0.0; MAX_PARAMETERS], right: 0.0 }; BOUNDS + 1];
        let count = self.bounds(theta, lag, &mut bounds);
        let step = within(&free, &bounds[..count], n, solve);
        let mut next = self.moved(theta, &step);
        draw_inside(&mut next.c[..self.orders.nc], RHO);
        next.lag = next.lag.clamp(*range.start(), *range.end());
        (next, self.promised(&step))
    }

    /// What bounds a step from `theta`: every zero of C on its way out, to first order, and the lag.
    fn bounds(&self, theta: &Theta, lag: Lag, bounds: &mut [Bound; BOUNDS + 1]) -> usize {
        let Orders { na, nb, nc, .. } = self.orders;
        let mut count = 0;
        if let Lag::Free { max } = lag {
            for (sign, right) in [(-1.0, theta.lag), (1.0, max - theta.lag)] {
                let mut row = [0.0; MAX_PARAMETERS];
                row[self.size - 1] = sign;
                bounds[count] = Bound { row, right };
                count += 1;
            }
        }
        let c = &theta.c[..nc];
        let Some(zeros) = zeros(c) else { return count };
        // Of two conjugates one is enough; the iteration leaves rounding on a real zero.
        for zero in zeros[..nc].iter().filter(|zero| zero.im > -1e-9 * zero.norm()) {
            let mut row = [0.0; MAX_PARAMETERS];
            outward(c, *zero, &mut row[na + nb..na + nb + nc]);
            if count <= BOUNDS && row.iter().all(|r| r.is_finite()) {
                bounds[count] = Bound { row, right: RHO * (1.0 - MARGIN) - zero.norm() };
                count += 1;
            }
        }
        count
    }

    /// The decrease of V that the quadratic model promises for a step: `-(2 g'd + d'J'Jd)/N`, g = J'e.
    fn promised(&self, step: &Parameters) -> f64 {
        let mut sum = 0.0;
        for i in 0..self.size {
            let row: f64 = self.jtj[i][..i].iter().zip(step).map(|(j, d)| j * d).sum();
            sum -= step[i] * (2.0 * (self.jte[i] + row) + self.jtj[i][i] * step[i]);
        }
        sum.max(0.0) / self.rows
    }

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

/// The step nearest to `free`, measured by the quadratic model, that keeps the bounds: those it breaks are made
/// equalities, the worst first, until it keeps all.
fn within(
    free: &Parameters,
    bounds: &[Bound],
    n: usize,
    solve: impl Fn(Parameters) -> Parameters,
) -> Parameters {
    let product = |a: &Parameters, b: &Parameters| a[..n].iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut step = *free;
    // The bounds that hold, and `G^-1` times their rows.
    let mut held: [(usize, Parameters); BOUNDS] = [(0, [0.0; MAX_PARAMETERS]); BOUNDS];
    for count in 0..BOUNDS {
        let excess = |i: usize| product(&bounds[i].row, &step) - bounds[i].right;
        let broken = (0..bounds.len())
            .filter(|i| held[..count].iter().all(|(known, _)| known != i) && excess(*i) > 1e-9);
        let Some(worst) = broken.max_by(|&a, &b| excess(a).total_cmp(&excess(b))) else { break };
        held[count] = (worst, solve(bounds[worst].row));
        let held = &held[..=count];
        let mut gram = [0.0; BOUNDS * BOUNDS];
        let mut force = [0.0; BOUNDS];
        for (i, (at, _)) in held.iter().enumerate() {
            for (j, (_, column)) in held[..=i].iter().enumerate() {
                gram[i * BOUNDS + j] = product(&bounds[*at].row, column);
            }
            force[i] = product(&bounds[*at].row, free) - bounds[*at].right;
        }
        let mut live = [true; MOST_COLUMNS];
        factor(&mut gram, BOUNDS, held.len(), &mut live);
        substitute(&gram, BOUNDS, &live, &mut force[..held.len()]);
        step = *free;
        for ((_, column), force) in held.iter().zip(force) {
            for (step, column) in step.iter_mut().zip(column) {
                *step -= force * column;
            }
        }
    }
    step
}
