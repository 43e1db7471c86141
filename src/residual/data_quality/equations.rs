//! The equations of the controller and of the process with PV shifted in time, by which a clock skew is found (see `clock.rs`).

use super::fact::log_density;
use super::quantised::{error_of, step_of};
use crate::sysid::arx::Arx;
use crate::sysid::criterion::{REGULAR, penalty};
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::stats::sd;
use crate::sysid::student::{self, FREEDOM};
use std::ops::{Range, RangeInclusive};

/// Longest skew tried (samples): less than the lead of the fitted rows and the rows behind them.
pub const LONGEST: i32 = 15;
/// Shifts of PV that are no skew (samples): the controller reads PV at its tick, or at the tick before.
pub const HONEST: RangeInclusive<i32> = 0..=1;
/// Least skew beyond these, and least growth of one (samples): less may come from when in a scan each tag is read.
const LEAST: f64 = 1.5;
/// Lags of PV, of OP's changes and of the set point in the controller: those of a PID with a filtered derivative.
const LAGS: [usize; 3] = [3, 2, 3];
/// Least scale of the errors of OP's changes, in standard deviations of OP: OP has at most six digits.
const ROUNDING: f64 = 1e-6;
/// Scale of the errors of OP's changes, as a share of their spread, up to which the controller's equation is exact: the noise of PV
/// keeps the equation of a process from being so exact.
const EXACT: f64 = 1e-3;
/// Rows whose gains are summed before the standard error is taken: what one equation loses, the other gains within so many rows.
const BLOCK: usize = 2 * LONGEST_LAG;
/// Most passes of reweighted least squares: the scale of an exact controller shrinks from pass to pass.
const PASSES: usize = 30;
/// Relative change of the scale at which the passes end: the log-likelihood of a row changes by no more.
const SETTLED: f64 = 1e-3;
/// Steps by which the two ends of a growing skew are refined (samples).
const STEPS: [f64; 3] = [0.5, 0.25, 0.125];
/// Directions in which the two ends are moved.
const WAYS: [(f64, f64); 8] =
    [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];

/// A shift of PV to later times, linear from the start of the window to its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// Shift at the start (samples).
    pub first: f64,
    /// Shift at the end (samples).
    pub last: f64,
}

impl Shift {
    /// A shift that is the same over the whole window.
    pub fn constant(by: i32) -> Self {
        Self { first: f64::from(by), last: f64::from(by) }
    }

    /// Whether it means a skew: one end is beyond the shifts that are none.
    pub fn is_wrong(&self) -> bool {
        let [least, most] = [*HONEST.start(), *HONEST.end()].map(f64::from);
        [self.first, self.last].iter().any(|by| *by <= least - LEAST || *by >= most + LEAST)
    }

    /// The position in the record of the PV that belongs to sample `k` of `n` (samples).
    fn source(&self, k: usize, n: usize) -> f64 {
        k as f64 - self.first - (self.last - self.first) * k as f64 / n as f64
    }

    /// Flags of PV at its right times: those of the nearest samples.
    pub fn nearest(&self, flags: &[bool]) -> Vec<bool> {
        let n = flags.len();
        let of = |k: usize| flags[self.source(k, n).round().clamp(0.0, n as f64 - 1.0) as usize];
        (0..n).map(of).collect()
    }

    /// PV, interpolated linearly, and its weights at the right times.
    pub fn moved(&self, y: &[f64], weight: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let end = y.len() - 1;
        let each = (0..y.len()).map(|k| {
            let at = self.source(k, y.len());
            let inside = at.clamp(0.0, end as f64);
            let (before, share) = (inside as usize, inside.fract());
            let after = (before + 1).min(end);
            let counts = if share > 0.0 { weight[before].min(weight[after]) } else { weight[before] };
            (y[before] + share * (y[after] - y[before]), if inside == at { counts } else { 0.0 })
        });
        each.unzip()
    }
}

