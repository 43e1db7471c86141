//! A load that changes once and stays: `gamma [k >= t]`, at the process' input, or as a shift of PV itself.
//!
//! Parameters: time t (s), rate 1; size (OP unit), rate 1/2. Alternatives: before or behind the
//! process. Proposed at the times that gain most in the high-order ARX and in the ARMAX.

use crate::residual::Kind;
use crate::residual::effect::EffectModel;
use crate::residual::hypotheses::{Proposal, Propose};
use crate::residual::report::{Described, in_op, in_pv};
use crate::residual::screening::{Screen, Since, best_times};
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;

/// Times proposed.
const TIMES: usize = 2;

/// Samples between times that are tried in the ARMAX.
const STRIDE: usize = 8;

/// The load steps.
pub struct Steps;

/// Informed.
pub fn informed(at: usize) -> Box<dyn EffectModel> {
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

impl EffectModel for Step {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR + THRESHOLD
    }
    fn alternatives(&self) -> f64 {
        2.0
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        out.push(heaviside(data.len(), self.at));
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
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

/// A level of PV that shifts: the load acts behind the process, or the sensor jumped.
#[derive(Clone, Debug)]
struct Shift {
    at: usize,
    size: f64,
}

impl EffectModel for Shift {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR + THRESHOLD
    }
    fn alternatives(&self) -> f64 {
        2.0
    }
    fn smooth(&self) -> Vec<Smooth> {
        vec![Smooth { value: self.size, step: 1e-4, bounds: (-20.0, 20.0) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.size = theta[0];
    }
    fn shifts_pv(&self) -> bool {
        true
    }
    fn on_pv(&self, _data: &IdData, offset: &mut [f64]) {
        offset.iter_mut().skip(self.at).for_each(|offset| *offset += self.size);
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        near(self.at, data, step).into_iter().map(|at| Shift { at, ..self.clone() }.boxed()).collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, _gamma: &[f64]) -> Described {
        let (time, pv) = (data.time(self.at as f64), self.size * data.units.y);
        let gain = in_pv(data, model) / in_op(data, model);
        Described::new(format!("PV's level shifts at {time:.1} s by {pv:.3}, whatever the valve does"))
            .with("time_s", time, "s")
            .with("size_op", pv / gain, "OP")
            .with("size_pv", pv, "PV")
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
        let most = screen.most(TIMES);
        let since = |(row, gain, _): &(usize, f64, f64)| Since { at: first + row, gain: *gain };
        let long = screen.long.steps(&[1.0]);
        let at_input = best_times(long.iter().map(since).collect(), most);
        let rate = |at: usize| screen.model.alone(screen.load(&heaviside(screen.data.len(), at))).0;
        let model = screen.times(STRIDE).map(|at| Since { at, gain: rate(at) });
        let in_model = best_times(model.collect(), most);
        let step = |since: Since| Proposal::new(Step { at: since.at }, since.gain);
        let mut out: Vec<Proposal> = at_input.into_iter().chain(in_model).map(step).collect();
        // A step that PV shows beside the output comes through A.
        let mut onset = vec![1.0];
        screen.of_y.iter().for_each(|a| onset.push(onset[onset.len() - 1] - a));
        let shown: Vec<(usize, f64, f64)> = screen.long.steps(&onset);
        let sized = |at: usize| shown.iter().find(|step| first + step.0 == at).map_or(0.0, |step| step.2);
        out.extend(
            best_times(shown.iter().map(since).collect(), most)
                .into_iter()
                .map(|since| Proposal::new(Shift { at: since.at, size: sized(since.at) }, since.gain)),
        );
        out
    }
}
