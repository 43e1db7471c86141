//! The interface of every effect beside friction: where it enters the model, what it costs, and how it is described.
//!
//! ```text
//! A(q) (y - o) = B(q) x + sum gamma_m phi_m + c0 + C(q) e
//! ```
//!
//! An effect enters in one of four places: it changes the valve ([`EffectModel::change_valve`]), it changes the stem x on its
//! way to the process ([`EffectModel::map_stem`], [`EffectModel::delay`]), it adds shapes phi of loads
//! ([`EffectModel::shapes`]), or it adds an offset o to PV ([`EffectModel::add_pv_offset`]).

use super::findings::{Described, Kind, Lasting};
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;
use std::fmt::Debug;

/// An effect with values for its parameters. What a method does not override, the effect leaves as it is.
pub trait EffectModel: Debug + Send + Sync {
    /// Its kind in the closed list.
    fn kind(&self) -> Kind;
    /// A copy.
    fn boxed(&self) -> Box<dyn EffectModel>;
    /// The tag that it uses.
    fn tag(&self) -> Option<&str> {
        None
    }
    /// Sum of the rates of its parameters (-): a parameter is penalised by its rate times ln N (see [`crate::sysid::criterion`]).
    fn rate(&self) -> f64;
    /// Number of alternatives among which it was chosen, beside its parameters (-): the penalty is the logarithm of it.
    fn alternatives(&self) -> f64 {
        1.0
    }
    /// The parameters in which the likelihood is smooth: the ARMAX fit estimates them with its coefficients.
    fn smooth(&self) -> Vec<Smooth> {
        Vec::new()
    }
    /// Sets the smooth parameters.
    fn set_smooth(&mut self, _theta: &[f64]) {}
    /// The same effect with neighbouring values of the parameters in which the likelihood jumps; `step` (-) from 1 down.
    fn neighbours(&self, _data: &IdData, _step: f64) -> Vec<Box<dyn EffectModel>> {
        Vec::new()
    }
    /// The sample at which it sets in, where it is a lasting change.
    fn change_time(&self) -> Option<usize> {
        None
    }
    /// The same effect with another change time (samples).
    fn with_change_time(&self, _at: usize) -> Box<dyn EffectModel> {
        self.boxed()
    }
    /// The simpler effect that it becomes at one value of a parameter. The simpler one is fitted wherever this effect leads,
    /// because the screening can miss it.
    fn special_case(&self) -> Option<Box<dyn EffectModel>> {
        None
    }
    /// Changes the parameters of the valve.
    fn change_valve(&self, _valve: &mut ValveModel) {}
    /// Whether [`EffectModel::map_stem`] changes the stem.
    fn maps_stem(&self) -> bool {
        false
    }
    /// Maps stem positions at sample `k` to what the process sees of them: of one valve, or of several valves side by side.
    fn map_stem(&self, _data: &IdData, _k: usize, _x: &mut [f64]) {}
    /// Dead time that it adds at sample `k` (samples).
    fn delay(&self, _k: usize) -> usize {
        0
    }
    /// Adds to the offset that PV shows and the process output does not have (standard deviations of PV).
    fn add_pv_offset(&self, _data: &IdData, _offset: &mut [f64]) {}
    /// Whether it has such an offset.
    fn has_pv_offset(&self) -> bool {
        false
    }
    /// What the next window may take as given; `None` for an effect that comes and goes.
    fn lasting(&self, _data: &IdData) -> Option<Lasting> {
        None
    }
    /// Appends the shapes phi of its loads.
    fn shapes(&self, _data: &IdData, _out: &mut Vec<Vec<f64>>) {}
    /// Its parameters in the plant's units, and the sentence that operators read. `gamma`: the coefficients of its own shapes.
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described;
}
