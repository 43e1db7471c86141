//! The alarms of the plant as they stand, and what happens to them; who calls keeps and tells what came of it.

use super::alarm_log::{AlarmChange, AlarmLog};
use super::alarms::{AlarmView, Said};
use super::kept::{KeptAlarm, RestoredAlarm};
use super::{Summary, words};
use crate::alarm::{
    Action, Alarm, AlarmId, Cause, Config, Flood, Kind, Line, Observation, Priority, Transition,
};
use crate::diagnosis::without_model_error;
use crate::signal::LoopId;
use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::sync::Arc;

/// An alarm and what is remembered beside it.
#[derive(Debug)]
pub(super) struct Standing {
    pub alarm: Alarm,
    pub said: Said,
    pub detail: String,
    pub grouped: bool,
    /// Suppressed because what it would say follows from another alarm.
    pub follows: bool,
}

impl Standing {
    pub fn new(alarm: Alarm) -> Self {
        Self { alarm, said: Said::default(), detail: String::new(), grouped: false, follows: false }
    }

    /// As it is kept, with what happened to it and whether somebody did that.
    fn kept(&self, id: &AlarmId, transitions: Vec<Transition>, acted: bool) -> KeptAlarm {
        KeptAlarm {
            id: id.clone(),
            saved: self.alarm.saved(),
            transitions,
            acted,
            by: self.said.by.clone(),
            comment: self.said.comment.clone(),
            detail: self.detail.clone(),
        }
    }

    /// Whether its shelving has run out.
    pub fn is_over(&self, now: f64) -> bool {
        self.alarm.flags().shelved_until.is_some_and(|until| now >= until)
    }
}

/// What alarms need of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShortRun<'r> {
    pub id: &'r LoopId,
    pub finished: f64,
    /// The valve sticks.
    pub sticky: bool,
    /// Whether it sticks can be told.
    pub identifiable: bool,
    /// Share of PV's standard deviation that the model does not explain.
    pub unexplained: Option<f64>,
    /// Its samples have not been counted before: it is a vote.
    pub counts: bool,
}

/// What somebody wants done about an alarm of another machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// Which alarm.
    pub id: AlarmId,
    /// What.
    pub action: Action,
    /// By whom, and what they say.
    pub said: Said,
    /// When the condition was raised that they have seen (s).
    pub raised_at: Option<f64>,
    /// When the state began that they have seen (s).
    pub since: Option<f64>,
    /// When (s).
    pub at: f64,
}

/// Takes what is wanted, and waits for nothing; false where it cannot be passed on.
pub type Order = Arc<dyn Fn(Wanted) -> bool + Send + Sync>;

/// Who takes what is wanted, where the alarms are another machine's.
#[derive(Clone, Default)]
pub(super) struct Orders(pub Option<Order>);

impl fmt::Debug for Orders {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Orders").field(&self.0.is_some()).finish()
    }
}

/// Whether since when its condition is pending is kept: one of minutes is not worth a row each time it comes and goes.
fn keeps_pending(kind: Kind) -> bool {
    kind == Kind::NotIdentifiable
}

/// What happened on another machine longer ago (s) when we hear of it is history: nobody is told of it, and it is no flood.
pub const NEWS_S: f64 = 86_400.0;

/// Whether an alarm is grouped in the flood after something happened to it at `now`, that was or was not before.
fn grouped(
    was: bool,
    cause: Cause,
    priority: Priority,
    now: f64,
    (flood, config): (&mut Flood, &Config),
) -> bool {
    match cause {
        Cause::Raised => flood.raised(priority, now, config),
        Cause::Cleared | Cause::Acknowledged => false,
        // It is counted in the flood already, and what is urgent is never grouped.
        Cause::MoreUrgent => was && priority < Priority::High,
        _ => was,
    }
}

/// What came of something: what is to be kept, and what is to be told.
#[derive(Debug, Default)]
pub(super) struct News {
    pub kept: Vec<KeptAlarm>,
    pub told: Vec<Arc<AlarmChange>>,
}

/// All alarms as they stand, under the settings in force.
#[derive(Debug, Default)]
pub(super) struct Board {
    pub config: Config,
    pub alarms: BTreeMap<AlarmId, Standing>,
    pub loops: HashSet<LoopId>,
    pub devices: HashSet<LoopId>,
    pub flood: Flood,
    /// What they did: a change gets its number while nobody else can make one.
    pub log: AlarmLog,
    /// Who is told what people want done, where the alarms are another machine's: nothing changes them here.
    pub orders: Orders,
}

impl Board {
    pub fn has(&self, id: &AlarmId) -> bool {
        let known = if id.kind.of_device() { &self.devices } else { &self.loops };
        known.contains(&id.subject) && self.config.is_enabled(id.kind)
    }

