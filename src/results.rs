//! What the diagnoses said: per loop the latest in full, the ones before as summaries, and the alarm that follows from
//! them. Everything is bounded; whoever wants to hear of news subscribes to a bounded channel.

mod alarm_log;
mod alarms;
pub mod basis;
mod board;
mod compensated;
mod events;
mod glance;
mod judged;
mod kept;
mod looked;
mod origin;
mod second;
mod source;
mod swings;
mod told;
pub mod words;

pub use crate::residual::Structure;
pub use alarm_log::{AlarmChange, MOST_CHANGES};
pub use alarms::{AlarmView, DeviceSeen, Said, TagsSeen};
pub use basis::{Basis, Extent, Silent};
pub use board::{NEWS_S, Order, Wanted};
pub use compensated::{Before, Compensated, Seen};
pub use events::{MOST_EVENTS, Past};
pub use glance::Glance;
pub use judged::{Judged, KnownEffect, ModelVersion, Residuals};
pub use kept::{Change, Keeper, KeptAlarm, Remembered, Restored, RestoredAlarm, Summary};
pub use origin::Origin;
pub use swings::SourceOrder;
pub use told::Told;

#[cfg(test)]
pub(crate) use judged::tests::{effect as made_effect, findings as made_findings};

use crate::alarm;
use crate::compensation::gate::{self, News};
use crate::diagnosis::Verdict;
use crate::signal::LoopId;
use alarms::Alarms;
use events::EventLog;
use looked::Looked;
use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use tokio::sync::broadcast;

/// Who asked for a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// The loop's period.
    Periodic,
    /// Somebody, by API.
    OnDemand,
}

/// How a run ended.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// With a diagnosis, whatever its verdict.
    Diagnosed(Box<Judged>),
    /// With what another machine says of it.
    Elsewhere(Box<Told>),
    /// Not before its deadline.
    DeadlineExceeded,
    /// With a panic, and what it said.
    Panicked(String),
}

impl Outcome {
    /// The stable, machine-readable name: a verdict or a failure.
    pub fn as_str(&self) -> &str {
        match self {
            Outcome::Diagnosed(judged) => judged.verdict().as_str(),
            Outcome::Elsewhere(told) => &told.summary.outcome,
            Outcome::DeadlineExceeded => "deadline_exceeded",
            Outcome::Panicked(_) => "panicked",
        }
    }
}

/// One run of the diagnosis on one loop.
#[derive(Clone, Debug)]
pub struct Run {
    /// Which loop.
    pub id: LoopId,
    /// When it began (s).
    pub started: f64,
    /// When it ended (s).
    pub finished: f64,
    /// How long it took on the wall clock (s).
    pub took_s: f64,
    /// Who asked.
    pub trigger: Trigger,
    /// The span of OP in the record it worked on (OP unit).
    pub op_span: Option<f64>,
    /// What it worked on; `None` for a run that failed.
    pub basis: Option<Arc<Basis>>,
    /// What came of it.
    pub outcome: Outcome,
}

impl Run {
    /// What was said, if anything was.
    pub fn judged(&self) -> Option<&Judged> {
        match &self.outcome {
            Outcome::Diagnosed(judged) => Some(judged),
            _ => None,
        }
    }

    /// Whether the valve sticks by this run.
    pub fn sticks(&self) -> bool {
        self.outcome.as_str() == Verdict::Stiction.as_str()
    }

    /// What turns OP units into % of OP span; 1 where that is not known, so that they stay what they are.
    fn percent(&self) -> f64 {
        self.op_span.filter(|span| *span > 0.0).map_or(1.0, |span| 100.0 / span)
    }

    /// Friction and its 95 % interval by the declared model, without effects [% of OP span].
    pub fn declared_friction(&self) -> Option<(f64, [f64; 2])> {
        let estimate = self.judged()?.diagnosis.estimate.as_ref()?;
        let percent = self.percent();
        Some((estimate.f * percent, estimate.f_ci95.map(|limit| limit * percent)))
    }

    /// What it says of a valve that a term of write-back acted on.
    pub fn compensated(&self) -> Option<Compensated> {
        match &self.outcome {
            Outcome::Elsewhere(told) => told.summary.compensated,
            _ => Compensated::of(self),
        }
    }

    /// A reason, behind what it says of a compensated valve.
    pub fn reasoned(&self, reason: &str) -> String {
        match self.compensated() {
            Some(own) => format!("{}; {reason}", own.reason(self)),
            None => reason.to_string(),
        }
    }

