//! What the latest run that looked at samples leaves to the next. A run on a silent source looks at none, and changes nothing of it.

use super::{Entry, Outcome, Remembered, Run, Summary};
use crate::residual::Structure;

/// What is left of that run.
#[derive(Debug, Default)]
pub(super) struct Looked {
    /// When the latest one that gave a diagnosis ended (s); the first on a silent source where there was none before.
    pub(super) at: Option<f64>,
    /// What it found; `None` after one that failed, so that everything is searched for.
    pub(super) structure: Option<Structure>,
    /// What stands for where its samples were read; `None` where nobody said.
    pub(super) source: Option<u64>,
}

impl Looked {
    /// As it was kept.
    pub(super) fn of(kept: &Remembered) -> Self {
        let looked: Vec<&Summary> = kept.summaries.iter().filter(|own| !own.is_silent()).collect();
        let told = kept.diagnosed.as_ref().filter(|(_, summary)| !summary.is_silent());
        let at = told.map(|(_, summary)| summary).or(looked.last().copied()).or(kept.summaries.first());
        let is_last =
            |own: &Summary| looked.last().is_some_and(|last| last.time.to_bits() == own.time.to_bits());
        let restored = told.filter(|(_, summary)| is_last(summary)).map(|(restored, _)| restored);
        Self {
            at: at.map(|summary| summary.time),
            structure: restored.and_then(|restored| restored.structure.clone()),
            source: restored.and_then(|restored| restored.source),
        }
    }
}

impl Summary {
    /// Whether nobody looked at samples, because their source was silent.
    pub fn is_silent(&self) -> bool {
        self.reason_code.as_deref() == Some("silent")
    }
}

impl Run {
    /// What the next run may take as given.
    fn structure(&self) -> Option<&Structure> {
        match &self.outcome {
            Outcome::Diagnosed(judged) => judged.structure(),
            Outcome::Elsewhere(told) => told.structure.as_ref().filter(|_| told.report.is_some()),
            Outcome::DeadlineExceeded | Outcome::Panicked(_) => None,
        }
    }
}

impl Entry {
    /// Takes what a run that has ended leaves.
    pub(super) fn look(&mut self, run: &Run, summary: &Summary) {
        if summary.is_silent() {
            self.looked.at.get_or_insert(summary.time);
            return;
        }
        let at = if run.effects().is_some() { Some(summary.time) } else { self.looked.at };
        self.looked = Looked { at, structure: run.structure().cloned(), source: run.source() };
    }
}
