//! How effects are proposed: what a hypothesis hands on to be fitted.

use crate::residual::effect::EffectModel;
use crate::residual::findings::Kind;
use crate::residual::screening::Screen;
use crate::sysid::valve::ValveModel;

/// An effect that the screening proposes to be fitted.
#[derive(Debug)]
pub struct Proposal {
    /// The effect.
    pub effect: Box<dyn EffectModel>,
    /// The valve that it was found with; `None` where that is the present one.
    pub valve: Option<ValveModel>,
    /// Log-likelihood that the screening expects it to gain (-).
    pub gain: f64,
}

impl Proposal {
    /// A proposal of an effect beside the present valve.
    pub fn new(effect: impl EffectModel + 'static, gain: f64) -> Self {
        Self { effect: Box::new(effect), valve: None, gain }
    }
}

/// How the effects of one kind are proposed.
pub trait Propose: Sync {
    /// The kind.
    fn kind(&self) -> Kind;
    /// The effects that are worth a fit beside the hypothesis that is screened, the best first.
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal>;
}

/// The proposals with the largest gains, `most` of them.
pub fn best(mut proposals: Vec<Proposal>, most: usize) -> Vec<Proposal> {
    proposals.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    proposals.truncate(most);
    proposals
}
