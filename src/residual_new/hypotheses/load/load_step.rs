//! A load that changes once and stays: `gamma [k >= t]`.
//!
//! Parameters: time t (s), rate 1; size (OP unit), rate 1/2. Proposed at the times that gain most in the high-order ARX.

use crate::residual_new::Kind;
use crate::residual_new::effect::Effect;
use crate::residual_new::hypotheses::{Proposal, Propose};
use crate::residual_new::report::{Described, in_op};
use crate::residual_new::screening::{Screen, Since, best_times};
use crate::sysid::armax::Armax;
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;

/// Times proposed.
const TIMES: usize = 2;

/// The load steps.
pub struct Steps;

/// Informed.
pub fn informed(at: usize) -> Box<dyn Effect> {
    Box::new(Step { at })
}

#[derive(Clone, Debug)]
struct Step {
    at: usize,
}

/// 0 before `at`, 1 from there on.
pub fn heaviside(n: usize, at: usize) -> Vec<f64> {
    (0..n).map(|k| f64::from(u8::from(k >= at))).collect()
}

impl Effect for Step {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn boxed(&self) -> Box<dyn Effect> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR + THRESHOLD
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        out.push(heaviside(data.len(), self.at));
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn Effect>> {
        near(self.at, data, step).into_iter().map(|at| Step { at }.boxed()).collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        let size = gamma.first().copied().unwrap_or(0.0) * in_op(data, model);
        let time = data.time(self.at as f64);
        Described::new(format!("the load changes at {time:.1} s, by what {size:.3} OP would do, and stays"))
            .with("time_s", time, "s")
            .with("size_op", size, "OP")
    }
}

/// Times to each side of `at`, inside the fitted rows: 4 samples at step 1, 2 at 1/2, 1 at 1/4.
pub fn near(at: usize, data: &IdData, step: f64) -> Vec<usize> {
    let by = (4.0 * step).round().max(1.0) as usize;
    let inside = |at: &usize| (data.first + 2..data.split - 2).contains(at);
    [at.saturating_sub(by), at + by].into_iter().filter(inside).collect()
}

impl Propose for Steps {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let first = screen.data.first;
        let ones = vec![1.0; screen.long.errors.len()];
        let times = screen.long.from_each_row(&ones).into_iter();
        best_times(times.map(|(row, gain)| Since { at: first + row, gain }).collect(), screen.most(TIMES))
            .into_iter()
            .map(|since| Proposal::new(Step { at: since.at }, since.gain))
            .collect()
    }
}