    /// The run in a few numbers.
    pub fn summary(&self) -> Summary {
        if let Outcome::Elsewhere(told) = &self.outcome {
            return told.summary.clone();
        }
        let judged = self.judged();
        let friction = judged.and_then(Judged::friction);
        let percent = self.percent();
        Summary {
            time: self.finished,
            took_s: self.took_s,
            trigger: self.trigger,
            outcome: self.outcome.as_str().to_string().into(),
            reason_code: match judged.map(Judged::verdict) {
                Some(Verdict::NotIdentifiable(why)) => Some(why.code().into()),
                _ => None,
            },
            compensated: self.compensated(),
            reason: match &self.outcome {
                Outcome::Diagnosed(judged) => self
                    .reasoned(judged.replaced_by().map_or(&judged.diagnosis.reason, |found| &found.reason)),
                Outcome::Elsewhere(told) => told.summary.reason.clone(),
                Outcome::DeadlineExceeded => "the run was not done before its deadline".to_string(),
                Outcome::Panicked(_) => "the diagnosis failed; the log says why".to_string(),
            },
            f_in_percent: judged.is_none() || op_in_percent(self.op_span),
            f: friction.map(|(f, ..)| f * percent),
            f_ci95: friction.map(|(_, interval, _)| interval.map(|limit| limit * percent)),
            delta_aic: friction.map(|(.., evidence)| evidence),
        }
    }
}

/// Whether friction along OP can be told in per cent of its span: where that is known. OP's values tell it before a diagnosis
/// ([`crate::signal::Record::find_span`]), and where they do not, as in kPa, f is in OP's own unit.
pub fn op_in_percent(op_span: Option<f64>) -> bool {
    op_span.is_some_and(|span| span.is_finite() && span > 0.0)
}

/// The unit along OP as everything that is shown writes it.
pub fn f_unit(in_percent: bool) -> &'static str {
    if in_percent { "% OP" } else { "OP units" }
}

/// What is known of one loop.
#[derive(Clone, Debug)]
pub struct Known {
    /// The latest run that gave a diagnosis, since the start.
    pub diagnosed: Option<Arc<Run>>,
    /// The latest diagnosis of before the start, while there is none since.
    pub restored: Option<Arc<Restored>>,
    /// The latest run of any kind.
    pub last: Option<Summary>,
    /// The summary of `diagnosed`, or of `restored`.
    pub summary: Option<Summary>,
    /// Which effects the model has, since when.
    pub model: ModelVersion,
    /// The alarm on its stiction.
    pub alarm: AlarmView,
    /// Its other alarms that are not normal.
    pub others: Vec<AlarmView>,
    /// The loop that it is expected to calm down with.
    pub swings_with: Option<LoopId>,
    /// When the latest diagnosis ended whose source was not silent (s); where there was none, the first on a silent one.
    pub looked_at: Option<f64>,
}

/// News.
#[derive(Clone, Debug)]
pub enum Event {
    /// A run has ended.
    Run(LoopId, Summary),
    /// An alarm has changed its state.
    Alarm(Arc<AlarmChange>),
    /// Something happened to a loop's write-back.
    Writeback(LoopId, News),
    /// The job over a loop's past has come further.
    Backfill {
        /// Which loop.
        id: LoopId,
        /// What it does.
        phase: &'static str,
        /// Slices read or windows diagnosed.
        done: usize,
        /// Of how many.
        of: usize,
    },
    /// Another configuration is in force.
    Reloaded {
        /// Loops now watched.
        loops: usize,
    },
}

#[derive(Debug)]
struct Entry {
    diagnosed: Option<(Arc<Run>, Summary)>,
    restored: Option<(Arc<Restored>, Summary)>,
    summaries: VecDeque<Summary>,
    model: ModelVersion,
    /// Friction as it was found last while no term acted.
    before: Option<Before>,
    /// Time of the last sample that was fitted by the last run of before the start that said whether the valve sticks (s).
    fitted_before: Option<f64>,
    /// What stands for where it is read; `None` where nobody said.
    source: Option<u64>,
    looked: Looked,
}

impl Entry {
    /// What is said of the loop: by the latest diagnosis, or by the one of before the start.
    fn summary(&self) -> Option<&Summary> {
        let restored = self.restored.as_ref().map(|(_, summary)| summary);
        self.diagnosed.as_ref().map(|(_, summary)| summary).or(restored)
    }
}

