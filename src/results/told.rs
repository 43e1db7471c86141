//! What somebody else's diagnosis says: everything that people and alarms need, without what it looked at.

use super::board::{News, ShortRun};
use super::{Entry, Outcome, Run, Summary, lock};
use super::{KnownEffect, ModelVersion, Restored, Results};
use crate::residual::Structure;
use crate::signal::LoopId;
use std::sync::Arc;

/// What somebody else's diagnosis says.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    /// In a few numbers.
    pub summary: Summary,
    /// The whole report, as the API writes it; `None` for a run that failed.
    pub report: Option<Arc<str>>,
    /// How good the data behind it was, as the report writes it.
    pub quality: String,
    /// Whether the published methods contradicted its verdict.
    pub doubtful: bool,
    /// Time of the last sample that was fitted (s); `None` where none was, or nobody said.
    pub fitted_until: Option<f64>,
    /// The effects in the model, in the order they were added.
    pub effects: Vec<KnownEffect>,
    /// What the next run may take as given.
    pub structure: Option<Structure>,
    /// The share of PV's standard deviation that the model does not explain; `None` where that was not looked at.
    pub unexplained: Option<f64>,
    /// Version of the program that says it.
    pub version: String,
}

impl Told {
    /// As a diagnosis of before the start is kept, on samples that were read there; `None` for a run that failed.
    fn restored(&self, source: Option<u64>) -> Option<Restored> {
        Some(Restored {
            finished: self.summary.time,
            took_s: self.summary.took_s,
            quality: self.quality.clone(),
            doubtful: self.doubtful,
            structure: self.structure.clone(),
            source,
            report: self.report.clone()?,
        })
    }
}

impl Entry {
    /// Remembers a run as the latest, or before the run at `later`, and no more than `most` of them. All that a machine ever made
    /// may come once more: what is older than everything that is known must not take the place of what came after it.
    fn put(&mut self, later: Option<usize>, summary: Summary, most: usize) {
        let mut at = later.unwrap_or(self.summaries.len());
        if self.summaries.len() >= most {
            if at == 0 {
                return;
            }
            self.summaries.pop_front();
            at -= 1;
        }
        self.summaries.insert(at, summary);
    }

    /// Takes a run that was made elsewhere as the latest, on samples of this source.
    pub(super) fn take(&mut self, told: &Told, source: Option<u64>) {
        if let Some(restored) = told.restored(source) {
            self.diagnosed = None;
            self.restored = Some((Arc::new(restored), told.summary.clone()));
        }
    }
}

impl Results {
    /// Time of the last sample that was fitted by the last run of before the start that said whether the valve sticks (s).
    pub fn fitted_before(&self, id: &LoopId) -> Option<f64> {
        self.entry(id).and_then(|entry| lock(&entry).fitted_before)
    }

    /// Takes a run that another machine has recorded, with the model after it, where that is new: alarms follow from what
    /// that machine says of them, not from this. False for one that is known already, or whose loop is not there. What is of
    /// later than `now` was stamped by a clock that was set back since, and is no later than this.
    pub fn learn(&self, run: Run, model: Option<ModelVersion>, now: f64) -> bool {
        let run = Arc::new(run);
        let Some(entry) = self.entry(&run.id) else { return false };
        let summary = run.summary();
        let mut entry = lock(&entry);
        if entry.summaries.iter().any(|known| known.time.to_bits() == summary.time.to_bits()) {
            return false;
        }
        let is_later = |known: &Summary| known.time > summary.time && known.time <= now;
        let later = entry.summaries.iter().position(is_later);
        entry.put(later, summary.clone(), self.keep);
        if later.is_none() {
            entry.look(&run, &summary);
            if let Outcome::Elsewhere(told) = &run.outcome {
                entry.take(told, run.source());
            }
        }
        let new = model.filter(|new| new.version > entry.model.version);
        if let Some(new) = &new {
            entry.model = new.clone();
        }
        let new = new.map(|new| (run.id.clone(), new));
        self.keep(Some((run.clone(), summary.clone())), new, News::default().kept);
        self.tell(super::Event::Run(run.id.clone(), summary));
        true
    }
}

impl Run {
    /// As the alarms see it; `counts`: whether it is a vote.
    pub(super) fn short(&self, counts: bool) -> ShortRun<'_> {
        let outcome = self.outcome.as_str();
        ShortRun {
            id: &self.id,
            finished: self.finished,
            sticky: outcome == "stiction",
            identifiable: matches!(outcome, "stiction" | "no_stiction"),
            unexplained: self.unexplained(),
            counts,
        }
    }

    /// The share of PV's standard deviation that the model, run freely over held-out samples, does not explain (0..1); 0
    /// where the residual is white; `None` where that was not looked at.
    pub fn unexplained(&self) -> Option<f64> {
        if let Outcome::Elsewhere(told) = &self.outcome {
            return told.unexplained;
        }
        let judged = self.judged()?;
        let (found, window) = (judged.findings.as_ref()?, judged.diagnosis.shown_window()?);
        let n = window.pv.len().max(1) as f64;
        let mean = window.pv.iter().sum::<f64>() / n;
        let spread = (window.pv.iter().map(|pv| (pv - mean).powi(2)).sum::<f64>() / n).sqrt();
        let share = found.after.free_run_rmse / spread;
        (spread > 0.0 && share.is_finite()).then_some(if found.unexplained { share } else { 0.0 })
    }

    /// Time of the last sample that it fitted (s); `None` where it fitted none.
    pub fn fitted_until(&self) -> Option<f64> {
        match &self.outcome {
            Outcome::Diagnosed(judged) => {
                let own = &judged.diagnosis.preparation;
                (own.n > 0).then_some(own.end)
            }
            Outcome::Elsewhere(told) => told.fitted_until,
            Outcome::DeadlineExceeded | Outcome::Panicked(_) => None,
        }
    }

    /// The effects in the model after it; `None` for a run that failed.
    pub fn effects(&self) -> Option<Vec<KnownEffect>> {
        match &self.outcome {
            Outcome::Diagnosed(judged) => Some(judged.effects()),
            Outcome::Elsewhere(told) => told.report.as_ref().map(|_| told.effects.clone()),
            Outcome::DeadlineExceeded | Outcome::Panicked(_) => None,
        }
    }
}
