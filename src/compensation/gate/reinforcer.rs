//! What the term should be: constant reinforcement of the f that was granted, at work.

use super::conditions::{self, Denial, Evidence, Inputs, Limits, Time, believed};
use super::{Gate, State};
use crate::compensation::{Compensator, ConstantReinforcement, CrSettings, Followed};

/// Constant reinforcement at work, and what it was made from.
#[derive(Clone, Debug)]
pub(super) struct Reinforcer {
    cr: ConstantReinforcement,
    evidence: Evidence,
    /// Stamp of the last OP it saw, and when (mono, s).
    op: Option<(f64, f64)>,
    /// What it asks for [%].
    pub(super) target: f64,
}

impl Gate {
    /// Lets the reinforcement see each OP once; where nothing is written it is computed all the same.
    pub(super) fn reinforce(&mut self, inputs: &Inputs, now: Time) {
        if !self.state.writes() {
            let usable = conditions::evidence(inputs, now.wall, &self.limits).is_none();
            let evidence = inputs.evidence.filter(|_| usable && self.state != State::Disabled);
            let made_of = self.cr.as_ref().map(|own| own.evidence.at);
            if evidence.map(|own| own.at) != made_of {
                self.cr = evidence.and_then(|evidence| self.reinforcer(evidence));
            }
        }
        let op = believed(inputs.op, now.wall, &self.limits).zip(inputs.op.map(|op| op.t));
        let percent = 100.0 / self.limits.op_span;
        let Some(own) = &mut self.cr else { return };
        let Some((op, t)) = op else {
            own.target = 0.0;
            return;
        };
        if own.op.is_none_or(|(last, _)| last != t) {
            let dt = own.op.map_or(0.0, |(_, at)| now.mono - at);
            own.target = own.cr.step(op * percent, dt);
            own.op = Some((t, now.mono));
        }
    }

    /// Made of what a diagnosis tells.
    pub(super) fn reinforcer(&self, evidence: Evidence) -> Option<Reinforcer> {
        let Limits { clamp, dead_band, rest_s, f_margin, .. } = self.limits;
        // The rate is the gate's: it holds for the withdrawal too.
        let settings = CrSettings { dead_band, rest_s, size: clamp, rate: f64::INFINITY };
        let [low, high] = evidence.f_ci95;
        let interval = [(low - f_margin).max(0.0), high + f_margin];
        let cr = ConstantReinforcement::new(evidence.f, interval, settings).ok()?;
        Some(Reinforcer { cr, evidence, op: None, target: 0.0 })
    }

    /// A later estimate moves the amplitude, or says that this is no longer the valve that was granted. One that is not
    /// sticky says nothing: the term hides the friction.
    pub(super) fn f_left(&mut self, inputs: &Inputs) -> Option<Denial> {
        let (own, evidence) = self.cr.as_mut().zip(inputs.evidence)?;
        if evidence.at <= own.evidence.at || !evidence.sticky {
            return None;
        }
        (own.cr.follow(evidence.f, evidence.f_ci95) == Followed::Outside).then_some(Denial::FOutsideInterval)
    }
}
