//! What one run says of a loop: the diagnosis, and the effects that its residual was traced to.

use super::second::{Second, second_opinions};
use crate::detectors::{Agreement, Opinion};
use crate::diagnosis::packed::Packed;
use crate::diagnosis::{Diagnosis, Verdict};
use crate::residual::{self, Findings, Structure};
use std::sync::Arc;

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
    /// What the published methods say of the same window; empty where there is none.
    pub opinions: Vec<Opinion>,
    /// How they agree with each other and with the verdict; `None` without a window.
    pub agreement: Option<Agreement>,
}

/// One-step residuals before and after the effects, packed: they are kept for every loop, only to be drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals {
    /// Time of the first sample (s).
    pub t0: f64,
    /// Sample period (s).
    pub ts: f64,
    /// First held-out sample: nothing was fitted to it, but it may have rejected effects.
    pub split: usize,
    /// Of the declared model (PV unit).
    pub before: Arc<Packed>,
    /// With the effects (PV unit); where there is none, the same.
    pub after: Arc<Packed>,
}

impl From<&residual::Curves> for Residuals {
    fn from(curves: &residual::Curves) -> Self {
        let before = Arc::new(Packed::new(&curves.residual_before));
        let after = Packed::second(&before, &curves.residual_after);
        Self { t0: curves.t0, ts: curves.ts, split: curves.split, before, after }
    }
}

impl From<Diagnosis> for Judged {
    fn from(diagnosis: Diagnosis) -> Self {
        Self { diagnosis, findings: None, residuals: None, opinions: Vec::new(), agreement: None }
    }
}

impl Judged {
    /// The findings that replace the diagnosis, see [`Findings::replaces_diagnosis`].
    pub fn replaced_by(&self) -> Option<&Findings> {
        self.findings.as_ref().filter(|found| found.replaces_diagnosis())
    }

    /// The verdict that counts.
    pub fn verdict(&self) -> &Verdict {
        self.replaced_by().map_or(&self.diagnosis.verdict, |found| &found.verdict)
    }

    /// The same with what the published methods say of its window; `integrates` as [`crate::signal::Record::integrates`].
    #[must_use]
    pub fn with_opinions(mut self, integrates: Option<bool>) -> Self {
        let sticks = match self.verdict() {
            Verdict::Stiction => Some(true),
            Verdict::NoStiction => Some(false),
            Verdict::NotIdentifiable(_) => None,
        };
        let window = self.diagnosis.shown_window().filter(|window| !window.is_empty());
        let found = &self.diagnosis.verdict;
        let second = window.map(|window| second_opinions(&window, integrates, found, sticks));
        if let Some(Second { opinions, agreement }) = second {
            (self.opinions, self.agreement) = (opinions, Some(agreement));
        }
        self
    }

    /// The same, without what only a look at one record needs: what is kept of every loop.
    #[must_use]
    pub fn packed(mut self) -> Self {
        let drawn = self.findings.as_ref().filter(|found| !found.curves.residual_before.is_empty());
        self.residuals = drawn.map(|found| Residuals::from(&found.curves)).or(self.residuals);
        self.findings.iter_mut().for_each(Findings::drop_curves);
        self.diagnosis.pack();
        self
    }

    /// Whether the methods contradict the verdict so that somebody should look at the loop.
    pub fn is_doubtful(&self) -> bool {
        self.agreement.as_ref().is_some_and(|agreement| agreement.doubtful)
    }

    /// Friction that counts: f, its interval (OP unit) and the evidence (-).
    pub fn friction(&self) -> Option<(f64, [f64; 2], f64)> {
        if matches!(self.verdict(), Verdict::NotIdentifiable(_)) {
            return None;
        }
        let with_effects = self.replaced_by().map(|found| found.friction_after);
        let friction = with_effects.map(|f| (f.f, f.f_ci95, f.delta_aic));
        friction.or_else(|| self.diagnosis.estimate.as_ref().map(|e| (e.f, e.f_ci95, e.delta_aic)))
    }

    /// What the next run may take as given.
    pub fn structure(&self) -> Option<&Structure> {
        self.findings.as_ref()?.structure.as_ref()
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::diagnosis::{Model, NotIdentifiable, Residual};
    use crate::residual::{Curves, Effect, Friction, Kind, Parameter, Traced};

    /// Findings with f 2.208 OP, as if they were traced.
    pub fn findings(verdict: Verdict, effects: Vec<Effect>) -> Findings {
        let residual = Residual { white: false, one_step_rmse: 0.031, free_run_rmse: 0.4 };
        let f = if verdict == Verdict::Stiction { 2.208 } else { 0.0 };
        Findings {
            traced: Traced { start: 1000.0, end: 2999.0, n: 2000 },
            effects,
            rejected: Vec::new(),
            candidates: vec![(Some(Kind::GainChange), 0.48), (Some(Kind::LoadStep), 0.41), (None, 0.11)],
            after: Residual { white: true, one_step_rmse: 0.012, free_run_rmse: 0.44 },
            before: residual,
            simulates_worse: true,
            f_detectable: Some(0.4),
            f_max: 6.0,
            unexplained: false,
            failed: Vec::new(),
            friction_before: Friction { f: 2.5, ..Friction::default() },
            friction_after: Friction { f, f_ci95: [f, 2.3], lag: 0.0, delta_aic: 707.0, posterior: 0.9995 },
            verdict,
            reason: "f = 2.208 [2.100, 2.300], evidence 707".into(),
            model: Model { na: 1, nb: 1, nc: 1, nk: 1, a: vec![0.5], b: vec![0.5], c: vec![0.0], rmse: 1.0 },
            curves: Curves::default(),
            stem: None,
            structure: None,
        }
    }

    /// An effect with a posterior.
    pub fn effect(kind: Kind, posterior: f64) -> Effect {
        Effect {
            kind,
            posterior,
            evidence: None,
            delta_aic: 31.0,
            tag: None,
            parameters: vec![Parameter { name: "ratio", value: 1.5, unit: "-" }],
            place: (kind == Kind::StaticNonlinearity).then_some("process"),
            explanation: "made for a test".into(),
        }
    }

    #[test]
    fn what_was_traced_replaces_the_declared_model_wherever_it_can_tell_friction() {
        let told = |declared: Verdict, traced: Option<Findings>| {
            let mut judged = Judged::from(Diagnosis::bare(declared, "made for a test"));
            judged.findings = traced;
            (judged.verdict().as_str(), judged.friction().map(|(f, _, evidence)| (f, evidence)))
        };
        let unknown = || Verdict::NotIdentifiable(NotIdentifiable::FlatPv);
        let traced = |verdict| Some(findings(verdict, Vec::new()));
        // Without any effect too, and in both directions.
        assert_eq!(told(Verdict::NoStiction, traced(Verdict::Stiction)), ("stiction", Some((2.208, 707.0))));
        assert_eq!(told(Verdict::Stiction, traced(Verdict::NoStiction)), ("no_stiction", Some((0.0, 707.0))));
        assert_eq!(told(unknown(), traced(Verdict::Stiction)), ("stiction", Some((2.208, 707.0))));
        assert_eq!(told(Verdict::NoStiction, traced(unknown())), ("no_stiction", None));
        assert_eq!(told(Verdict::NoStiction, None), ("no_stiction", None));
    }
}