/// The difference of two log-likelihoods, summed over the rows, and the same in its standard errors (-).
pub fn gain(of: &[f64], others: &[f64]) -> (f64, f64) {
    let each: Vec<f64> = of.iter().zip(others).map(|(of, other)| of - other).collect();
    let blocks: Vec<f64> = each.chunks(BLOCK).map(|few| few.iter().sum()).collect();
    let sum: f64 = blocks.iter().sum();
    (sum, sum / (sd(&blocks) * (blocks.len() as f64).sqrt()).max(f64::MIN_POSITIVE))
}

/// The equation of the controller, fitted to a shifted PV.
pub struct Controller {
    /// Shift of PV.
    pub shift: Shift,
    /// Scale of the errors of OP's changes (standard deviations of OP).
    pub scale: f64,
    /// Log-likelihood of each row (-).
    pub each: Vec<f64>,
}

impl Controller {
    /// Log-likelihood of all rows (-).
    pub fn log_likelihood(&self) -> f64 {
        self.each.iter().sum()
    }
}

/// The equations of the controller and of the process on one record.
pub struct Equations<'a> {
    data: &'a IdData,
    /// `u[k] - u[k-1]`.
    changes: Vec<f64>,
    /// Least scales of the errors of OP's changes and of PV, by the steps in which they are written.
    least: [f64; 2],
    /// Scale up to which the equation of the controller is exact.
    pub exact: f64,
}

impl<'a> Equations<'a> {
    /// The equations on a record. `step`: the quantum of PV.
    pub fn new(data: &'a IdData, step: f64) -> Self {
        let u = &data.u;
        let changes: Vec<f64> = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
        let of_u = error_of(step_of(u)).max(ROUNDING);
        Self { exact: of_u.max(EXACT * sd(&changes)), least: [of_u, error_of(step)], data, changes }
    }

    /// The controller, fitted to some rows with PV shifted.
    pub fn controller(&self, shift: Shift, rows: Range<usize>) -> Controller {
        let (y, _) = shift.moved(&self.data.y, &self.data.weight);
        let ones = vec![1.0; rows.len()];
        let mut columns: Vec<&[f64]> = vec![&ones];
        columns.extend(lagged(&y, &rows, 0..LAGS[0]));
        let target = &self.changes[rows.clone()];
        let mut start = ones.clone();
        match &self.data.sp {
            Some(sp) => columns.extend(lagged(sp, &rows, 0..LAGS[2])),
            None => {
                // A set point that is not recorded is taken to add the same at two samples in a row: it cancels in the second
                // differences of OP, and their weights are a start.
                let before = lagged(&self.changes, &rows, 1..2).flatten();
                let second_differences: Vec<f64> =
                    target.iter().zip(before).map(|(now, before)| now - before).collect();
                start = self.robust(&columns, &second_differences, ones.clone()).2;
            }
        }
        columns.extend(lagged(&self.changes, &rows, 1..1 + LAGS[1]));
        let (e, scale, _) = self.robust(&columns, target, start);
        Controller { shift, scale, each: e.iter().map(|e| log_density(*e, scale)).collect() }
    }

    /// Regression with Student-t errors, by reweighted least squares: the errors of `target`, their scale, and the weights. `omega`:
    /// weights to start from.
    fn robust(&self, columns: &[&[f64]], target: &[f64], mut omega: Vec<f64>) -> (Vec<f64>, f64, Vec<f64>) {
        let ones = vec![1.0; target.len()];
        let (mut e, mut scale) = (target.to_vec(), student::first_scale(target, &ones));
        for _ in 0..PASSES {
            e = errors(columns, target, &omega);
            let before = scale;
            scale = student::scale(&e, &ones, scale, FREEDOM, 0.0).max(self.least[0]);
            student::reweigh(&e, &ones, (scale, FREEDOM), &mut omega);
            if (scale / before - 1.0).abs() < SETTLED {
                break;
            }
        }
        (e, scale, omega)
    }

    /// Log-likelihood of each row of the process, fitted with PV shifted (-).
    pub fn process(&self, shift: Shift) -> Vec<f64> {
        let mut moved = self.data.clone();
        (moved.y, moved.weight) = shift.moved(&self.data.y, &self.data.weight);
        let fit = Arx::new(&moved, &moved.y, &[]).fit(&moved.u, None);
        let weight = &moved.weight[moved.rows()];
        // The scale of the fit belongs to its own degrees of freedom: it is estimated again for those of `log_density`.
        let scale = student::scale(&fit.e, weight, fit.scale, FREEDOM, self.least[1]);
        fit.e.iter().zip(weight).map(|(e, w)| w * log_density(*e, scale)).collect()
    }

