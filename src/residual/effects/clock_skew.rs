//! OP and PV are stamped by clocks that disagree; skew [s], positive when PV's stamps are early, of clocks that part its mean.
//!
//! The process hides a skew in its delay, the controller does not: `u[k] - u[k-1]` is computed from PV at k (and just
//! before). If it fits PV of several samples earlier or of later ones far better, the stamps are wrong, and PV is shifted.

use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::stats::{mean, median};
use std::ops::Range;

/// Longest skew tried (samples), and at the ends of a window over which it grows.
const LONGEST: i32 = 15;
const AT_AN_END: i32 = 8;
/// Unexplained share of OP's changes that the right skew leaves at most, and that as a share of what the stamps leave.
const MOST_LEFT: f64 = 0.5;
const FAR_BETTER: f64 = 0.6;
/// What the stamps leave unexplained at least where they are wrong; less where the right skew leaves next to nothing of it:
/// a PV that hardly changes from sample to sample.
const LEAST_HONEST: (f64, f64) = (0.01, 0.001);
const EXACT: f64 = 0.02;
/// What is left, as a multiple of the least, up to which a skew is as good; or next to nothing, as a share of what the stamps
/// leave.
const AS_GOOD: f64 = 1.1;
const NOTHING: f64 = 1e-3;
/// Least growth of a skew over the window (samples), and what it leaves at most as a share of what any constant one does: clocks
/// that agree seem to part by half a sample.
const LEAST_GROWTH: f64 = 1.5;
const BETTER: f64 = 0.9;
/// First step of the two ends of a skew that grows (samples), and how often it is halved.
const STEP: f64 = 0.5;
const HALVINGS: usize = 2;
/// Huber's bend (sd), and passes of reweighted least squares.
const BEND: f64 = 1.345;
const PASSES: usize = 4;

pub struct ClockSkew;

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

    /// Where PV of sample `k` of `n` was, `more` samples before; the later of two neighbours, and the share of the other.
    fn origin(&self, k: usize, n: usize, more: usize) -> (i64, f64) {
        let by = self.first + (self.last - self.first) * k as f64 / n as f64;
        let at = k as f64 - by - more as f64;
        let later = at.ceil();
        (later as i64, later - at)
    }
}

/// The value between two neighbours.
fn between(y: &[f64], (later, share): (i64, f64)) -> f64 {
    let at = |k: i64| y[k.clamp(0, y.len() as i64 - 1) as usize];
    if share > 0.0 { at(later) + share * (at(later - 1) - at(later)) } else { at(later) }
}

impl Term for Shift {
    fn kind(&self) -> Kind {
        Kind::ClockSkew
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(*self)
    }
    fn data(&self, stage: &mut Stage) {
        let n = stage.y.len();
        stage.y = (0..n).map(|k| between(&stage.y, self.origin(k, n, 0))).collect();
        let counts = |(later, share): (i64, f64)| {
            let of =
                |k: i64| usize::try_from(k).ok().and_then(|k| stage.weight.get(k)).copied().unwrap_or(0.0);
            if share > 0.0 { of(later).min(of(later - 1)) } else { of(later) }
        };
        stage.weight = (0..n).map(|k| counts(self.origin(k, n, 0))).collect();
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let [first, last] = [self.first, self.last].map(|by| by * data.scale.ts);
        let side = |by: f64| if by > 0.0 { "early" } else { "late" };
        let mut parameters = vec![Parameter { name: "skew_s", value: 0.5 * (first + last), unit: "s" }];
        let explanation = if first == last {
            format!(
                "PV's stamps are {:.3} s {} against OP's: the controller says so",
                first.abs(),
                side(first)
            )
        } else {
            parameters.push(Parameter { name: "growth_s", value: last - first, unit: "s" });
            format!(
                "PV's stamps drift against OP's, from {:.3} s {} to {:.3} s {}: the controller says so",
                first.abs(),
                side(first),
                last.abs(),
                side(last)
            )
        };
        (parameters, explanation)
    }
}

impl Recognise for ClockSkew {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let found = skew(&c.stage.u, &c.stage.y, c.data.sp.as_deref());
        let shift = |(shift, loss): (Shift, f64)| Proposal {
            term: shift.boxed(),
            loss,
            parameters: if shift.first == shift.last { 1.0 } else { 2.0 },
            tried: 1.0,
            element: None,
        };
        found.map(shift).into_iter().collect()
    }
    fn direct(&self) -> bool {
        true
    }
}

