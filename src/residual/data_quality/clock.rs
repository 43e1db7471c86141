//! OP and PV are stamped by clocks that disagree; skew [s], positive when PV's stamps are early, of clocks that part its mean.
//!
//! ```text
//! controller  u[k] - u[k-1] = sum_{i=0}^{3} g_i y[k-i] + sum_{i=1}^{2} h_i (u[k-i] - u[k-i-1]) + c + sum_{i=0}^{2} r_i sp[k-i] + e
//! process     y[k]          = the high-order ARX on u
//! ```
//!
//! The process hides a skew in its delay, the controller does not: a PI or PID controller, its derivative filtered or not, is
//! the first equation, and PV of other times does not fit it. PV is moved by every skew, and the likelihood of the controller
//! is compared with that at honest stamps.
//!
//! Where a controller does more than its equation says (feed-forward, a cascade), PV of later samples explains OP's changes
//! as well, since it answers to them. But then OP's changes explain PV no more. So both equations together have to be
//! likelier, too: by the chain rule of probability their sum gains nothing by what moves from one to the other.

use super::quantised::quantum;
use super::{Fact, TOLD, posterior};
use crate::residual::Kind;
use crate::residual::report::Described;
use crate::sysid::arx::Arx;
use crate::sysid::criterion::{REGULAR, THRESHOLD, score};
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, factor, substitute};
use crate::sysid::student::{self, FREEDOM};
use std::ops::{Range, RangeInclusive};

/// Longest skew tried (samples): a lag of the high-order ARX less one, so that the process has one left.
const LONGEST: i32 = 15;
/// Samples that PV is moved by where stamps are honest: the controller sees PV at its tick or at the one before.
const HONEST: RangeInclusive<i32> = 0..=1;
/// Least skew beyond honest stamps, and least growth of one (samples): less is a matter of when in a scan each tag is read.
const LEAST: f64 = 1.5;
/// PV's lags in the controller, those of OP's changes, and those of the set point: a PID with a filtered derivative.
const LAGS: [usize; 3] = [3, 2, 3];
/// Least error of OP's changes in OP's standard deviations: a number of seven digits.
const ROUNDING: f64 = 1e-6;
/// Passes of reweighted least squares.
const PASSES: usize = 6;
/// Steps of the two ends of a skew that grows (samples).
const STEPS: [f64; 3] = [0.5, 0.25, 0.125];

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

    /// PV and its weights at the right times.
    fn moved(&self, y: &[f64], weight: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let last = y.len() - 1;
        let each = (0..y.len()).map(|k| {
            let at = k as f64 - self.first - (self.last - self.first) * k as f64 / y.len() as f64;
            let (before, share) = (at.floor(), at - at.floor());
            let inside = |k: f64| k.clamp(0.0, last as f64) as usize;
            let (a, b) = (inside(before), inside(if share > 0.0 { before + 1.0 } else { before }));
            let known = at >= 0.0 && at <= last as f64;
            (y[a] + share * (y[b] - y[a]), if known { weight[a].min(weight[b]) } else { 0.0 })
        });
        each.unzip()
    }
}

/// Tells clocks that disagree, and puts PV's stamps right.
pub fn assess(data: &mut IdData) -> Option<Fact> {
    let (shift, log_odds) = skew(data)?;
    let posterior = posterior(log_odds);
    if posterior < TOLD {
        return None;
    }
    (data.y, data.weight) = shift.moved(&data.y, &data.weight);
    Some(Fact { kind: Kind::ClockSkew, posterior, described: describe(data, shift) })
}

fn describe(data: &IdData, shift: Shift) -> Described {
    let [first, last] = [shift.first, shift.last].map(|by| by * data.units.ts);
    let side = |by: f64| if by > 0.0 { "early" } else { "late" };
    let (from, to) = (first.abs(), last.abs());
    let explanation = if first == last {
        format!("PV's stamps are {from:.3} s {} against OP's: the controller says so", side(first))
    } else {
        format!(
            "PV's stamps drift against OP's, from {from:.3} s {} to {to:.3} s {}: the controller says so",
            side(first),
            side(last)
        )
    };
    let described = Described::new(explanation).with("skew_s", 0.5 * (first + last), "s");
    if first == last { described } else { described.with("growth_s", last - first, "s") }
}

