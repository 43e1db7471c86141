//! What one run says of a loop: the diagnosis, and the effects that its residual was traced to.

use crate::diagnosis::{Diagnosis, Verdict};
use crate::residual::{self, Findings};

/// An effect beside friction and linear dynamics, with its tag where it is measured.
pub type KnownEffect = (residual::Kind, Option<String>);

/// A diagnosis, and what its residual was traced to.
#[derive(Clone, Debug)]
pub struct Judged {
    /// By the declared model.
    pub diagnosis: Diagnosis,
    /// With the effects that the declared model lacks; `None` where nothing could be traced.
    pub findings: Option<Findings>,
    /// What both models leave over, for drawing; `None` where nothing could be traced.
    pub residuals: Option<Residuals>,
}

/// One-step residuals before and after the effects, in single precision: they are kept for every loop, only to be drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals {
    /// Time of the first sample (s).
    pub t0: f64,
    /// Sample period (s).
    pub ts: f64,
    /// First sample that no fit has seen.
    pub split: usize,
    /// Of the declared model (PV unit).
    pub before: Vec<f32>,
    /// With the effects (PV unit).
    pub after: Vec<f32>,
}

impl From<&residual::Curves> for Residuals {
    fn from(curves: &residual::Curves) -> Self {
        let single = |v: &[f64]| v.iter().map(|e| *e as f32).collect();
        Self {
            t0: curves.t0,
            ts: curves.ts,
            split: curves.split,
            before: single(&curves.residual_before),
            after: single(&curves.residual_after),
        }
    }
}

impl From<Diagnosis> for Judged {
    fn from(diagnosis: Diagnosis) -> Self {
        Self { diagnosis, findings: None, residuals: None }
    }
}

impl Judged {
    /// The findings that replace the diagnosis: effects were found, and with them friction can be told.
    pub fn replaced_by(&self) -> Option<&Findings> {
        let told = |found: &&Findings| {
            !found.effects.is_empty() && !matches!(found.verdict, Verdict::NotIdentifiable(_))
        };
        self.findings.as_ref().filter(told)
    }

    /// The verdict that counts.
    pub fn verdict(&self) -> &Verdict {
        self.replaced_by().map_or(&self.diagnosis.verdict, |found| &found.verdict)
    }

    /// Friction that counts: f, its interval (OP unit) and the evidence (-).
    pub fn friction(&self) -> Option<(f64, [f64; 2], f64)> {
        let with_effects = self.replaced_by().map(|found| found.friction_after);
        let friction = with_effects.map(|f| (f.f, f.f_ci95, f.delta_aic));
        friction.or_else(|| self.diagnosis.estimate.as_ref().map(|e| (e.f, e.f_ci95, e.delta_aic)))
    }

    /// The effects in the model, in the order they were added.
    pub fn effects(&self) -> Vec<KnownEffect> {
        let effects = self.findings.iter().flat_map(|found| &found.effects);
        effects.map(|effect| (effect.kind, effect.tag.clone())).collect()
    }
}

/// The state of a loop's model: a new version whenever its effects change.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelVersion {
    /// Counted from 1; 0 before the first diagnosis.
    pub version: u64,
    /// When this version began (s).
    pub since: f64,
    /// Its effects, in the order they were added.
    pub effects: Vec<KnownEffect>,
}