/// How PV has to be moved, where it has to, and what is left unexplained then as a share of what the stamps leave.
fn skew(u: &[f64], y: &[f64], sp: Option<&[f64]>) -> Option<(Shift, f64)> {
    let reach = LONGEST as usize + 3;
    let whole = reach..u.len().saturating_sub(reach);
    let left = |shift: Shift| unexplained(u, y, sp, shift, whole.clone());
    let honest = (0..=1).map(|by| left(Shift::constant(by))).fold(1.0, f64::min);
    if honest < LEAST_HONEST.1 {
        return None;
    }
    let others: Vec<(f64, i32)> = (-LONGEST..=LONGEST).map(|by| (left(Shift::constant(by)), by)).collect();
    let least = others.iter().map(|l| l.0).fold(f64::INFINITY, f64::min);
    if let Some((grown, shift)) = growing(u, y, sp, whole.clone())
        && grown <= MOST_LEFT
        && grown <= BETTER * least.min(honest)
    {
        return Some((shift, grown / honest));
    }
    // Of three samples of PV one that is not needed may be before or after: the later is.
    let as_good = (AS_GOOD * least).max(NOTHING * honest);
    let by = others.iter().rev().find(|l| l.0 <= as_good)?.1;
    let far_better = if honest < LEAST_HONEST.0 { EXACT } else { FAR_BETTER };
    let wrong = !(-1..=2).contains(&by) && least <= MOST_LEFT && least <= far_better * honest;
    wrong.then_some((Shift::constant(by), least / honest))
}

/// The skew that grows over the window and leaves least, with what that is, where the first third and the last do not agree on one.
fn growing(u: &[f64], y: &[f64], sp: Option<&[f64]>, whole: Range<usize>) -> Option<(f64, Shift)> {
    let third = whole.len() / 3;
    let best = |rows: Range<usize>| {
        // A third in which OP rests says nothing.
        let left = |by: i32| {
            Some(unexplained(u, y, sp, Shift::constant(by), rows.clone())).filter(|left| *left < 1.0)
        };
        let all = (-AT_AN_END..=AT_AN_END).filter_map(|by| Some((left(by)?, f64::from(by))));
        all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|least| least.1)
    };
    let (early, late) = (best(whole.start..whole.start + third)?, best(whole.end - third..whole.end)?);
    if early == late {
        return None;
    }
    // From the middles of the thirds to the ends.
    let beyond = 0.25 * (late - early);
    let left = |shift: Shift| (unexplained(u, y, sp, shift, whole.clone()), shift);
    let mut found = left(Shift { first: early - beyond, last: late + beyond });
    let mut step = STEP;
    for _ in 0..=HALVINGS {
        let mut moved = true;
        while moved {
            let Shift { first, last } = found.1;
            let steps = [
                (step, step),
                (-step, -step),
                (step, -step),
                (-step, step),
                (step, 0.0),
                (-step, 0.0),
                (0.0, step),
                (0.0, -step),
            ];
            let next = steps.map(|(a, b)| left(Shift { first: first + a, last: last + b }));
            let limit = f64::from(LONGEST);
            let next = next.into_iter().filter(|l| l.1.first.abs() <= limit && l.1.last.abs() <= limit);
            let next = next.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|next| next.0 < found.0);
            moved = next.is_some();
            found = next.unwrap_or(found);
        }
        step *= 0.5;
    }
    ((found.1.last - found.1.first).abs() >= LEAST_GROWTH).then_some(found)
}

