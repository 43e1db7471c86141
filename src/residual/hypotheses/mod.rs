//! The hypotheses, one file each: equation, parameters with units, rates, and how they are proposed.

pub mod load;
pub mod process;
pub mod valve;

use super::effect::EffectModel;
use super::findings::{Kind, Lasting};
use super::screening::Screen;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// An effect worth a fit.
#[derive(Debug)]
pub struct Proposal {
    /// The effect.
    pub effect: Box<dyn EffectModel>,
    /// The valve it was found with, where not the present one.
    pub valve: Option<ValveModel>,
    /// Log-likelihood that screening promises.
    pub gain: f64,
}

impl Proposal {
    /// Of an effect beside the present valve.
    pub fn new(effect: impl EffectModel + 'static, gain: f64) -> Self {
        Self { effect: Box::new(effect), valve: None, gain }
    }
}

/// An effect that was found in another window.
pub fn again(data: &IdData, lasting: &Lasting) -> Option<Box<dyn EffectModel>> {
    match lasting {
        Lasting::OscillatingLoad { period_s, harmonics } => {
            load::oscillating_load::again(data, *period_s, *harmonics)
        }
        Lasting::MeasuredDisturbance { tag, delay_s } => {
            load::measured_disturbance::again(data, tag, *delay_s)
        }
        Lasting::Characteristic { curvature_per_op } => valve::characteristic::again(data, *curvature_per_op),
        Lasting::GainOfPv { gain_per_pv } => process::gain_of_pv::again(data, *gain_per_pv),
        Lasting::ValveSaturation { level, above, held } => {
            valve::saturation::again(data, *level, *above, *held)
        }
        Lasting::AsymmetricFriction { asymmetry } => valve::asymmetric_friction::again(*asymmetry),
    }
}

/// How an effect is proposed.
pub trait Propose: Sync {
    /// Which.
    fn kind(&self) -> Kind;
    /// What is worth a fit beside the hypothesis that is screened, the best first.
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal>;
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

/// The best `most` by promised gain.
pub fn best(mut proposals: Vec<Proposal>, most: usize) -> Vec<Proposal> {
    proposals.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    proposals.truncate(most);
    proposals
}
