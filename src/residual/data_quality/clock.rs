//! OP and PV are stamped by clocks that disagree; skew [s], positive when PV's stamps are early, of clocks that part its mean.
//!
//! ```text
//! controller  du[k] = sum_{i=0}^{2} g_i y[k-i] + sum_{i=1}^{2} h_i du[k-i] + sum_{i=0}^{2} r_i sp[k-i] + c + e,   du[k] = u[k] - u[k-1]
//! process     y[k]  = the high-order ARX on u
//! ```
//!
//! The process hides a skew in its delay, the controller does not: a PI or PID controller, its derivative filtered or not, is
//! the first equation, and PV of other times does not fit it. PV is moved by every skew, and the likelihood of the controller
//! is compared with that at honest stamps.
//!
//! Where a controller does more than its equation says (feed-forward, a cascade), PV of later samples explains OP's changes,
//! too, since it answers to them. But then OP's changes explain PV no more. So, where the controller is not exact, both
//! equations together have to be likelier: by the chain rule of probability their sum gains nothing by what moves from one to
//! the other. Neither equation is the whole truth, so the gain is compared with its own standard error.
//!
//! Source: Vuong, Econometrica 1989, 57, 307.

use super::quantised::{error_of, step_of};
use super::{Fact, TOLD, log_density, posterior};
use crate::residual::Kind;
use crate::residual::report::Described;
use crate::sysid::arx::Arx;
use crate::sysid::criterion::{REGULAR, THRESHOLD, score};
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::stats::sd;
use crate::sysid::student::{self, FREEDOM};
use std::ops::{Range, RangeInclusive};

/// Longest skew tried (samples): less than the lead of the fitted rows and the rows behind them.
const LONGEST: i32 = 15;
/// Samples that PV is moved by where stamps are honest: the controller sees PV at its tick or at the one before.
const HONEST: RangeInclusive<i32> = 0..=1;
/// Least skew beyond honest stamps, and least growth of one (samples): less is a matter of when in a scan each tag is read.
const LEAST: f64 = 1.5;
/// Lags of PV, of OP's changes and of the set point in the controller: those of a PID with a filtered derivative.
const LAGS: [usize; 3] = [3, 2, 3];
/// Least error of OP's changes in OP's standard deviations: OP is written with no more than six digits.
const ROUNDING: f64 = 1e-6;
/// Error of OP's changes as a share of them, up to which a controller is exact: no PV is so free of noise that a process could be.
const EXACT: f64 = 1e-3;
/// Standard errors by which two equations that are not exact have to be likelier: chance does that once in a thousand.
const STANDARD_ERRORS: f64 = 3.0;
/// Rows whose gains are summed before their standard error is taken: what one equation loses the other gains within these.
const BLOCK: usize = 2 * LONGEST_LAG;
/// Passes of reweighted least squares.
const PASSES: usize = 6;
/// Steps of the two ends of a skew that grows (samples).
const STEPS: [f64; 3] = [0.5, 0.25, 0.125];
/// Ways to move the two ends.
const WAYS: [(f64, f64); 8] =
    [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];

/// Samples that PV is moved to later times, at the window's start and at its end.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shift {
    first: f64,
    last: f64,
}

impl Shift {
    fn constant(by: i32) -> Self {
        Self { first: f64::from(by), last: f64::from(by) }
    }

    /// Whether it is one that matters.
    fn is_wrong(&self) -> bool {
        let [least, most] = [*HONEST.start(), *HONEST.end()].map(f64::from);
        [self.first, self.last].iter().any(|by| *by <= least - LEAST || *by >= most + LEAST)
    }

    /// PV and its weights at the right times.
    fn moved(&self, y: &[f64], weight: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let end = y.len() - 1;
        let each = (0..y.len()).map(|k| {
            let at = k as f64 - self.first - (self.last - self.first) * k as f64 / y.len() as f64;
            let inside = at.clamp(0.0, end as f64);
            let (before, share) = (inside as usize, inside.fract());
            let after = (before + 1).min(end);
            let counts = if share > 0.0 { weight[before].min(weight[after]) } else { weight[before] };
            (y[before] + share * (y[after] - y[before]), if inside == at { counts } else { 0.0 })
        });
        each.unzip()
    }
}

/// Tells clocks that disagree, and puts PV's stamps right; `step`: the quantum of PV.
pub fn assess(data: &mut IdData, step: f64) -> Option<Fact> {
    let (shift, log_odds) = skew(data, step)?;
    let posterior = posterior(log_odds);
    if posterior < TOLD {
        return None;
    }
    (data.y, data.weight) = shift.moved(&data.y, &data.weight);
    Some(Fact { kind: Kind::ClockSkew, posterior, described: describe(data, shift) })
}

fn describe(data: &IdData, shift: Shift) -> Described {
    let [first, last] = [shift.first, shift.last].map(|by| by * data.units.ts);
    let told = |by: f64| format!("{:.3} s {}", by.abs(), if by > 0.0 { "early" } else { "late" });
    let skew = |explanation| Described::new(explanation).with("skew_s", 0.5 * (first + last), "s");
    if first == last {
        return skew(format!("PV's stamps are {} against OP's: the controller says so", told(first)));
    }
    let (from, to) = (told(first), told(last));
    skew(format!("PV's stamps drift against OP's, from {from} to {to}: the controller says so")).with(
        "growth_s",
        last - first,
        "s",
    )
}