    /// The controller with the likeliest constant shift, in some rows.
    pub fn constant(&self, rows: Range<usize>) -> Controller {
        let rated = |by| self.controller(Shift::constant(by), rows.clone());
        let all: Vec<(f64, Controller)> =
            (-LONGEST..=LONGEST).map(rated).map(|one| (one.log_likelihood(), one)).collect();
        let most = all.iter().map(|one| one.0).fold(f64::NEG_INFINITY, f64::max);
        // A PI controller needs only two of the three samples of PV, so that two shifts fit alike. Of the shifts that are as likely but
        // for the penalty of one coefficient, the latest is right: the oldest sample is the one that it does not need.
        let unneeded = penalty(REGULAR, rows.len() as f64);
        let latest = all.into_iter().rev().find(|one| one.0 >= most - unneeded);
        latest.map_or_else(|| rated(0), |one| one.1)
    }

    /// The controller with the likeliest shift that grows over the window; `None` where the first and the last third of the rows have
    /// the same constant shift, or where the growth is too small.
    pub fn growing(&self, rows: Range<usize>) -> Option<Controller> {
        let third = rows.len() / 3;
        let [early, late] = [rows.start..rows.start + third, rows.end - third..rows.end]
            .map(|rows| self.constant(rows).shift.first);
        if early == late {
            return None;
        }
        // The shifts of the thirds are extrapolated from their middles to the ends of the window.
        let middle = |k: usize| k as f64 / self.data.len() as f64;
        let (from, to) = (middle(rows.start + third / 2), middle(rows.end - third / 2));
        let growth = (late - early) / (to - from);
        let first = early - growth * from;
        let rated = |shift: Shift| {
            let one = self.controller(shift, rows.clone());
            (one.log_likelihood(), one)
        };
        let inside = |by: f64| by.abs() <= f64::from(LONGEST);
        let mut found = rated(Shift { first, last: first + growth });
        for step in STEPS {
            loop {
                let Shift { first, last } = found.1.shift;
                let next = WAYS.map(|(a, b)| Shift { first: first + a * step, last: last + b * step });
                let next = next.into_iter().filter(|shift| inside(shift.first) && inside(shift.last));
                let next = next.map(rated).max_by(|a, b| a.0.total_cmp(&b.0));
                let Some(next) = next.filter(|next| next.0 > found.0) else { break };
                found = next;
            }
        }
        let Shift { first, last } = found.1.shift;
        ((last - first).abs() >= LEAST).then_some(found.1)
    }
}

/// A signal in some rows, at each of these lags (samples).
fn lagged<'v>(v: &'v [f64], rows: &Range<usize>, lags: Range<usize>) -> impl Iterator<Item = &'v [f64]> {
    let Range { start, end } = *rows;
    lags.map(move |lag| &v[start - lag..end - lag])
}

/// The errors of a weighted least-squares regression of `target` on `columns`.
fn errors(columns: &[&[f64]], target: &[f64], weight: &[f64]) -> Vec<f64> {
    let size = columns.len();
    let root: Vec<f64> = weight.iter().map(|weight| weight.sqrt()).collect();
    let by = |column: &[f64]| -> Vec<f64> { column.iter().zip(&root).map(|(c, w)| c * w).collect() };
    let scaled: Vec<Vec<f64>> = columns.iter().map(|column| by(column)).collect();
    let all: Vec<&[f64]> = scaled.iter().map(Vec::as_slice).collect();
    let (mut g, mut theta) = (vec![0.0; size * size], vec![0.0; size]);
    lower(&all, &mut g, size);
    products(&[&by(target)], &all, |_, i, sum| theta[i] = sum);
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, size, size, &mut live);
    substitute(&g, size, &live, &mut theta);
    let mut e = target.to_vec();
    for (theta, column) in theta.iter().zip(columns) {
        e.iter_mut().zip(*column).for_each(|(e, c)| *e -= theta * c);
    }
    e
}
