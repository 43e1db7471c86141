//! The two equations that a skew of clocks is told by: the controller and the process, with PV moved (see [`super::clock`]).

use super::log_density;
use super::quantised::{error_of, step_of};
use crate::sysid::arx::Arx;
use crate::sysid::criterion::REGULAR;
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::stats::sd;
use crate::sysid::student::{self, FREEDOM};
use std::ops::{Range, RangeInclusive};

/// Longest skew tried (samples): less than the lead of the fitted rows and the rows behind them.
pub const LONGEST: i32 = 15;
/// Samples that PV is moved by where stamps are honest: the controller sees PV at its tick or at the one before.
pub const HONEST: RangeInclusive<i32> = 0..=1;
/// Least skew beyond honest stamps, and least growth of one (samples): less is a matter of when in a scan each tag is read.
const LEAST: f64 = 1.5;
/// Lags of PV, of OP's changes and of the set point in the controller: those of a PID with a filtered derivative.
const LAGS: [usize; 3] = [3, 2, 3];
/// Least error of OP's changes in OP's standard deviations: OP is written with no more than six digits.
const ROUNDING: f64 = 1e-6;
/// Error of OP's changes as a share of them, up to which a controller is exact: no PV is so free of noise that a process could be.
const EXACT: f64 = 1e-3;
/// Rows whose gains are summed before their standard error is taken: what one equation loses the other gains within these.
const BLOCK: usize = 2 * LONGEST_LAG;
/// Most passes of reweighted least squares: an exact controller is found from afar, its scale shrinks from pass to pass.
const PASSES: usize = 30;
/// Relative change of the scale at which the passes end: it moves a row's likelihood by no more.
const SETTLED: f64 = 1e-3;
/// Steps of the two ends of a skew that grows (samples).
const STEPS: [f64; 3] = [0.5, 0.25, 0.125];
/// Ways to move the two ends.
const WAYS: [(f64, f64); 8] =
    [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];

/// Samples that PV is moved to later times, at the window's start and at its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// At the start.
    pub first: f64,
    /// At the end.
    pub last: f64,
}

impl Shift {
    /// One that does not grow.
    pub fn constant(by: i32) -> Self {
        Self { first: f64::from(by), last: f64::from(by) }
    }

    /// Whether it is one that matters.
    pub fn is_wrong(&self) -> bool {
        let [least, most] = [*HONEST.start(), *HONEST.end()].map(f64::from);
        [self.first, self.last].iter().any(|by| *by <= least - LEAST || *by >= most + LEAST)
    }

    /// Where PV of sample `k` of `n` stands in the record (samples).
    fn from(&self, k: usize, n: usize) -> f64 {
        k as f64 - self.first - (self.last - self.first) * k as f64 / n as f64
    }

    /// The same of what each sample is or is not: that of the nearest one.
    pub fn nearest(&self, flags: &[bool]) -> Vec<bool> {
        let n = flags.len();
        let of = |k: usize| flags[self.from(k, n).round().clamp(0.0, n as f64 - 1.0) as usize];
        (0..n).map(of).collect()
    }

    /// PV and its weights at the right times.
    pub fn moved(&self, y: &[f64], weight: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let end = y.len() - 1;
        let each = (0..y.len()).map(|k| {
            let at = self.from(k, y.len());
            let inside = at.clamp(0.0, end as f64);
            let (before, share) = (inside as usize, inside.fract());
            let after = (before + 1).min(end);
            let counts = if share > 0.0 { weight[before].min(weight[after]) } else { weight[before] };
            (y[before] + share * (y[after] - y[before]), if inside == at { counts } else { 0.0 })
        });
        each.unzip()
    }
}

/// By how much the log-likelihoods of rows exceed others, and that in its standard errors.
pub fn gain(of: &[f64], others: &[f64]) -> (f64, f64) {
    let each: Vec<f64> = of.iter().zip(others).map(|(of, other)| of - other).collect();
    let blocks: Vec<f64> = each.chunks(BLOCK).map(|few| few.iter().sum()).collect();
    let sum: f64 = blocks.iter().sum();
    (sum, sum / (sd(&blocks) * (blocks.len() as f64).sqrt()).max(f64::MIN_POSITIVE))
}

/// The controller with PV moved.
pub struct Controller {
    /// By how much.
    pub shift: Shift,
    /// Scale of its errors.
    pub scale: f64,
    /// Log-likelihood of each row.
    pub each: Vec<f64>,
}

