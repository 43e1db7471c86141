//! A load that changes once and stays, a step `gamma [k >= t]`. It enters in one of two places: in the equation, or at the process
//! input together with the stem (through B). A step in PV itself is the sensor's ([`crate::residual::hypotheses::sensor::pv_offset`]).
//!
//! Parameters: time t (s), rate 1; size gamma (OP unit), rate 1/2. Alternatives: the three places. It is proposed at the times that
//! gain most in the high-order ARX and in the ARMAX.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::hypotheses::change_time::{LARGEST_STEP, heaviside, neighbouring_times};
use crate::residual::hypotheses::gains::in_op;
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::hypotheses::sensor::pv_offset;
use crate::residual::screening::{ChangeTime, Screen, best_times};
use crate::signal::moment;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;

/// Times proposed.
const TIMES: usize = 2;
/// Samples between the times that are screened in the ARMAX.
const STRIDE: usize = 8;

/// The load steps.
pub struct Steps;

/// Where a step enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// In the equation, so that PV shows it at once.
    Equation,
    /// At the process input, as the stem does, so that PV shows it one dead time later.
    Input,
}

#[derive(Clone, Debug)]
struct Step {
    /// Sample of the change.
    at: usize,
    place: Place,
    /// Size, where it is not a coefficient of the equation (standard deviations of OP).
    size: f64,
}

/// A step in the equation.
pub fn in_equation(at: usize) -> Box<dyn EffectModel> {
    Step { at, place: Place::Equation, size: 0.0 }.boxed()
}

/// A step at the process input. `size`: in standard deviations of OP.
pub fn at_input(at: usize, size: f64) -> Box<dyn EffectModel> {
    Step { at, place: Place::Input, size: size.clamp(-LARGEST_STEP, LARGEST_STEP) }.boxed()
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
        vec![Smooth { value: self.size, step: 1e-4, bounds: (-LARGEST_STEP, LARGEST_STEP) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.size = theta.first().copied().unwrap_or(self.size);
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        if self.place == Place::Equation {
            out.push(heaviside(data.len(), self.at));
        }
    }
    fn maps_stem(&self) -> bool {
        self.place == Place::Input
    }
    fn map_stem(&self, _data: &IdData, k: usize, x: &mut [f64]) {
        if k >= self.at {
            x.iter_mut().for_each(|x| *x += self.size);
        }
    }
    fn change_time(&self) -> Option<usize> {
        Some(self.at)
    }
    fn with_change_time(&self, at: usize) -> Box<dyn EffectModel> {
        Step { at, ..self.clone() }.boxed()
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        neighbouring_times(self.at, data, step)
            .into_iter()
            .map(|at| Step { at, ..self.clone() }.boxed())
            .collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        let time = data.time(self.at as f64);
        let size = match self.place {
            Place::Equation => gamma.first().copied().unwrap_or(0.0) * in_op(data, model),
            Place::Input => self.size * data.units.u,
        };
        let (at, worth) = (moment(time), data.units.along_op(size));
        Described::new(format!("the load changes at {at} and stays changed, as if OP had moved by {worth}"))
            .with("time_s", time, "s")
            .with("size_op", size, "OP")
    }
}

impl Propose for Steps {
    fn kind(&self) -> Kind {
        Kind::LoadStep
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let first = screen.data.first;
        let most = screen.limit(TIMES);
        let since = |(row, gain, _): &(usize, f64, f64)| ChangeTime { at: first + row, gain: *gain };
        let in_equation = best_times(screen.arx.step_gains(&[1.0]).iter().map(since).collect(), most);
        let rate = |at: usize| screen.armax.single_gain(screen.load_step_regressor(at)).0;
        let in_model = screen.change_times(STRIDE).map(|at| ChangeTime { at, gain: rate(at) });
        let in_model = best_times(in_model.collect(), most);
        let mut out = Vec::new();
        for since in in_equation.into_iter().chain(in_model) {
            let step = Step { at: since.at, place: Place::Equation, size: 0.0 };
            // The process answers a step at its input one dead time later.
            let at = since.at.saturating_sub(screen.base.model.nk);
            let (gain, size) = screen.armax.single_gain(screen.stem_step_regressor(at));
            let size = size.clamp(-LARGEST_STEP, LARGEST_STEP);
            out.push(Proposal::new(step.clone(), since.gain));
            out.push(Proposal::new(Step { at, place: Place::Input, size }, gain.max(since.gain)));
        }
        out.extend(pv_offset::propose(screen, most));
        out
    }
}