/// The share of OP's changes in these rows that `y[k-by], y[k-by-1], y[k-by-2]` and the set point leave unexplained, of samples
/// weighted so that the kicks of a set point that is not recorded do not rule.
fn unexplained(u: &[f64], y: &[f64], sp: Option<&[f64]>, shift: Shift, rows: Range<usize>) -> f64 {
    if rows.len() <= 20 {
        return 1.0;
    }
    let change: Vec<f64> = rows.clone().map(|k| u[k] - u[k - 1]).collect();
    let of_y = (0..3).map(|more| rows.clone().map(|k| between(y, shift.origin(k, y.len(), more))).collect());
    let columns: Vec<Vec<f64>> = of_y
        .chain([vec![1.0; rows.len()]])
        .chain(
            sp.into_iter().flat_map(|sp| (0..3).map(|more| sp[rows.start - more..rows.end - more].to_vec())),
        )
        .collect();
    let mut weight = vec![1.0; change.len()];
    let mut e = Vec::new();
    for _ in 0..PASSES {
        e = errors(&columns, &change, &weight);
        let sizes: Vec<f64> = e.iter().map(|e| e.abs()).collect();
        // Most changes of an OP that rests are 0: the mean keeps the scale above.
        let scale = (median(&sizes) / 0.6745).max(0.5 * mean(&sizes));
        weight.iter_mut().zip(&sizes).for_each(|(w, e)| *w = (BEND * scale / e.max(1e-300)).min(1.0));
    }
    let power = |v: &[f64]| v.iter().zip(&weight).map(|(v, w)| (w * v).powi(2)).sum::<f64>();
    let all = power(&change);
    if all > 0.0 { power(&e) / all } else { 1.0 }
}

/// What weighted least squares leaves of `target`.
fn errors(columns: &[Vec<f64>], target: &[f64], weight: &[f64]) -> Vec<f64> {
    let size = columns.len();
    let mut g = vec![0.0; size * size];
    let mut theta = vec![0.0; size];
    for i in 0..size {
        let own: Vec<f64> = columns[i].iter().zip(weight).map(|(c, w)| c * w).collect();
        for j in 0..=i {
            g[i * size + j] = dot(&own, &columns[j]);
        }
        theta[i] = dot(&own, target);
    }
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, size, size, &mut live);
    substitute(&g, size, &live, &mut theta);
    let mut e = target.to_vec();
    for (theta, column) in theta.iter().zip(columns) {
        e.iter_mut().zip(column).for_each(|(e, c)| *e -= theta * c);
    }
    e
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// OP and PV of a first-order loop whose set point moves every 90 samples, and that set point.
    fn run() -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(11));
        let (mut x, mut op, mut last): (f64, f64, f64) = (0.0, 0.0, 0.0);
        let (mut u, mut y, mut sp) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..900 {
            let target = [0.0, 2.0, -1.0, 1.5][k / 90 % 4];
            let draw: f64 = noise.next().unwrap_or(0.0);
            let pv = x + 0.1 * draw;
            let error: f64 = target - pv;
            op += 0.8 * (error - last + error / 8.0);
            last = error;
            x = 0.85 * x + 0.15 * op;
            u.push(op);
            y.push(pv);
            sp.push(target);
        }
        (u, y, sp)
    }

    #[test]
    fn a_skew_is_found_to_the_sample_whether_the_set_point_is_recorded_or_not() {
        let (u, y, sp) = run();
        let n = y.len() as i32;
        for by in [-5, -3, 3, 6] {
            // PV is stamped `by` samples early.
            let stamped: Vec<f64> = (0..n).map(|k| y[(k + by).clamp(0, n - 1) as usize]).collect();
            for sp in [Some(&sp[..]), None] {
                let found = skew(&u, &stamped, sp).map(|found| found.0);
                assert_eq!(found, Some(Shift::constant(by)), "{}", sp.is_some());
            }
        }
    }

    #[test]
    fn clocks_that_part_are_found_at_both_ends() {
        let (u, y, sp) = run();
        let n = y.len();
        for (first, last) in [(0.0, 3.0), (0.0, -4.0), (2.0, -2.0), (-1.0, -7.0)] {
            let wrong = Shift { first: -first, last: -last };
            let stamped: Vec<f64> = (0..n).map(|k| between(&y, wrong.origin(k, n, 0))).collect();
            for sp in [Some(&sp[..]), None] {
                let (found, _) = skew(&u, &stamped, sp).expect("they part");
                let grows = |shift: Shift| shift.last - shift.first;
                let off = (grows(found) - (last - first)).abs();
                // PI needs two of three samples of PV; half of the noise between two is lost.
                assert!(off <= 0.5 && (found.first - first).abs() < 1.5, "{found:?} for {first} to {last}");
            }
        }
    }

    #[test]
    fn honest_stamps_have_none() {
        let (u, y, sp) = run();
        assert_eq!(skew(&u, &y, Some(&sp)), None);
        assert_eq!(skew(&u, &y, None), None);
    }
}