impl Controller {
    /// Log-likelihood of all rows.
    pub fn log_likelihood(&self) -> f64 {
        self.each.iter().sum()
    }
}

/// The controller and the process, as far as the signals show them.
pub struct Equations<'a> {
    data: &'a IdData,
    /// `u[k] - u[k-1]`.
    changes: Vec<f64>,
    /// Least scales of the errors of OP's changes and of PV: what their steps leave.
    least: [f64; 2],
    /// Scale up to which a controller is exact.
    pub exact: f64,
}

impl<'a> Equations<'a> {
    /// Of this data; `step`: the quantum of PV.
    pub fn new(data: &'a IdData, step: f64) -> Self {
        let u = &data.u;
        let changes: Vec<f64> = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
        let of_u = error_of(step_of(u)).max(ROUNDING);
        Self { exact: of_u.max(EXACT * sd(&changes)), least: [of_u, error_of(step)], data, changes }
    }

    /// The controller in these rows, with PV moved.
    pub fn controller(&self, shift: Shift, rows: Range<usize>) -> Controller {
        let (y, _) = shift.moved(&self.data.y, &self.data.weight);
        let ones = vec![1.0; rows.len()];
        let mut columns: Vec<&[f64]> = vec![&ones];
        columns.extend(late(&y, &rows, 0..LAGS[0]));
        let target = &self.changes[rows.clone()];
        let mut start = ones.clone();
        match &self.data.sp {
            Some(sp) => columns.extend(late(sp, &rows, 0..LAGS[2])),
            None => {
                // Where the set point is not recorded, what it adds at each sample is taken to be the same at the next one.
                let before = late(&self.changes, &rows, 1..2).flatten();
                let bends: Vec<f64> = target.iter().zip(before).map(|(now, before)| now - before).collect();
                start = self.robust(&columns, &bends, ones.clone()).2;
            }
        }
        columns.extend(late(&self.changes, &rows, 1..1 + LAGS[1]));
        let (e, scale, _) = self.robust(&columns, target, start);
        Controller { shift, scale, each: e.iter().map(|e| log_density(*e, scale)).collect() }
    }

    /// The errors of OP's changes, their scale and the weights it gives, from these weights on.
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

    /// Log-likelihood of each row of the process with PV moved.
    pub fn process(&self, shift: Shift) -> Vec<f64> {
        let mut moved = self.data.clone();
        (moved.y, moved.weight) = shift.moved(&self.data.y, &self.data.weight);
        let fit = Arx::new(&moved, &moved.y, &[]).fit(&moved.u, None);
        let weight = &moved.weight[moved.rows()];
        // The fit's scale is that of its own degrees of freedom; a density takes the scale of its own.
        let scale = student::scale(&fit.e, weight, fit.scale, FREEDOM, self.least[1]);
        fit.e.iter().zip(weight).map(|(e, w)| w * log_density(*e, scale)).collect()
    }

    /// The skew that is likeliest in these rows.
    pub fn constant(&self, rows: Range<usize>) -> Controller {
        let rated = |by| self.controller(Shift::constant(by), rows.clone());
        let all: Vec<(f64, Controller)> =
            (-LONGEST..=LONGEST).map(rated).map(|one| (one.log_likelihood(), one)).collect();
        let most = all.iter().map(|one| one.0).fold(f64::NEG_INFINITY, f64::max);
        // A PI controller needs two of three samples of PV: the one that it does not need may be before or after. It is before.
        let unneeded = REGULAR * (rows.len() as f64).ln();
        let latest = all.into_iter().rev().find(|one| one.0 >= most - unneeded);
        latest.map_or_else(|| rated(0), |one| one.1)
    }

    /// The skew that grows over the window and is likeliest, where the first third of the rows and the last do not agree on one.
    pub fn growing(&self, rows: Range<usize>) -> Option<Controller> {
        let third = rows.len() / 3;
        let [early, late] = [rows.start..rows.start + third, rows.end - third..rows.end]
            .map(|rows| self.constant(rows).shift.first);
        if early == late {
            return None;
        }
        // From the middles of the thirds to the ends of the window.
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

/// A signal in these rows, so many samples late.
fn late<'v>(v: &'v [f64], rows: &Range<usize>, lags: Range<usize>) -> impl Iterator<Item = &'v [f64]> {
    let Range { start, end } = *rows;
    lags.map(move |lag| &v[start - lag..end - lag])
}

/// What weighted least squares leaves of `target`.
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
