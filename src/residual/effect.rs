//! What an effect does to the model: the interface behind every hypothesis beside friction.

use super::findings::{Kind, Lasting};
use super::report::Described;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;
use std::fmt::Debug;

/// An effect at some value of its parameters; what it does not touch stays as it is.
pub trait EffectModel: Debug + Send + Sync {
    /// Which of the closed list.
    fn kind(&self) -> Kind;
    /// A copy.
    fn boxed(&self) -> Box<dyn EffectModel>;
    /// The tag it takes.
    fn tag(&self) -> Option<&str> {
        None
    }
    /// Sum of the rates of its parameters: each costs its rate times ln N (see [`crate::sysid::criterion`]).
    fn rate(&self) -> f64;
    /// Alternatives among which it was chosen, beside its parameters (-).
    fn alternatives(&self) -> f64 {
        1.0
    }
    /// Parameters in which the likelihood is smooth.
    fn smooth(&self) -> Vec<Smooth> {
        Vec::new()
    }
    /// Sets them.
    fn set_smooth(&mut self, _theta: &[f64]) {}
    /// The same effect a little to each side in the parameters in which the likelihood jumps; `step` from 1 down.
    fn neighbours(&self, _data: &IdData, _step: f64) -> Vec<Box<dyn EffectModel>> {
        Vec::new()
    }
    /// The sample at which it sets in, where it changes something for good.
    fn at(&self) -> Option<usize> {
        None
    }
    /// The same at another sample.
    fn moved(&self, _at: usize) -> Box<dyn EffectModel> {
        self.boxed()
    }
    /// Itself, and the same where it may enter elsewhere.
    fn variants(&self) -> Vec<Box<dyn EffectModel>> {
        vec![self.boxed()]
    }
    /// What it is at one value of a parameter: it competes wherever this effect leads, because a search can miss it.
    fn special_case(&self) -> Option<Box<dyn EffectModel>> {
        None
    }
    /// Changes the valve.
    fn on_valve(&self, _valve: &mut ValveModel) {}
    /// Whether it changes the stem on its way to the process.
    fn bends(&self) -> bool {
        false
    }
    /// Changes stem positions at sample `k` on their way to the process: of one valve or of several side by side.
    fn bend(&self, _data: &IdData, _k: usize, _x: &mut [f64]) {}
    /// Samples by which the process sees the stem later at sample `k` than elsewhere.
    fn delay(&self, _k: usize) -> usize {
        0
    }
    /// Adds what PV shows beside the process' output.
    fn on_pv(&self, _data: &IdData, _offset: &mut [f64]) {}
    /// Whether it does.
    fn shifts_pv(&self) -> bool {
        false
    }
    /// What the next window may take as given; `None` for what comes and goes.
    fn lasting(&self, _data: &IdData) -> Option<Lasting> {
        None
    }
    /// Adds the shapes of loads.
    fn shapes(&self, _data: &IdData, _out: &mut Vec<Vec<f64>>) {}
    /// Its parameters and its sentence; `gamma`: the coefficients of its own shapes.
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described;
}