    /// Lets something happen to an alarm, and takes down what came of it. An alarm that is not wanted stays away.
    pub fn change(
        &mut self,
        id: &AlarmId,
        said: Option<&Said>,
        detail: Option<String>,
        news: &mut News,
        act: impl FnOnce(&mut Alarm, &Config) -> Vec<Transition>,
    ) {
        if !self.has(id) || self.orders.0.is_some() {
            return;
        }
        let own = self.alarms.entry(id.clone()).or_insert_with(|| Standing::new(Alarm::new(id.kind)));
        let before = own.alarm.saved();
        let transitions = act(&mut own.alarm, &self.config);
        if let Some(said) = said {
            own.said = said.clone();
        }
        if let Some(detail) = detail {
            own.detail = detail;
        }
        let mut after = own.alarm.saved();
        if !keeps_pending(id.kind) {
            after.pending = before.pending;
        }
        let priority = own.alarm.priority().unwrap_or(self.config.priority(id.kind, None));
        for transition in &transitions {
            let flood = (&mut self.flood, &self.config);
            own.grouped = grouped(own.grouped, transition.cause, priority, transition.at, flood);
            let Said { by, comment } = said.cloned().unwrap_or_default();
            news.told.push(self.log.push(AlarmChange {
                number: 0,
                id: id.clone(),
                transition: *transition,
                priority,
                grouped: own.grouped,
                detail: own.detail.clone(),
                by,
                comment,
                told: false,
            }));
        }
        if said.is_some() || !transitions.is_empty() || before != after {
            news.kept.push(own.kept(id, transitions, said.is_some()));
        }
    }

    /// All alarms as they stand, but those of which there is nothing to keep.
    pub fn all(&self) -> Vec<KeptAlarm> {
        let there = self.alarms.iter().filter(|(_, own)| !own.alarm.is_blank());
        there.map(|(id, own)| own.kept(id, Vec::new(), false)).collect()
    }

    /// The clock was set by so much (s): no condition has held for longer by that, also after a restart. Of another machine's
    /// alarms its own clock counts.
    pub fn clock_was_set(&mut self, by: f64, news: &mut News) {
        if self.orders.0.is_some() {
            return;
        }
        for (id, own) in &mut self.alarms {
            own.alarm.clock_was_set(by);
            if keeps_pending(id.kind) && own.alarm.saved().pending.is_some() {
                news.kept.push(own.kept(id, Vec::new(), false));
            }
        }
    }

    /// Takes a condition that is there, with what it is, or not. Nothing is made for an alarm that has nothing to say.
    pub fn level(&mut self, id: &AlarmId, present: Option<String>, now: f64, news: &mut News) {
        if present.is_some() || self.alarms.contains_key(id) {
            let is_present = present.is_some();
            self.change(id, None, present, news, |alarm, config| alarm.level(is_present, now, config));
        }
    }

    pub fn suppress(&mut self, id: &AlarmId, follows: bool, now: f64, news: &mut News) {
        if self.alarms.get(id).map_or(!follows, |own| own.follows == follows) {
            return;
        }
        self.change(id, None, None, news, |alarm, config| {
            alarm.suppress(follows, id.subject.as_str(), now, config)
        });
        if let Some(own) = self.alarms.get_mut(id) {
            own.follows = follows;
        }
    }

    /// Takes an alarm as it was kept: in place of one that nothing has happened to, and into any other.
    pub fn merge(&mut self, kept: RestoredAlarm, now: f64, news: &mut News) {
        if !self.has(&kept.id) {
            return;
        }
        let Some(own) = self.alarms.get_mut(&kept.id).filter(|own| !own.alarm.is_blank()) else {
            let id = kept.id.clone();
            self.restore(kept);
            // One that is blank may wait to be written too, and must not take the place of this.
            news.kept.extend(self.alarms.get(&id).map(|own| own.kept(&id, Vec::new(), false)));
            return;
        };
        if own.said == Said::default() {
            own.said = Said { by: kept.by, comment: kept.comment };
        }
        let detail = own.detail.is_empty().then_some(kept.detail);
        self.change(&kept.id, None, detail, news, |alarm, config| alarm.merge(kept.saved, now, config));
    }