/// How PV has to be moved, where it may have to, and the log-odds for that.
fn skew(data: &IdData) -> Option<(Shift, f64)> {
    let both = Both::new(data);
    let rows = data.rows();
    let n = rows.len() as f64;
    let controller = |shift: Shift| both.controller(shift, rows.clone()).0;
    let honest: Vec<(Shift, f64)> =
        HONEST.map(Shift::constant).map(|shift| (shift, controller(shift))).collect();
    let stamped = honest.iter().map(|h| h.1).fold(f64::NEG_INFINITY, f64::max);
    let constant = both.constant(rows.clone(), REGULAR * n.ln());
    let worth = score(constant.1, 0.0, f64::from(2 * LONGEST + 1), n);
    let mut found = Some((constant.0, worth)).filter(|found| wrong(found.0));
    if let Some((shift, likelihood)) = both.growing(rows.clone()) {
        let worth = score(likelihood, 2.0 * THRESHOLD, 1.0, n);
        if found.is_none_or(|found| worth > found.1) {
            found = Some((shift, worth));
        }
    }
    let (shift, worth) = found?;
    if worth < stamped {
        return None;
    }
    let gain = both.controller(shift, rows.clone()).1;
    if std::env::var("CLOCK").is_ok() {
        println!("      n {n} honest {:?} constant {:?} growing {:?} process {:.0} {:.0} {:.0}", honest, constant, both.growing(rows.clone()), both.process(Shift::constant(0), gain), both.process(Shift::constant(1), gain), both.process(shift,gain));
    }
    let together = honest.iter().map(|h| h.1 + both.process(h.0, gain)).fold(f64::NEG_INFINITY, f64::max);
    Some((shift, (worth - stamped).min(worth + both.process(shift, gain) - together)))
}

/// Whether a skew is one that matters.
fn wrong(shift: Shift) -> bool {
    let beyond = |by: f64| by <= f64::from(*HONEST.start()) - LEAST || by >= f64::from(*HONEST.end()) + LEAST;
    beyond(shift.first) || beyond(shift.last)
}

/// The controller and the process, as far as the signals show them.
struct Both<'a> {
    data: &'a IdData,
    /// `u[k] - u[k-1]`.
    changes: Vec<f64>,
    /// Least scale of the controller's errors.
    floor: f64,
}

impl<'a> Both<'a> {
    fn new(data: &'a IdData) -> Self {
        let u = &data.u;
        let changes = (0..u.len()).map(|k| u[k] - u[k.saturating_sub(1)]).collect();
        // An OP that is written in steps is known to a step only.
        let step = quantum(u).map_or(0.0, |quantum| quantum.size);
        Self { data, changes, floor: (step / 12f64.sqrt()).max(ROUNDING) }
    }

    /// The controller's log-likelihood in these rows, with PV moved.
    fn controller(&self, shift: Shift, rows: Range<usize>) -> (f64, f64) {
        let (y, _) = shift.moved(&self.data.y, &self.data.weight);
        let ones = vec![1.0; rows.len()];
        let late = |v: &'_ [f64], lag: usize| v[rows.start - lag..rows.end - lag].to_vec();
        let mut columns: Vec<Vec<f64>> = (0..LAGS[0]).map(|lag| late(&y, lag)).collect();
        columns.extend((1..=LAGS[1]).map(|lag| late(&self.changes, lag)));
        columns.push(ones.clone());
        columns.extend(self.data.sp.iter().flat_map(|sp| (0..LAGS[2]).map(|lag| late(sp, lag))));
        let target = &self.changes[rows.clone()];
        let (mut omega, mut scale) = (ones.clone(), None);
        let (mut e, mut of_y) = (Vec::new(), 0.0);
        for _ in 0..PASSES {
            (e, of_y) = errors(&columns, target, &omega);
            let guess = scale.unwrap_or_else(|| student::first_scale(&e, &ones));
            let found = student::scale(&e, &ones, guess, FREEDOM).max(self.floor);
            student::reweigh(&e, &ones, (found, FREEDOM), &mut omega);
            scale = Some(found);
        }
        (student::log_likelihood(&e, &ones, scale.unwrap_or(self.floor), FREEDOM), of_y)
    }

