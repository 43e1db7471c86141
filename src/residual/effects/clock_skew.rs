//! OP and PV are stamped by clocks that disagree; skew [s], positive when PV's stamps are early.
//!
//! The process hides a skew in its delay, the controller does not: `u[k] - u[k-1]` is computed from PV at k (and just
//! before). If it fits PV of several samples earlier or of later ones far better, the stamps are wrong, and PV is shifted.

use super::{Context, Proposal, Recognise};
use crate::diagnosis::linalg::{MOST_COLUMNS, dot, factor, substitute};
use crate::residual::model::{Data, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Longest skew tried (samples).
const LONGEST: i32 = 15;
/// Unexplained share of OP's changes that the right skew leaves at most, and that as a share of what the stamps leave.
const MOST_LEFT: f64 = 0.5;
const FAR_BETTER: f64 = 0.6;
/// What the stamps leave unexplained at least where they are wrong.
const LEAST_HONEST: f64 = 0.01;

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
    fn describe(&self, data: &Data, _gamma: &[f64], _gain: f64) -> (Vec<Parameter>, String) {
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
        let left: Vec<(f64, i32)> = (-LONGEST..=LONGEST)
            .map(|by| (unexplained(&c.stage.u, &c.stage.y, c.data.sp.as_deref(), by), by))
            .collect();
        let Some(&(least, by)) = left.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { return Vec::new() };
        let honest = left.iter().filter(|(_, by)| (0..=1).contains(by)).map(|l| l.0).fold(1.0, f64::min);
        if (-1..=2).contains(&by) || honest < LEAST_HONEST || least > MOST_LEFT || least > FAR_BETTER * honest
        {
            return Vec::new();
        }
        let loss = least / honest;
        vec![Proposal { term: Box::new(Shift { by }), loss, parameters: 1.0, tried: 1.0, element: None }]
    }
    fn direct(&self) -> bool {
        true
    }
}

/// The share of OP's changes that `y[k-by], y[k-by-1], y[k-by-2]` and the set point leave unexplained.
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
    let size = columns.len();
    let mut g = vec![0.0; size * size];
    let mut theta = vec![0.0; size];
    for i in 0..size {
        for j in 0..=i {
            g[i * size + j] = dot(&columns[i], &columns[j]);
        }
        theta[i] = dot(&columns[i], &change);
    }
    let r = theta.clone();
    let mut live = [true; MOST_COLUMNS];
    factor(&mut g, size, size, &mut live);
    substitute(&g, size, &live, &mut theta);
    let power = dot(&change, &change);
    if power > 0.0 { ((power - dot(&r, &theta)) / power).max(0.0) } else { 1.0 }
}
