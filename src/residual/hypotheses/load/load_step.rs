//! A load that changes once and stays: `gamma [k >= t]` in the equation, beside the stem through B, or in PV itself.
//!
//! Parameters: time t (s), rate 1; size (OP unit), rate 1/2. Alternatives: the three places. Proposed at the times that gain
//! most in the high-order ARX and in the ARMAX.

use crate::residual::Kind;
use crate::residual::effect::EffectModel;
use crate::residual::hypotheses::{Proposal, Propose};
use crate::residual::report::{Described, in_op, in_pv};
use crate::residual::screening::{Screen, Since, best_times};
use crate::signal::{moment, told};
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;

/// Times proposed.
const TIMES: usize = 2;
/// Samples between times that are tried in the ARMAX.
const STRIDE: usize = 8;
/// Largest step, in standard deviations of OP or PV.
const MOST: f64 = 20.0;

/// The load steps.
pub struct Steps;

/// Where a step enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// The equation, at once.
    Equation,
    /// The process' input, as the stem does.
    Input,
    /// PV: behind the process, or in the sensor.
    Pv,
}

#[derive(Clone, Debug)]
struct Step {
    at: usize,
    place: Place,
    /// Its size, where that is no coefficient of the equation.
    size: f64,
}

/// A step at the process' input, of this size (standard deviations of OP).
pub fn at_input(at: usize, size: f64) -> Box<dyn EffectModel> {
    Step { at, place: Place::Input, size: size.clamp(-MOST, MOST) }.boxed()
}

/// 0 before `at`, 1 from there on.
pub fn heaviside(n: usize, at: usize) -> Vec<f64> {
    (0..n).map(|k| f64::from(u8::from(k >= at))).collect()
}

/// Times to each side of `at`, inside the fitted rows: 4 samples at step 1, 2 at 1/2, 1 at 1/4.
pub fn near(at: usize, data: &IdData, step: f64) -> Vec<usize> {
    let by = (4.0 * step).round().max(1.0) as usize;
    let inside = |at: &usize| (data.first + 2..data.split - 2).contains(at);
    [at.saturating_sub(by), at + by].into_iter().filter(inside).collect()
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
        3.0
    }
    fn smooth(&self) -> Vec<Smooth> {
        if self.place == Place::Equation {
            return Vec::new();
        }
        vec![Smooth { value: self.size, step: 1e-4, bounds: (-MOST, MOST) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.size = theta.first().copied().unwrap_or(self.size);
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        if self.place == Place::Equation {
            out.push(heaviside(data.len(), self.at));
        }
    }
    fn bends(&self) -> bool {
        self.place == Place::Input
    }
    fn bend(&self, _data: &IdData, k: usize, x: &mut [f64]) {
        if k >= self.at {
            x.iter_mut().for_each(|x| *x += self.size);
        }
    }
    fn shifts_pv(&self) -> bool {
        self.place == Place::Pv
    }
    fn on_pv(&self, _data: &IdData, offset: &mut [f64]) {
        if self.place == Place::Pv {
            offset.iter_mut().skip(self.at).for_each(|offset| *offset += self.size);
        }
    }
    fn at(&self) -> Option<usize> {
        Some(self.at)
    }
    fn moved(&self, at: usize) -> Box<dyn EffectModel> {
        Step { at, ..self.clone() }.boxed()
    }
    fn variants(&self) -> Vec<Box<dyn EffectModel>> {
        let places = [Place::Equation, Place::Input, Place::Pv].into_iter();
        let others = places.filter(|place| *place != self.place);
        let others = others.map(|place| Step { place, size: 0.0, ..self.clone() }.boxed());
        [self.boxed()].into_iter().chain(others).collect()
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        near(self.at, data, step).into_iter().map(|at| Step { at, ..self.clone() }.boxed()).collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        let time = data.time(self.at as f64);
        let gain = in_pv(data, model) / in_op(data, model);
        let size = match self.place {
            Place::Equation => gamma.first().copied().unwrap_or(0.0) * in_op(data, model),
            Place::Input => self.size * data.units.u,
            Place::Pv => self.size * data.units.y / gain,
        };
        let said = match self.place {
            Place::Pv => {
                let size = told(self.size * data.units.y);
                format!("PV's level shifts at {} by {size} and stays", moment(time))
            }
            _ => {
                let worth = data.units.along_op(size);
                let at = moment(time);
                format!("the load changes at {at} and stays changed, with the effect of {worth}")
            }
        };
        let described = Described::new(said).with("time_s", time, "s").with("size_op", size, "OP");
        // Nothing of the load has to change for that.
        if self.place == Place::Pv { described.at("pv") } else { described }
    }
}

impl Propose for Steps {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let (first, n) = (screen.data.first, screen.data.len());
        let most = screen.most(TIMES);
        let since = |(row, gain, _): &(usize, f64, f64)| Since { at: first + row, gain: *gain };
        let in_equation = best_times(screen.long.steps(&[1.0]).iter().map(since).collect(), most);
        let rate = |at: usize| screen.model.alone(screen.load(&heaviside(n, at))).0;
        let in_model = screen.times(STRIDE).map(|at| Since { at, gain: rate(at) });
        let in_model = best_times(in_model.collect(), most);
        let mut out = Vec::new();
        for since in in_equation.into_iter().chain(in_model) {
            let step = Step { at: since.at, place: Place::Equation, size: 0.0 };
            // The process answers to the step as it does to the stem, a delay later.
            let at = since.at.saturating_sub(screen.base.model.nk);
            let (gain, size) = screen.model.alone(screen.stem(&heaviside(n, at)));
            let size = size.clamp(-MOST, MOST);
            out.push(Proposal::new(step.clone(), since.gain));
            out.push(Proposal::new(Step { at, place: Place::Input, size }, gain.max(since.gain)));
        }
        // A step that PV shows beside the output comes through A.
        let mut onset = vec![1.0];
        screen.of_y.iter().for_each(|a| onset.push(onset[onset.len() - 1] - a));
        let shown: Vec<(usize, f64, f64)> = screen.long.steps(&onset);
        let sized = |at: usize| shown.iter().find(|step| first + step.0 == at).map_or(0.0, |step| step.2);
        out.extend(best_times(shown.iter().map(since).collect(), most).into_iter().map(|since| {
            let size = sized(since.at).clamp(-MOST, MOST);
            Proposal::new(Step { at: since.at, place: Place::Pv, size }, since.gain)
        }));
        out
    }
}
