//! What outlives a restart: a run in a few numbers, what changed and is to be kept, and what was kept and comes back.

use super::looked::Looked;
use super::{Before, Compensated, ModelVersion, Results, Run, Trigger, lock};
use crate::alarm::{AlarmId, Saved, Transition};
use crate::residual::Structure;
use crate::signal::LoopId;
use std::borrow::Cow;
use std::fmt;
use std::sync::{Arc, OnceLock, PoisonError};

/// A run in a few numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// When it ended (s).
    pub time: f64,
    /// How long it took on the wall clock (s).
    pub took_s: f64,
    /// Who asked.
    pub trigger: Trigger,
    /// A verdict, `deadline_exceeded` or `panicked`.
    pub outcome: Cow<'static, str>,
    /// Why nothing could be said, where nothing could.
    pub reason_code: Option<Cow<'static, str>>,
    /// The verdict in one line.
    pub reason: String,
    /// Friction [% of OP span, see `f_in_percent`].
    pub f: Option<f64>,
    /// Its 95 % interval, in the same unit.
    pub f_ci95: Option<[f64; 2]>,
    /// Whether f is in per cent of OP's span; else in OP's own units, whose span is not known.
    pub f_in_percent: bool,
    /// Evidence (-).
    pub delta_aic: Option<f64>,
    /// What it says of a valve that a term of write-back acted on.
    pub compensated: Option<Compensated>,
}

impl Summary {
    /// The friction that it tells, to be compared with while a term acts.
    pub fn before(&self) -> Option<Before> {
        self.f.zip(self.f_ci95).map(|(f, f_ci95)| Before { f, f_ci95 })
    }
}

/// Something changed: all of it belongs together, and is kept together or not at all.
#[derive(Clone, Debug)]
pub struct Change {
    /// The run that has ended, where one has.
    pub run: Option<(Arc<Run>, Summary)>,
    /// The version of a loop's model, where it is a new one.
    pub model: Option<(LoopId, ModelVersion)>,
    /// Alarms that changed.
    pub alarms: Vec<KeptAlarm>,
}

/// An alarm that changed.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptAlarm {
    /// Which.
    pub id: AlarmId,
    /// The alarm after the change.
    pub saved: Saved,
    /// What happened to its state.
    pub transitions: Vec<Transition>,
    /// Whether somebody acted, who is `by`.
    pub acted: bool,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
    /// What the condition is, in one line.
    pub detail: String,
}

/// An alarm of before the restart.
#[derive(Clone, Debug, PartialEq)]
pub struct RestoredAlarm {
    /// Which.
    pub id: AlarmId,
    /// The alarm as it was kept.
    pub saved: Saved,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
    /// What the condition is, in one line.
    pub detail: String,
}

/// Is told of every change, in order; it must not wait for anything.
pub type Keeper = Arc<dyn Fn(Change) + Send + Sync>;

/// A diagnosis of before the restart.
#[derive(Clone, Debug, PartialEq)]
pub struct Restored {
    /// When it was made (s).
    pub finished: f64,
    /// How long it took on the wall clock (s).
    pub took_s: f64,
    /// How good the data behind it was, as the report writes it.
    pub quality: String,
    /// Whether the published methods contradicted its verdict.
    pub doubtful: bool,
    /// What the next run may take as given.
    pub structure: Option<Structure>,
    /// What stands for where its samples were read; `None` where nobody said.
    pub source: Option<u64>,
    /// The whole report, as the API writes it.
    pub report: Arc<str>,
}

/// What was kept of a loop.
#[derive(Clone, Debug, Default)]
pub struct Remembered {
    /// Runs, oldest first.
    pub summaries: Vec<Summary>,
    /// The latest run that gave a diagnosis, which is one of the summaries by its time.
    pub diagnosed: Option<(Restored, Summary)>,
    /// Friction as it was found last while no term acted, of the valve of the latest diagnosis.
    pub before: Option<Before>,
    /// Time of the last sample that was fitted by the last run that said whether the valve sticks (s).
    pub fitted_until: Option<f64>,
    /// The model's version.
    pub model: ModelVersion,
}