    /// Takes an alarm as another machine has it, which is the only one to change it, and what happened to it there. The flood is
    /// that of all machines together, by our clock: they come here at once, whenever each was raised.
    pub fn follow(&mut self, kept: RestoredAlarm, change: Option<AlarmChange>, now: f64, news: &mut News) {
        let RestoredAlarm { id, saved, by, comment, detail } = kept;
        if !self.has(&id) {
            // The loop is gone, but the end of its alarm is kept and told. Otherwise the alarm would stand again when the loop is
            // back, and nobody would know why it has disappeared.
            if let Some(change) = change.filter(|change| change.transition.cause == Cause::Forgotten) {
                let transitions = vec![change.transition];
                // A kind that is switched off here is not shown.
                if self.config.is_enabled(id.kind) && !self.log.has(&id, &change.transition) {
                    news.told.push(self.log.push(AlarmChange { grouped: false, ..change }));
                }
                news.kept.push(KeptAlarm { id, saved, transitions, acted: false, by, comment, detail });
            }
            return;
        }
        let mut change = change.filter(|change| !self.log.has(&id, &change.transition));
        let mut is_grouped = self.alarms.get(&id).is_some_and(|own| own.grouped);
        if let Some(change) = &mut change {
            let Transition { at, cause, .. } = change.transition;
            let is_past = cause == Cause::Raised && at < now - NEWS_S;
            let flood = (&mut self.flood, &self.config);
            is_grouped = !is_past && grouped(is_grouped, cause, change.priority, now, flood);
            change.grouped = is_grouped;
        }
        let alarm = Alarm::restored(id.kind, &self.config, saved.clone());
        let said = Said { by: by.clone(), comment: comment.clone() };
        let standing = Standing { alarm, said, detail: detail.clone(), grouped: is_grouped, follows: false };
        let before = self.alarms.insert(id.clone(), standing);
        let transitions: Vec<Transition> = change.iter().map(|change| change.transition).collect();
        if transitions.is_empty() && before.is_some_and(|own| own.alarm.saved() == saved) {
            return;
        }
        let acted = change.as_ref().is_some_and(|change| change.by.is_some());
        news.told.extend(change.map(|change| self.log.push(change)));
        news.kept.push(KeptAlarm { id, saved, transitions, acted, by, comment, detail });
    }

    /// Takes an alarm as it was kept, unless something has happened to it since.
    pub fn restore(&mut self, kept: RestoredAlarm) {
        let RestoredAlarm { id, saved, by, comment, detail } = kept;
        let touched = self.alarms.get(&id).is_some_and(|own| !own.alarm.is_blank());
        if self.has(&id) && !touched {
            // What the configuration suppressed is for the configuration in force to say.
            let follows = saved.flags.suppressed && matches!(id.kind, Kind::TagBad | Kind::NotIdentifiable);
            let alarm = Alarm::restored(id.kind, &self.config, saved);
            let said = Said { by, comment };
            self.alarms.insert(id, Standing { alarm, said, detail, grouped: false, follows });
        }
    }

    pub fn place(&mut self, loops: &[LoopId], config: &Config, now: f64, news: &mut News) {
        let known: HashSet<LoopId> = loops.iter().cloned().collect();
        let is_there = |id: &AlarmId| id.kind.of_device() || known.contains(&id.subject);
        self.forget(|id| config.is_enabled(id.kind) && is_there(id), now, news);
        self.config = config.clone();
        self.loops = known;
        for id in loops {
            let id = AlarmId::new(id.clone(), Kind::Stiction);
            self.alarms.entry(id).or_insert_with(|| Standing::new(Alarm::new(Kind::Stiction)));
        }
    }

    pub fn watch_devices(&mut self, names: &[LoopId], now: f64, news: &mut News) {
        let known: HashSet<LoopId> = names.iter().cloned().collect();
        self.forget(|id| !id.kind.of_device() || known.contains(&id.subject), now, news);
        self.devices = known;
    }

    /// Ends what stands of alarms that were not there before. It was kept at a time after which nobody saw it go, and nobody was
    /// told that it is over.
    pub fn begin_anew(&mut self, was_there: impl Fn(&AlarmId) -> bool, now: f64, news: &mut News) {
        let new: Vec<AlarmId> = self.alarms.keys().filter(|id| !was_there(id)).cloned().collect();
        for id in new {
            self.change(&id, None, None, news, |alarm, _| alarm.forget(now));
        }
    }

    /// Lets the alarms that follow from a loop's diagnoses begin anew with what comes after `now`.
    pub fn forget_evidence(&mut self, id: &LoopId, now: f64, news: &mut News) {
        for kind in [Kind::Stiction, Kind::FRising, Kind::NotIdentifiable, Kind::UnexplainedResidual] {
            let id = AlarmId::new(id.clone(), kind);
            if self.alarms.contains_key(&id) {
                self.change(&id, None, None, news, |alarm, config| alarm.forget_evidence(now, config));
            }
        }
    }

    /// Drops all alarms but those that stay, while the configuration that has them is still in force. Nothing would ever clear
    /// one that stands where it was told, so it is told that it is over.
    fn forget(&mut self, stays: impl Fn(&AlarmId) -> bool, now: f64, news: &mut News) {
        let gone: Vec<AlarmId> = self.alarms.keys().filter(|id| !stays(id)).cloned().collect();
        for id in gone {
            self.change(&id, None, None, news, |alarm, _| alarm.forget(now));
            self.alarms.remove(&id);
        }
    }