/// The results of all loops.
#[derive(Debug)]
pub struct Results {
    entries: RwLock<HashMap<LoopId, Arc<Mutex<Entry>>>>,
    keep: usize,
    /// Loops with a term in force.
    reinforced: RwLock<HashSet<LoopId>>,
    /// Of each loop that is expected to calm down with another, the order on that other.
    sources: RwLock<HashMap<LoopId, SourceOrder>>,
    alarms: Alarms,
    events: broadcast::Sender<Event>,
    log: EventLog,
    keeper: kept::Keeping,
}

impl Results {
    /// Room for these loops, `keep` summaries each.
    pub fn new(loops: &[LoopId], keep: usize, alarm_config: &alarm::Config) -> Self {
        let results = Self {
            entries: RwLock::default(),
            keep: keep.max(1),
            reinforced: RwLock::default(),
            sources: RwLock::default(),
            alarms: Alarms::default(),
            events: broadcast::channel(MOST_EVENTS).0,
            log: EventLog::default(),
            keeper: kept::Keeping::default(),
        };
        // There is nothing to forget yet, whenever that is.
        results.reload(loops, alarm_config, 0.0);
        results
    }

    /// Takes another set of loops at `now`: known ones keep their results and alarms, the others are forgotten, and everybody
    /// hears that alarms of theirs are over. That there are other loops is told by [`Results::tell_reload`], once they are shown.
    pub fn reload(&self, loops: &[LoopId], alarm_config: &alarm::Config, now: f64) {
        let mut entries = self.entries.write().unwrap_or_else(PoisonError::into_inner);
        self.place_alarms(loops, alarm_config, now);
        let mut old = std::mem::take(&mut *entries);
        for id in loops {
            let entry = old.remove(id).unwrap_or_else(|| {
                Arc::new(Mutex::new(Entry {
                    diagnosed: None,
                    restored: None,
                    summaries: VecDeque::new(),
                    model: ModelVersion::default(),
                    before: None,
                    fitted_before: None,
                    source: None,
                    looked: Looked::default(),
                }))
            });
            entries.insert(id.clone(), entry);
        }
    }

    /// Tells everybody that another configuration is in force.
    pub fn tell_reload(&self) {
        let loops = self.entries.read().unwrap_or_else(PoisonError::into_inner).len();
        self.tell(Event::Reloaded { loops });
    }

    /// Hears of every event from now on. A subscriber that lags behind by more than the backlog is told how many it lost.
    pub fn subscribe(&self) -> broadcast::Receiver<Event> {
        self.events.subscribe()
    }

    /// Tells everybody what happened to a loop's write-back. While a term is in force it hides the friction: only a
    /// diagnosis that finds it all the same has a vote on the alarm.
    pub fn tell_writeback(&self, id: &LoopId, news: &News) {
        if let gate::Event::Moved { to, .. } = news.event {
            let mut reinforced = self.reinforced.write().unwrap_or_else(PoisonError::into_inner);
            if to.writes() {
                reinforced.insert(id.clone())
            } else {
                reinforced.remove(id)
            };
        }
        if let gate::Event::Moved { to, cause, .. } = &news.event {
            match (to, cause) {
                // Told as soon as a fault closes the gate: a reload or a stop may come before it has tripped.
                (gate::State::Withdrawing, gate::Cause::Denied(why))
                    if *why != gate::Denial::GrantExpired =>
                {
                    self.watch_trip(id, Some(words::tripped(Some(*why), *cause)), news.at);
                }
                (gate::State::Withdrawing, _) => {}
                (gate::State::Tripped, _) => {
                    self.watch_trip(id, Some(words::tripped(news.tripped_by, *cause)), news.at);
                }
                _ => self.watch_trip(id, None, news.at),
            }
        }
        self.tell(Event::Writeback(id.clone(), news.clone()));
    }

    /// Terms may be in force of these loops only: of another whose write-back failed nobody says that its term has ended.
    pub fn keep_reinforced(&self, is_written: impl Fn(&LoopId) -> bool) {
        let mut reinforced = self.reinforced.write().unwrap_or_else(PoisonError::into_inner);
        reinforced.retain(is_written);
    }

    /// Takes the end of a run, lets the alarm see it and tells everybody. A run of a loop that is no longer there is
    /// handed back and otherwise ignored.
    pub fn record(&self, run: Run) -> Arc<Run> {
        self.enter(run, true)
    }

    /// The same of a run on samples that were counted before: it is no vote for or against an alarm.
    pub fn record_again(&self, run: Run) -> Arc<Run> {
        self.enter(run, false)
    }