/// Who keeps what changes, once somebody does.
#[derive(Default)]
pub(super) struct Keeping(OnceLock<Keeper>);

impl fmt::Debug for Keeping {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Keeping").field(&self.0.get().is_some()).finish()
    }
}

impl Results {
    /// Tells `keeper` of every change from now on; the first that is named stays.
    pub fn keep_with(&self, keeper: Keeper) {
        let _ = self.keeper.0.set(keeper);
    }

    pub(super) fn keep(
        &self,
        run: Option<(Arc<Run>, Summary)>,
        model: Option<(LoopId, ModelVersion)>,
        alarms: Vec<KeptAlarm>,
    ) {
        let nothing = run.is_none() && model.is_none() && alarms.is_empty();
        if let Some(keeper) = self.keeper.0.get().filter(|_| !nothing) {
            keeper(Change { run, model, alarms });
        }
    }

    /// The model of each loop that has one.
    pub fn models(&self) -> Vec<(LoopId, ModelVersion)> {
        let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
        let all: Vec<_> = entries.iter().map(|(id, entry)| (id.clone(), entry.clone())).collect();
        drop(entries);
        let models = all.into_iter().map(|(id, entry)| (id, lock(&entry).model.clone()));
        models.filter(|(_, model)| model.version > 0).collect()
    }

    /// Runs that are remembered of each loop.
    pub fn room(&self) -> usize {
        self.keep
    }

    /// Takes back what was kept of a loop, with the times of then, before what there is; of a loop that was diagnosed since
    /// only the runs. False where the latest diagnosis of what was kept is of another valve than the loop has now.
    pub fn restore(&self, id: &LoopId, kept: Remembered) -> bool {
        let Some(entry) = self.entry(id) else { return true };
        let mut entry = lock(&entry);
        if entry.summaries.is_empty() {
            entry.looked = Looked::of(&kept);
        }
        let begun = entry.summaries.front().map_or(f64::INFINITY, |first| first.time);
        let room = self.keep.saturating_sub(entry.summaries.len());
        // One of since the start is not of before, though its clock was behind then and set right later.
        let is_known =
            |own: &Summary| entry.summaries.iter().any(|known| known.time.to_bits() == own.time.to_bits());
        let is_before = |own: &Summary| own.time < begun && !is_known(own);
        let before: Vec<Summary> = kept.summaries.into_iter().rev().filter(is_before).take(room).collect();
        before.into_iter().for_each(|summary| entry.summaries.push_front(summary));
        let source = kept.diagnosed.as_ref().and_then(|(restored, _)| restored.source);
        let is_own = entry.is_of(source);
        if entry.before.is_none() && is_own {
            entry.before = kept.before;
        }
        entry.fitted_before = entry.fitted_before.or(kept.fitted_until.filter(|_| is_own));
        if entry.diagnosed.is_none() && entry.restored.is_none() {
            entry.restored = kept.diagnosed.map(|(restored, summary)| (Arc::new(restored), summary));
        }
        if entry.model.version == 0 {
            entry.model = kept.model;
        }
        is_own
    }

    /// Takes the latest model of before a start that did not know it: versions go on from there, and what was found since is
    /// a new one.
    pub fn merge_model(&self, id: &LoopId, left: ModelVersion) {
        let Some(entry) = self.entry(id) else { return };
        let mut entry = lock(&entry);
        let own = &mut entry.model;
        if own.version == 0 || (own.version <= left.version && own.effects == left.effects) {
            *own = left;
            return;
        }
        if own.version > left.version {
            return;
        }
        own.version = left.version + 1;
        self.keep(None, Some((id.clone(), own.clone())), Vec::new());
    }
}
