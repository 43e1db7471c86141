//! The equations of the controller and of the process with PV shifted in time, by which a clock skew is found (see `clock.rs`).

use super::fact::{log_density, measured};
use super::quantised::{error_of, step_of};
use crate::sysid::arx::Arx;
use crate::sysid::controller::{self, EXACT, LAGS, MARGIN, Robust, is_stable, robust, rounding};
use crate::sysid::criterion::{REGULAR, penalty};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::stats::{median, sd};
use crate::sysid::student::{self, FREEDOM};
use std::ops::{Range, RangeInclusive};

/// Longest skew tried (samples).
pub const LONGEST: i32 = controller::LONGEST as i32;
/// Longest skew at an end of a growing one (samples), still less than the lead of the fitted rows.
const LONGEST_END: i32 = 2 * LONGEST;
/// Shifts of PV that are no skew (samples): the controller reads PV at its tick, or at the tick before.
pub const HONEST: RangeInclusive<i32> = 0..=1;
/// Least skew beyond these, and least growth of one (samples): less may come from when in a scan each tag is read.
const LEAST: f64 = 1.5;
/// Least scale of the errors of OP's changes, in standard deviations of OP: OP has at most six digits.
const ROUNDING: f64 = 1e-6;
/// Rows whose gains are summed before the standard error is taken: what one equation loses, the other gains within so many rows.
const BLOCK: usize = 2 * LONGEST_LAG;
/// Sections of the rows in which a growing skew is looked for: within one it grows by less than two samples.
const SECTIONS: usize = 8;
/// Part of a sample that arithmetic may add to a whole number.
const TINY: f64 = 1e-9;
/// Steps by which the two ends of a growing skew are refined (samples).
const STEPS: [f64; 5] = [0.5, 0.25, 0.125, 0.0625, 0.03125];
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

    /// The sample of PV that belongs to sample `k` of `n`.
    ///
    /// It is a whole sample, and the later one of two. PV between two samples would have PV of the earlier one in it, from which an
    /// earlier OP was computed: OP would predict the noise of PV, and a model would find the controller's inverse. The later sample
    /// only makes the dead time shorter.
    fn sample(&self, k: usize, n: usize) -> f64 {
        (self.source(k, n) - TINY).ceil()
    }

    /// Flags of PV at its right times.
    pub fn flags(&self, flags: &[bool]) -> Vec<bool> {
        let n = flags.len();
        (0..n).map(|k| flags[self.sample(k, n).clamp(0.0, n as f64 - 1.0) as usize]).collect()
    }

    /// PV and its weights at the right times.
    pub fn moved(&self, y: &[f64], weight: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let end = y.len() - 1;
        let each = (0..y.len()).map(|k| {
            let at = self.sample(k, y.len());
            let inside = at.clamp(0.0, end as f64);
            (y[inside as usize], if inside == at { weight[inside as usize] } else { 0.0 })
        });
        each.unzip()
    }

    /// Whether PV is recorded late somewhere in the window.
    pub fn is_late(&self) -> bool {
        self.first.min(self.last) < 0.0
    }

    /// Whether this end (samples) is at the longest skew that is tried on rows, or beyond, so that it may be longer.
    pub fn is_longest(by: f64) -> bool {
        by.abs() >= f64::from(LONGEST) - STEPS[0]
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
    /// Scale up to which they are those of rounding.
    pub exact: f64,
    /// Whether it computes OP of PV alone ([`is_stable`]).
    pub is_stable: bool,
    /// Log-likelihood of each row (-).
    pub each: Vec<f64>,
}

impl Controller {
    /// Log-likelihood of all rows (-).
    pub fn log_likelihood(&self) -> f64 {
        self.each.iter().sum()
    }

    /// Whether the equation may be exact but for rounding, and for a few rows.
    pub fn is_exact(&self) -> bool {
        self.scale <= self.exact
    }
}

/// The equations of the controller and of the process on one record.
pub struct Equations<'a> {
    data: &'a IdData,
    /// `u[k] - u[k-1]`.
    changes: Vec<f64>,
    /// Least scales of the errors of OP's changes and of PV, by the steps in which they are written.
    least: [f64; 2],
    /// The steps in which OP and PV are written (their standard deviations).
    steps: [f64; 2],
    /// Scale of the errors of OP's changes up to which the controller's equation is exact, whatever its coefficients.
    pub exact: f64,
}

