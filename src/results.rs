//! What the diagnoses said: per loop the latest in full, the ones before as summaries, and the alarm that follows from
//! them. Everything is bounded; whoever wants to hear of news subscribes to a bounded channel.

mod alarm_log;
pub mod basis;
mod judged;
mod kept;
mod origin;

pub use alarm_log::AlarmChange;
pub use basis::{Basis, Extent};
pub use judged::{Judged, KnownEffect, ModelVersion, Residuals};
pub use kept::{Change, Keeper, Remembered, Restored, Summary};
pub use origin::Origin;

use crate::alarm::{self, Alarm, Observation, Refusal, State, Transition};
use crate::compensation::gate::{self, News};
use crate::diagnosis::{Diagnosis, Verdict};
use crate::signal::LoopId;
use alarm_log::AlarmLog;
use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use tokio::sync::broadcast;

/// Events kept for a subscriber that is slow to take them.
const EVENT_BACKLOG: usize = 1024;

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
    /// Not before its deadline.
    DeadlineExceeded,
    /// With a panic, and what it said.
    Panicked(String),
}

impl Outcome {
    /// The stable, machine-readable name: a verdict or a failure.
    pub fn as_str(&self) -> &'static str {
        match self {
            Outcome::Diagnosed(judged) => judged.verdict().as_str(),
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
        self.judged().is_some_and(|judged| *judged.verdict() == Verdict::Stiction)
    }

    /// What turns OP units into % of OP span; a span that is not known is taken for 100.
    fn percent(&self) -> f64 {
        self.op_span.filter(|span| *span > 0.0).map_or(1.0, |span| 100.0 / span)
    }

    /// Friction and its 95 % interval by the declared model, without effects [% of OP span].
    pub fn declared_friction(&self) -> Option<(f64, [f64; 2])> {
        let estimate = self.judged()?.diagnosis.estimate.as_ref()?;
        let percent = self.percent();
        Some((estimate.f * percent, estimate.f_ci95.map(|limit| limit * percent)))
    }

    fn summary(&self) -> Summary {
        let judged = self.judged();
        let friction = judged.and_then(Judged::friction);
        let percent = self.percent();
        Summary {
            time: self.finished,
            took_s: self.took_s,
            trigger: self.trigger,
            outcome: self.outcome.as_str().into(),
            reason_code: match judged.map(Judged::verdict) {
                Some(Verdict::NotIdentifiable(why)) => Some(why.code().into()),
                _ => None,
            },
            reason: match &self.outcome {
                Outcome::Diagnosed(judged) => judged
                    .replaced_by()
                    .map_or_else(|| judged.diagnosis.reason.clone(), |found| found.reason.clone()),
                Outcome::DeadlineExceeded => "the run was not done before its deadline".to_string(),
                Outcome::Panicked(_) => "the diagnosis failed; the log says why".to_string(),
            },
            f_in_percent: judged.is_none_or(|j| op_in_percent(self.op_span, &j.diagnosis)),
            f: friction.map(|(f, ..)| f * percent),
            f_ci95: friction.map(|(_, interval, _)| interval.map(|limit| limit * percent)),
            delta_aic: friction.map(|(.., evidence)| evidence),
        }
    }
}

/// Whether friction along OP can be told in per cent of its span: the span is configured, or OP's values could be per
/// cent, all within 0..100 and not all within 0..1 (which would be a share of the span).
pub fn op_in_percent(op_span: Option<f64>, diagnosis: &Diagnosis) -> bool {
    if op_span.is_some_and(|span| span.is_finite() && span > 0.0) {
        return true;
    }
    let op = diagnosis.window.as_ref().map_or(&[][..], |window| &window.op);
    let least = op.iter().copied().fold(f64::INFINITY, f64::min);
    let most = op.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    least >= 0.0 && most <= 100.0 && most > 1.0
}

/// The unit along OP as everything that is shown writes it.
pub fn f_unit(in_percent: bool) -> &'static str {
    if in_percent { "% OP" } else { "OP units" }
}

/// A loop's alarm at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct AlarmView {
    /// Which loop.
    pub id: LoopId,
    /// What the operator sees.
    pub state: State,
    /// Whether the condition holds, shelved or not.
    pub active: bool,
    /// When the state last changed (s).
    pub since: Option<f64>,
    /// When the condition was last raised (s).
    pub raised_at: Option<f64>,
    /// Until when it is shelved (s).
    pub shelved_until: Option<f64>,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
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
    /// The alarm.
    pub alarm: AlarmView,
}

/// News.
#[derive(Clone, Debug)]
pub enum Event {
    /// A run has ended.
    Run(LoopId, Summary),
    /// An alarm has changed its state.
    Alarm(LoopId, Transition),
    /// Something happened to a loop's write-back.
    Writeback(LoopId, News),
    /// Another configuration is in force.
    Reloaded {
        /// Loops now watched.
        loops: usize,
    },
}