    fn enter(&self, run: Run, counts: bool) -> Arc<Run> {
        let run = Arc::new(run);
        let Some(entry) = self.entry(&run.id) else {
            return run;
        };
        let summary = run.summary();
        let mut entry = lock(&entry);
        // A run that ends after a reload may be on another valve's samples.
        let is_own = entry.is_of(run.source());
        if entry.summaries.len() == self.keep {
            entry.summaries.pop_front();
        }
        entry.summaries.push_back(summary.clone());
        entry.look(&run, &summary);
        let mut new_model = None;
        if let Some(effects) = run.effects() {
            // A run that looked at nothing says nothing of the effects.
            let is_news = entry.model.version == 0 || entry.model.effects != effects;
            if is_news && !summary.is_silent() {
                let version = entry.model.version + 1;
                entry.model = ModelVersion { version, since: run.finished, effects };
                new_model = Some((run.id.clone(), entry.model.clone()));
            }
            if run.sticks() && summary.compensated.is_none() && is_own {
                entry.before = summary.before();
            }
            match &run.outcome {
                Outcome::Elsewhere(told) => entry.take(told, run.source()),
                _ => (entry.diagnosed, entry.restored) = (Some((run.clone(), summary.clone())), None),
            }
        }
        // Before the loop is let go, so that its runs reach its alarms, the store and who listens in order.
        self.judge(&run, summary, new_model, counts && is_own);
        drop(entry);
        run
    }

    fn is_reinforced(&self, id: &LoopId) -> bool {
        self.reinforced.read().unwrap_or_else(PoisonError::into_inner).contains(id)
    }

    /// What is known of a loop at `now`.
    pub fn get(&self, id: &LoopId, now: f64) -> Option<Known> {
        let entry = self.entry(id)?;
        let mut alarms = self.alarms_of(id, now).into_iter();
        let (alarm, others) = (alarms.next()?, alarms.collect());
        let entry = lock(&entry);
        Some(Known {
            diagnosed: entry.diagnosed.as_ref().map(|(run, _)| run.clone()),
            restored: entry.restored.as_ref().map(|(restored, _)| restored.clone()),
            last: entry.summaries.back().cloned(),
            summary: entry.summary().cloned(),
            model: entry.model.clone(),
            alarm,
            others,
            swings_with: self.swings_with(id),
            looked_at: entry.looked.at,
        })
    }

    /// The effects in a loop's model.
    pub fn effects(&self, id: &LoopId) -> Vec<KnownEffect> {
        self.entry(id).map_or_else(Vec::new, |entry| lock(&entry).model.effects.clone())
    }

    /// What the last run found and the next may take as given, whatever was said of a silent source since; nothing after a run that
    /// failed, or where that run was on another valve's samples.
    pub fn structure(&self, id: &LoopId) -> Option<Structure> {
        let entry = self.entry(id)?;
        let entry = lock(&entry);
        entry.looked.structure.clone().filter(|_| entry.is_of(entry.looked.source))
    }

    /// Friction as it was found last while no term acted.
    pub fn before(&self, id: &LoopId) -> Option<Before> {
        self.entry(id).and_then(|entry| lock(&entry).before)
    }

    /// Takes it as it was known then.
    pub fn set_before(&self, id: &LoopId, before: Option<Before>) {
        if let Some(entry) = self.entry(id) {
            lock(&entry).before = before;
        }
    }

    /// Summaries of a loop's runs, oldest first.
    pub fn summaries(&self, id: &LoopId) -> Option<Vec<Summary>> {
        let entry = self.entry(id)?;
        let summaries = lock(&entry).summaries.iter().cloned().collect();
        Some(summaries)
    }

    /// How many loops have been run at least once, and how many there are.
    pub fn coverage(&self) -> (usize, usize) {
        let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
        let run = entries.values().filter(|entry| !lock(entry).summaries.is_empty()).count();
        (run, entries.len())
    }

    fn entry(&self, id: &LoopId) -> Option<Arc<Mutex<Entry>>> {
        self.entries.read().unwrap_or_else(PoisonError::into_inner).get(id).cloned()
    }

    /// Tells everybody how far the job over a loop's past has come.
    pub fn tell_backfill(&self, event: Event) {
        self.tell(event);
    }

    fn tell(&self, event: Event) {
        self.log.note(event.clone());
        // An error here only means that nobody listens.
        let _ = self.events.send(event);
    }
}

/// A panic elsewhere leaves an entry whole: every change to it is one assignment.
fn lock(entry: &Mutex<Entry>) -> MutexGuard<'_, Entry> {
    entry.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