    /// The process' log-likelihood with PV moved.
    fn process(&self, shift: Shift, gain: f64) -> f64 {
        let mut moved = self.data.clone();
        (moved.y, moved.weight) = shift.moved(&self.data.y, &self.data.weight);
        let fit = Arx::new(&moved, &moved.y, &[]).fit(&moved.u, None);
        let floor = fit.scale.max(self.floor / gain.abs());
        student::log_likelihood(&fit.e, &moved.weight[moved.rows()], floor, FREEDOM)
    }

    /// The skew that is likeliest in these rows, and its log-likelihood.
    fn constant(&self, rows: Range<usize>, as_good: f64) -> (Shift, f64) {
        let all: Vec<(Shift, f64)> = (-LONGEST..=LONGEST)
            .map(Shift::constant)
            .map(|shift| (shift, self.controller(shift, rows.clone()).0))
            .collect();
        let best = all.iter().map(|s| s.1).fold(f64::NEG_INFINITY, f64::max);
        // A PI controller needs two of four samples of PV: those that it does not need may be before or after. After is right.
        let latest = all.iter().rev().find(|s| s.1 >= best - as_good);
        latest.copied().unwrap_or((Shift::constant(0), best))
    }

    /// The skew that grows over the window and is likeliest, where the first third of the rows and the last do not agree on one.
    fn growing(&self, rows: Range<usize>) -> Option<(Shift, f64)> {
        let third = rows.len() / 3;
        let best = |rows: Range<usize>| self.constant(rows, REGULAR * (third as f64).ln()).0.first;
        let (early, late) = (best(rows.start..rows.start + third), best(rows.end - third..rows.end));
        if early == late {
            return None;
        }
        // From the middles of the thirds to the ends of the window.
        let middles = [rows.start + third / 2, rows.end - third / 2].map(|k| k as f64 / self.data.len() as f64);
        let growth = (late - early) / (middles[1] - middles[0]);
        let start = early - growth * middles[0];
        let rated = |shift: Shift| (shift, self.controller(shift, rows.clone()).0);
        let mut found = rated(Shift { first: start, last: start + growth });
        for step in STEPS {
            loop {
                let Shift { first, last } = found.0;
                let to = [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
                let next = to.map(|(a, b)| Shift { first: first + a * step, last: last + b * step });
                let limit = f64::from(LONGEST);
                let inside = next.into_iter().filter(|s| s.first.abs() <= limit && s.last.abs() <= limit);
                let next = inside.map(rated).max_by(|a, b| a.1.total_cmp(&b.1));
                let Some(next) = next.filter(|next| next.1 > found.1) else { break };
                found = next;
            }
        }
        ((found.0.last - found.0.first).abs() >= LEAST && wrong(found.0)).then_some(found)
    }
}

/// What weighted least squares leaves of `target`.
fn errors(columns: &[Vec<f64>], target: &[f64], weight: &[f64]) -> (Vec<f64>, f64) {
    let size = columns.len();
    let by = |column: &[f64]| -> Vec<f64> { column.iter().zip(weight).map(|(c, w): (&f64, &f64)| c * w.sqrt()).collect() };
    let scaled: Vec<Vec<f64>> = columns.iter().map(|column| by(column)).collect();
    let all: Vec<&[f64]> = scaled.iter().map(Vec::as_slice).collect();
    let mut g = vec![0.0; size * size];
    let mut theta = vec![0.0; size];
    lower(&all, &mut g, size);
    products(&[&by(target)], &all, |_, i, sum| theta[i] = sum);
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, size, size, &mut live);
    substitute(&g, size, &live, &mut theta);
    let mut e = target.to_vec();
    for (theta, column) in theta.iter().zip(columns) {
        e.iter_mut().zip(column).for_each(|(e, c)| *e -= theta * c);
    }
    (e, theta[0])
}