    /// Lets the design of the configuration suppress what it says, and no longer what it does not.
    pub fn design(&mut self, now: f64, news: &mut News) {
        let own = self.config.suppressed.clone();
        let named = own.iter().filter_map(|text| text.rsplit_once('/'));
        let mut ids: Vec<AlarmId> = self.alarms.keys().cloned().collect();
        for (subject, kind) in named.filter_map(|(subject, kind)| Some((subject, Kind::named(kind)?))) {
            let known = if kind.of_device() { &self.devices } else { &self.loops };
            let meant = known.iter().filter(|id| subject == "*" || subject == id.as_str());
            ids.extend(meant.map(|id| AlarmId::new(id.clone(), kind)));
        }
        for id in ids {
            let follows = self.alarms.get(&id).is_some_and(|own| own.follows);
            self.change(&id, None, None, news, |alarm, config| {
                alarm.suppress(follows, id.subject.as_str(), now, config)
            });
        }
    }

    pub fn view(&self, id: &AlarmId, now: f64) -> AlarmView {
        let blank = Standing::new(Alarm::new(id.kind));
        let own = self.alarms.get(id).unwrap_or(&blank);
        let flags = own.alarm.flags();
        AlarmView {
            id: id.clone(),
            state: own.alarm.state(),
            priority: own.alarm.priority().unwrap_or(self.config.priority(id.kind, None)),
            active: flags.active,
            since: flags.since,
            raised_at: flags.raised_at,
            shelved_until: flags.shelved_until,
            one_shot: flags.one_shot,
            chattering: own.alarm.chatters(now, &self.config),
            stale: own.alarm.is_stale(now, &self.config),
            grouped: own.grouped,
            detail: own.detail.clone(),
            by: own.said.by.clone(),
            comment: own.said.comment.clone(),
        }
    }

    /// What a run says, to each kind that listens.
    pub fn judge(&mut self, run: ShortRun<'_>, summary: &Summary, reinforced: bool, news: &mut News) {
        let of = |kind| AlarmId::new(run.id.clone(), kind);
        let ShortRun { finished: now, sticky, identifiable, counts, .. } = run;
        // Of a window that a term acted on nothing else can be expected, though it has ended since.
        let reinforced = reinforced || summary.compensated.is_some();
        let known = summary.f.zip(summary.delta_aic).filter(|_| identifiable && (sticky || !reinforced));
        let known = known.filter(|_| counts);
        let seen = known.map_or(Observation::Unknown, |(f, evidence)| self.config.judge(sticky, f, evidence));
        // Limits in per cent of a span say nothing of f where that span is not known.
        let f_percent = summary.f.filter(|_| summary.f_in_percent);
        let priority = self.config.priority(Kind::Stiction, f_percent);
        let detail = sticky.then(|| summary.words());
        self.change(&of(Kind::Stiction), None, detail, news, |alarm, config| {
            alarm.observe(seen, priority, now, config)
        });

        // A term in force hides the friction: what is left of it is no measure of the valve.
        let tells = identifiable && !reinforced && counts;
        if let (Some(f), Some(interval), true) = (f_percent, summary.f_ci95, tells) {
            // All diagnoses of a valve have the error of the models in common, so it causes no rise.
            let interval = without_model_error(f, interval);
            let id = of(Kind::FRising);
            let mut line = None;
            self.change(&id, None, None, news, |alarm, config| {
                let taken = alarm.estimate(f, interval, now, config);
                line = alarm.line(config);
                taken
            });
            if let (Some(own), Some(line)) = (self.alarms.get_mut(&id), line) {
                own.detail = rising(line, summary);
            }
        }

        let code = summary.reason_code.as_deref().unwrap_or(&summary.outcome);
        let fault = !identifiable
            && !reinforced
            && !self.config.not_identifiable.ignore.iter().any(|known| known == code);
        self.level(&of(Kind::NotIdentifiable), fault.then(|| summary.words()), now, news);

        if let Some(share) = run.unexplained.filter(|_| identifiable && counts) {
            let most = self.config.unexplained_residual.share;
            let (seen, detail) = if share >= most {
                (Observation::Present, Some(words::unexplained(share)))
            } else {
                // A dead-band of a tenth, so that a share at the limit does not come and go.
                (if share <= 0.9 * most { Observation::Absent } else { Observation::Between }, None)
            };
            let priority = self.config.unexplained_residual.priority;
            self.change(&of(Kind::UnexplainedResidual), None, detail, news, |alarm, config| {
                alarm.observe(seen, priority, now, config)
            });
        }
    }
}

fn rising(line: Line, summary: &Summary) -> String {
    let unit = super::f_unit(summary.f_in_percent);
    words::rising(line.rise, line.low, line.span_s, unit)
}