/// How PV has to be moved, where it may have to, and the log-odds for that.
fn skew(data: &IdData, step: f64) -> Option<(Shift, f64)> {
    let equations = Equations::new(data, step);
    let rows = data.rows();
    let n = rows.len() as f64;
    let honest: Vec<Controller> =
        HONEST.map(|by| equations.controller(Shift::constant(by), rows.clone())).collect();
    let constant = equations.constant(rows.clone());
    // One of so many numbers, or two ends that may lie anywhere.
    let mut best = (&constant, 0.0, f64::from(2 * LONGEST + 1));
    let worth =
        |(of, rate, alternatives): (&Controller, f64, f64)| score(of.log_likelihood(), rate, alternatives, n);
    let growing = equations.growing(rows);
    if let Some(growing) = &growing {
        let other = (growing, 2.0 * THRESHOLD, 1.0);
        if worth(other) > worth(best) && gain(&growing.each, &constant.each).1 > STANDARD_ERRORS {
            best = other;
        }
    }
    let stamped = honest.iter().map(|honest| worth((honest, 0.0, 1.0))).fold(f64::NEG_INFINITY, f64::max);
    let (log_odds, (best, rate, alternatives)) = (worth(best) - stamped, best);
    if !best.shift.is_wrong() || log_odds < 0.0 {
        return None;
    }
    if best.scale <= equations.exact {
        return Some((best.shift, log_odds));
    }
    let both = |of: &Controller| -> Vec<f64> {
        equations
            .process(of.shift)
            .iter()
            .zip(&of.each)
            .map(|(process, controller)| process + controller)
            .collect()
    };
    let with = both(best);
    let rivals = honest.iter().map(|honest| gain(&with, &both(honest)));
    let (together, errors) = rivals.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (errors > STANDARD_ERRORS).then(|| (best.shift, log_odds.min(score(together, rate, alternatives, n))))
}

/// By how much the log-likelihoods of rows exceed others, and that in its standard errors.
fn gain(of: &[f64], others: &[f64]) -> (f64, f64) {
    let each: Vec<f64> = of.iter().zip(others).map(|(of, other)| of - other).collect();
    let blocks: Vec<f64> = each.chunks(BLOCK).map(|few| few.iter().sum()).collect();
    let sum: f64 = blocks.iter().sum();
    (sum, sum / (sd(&blocks) * (blocks.len() as f64).sqrt()).max(f64::MIN_POSITIVE))
}

/// The controller with PV moved.
struct Controller {
    shift: Shift,
    /// Scale of its errors.
    scale: f64,
    /// Log-likelihood of each row.
    each: Vec<f64>,
}

impl Controller {
    fn log_likelihood(&self) -> f64 {
        self.each.iter().sum()
    }
}

/// The controller and the process, as far as the signals show them.
struct Equations<'a> {
    data: &'a IdData,
    /// `u[k] - u[k-1]`.
    changes: Vec<f64>,
    /// Least scales of the errors of OP's changes and of PV: what their steps leave.
    least: [f64; 2],
    /// Scale up to which a controller is exact.
    exact: f64,
}

impl<'a> Equations<'a> {
    fn new(data: &'a IdData, step: f64) -> Self {
        let u = &data.u;
        let changes: Vec<f64> = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
        let of_u = error_of(step_of(u)).max(ROUNDING);
        Self { exact: of_u.max(EXACT * sd(&changes)), least: [of_u, error_of(step)], data, changes }
    }

    /// The controller in these rows, with PV moved.
    fn controller(&self, shift: Shift, rows: Range<usize>) -> Controller {
        let (y, _) = shift.moved(&self.data.y, &self.data.weight);
        let ones = vec![1.0; rows.len()];
        let of_sp = self.data.sp.iter().map(|sp| (&sp[..], 0..LAGS[2]));
        let signals = [(&y[..], 0..LAGS[0]), (&self.changes[..], 1..1 + LAGS[1])].into_iter().chain(of_sp);
        let late = signals.flat_map(|(v, lags)| lags.map(|lag| &v[rows.start - lag..rows.end - lag]));
        let columns: Vec<&[f64]> = [&ones[..]].into_iter().chain(late.collect::<Vec<_>>()).collect();
        let target = &self.changes[rows.clone()];
        let (mut omega, mut e) = (ones.clone(), target.to_vec());
        let mut scale = student::first_scale(&e, &ones);
        for _ in 0..PASSES {
            e = errors(&columns, target, &omega);
            scale = student::scale(&e, &ones, scale, FREEDOM).max(self.least[0]);
            student::reweigh(&e, &ones, (scale, FREEDOM), &mut omega);
        }
        Controller { shift, scale, each: e.iter().map(|e| log_density(*e, scale)).collect() }
    }

    /// Log-likelihood of each row of the process with PV moved.
    fn process(&self, shift: Shift) -> Vec<f64> {
        let mut moved = self.data.clone();
        (moved.y, moved.weight) = shift.moved(&self.data.y, &self.data.weight);
        let fit = Arx::new(&moved, &moved.y, &[]).fit(&moved.u, None);
        let scale = fit.scale.max(self.least[1]);
        fit.e.iter().zip(&moved.weight[moved.rows()]).map(|(e, w)| w * log_density(*e, scale)).collect()
    }

    /// The skew that is likeliest in these rows.
    fn constant(&self, rows: Range<usize>) -> Controller {
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
    fn growing(&self, rows: Range<usize>) -> Option<Controller> {
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
