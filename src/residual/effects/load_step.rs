//! A load that changes once: `g1 [k >= t] + g2 [k = t]`, time [s], size [OP].

use super::{Context, Proposal, Recognise, best};
use crate::residual::model::{Data, Knob, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Fewest samples to each side of a change.
pub const MARGIN: usize = 12;

/// Samples within which times of a change are one alternative: what they explain hardly differs, so that the largest of all is that
/// of some 20 independent ones (Andrews 1993: 12.3 where one has 6.6, at 1 %), fewer than this leaves.
pub const ALIKE: f64 = 12.0;

/// Least gain in likelihood of what stays over what happens at its time alone (-).
const STAYS: f64 = 15.0;

/// Times that are looked at closely, and samples about each.
const STEPS: usize = 2;
const ABOUT: usize = 2;

pub struct LoadStep;

#[derive(Clone, Debug)]
struct Step {
    at: f64,
    bounds: (f64, f64),
    entry: usize,
}

/// 0 before `at`, 1 from there on.
pub fn heaviside(n: usize, at: usize) -> Vec<f64> {
    (0..n).map(|k| f64::from(u8::from(k >= at))).collect()
}

fn pulse(n: usize, at: usize) -> Vec<f64> {
    (0..n).map(|k| f64::from(u8::from(k == at))).collect()
}

impl Term for Step {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![Knob { value: self.at, step: 2.0, smooth: false, bounds: self.bounds }]
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.at = value.round();
    }
    fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
        let at = self.at as usize;
        out.push(heaviside(data.len(), at));
        out.extend((0..self.entry).map(|more| pulse(data.len(), at + more)));
    }
    fn describe(&self, data: &Data, gamma: &[f64], linear: &Linear) -> (Vec<Parameter>, String) {
        let time = data.scale.t0 + self.at * data.scale.ts;
        let in_op = gamma.first().map_or(0.0, |g| g * linear.in_op()) * data.scale.u;
        let parameters = vec![
            Parameter { name: "time_s", value: time, unit: "s" },
            Parameter { name: "size_op", value: in_op, unit: "OP" },
        ];
        (parameters, format!("the load changes at {time:.1} s, by what {in_op:.3} OP would do, and stays"))
    }
}

impl Recognise for LoadStep {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let margin = MARGIN.max((c.data.split - c.data.first) / 12);
        let (from, to) = (c.data.first + margin / 2, c.data.split.saturating_sub(margin));
        let n = c.data.len();
        let mut step = c.left().column();
        let mut rated: Vec<(f64, usize)> = Vec::new();
        for at in (from..c.data.split).rev() {
            step.add(at - c.data.first, 1.0);
            if at < to {
                rated.push((step.alone().0, at));
            }
        }
        let mut out = Vec::new();
        for _ in 0..STEPS {
            let Some(&(_, near)) = rated.iter().min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            rated.retain(|(_, at)| at.abs_diff(near) > 2 * ABOUT);
            for at in near.saturating_sub(ABOUT)..=near + ABOUT {
                for entry in [0, 2] {
                    let mut shapes = vec![heaviside(n, at)];
                    shapes.extend((0..entry).map(|more| pulse(n, at + more)));
                    let refs: Vec<&[f64]> = shapes.iter().map(Vec::as_slice).collect();
                    let raw = c.quick.with(&refs).0;
                    // A sample far off, or a jump of the stem missed by one, is no load that stays.
                    let once = if entry == 0 { c.quick.loss } else { c.quick.with(&refs[1..]).0 };
                    if c.rows() * (once / raw).ln() < STAYS {
                        continue;
                    }
                    let loss = raw * (2.0 * entry as f64 / c.rows()).exp();
                    let bounds = (from as f64, to as f64);
                    let term = Step { at: at as f64, bounds, entry };
                    let tried = (to.saturating_sub(from)) as f64;
                    out.push(Proposal { term: Box::new(term), loss, parameters: 1.0, tried, element: None });
                }
            }
        }
        best(out, 2)
    }
}
