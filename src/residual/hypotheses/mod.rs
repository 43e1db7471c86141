//! The hypotheses of effects, one file each: equation, parameters with units, rates (the penalty of a parameter is its rate times
//! ln N), number of alternatives, how the effect is proposed, and the sentence that operators read (`describe`).
//!
//! | where | what |
//! |---|---|
//! | [`load`] | loads: a step, a drift, an oscillation, a measured disturbance |
//! | [`process`] | the gain and the dead time of the process |
//! | [`sensor`] | what PV shows and the process output does not have |
//! | [`valve`] | the valve beside its friction |
//! | [`proposal`], [`change_time`], [`gains`] | what they share |

pub mod change_time;
pub mod gains;
pub mod load;
pub mod process;
pub mod proposal;
pub mod sensor;
pub mod valve;

pub use proposal::{Proposal, Propose};

use super::effect::EffectModel;
use super::findings::{Kind, Lasting};
use crate::sysid::iddata::IdData;
use load::load_step;
use sensor::pv_offset;

/// An effect that was found in an earlier window, for this one; `None` where this record does not allow it.
pub fn restored(data: &IdData, lasting: &Lasting) -> Option<Box<dyn EffectModel>> {
    match lasting {
        Lasting::OscillatingLoad { period_s, harmonics } => {
            load::oscillating_load::restored(data, *period_s, *harmonics)
        }
        Lasting::MeasuredDisturbance { tag, delay_s } => {
            load::measured_disturbance::restored(data, tag, *delay_s)
        }
        Lasting::Characteristic { curvature_per_op } => {
            valve::characteristic::restored(data, *curvature_per_op)
        }
        Lasting::GainOfPv { gain_per_pv } => process::gain_of_pv::restored(data, *gain_per_pv),
        Lasting::ValveSaturation { level, above, held } => {
            valve::saturation::restored(data, *level, *above, *held)
        }
        Lasting::AsymmetricFriction { asymmetry } => valve::asymmetric_friction::restored(*asymmetry),
    }
}

/// Every effect that competes in the criterion.
pub const ALL: &[&dyn Propose] = &[
    &load::oscillating_load::Oscillating,
    &load::measured_disturbance::Measured,
    &load::load_step::Steps,
    &load::drift::Ramps,
    &process::gain_change::GainChanges,
    &process::dead_time_change::DeadTimeChanges,
    &process::gain_of_pv::GainsOfPv,
    &valve::saturation::Saturations,
    &valve::characteristic::Characteristics,
    &valve::asymmetric_friction::Asymmetries,
    &valve::friction_drift::Drifts,
];

/// The effect itself, and the same effect at every other place where it may enter.
///
/// Only a step has other places: the equation, the process input, and PV itself. Their sizes have to be estimated anew.
pub fn variants(effect: &dyn EffectModel) -> Vec<Box<dyn EffectModel>> {
    let mut all = vec![effect.boxed()];
    if let Some(at) = effect.change_time().filter(|_| effect.kind() == Kind::LoadStep) {
        let place = |step: &dyn EffectModel| (step.maps_stem(), step.has_pv_offset());
        let steps = [load_step::in_equation(at), load_step::at_input(at, 0.0), pv_offset::at(at, 0.0)];
        all.extend(steps.into_iter().filter(|step| place(step.as_ref()) != place(effect)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_competes_with_the_same_step_at_its_other_places() {
        let place = |step: &dyn EffectModel| (step.maps_stem(), step.has_pv_offset());
        let [equation, input, pv] = [(false, false), (true, false), (false, true)];
        let steps = [load_step::in_equation(40), load_step::at_input(40, 1.0), pv_offset::at(40, 1.0)];
        let orders = [[equation, input, pv], [input, equation, pv], [pv, equation, input]];
        for (step, order) in steps.iter().zip(orders) {
            let all = variants(step.as_ref());
            let places: Vec<_> = all.iter().map(|step| place(step.as_ref())).collect();
            assert_eq!(places, order, "{step:?}");
            assert!(all.iter().all(|step| step.change_time() == Some(40) && step.rate() == all[0].rate()));
        }
        let gain = process::gain_of_pv::restored(&IdData::default(), 0.0).expect("a slope");
        assert_eq!(variants(gain.as_ref()).len(), 1, "a gain has one place");
    }
}