impl<'a> Equations<'a> {
    /// The equations on a record. `step`: the quantum of PV.
    pub fn new(data: &'a IdData, step: f64) -> Self {
        let (u, units) = (&data.u, &data.units);
        let changes: Vec<f64> = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
        let of_u = error_of(step_of(u)).max(ROUNDING);
        let digits = |v: &[f64], scale: f64, zero: f64| {
            let written: Vec<f64> = v.iter().map(|v| v * scale + zero).collect();
            if scale > 0.0 { controller::resolution(&written) / scale } else { 0.0 }
        };
        let of_op = step_of(u).max(digits(u, units.u, units.u0));
        // PV in place of missing samples has digits of its own.
        let of_pv = step.max(digits(&measured(data, &data.y), units.y, units.y0));
        let exact = of_u.max(EXACT * sd(&changes));
        Self { exact, least: [of_u, error_of(step)], steps: [of_op, of_pv], data, changes }
    }

    /// The controller, fitted to some rows with PV shifted.
    pub fn controller(&self, shift: Shift, rows: Range<usize>) -> Controller {
        self.controller_of(LAGS[1], shift, rows)
    }

    /// [`Self::controller`] with so many earlier changes of OP. Without those that a controller does not need its equation is unique.
    pub fn controller_of(&self, moves: usize, shift: Shift, rows: Range<usize>) -> Controller {
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
                start = self.robust(&columns, &second_differences, start).omega;
            }
        }
        let of_changes = columns.len();
        columns.extend(lagged(&self.changes, &rows, 1..1 + moves));
        let Robust { errors, scale, theta, .. } = self.robust(&columns, target, start);
        let (g, h) = (&theta[1..1 + LAGS[0]], &theta[of_changes..]);
        Controller {
            shift,
            scale,
            exact: self.exact.max(MARGIN * rounding(self.steps, g, h)),
            is_stable: is_stable(h),
            each: errors.iter().map(|e| log_density(*e, scale)).collect(),
        }
    }

    /// Regression with Student-t errors. `omega`: weights to start from.
    fn robust(&self, columns: &[&[f64]], target: &[f64], omega: Vec<f64>) -> Robust {
        robust(columns, target, omega, self.least[0])
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

    /// The controller with the likeliest shift that grows over the window; `None` where all sections of the rows have the same
    /// constant shift, or where the growth is too small.
    pub fn growing(&self, rows: Range<usize>) -> Option<Controller> {
        let long = rows.len() / SECTIONS;
        let section = |i: usize| rows.start + i * long..rows.start + (i + 1) * long;
        let shifts: Vec<f64> = (0..SECTIONS).map(|i| self.constant(section(i)).shift.first).collect();
        if shifts.iter().all(|by| *by == shifts[0]) {
            return None;
        }
        // A line through the sections, by medians: a section may have found another shift by chance.
        let middle = |i: usize| (rows.start + i * long + long / 2) as f64 / self.data.len() as f64;
        let pairs = (0..SECTIONS).flat_map(|a| (0..a).map(move |b| (a, b)));
        let slopes: Vec<f64> =
            pairs.map(|(a, b)| (shifts[a] - shifts[b]) / (middle(a) - middle(b))).collect();
        let growth = median(&slopes);
        let starts: Vec<f64> = (0..SECTIONS).map(|i| shifts[i] - growth * middle(i)).collect();
        let first = median(&starts);
        // The line may lead beyond the shifts that a section tries.
        let most = f64::from(LONGEST_END);
        let start = Shift { first: first.clamp(-most, most), last: (first + growth).clamp(-most, most) };
        let rated = |shift: Shift| {
            let one = self.controller(shift, rows.clone());
            (one.log_likelihood(), one)
        };
        let inside = |by: f64| by.abs() <= most;
        let refined = |start: Shift| {
            let mut found = rated(start);
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
            found
        };
        let (most_likely, found) = refined(start);
        // A sample less late may fit alike, as for a constant shift: then it is right.
        let less_late = refined(Shift { first: found.shift.first + 1.0, last: found.shift.last + 1.0 });
        let is_alike = less_late.0 >= most_likely - penalty(REGULAR, rows.len() as f64);
        let found = if is_alike && less_late.1.shift.last > found.shift.last { less_late.1 } else { found };
        let Shift { first, last } = found.shift;
        ((last - first).abs() >= LEAST).then_some(found)
    }
}

/// A signal in some rows, at each of these lags (samples).
fn lagged<'v>(v: &'v [f64], rows: &Range<usize>, lags: Range<usize>) -> impl Iterator<Item = &'v [f64]> {
    let Range { start, end } = *rows;
    lags.map(move |lag| &v[start - lag..end - lag])
}