/// An operator's action on an alarm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Seen.
    Acknowledge,
    /// Silence for this long (s).
    Shelve(f64),
    /// End the silence.
    Unshelve,
}

#[derive(Debug)]
struct Entry {
    diagnosed: Option<(Arc<Run>, Summary)>,
    restored: Option<(Arc<Restored>, Summary)>,
    summaries: VecDeque<Summary>,
    model: ModelVersion,
    alarm: Alarm,
    by: Option<String>,
    comment: Option<String>,
}

/// The results of all loops.
#[derive(Debug)]
pub struct Results {
    entries: RwLock<HashMap<LoopId, Arc<Mutex<Entry>>>>,
    alarm_config: RwLock<alarm::Config>,
    keep: usize,
    /// Loops with a term in force.
    reinforced: RwLock<HashSet<LoopId>>,
    alarm_log: AlarmLog,
    events: broadcast::Sender<Event>,
    keeper: kept::Keeping,
}

impl Results {
    /// Room for these loops, `keep` summaries each.
    pub fn new(loops: &[LoopId], keep: usize, alarm_config: &alarm::Config) -> Self {
        let results = Self {
            entries: RwLock::default(),
            alarm_config: RwLock::new(alarm_config.clone()),
            keep: keep.max(1),
            reinforced: RwLock::default(),
            alarm_log: AlarmLog::default(),
            events: broadcast::channel(EVENT_BACKLOG).0,
            keeper: kept::Keeping::default(),
        };
        results.place(loops, alarm_config);
        results
    }

    /// Takes another set of loops: known ones keep their results and alarms, the others are forgotten.
    pub fn reload(&self, loops: &[LoopId], alarm_config: &alarm::Config) {
        self.place(loops, alarm_config);
        self.tell(Event::Reloaded { loops: loops.len() });
    }

    fn place(&self, loops: &[LoopId], alarm_config: &alarm::Config) {
        let mut entries = self.entries.write().unwrap_or_else(PoisonError::into_inner);
        *self.alarm_config.write().unwrap_or_else(PoisonError::into_inner) = alarm_config.clone();
        let mut old = std::mem::take(&mut *entries);
        for id in loops {
            let entry = old.remove(id).unwrap_or_else(|| {
                Arc::new(Mutex::new(Entry {
                    diagnosed: None,
                    restored: None,
                    summaries: VecDeque::new(),
                    model: ModelVersion::default(),
                    alarm: Alarm::new(alarm_config.clone()),
                    by: None,
                    comment: None,
                }))
            });
            lock(&entry).alarm.reconfigure(alarm_config.clone());
            entries.insert(id.clone(), entry);
        }
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
        self.tell(Event::Writeback(id.clone(), news.clone()));
    }

    /// Takes the end of a run, lets the alarm see it and tells everybody. A run of a loop that is no longer there is
    /// handed back and otherwise ignored.
    pub fn record(&self, run: Run) -> Arc<Run> {
        let run = Arc::new(run);
        let Some(entry) = self.entry(&run.id) else {
            return run;
        };
        let summary = run.summary();
        let observation = self.observation(&run, &summary);
        let transitions = {
            let mut entry = lock(&entry);
            if entry.summaries.len() == self.keep {
                entry.summaries.pop_front();
            }
            entry.summaries.push_back(summary.clone());
            let mut new_model = None;
            if let Some(judged) = run.judged() {
                let effects = judged.effects();
                if entry.model.version == 0 || entry.model.effects != effects {
                    let version = entry.model.version + 1;
                    entry.model = ModelVersion { version, since: run.finished, effects };
                    new_model = Some(entry.model.clone());
                }
                entry.diagnosed = Some((run.clone(), summary.clone()));
                entry.restored = None;
            }
            let transitions = entry.alarm.observe(observation, run.finished);
            self.keep(&run.id, &entry, |change| Change {
                run: Some((run.clone(), summary.clone())),
                model: new_model,
                transitions: transitions.clone(),
                ..change
            });
            transitions
        };
        self.tell(Event::Run(run.id.clone(), summary));
        self.tell_all(&run.id, transitions, (None, None));
        run
    }

    fn observation(&self, run: &Run, summary: &Summary) -> Observation {
        let verdict = run.judged().map(Judged::verdict);
        let (Some(f), Some(evidence)) = (summary.f, summary.delta_aic) else {
            return Observation::Unknown;
        };
        match verdict {
            None | Some(Verdict::NotIdentifiable(_)) => Observation::Unknown,
            Some(Verdict::NoStiction) if self.is_reinforced(&run.id) => Observation::Unknown,
            Some(verdict) => {
                let config = self.alarm_config.read().unwrap_or_else(PoisonError::into_inner);
                config.judge(*verdict == Verdict::Stiction, f, evidence)
            }
        }
    }

    fn is_reinforced(&self, id: &LoopId) -> bool {
        self.reinforced.read().unwrap_or_else(PoisonError::into_inner).contains(id)
    }

