//! OP and PV are stamped by clocks that disagree; skew [s], positive when PV's stamps are early.
//!
//! The process hides a skew in its delay, the controller does not: `u[k] - u[k-1]` is computed from PV at k (and just
//! before). If it fits PV of several samples earlier or of later ones far better, the stamps are wrong, and PV is shifted.

use super::{Context, Proposal, Recognise};
use crate::diagnosis::linalg::{MOST_COLUMNS, dot, factor, substitute};
use crate::diagnosis::stats::{mean, median};
use crate::residual::model::{Data, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Longest skew tried (samples).
const LONGEST: i32 = 15;
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
/// Huber's bend (sd), and passes of reweighted least squares.
const BEND: f64 = 1.345;
const PASSES: usize = 4;

pub struct ClockSkew;

#[derive(Clone, Debug)]
struct Shift {
    /// Samples that PV is moved to later times.
    by: i32,
}

impl Term for Shift {
    fn kind(&self) -> Kind {
        Kind::ClockSkew
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn data(&self, stage: &mut Stage) {
        let n = stage.y.len() as i32;
        let at = |k: i32| (k - self.by).clamp(0, n - 1) as usize;
        stage.y = (0..n).map(|k| stage.y[at(k)]).collect();
        let weight = std::mem::take(&mut stage.weight);
        let inside = |k: i32| (0..n).contains(&(k - self.by));
        stage.weight = (0..n).map(|k| if inside(k) { weight[at(k)] } else { 0.0 }).collect();
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let skew = f64::from(self.by) * data.scale.ts;
        let late = if self.by > 0 { "early" } else { "late" };
        let parameters = vec![Parameter { name: "skew_s", value: skew, unit: "s" }];
        (
            parameters,
            format!("PV's stamps are {:.3} s {late} against OP's: the controller says so", skew.abs()),
        )
    }
}

impl Recognise for ClockSkew {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let found = skew(&c.stage.u, &c.stage.y, c.data.sp.as_deref());
        let shift = |(by, loss)| Proposal {
            term: Box::new(Shift { by }),
            loss,
            parameters: 1.0,
            tried: 1.0,
            element: None,
        };
        found.map(shift).into_iter().collect()
    }
    fn direct(&self) -> bool {
        true
    }
}

/// Samples that PV has to be moved to later times, where it has to, and what is left unexplained then as a share of what the
/// stamps leave.
fn skew(u: &[f64], y: &[f64], sp: Option<&[f64]>) -> Option<(i32, f64)> {
    let left = |by: i32| unexplained(u, y, sp, by);
    let honest = (0..=1).map(left).fold(1.0, f64::min);
    if honest < LEAST_HONEST.1 {
        return None;
    }
    let others: Vec<(f64, i32)> = (-LONGEST..=LONGEST).map(|by| (left(by), by)).collect();
    let least = others.iter().map(|l| l.0).fold(f64::INFINITY, f64::min);
    // Of three samples of PV one that is not needed may be before or after: the later is.
    let as_good = (AS_GOOD * least).max(NOTHING * honest);
    let by = others.iter().rev().find(|l| l.0 <= as_good)?.1;
    let far_better = if honest < LEAST_HONEST.0 { EXACT } else { FAR_BETTER };
    let wrong = !(-1..=2).contains(&by) && least <= MOST_LEFT && least <= far_better * honest;
    wrong.then_some((by, least / honest))
}

/// The share of OP's changes that `y[k-by], y[k-by-1], y[k-by-2]` and the set point leave unexplained, of samples weighted
/// so that the kicks of a set point that is not recorded do not rule.
fn unexplained(u: &[f64], y: &[f64], sp: Option<&[f64]>, by: i32) -> f64 {
    let reach = LONGEST as usize + 3;
    let (from, to) = (reach, u.len().saturating_sub(reach));
    if to <= from + 20 {
        return 1.0;
    }
    let change: Vec<f64> = (from..to).map(|k| u[k] - u[k - 1]).collect();
    let columns: Vec<Vec<f64>> = (0..3)
        .map(|more| (from..to).map(|k| y[(k as i32 - by - more) as usize]).collect())
        .chain([vec![1.0; to - from]])
        .chain(sp.into_iter().flat_map(|sp| (0..3).map(move |more| sp[from - more..to - more].to_vec())))
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
                assert_eq!(skew(&u, &stamped, sp).map(|found| found.0), Some(by), "{}", sp.is_some());
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