    /// What is known of a loop at `now`.
    pub fn get(&self, id: &LoopId, now: f64) -> Option<Known> {
        let entry = self.entry(id)?;
        self.let_pass(id, &entry, now);
        let entry = lock(&entry);
        Some(Known {
            diagnosed: entry.diagnosed.as_ref().map(|(run, _)| run.clone()),
            restored: entry.restored.as_ref().map(|(restored, _)| restored.clone()),
            last: entry.summaries.back().cloned(),
            summary: entry
                .diagnosed
                .as_ref()
                .map(|(_, summary)| summary)
                .or(entry.restored.as_ref().map(|(_, summary)| summary))
                .cloned(),
            model: entry.model.clone(),
            alarm: view(id, &entry),
        })
    }

    /// The effects in a loop's model: what the next diagnosis starts from.
    pub fn effects(&self, id: &LoopId) -> Vec<KnownEffect> {
        self.entry(id).map_or_else(Vec::new, |entry| lock(&entry).model.effects.clone())
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

    /// All alarms at `now`, by loop.
    pub fn alarms(&self, now: f64) -> Vec<AlarmView> {
        self.tick(now);
        let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
        let mut alarms: Vec<AlarmView> = entries.iter().map(|(id, entry)| view(id, &lock(entry))).collect();
        alarms.sort_by(|a, b| a.id.cmp(&b.id));
        alarms
    }

    /// An operator acts on a loop's alarm at `now`; `None` for a loop that is not there.
    ///
    /// # Errors
    /// The alarm's [`Refusal`] when its state does not allow the action.
    pub fn act(
        &self,
        id: &LoopId,
        action: Action,
        by: Option<String>,
        comment: Option<String>,
        now: f64,
    ) -> Option<Result<AlarmView, Refusal>> {
        let entry = self.entry(id)?;
        self.let_pass(id, &entry, now);
        let acted = {
            let mut entry = lock(&entry);
            let acted = match action {
                Action::Acknowledge => entry.alarm.acknowledge(now),
                Action::Shelve(duration) => entry.alarm.shelve(duration, now),
                Action::Unshelve => entry.alarm.unshelve(now),
            };
            acted.map(|transitions| {
                (entry.by, entry.comment) = (by.clone(), comment.clone());
                let kept = transitions.clone();
                self.keep(id, &entry, |change| Change { transitions: kept, acted: true, ..change });
                (transitions, view(id, &entry))
            })
        };
        Some(acted.map(|(transitions, view)| {
            self.tell_all(id, transitions, (by, comment));
            view
        }))
    }

    /// Lets time pass for all alarms: shelvings that have run out end, and everybody hears of it.
    pub fn tick(&self, now: f64) {
        let shelved: Vec<_> = {
            let entries = self.entries.read().unwrap_or_else(PoisonError::into_inner);
            let shelved = entries.iter().filter(|(_, entry)| lock(entry).alarm.state() == State::Shelved);
            shelved.map(|(id, entry)| (id.clone(), entry.clone())).collect()
        };
        for (id, entry) in shelved {
            self.let_pass(&id, &entry, now);
        }
    }

    fn let_pass(&self, id: &LoopId, entry: &Mutex<Entry>, now: f64) {
        let transitions = {
            let mut entry = lock(entry);
            let transitions = entry.alarm.tick(now);
            if !transitions.is_empty() {
                self.keep(id, &entry, |change| Change { transitions: transitions.clone(), ..change });
            }
            transitions
        };
        self.tell_all(id, transitions, (None, None));
    }

    /// The changes of alarms that are remembered, newest first.
    pub fn alarm_log(&self) -> Vec<AlarmChange> {
        self.alarm_log.newest_first()
    }

    fn entry(&self, id: &LoopId) -> Option<Arc<Mutex<Entry>>> {
        self.entries.read().unwrap_or_else(PoisonError::into_inner).get(id).cloned()
    }

    fn tell_all(&self, id: &LoopId, transitions: Vec<Transition>, said: (Option<String>, Option<String>)) {
        for transition in transitions {
            let (by, comment) = said.clone();
            self.alarm_log.push(AlarmChange { id: id.clone(), transition, by, comment });
            self.tell(Event::Alarm(id.clone(), transition));
        }
    }

    fn tell(&self, event: Event) {
        // An error here only means that nobody listens.
        let _ = self.events.send(event);
    }
}

/// A panic elsewhere leaves an entry whole: every change to it is one assignment.
fn lock(entry: &Mutex<Entry>) -> MutexGuard<'_, Entry> {
    entry.lock().unwrap_or_else(PoisonError::into_inner)
}

fn view(id: &LoopId, entry: &Entry) -> AlarmView {
    AlarmView {
        id: id.clone(),
        state: entry.alarm.state(),
        active: entry.alarm.is_active(),
        since: entry.alarm.since(),
        raised_at: entry.alarm.raised_at(),
        shelved_until: entry.alarm.shelved_until(),
        by: entry.by.clone(),
        comment: entry.comment.clone(),
    }
}

#[cfg(test)]
mod tests;
