//! The alarms of the plant: which there are, what runs, tags and collectors say to them, and what people do about them.

use super::alarm_log::{AlarmChange, AlarmLog};
use super::kept::{KeptAlarm, RestoredAlarm};
use super::{Event, Results, Run, Summary};
use crate::alarm::{
    Action, Alarm, AlarmId, Cause, Config, Flood, FloodView, Kind, Line, Observation, Priority, Refusal,
    State, Transition,
};
use crate::diagnosis::Verdict;
use crate::signal::LoopId;
use std::collections::{BTreeMap, HashSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// An alarm at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct AlarmView {
    /// Which.
    pub id: AlarmId,
    /// What the operator sees.
    pub state: State,
    /// How soon somebody has to act.
    pub priority: Priority,
    /// Whether the condition holds, silent or not.
    pub active: bool,
    /// When the state last changed (s).
    pub since: Option<f64>,
    /// When the condition was last raised (s).
    pub raised_at: Option<f64>,
    /// Until when it is shelved (s).
    pub shelved_until: Option<f64>,
    /// Shelved until its condition goes.
    pub one_shot: bool,
    /// Raised so often lately that it says nothing any more.
    pub chattering: bool,
    /// Its condition has held for very long.
    pub stale: bool,
    /// Raised in a flood.
    pub grouped: bool,
    /// What the condition is, in one line; empty before it ever held.
    pub detail: String,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// What people, and what they said with it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Said {
    /// Who.
    pub by: Option<String>,
    /// What.
    pub comment: Option<String>,
}

/// An alarm and what is remembered beside it.
#[derive(Debug)]
struct Standing {
    alarm: Alarm,
    said: Said,
    detail: String,
    grouped: bool,
    /// Suppressed because what it would say follows from another alarm.
    follows: bool,
}

impl Standing {
    fn new(alarm: Alarm) -> Self {
        Self { alarm, said: Said::default(), detail: String::new(), grouped: false, follows: false }
    }
}

impl Standing {
    /// Whether its shelving has run out.
    fn is_over(&self, now: f64) -> bool {
        self.alarm.flags().shelved_until.is_some_and(|until| now >= until)
    }
}

/// What came of something: what is to be kept, and what is to be told.
#[derive(Debug, Default)]
pub(super) struct News {
    pub kept: Vec<KeptAlarm>,
    pub told: Vec<AlarmChange>,
}

#[derive(Debug, Default)]
struct Board {
    config: Config,
    alarms: BTreeMap<AlarmId, Standing>,
    loops: HashSet<LoopId>,
    devices: HashSet<LoopId>,
    flood: Flood,
}

/// All alarms, and what they did.
#[derive(Debug, Default)]
pub(super) struct Alarms {
    board: Mutex<Board>,
    pub log: AlarmLog,
}

impl Alarms {
    /// A panic elsewhere leaves the board whole enough: every alarm is changed by one call.
    fn lock(&self) -> MutexGuard<'_, Board> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Board {
    fn has(&self, id: &AlarmId) -> bool {
        let known = if id.kind.of_device() { &self.devices } else { &self.loops };
        known.contains(&id.subject) && self.config.is_enabled(id.kind)
    }

    /// Lets something happen to an alarm, and takes down what came of it. An alarm that is not wanted stays away.
    fn change(
        &mut self,
        id: &AlarmId,
        said: Option<&Said>,
        detail: Option<String>,
        news: &mut News,
        act: impl FnOnce(&mut Alarm, &Config) -> Vec<Transition>,
    ) {
        if !self.has(id) {
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
        if id.kind != Kind::NotIdentifiable {
            // How long a condition of minutes has been pending is not worth a row each time it comes and goes.
            after.pending = before.pending;
        }
        let priority = own.alarm.priority().unwrap_or(self.config.priority(id.kind, None));
        for transition in &transitions {
            match transition.cause {
                Cause::Raised => own.grouped = self.flood.raised(priority, transition.at, &self.config),
                Cause::Cleared | Cause::Acknowledged => own.grouped = false,
                _ => {}
            }
            let Said { by, comment } = said.cloned().unwrap_or_default();
            news.told.push(AlarmChange {
                number: 0,
                id: id.clone(),
                transition: *transition,
                priority,
                grouped: own.grouped,
                detail: own.detail.clone(),
                by,
                comment,
            });
        }
        if said.is_some() || !transitions.is_empty() || before != after {
            news.kept.push(KeptAlarm {
                id: id.clone(),
                saved: own.alarm.saved(),
                transitions,
                acted: said.is_some(),
                by: own.said.by.clone(),
                comment: own.said.comment.clone(),
                detail: own.detail.clone(),
            });
        }
    }

    /// Takes a condition that is there, with what it is, or not. Nothing is made for an alarm that has nothing to say.
    fn level(&mut self, id: &AlarmId, present: Option<String>, now: f64, news: &mut News) {
        if present.is_some() || self.alarms.contains_key(id) {
            let is_present = present.is_some();
            self.change(id, None, present, news, |alarm, config| alarm.level(is_present, now, config));
        }
    }

    fn suppress(&mut self, id: &AlarmId, follows: bool, now: f64, news: &mut News) {
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

    fn place(&mut self, loops: &[LoopId], config: &Config) {
        self.config = config.clone();
        self.loops = loops.iter().cloned().collect();
        for id in loops {
            let id = AlarmId::new(id.clone(), Kind::Stiction);
            self.alarms.entry(id).or_insert_with(|| Standing::new(Alarm::new(Kind::Stiction)));
        }
        self.forget();
    }

    fn forget(&mut self) {
        let mut alarms = std::mem::take(&mut self.alarms);
        alarms.retain(|id, _| self.has(id));
        self.alarms = alarms;
    }

    /// Lets the design of the configuration suppress what it says, and no longer what it does not.
    fn design(&mut self, now: f64, news: &mut News) {
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

    fn view(&self, id: &AlarmId, now: f64) -> AlarmView {
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
    fn judge(&mut self, run: &Run, summary: &Summary, reinforced: bool, news: &mut News) {
        let of = |kind| AlarmId::new(run.id.clone(), kind);
        let (now, verdict) = (run.finished, run.judged().map(super::Judged::verdict));
        let identifiable = !matches!(verdict, None | Some(Verdict::NotIdentifiable(_)));
        let sticky = verdict == Some(&Verdict::Stiction);
        let known = summary.f.zip(summary.delta_aic).filter(|_| identifiable && (sticky || !reinforced));
        let seen = known.map_or(Observation::Unknown, |(f, evidence)| self.config.judge(sticky, f, evidence));
        let priority = self.config.priority(Kind::Stiction, summary.f);
        let detail = sticky.then(|| summary.reason.clone());
        self.change(&of(Kind::Stiction), None, detail, news, |alarm, config| {
            alarm.observe(seen, priority, now, config)
        });

        // A term in force hides the friction: what is left of it is no measure of the valve.
        if let (Some(f), Some(interval), true) = (summary.f, summary.f_ci95, identifiable && !reinforced) {
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
        let fault = !identifiable && !self.config.not_identifiable.ignore.iter().any(|known| known == code);
        self.level(&of(Kind::NotIdentifiable), fault.then(|| summary.reason.clone()), now, news);

        if let Some(share) = unexplained(run).filter(|_| identifiable) {
            let most = self.config.unexplained_residual.share;
            let (seen, detail) = if share >= most {
                (
                    Observation::Present,
                    Some(format!("{:.0} % of PV's movement is unexplained", 100.0 * share)),
                )
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
    let days = line.span_s / 86_400.0;
    format!("f has risen by {:.2} {unit} in {days:.0} days, by {:.2} at least", line.rise, line.low.max(0.0))
}

/// The share of PV's standard deviation that the model, run freely over data it has not seen, does not explain; `None` where
/// that was not looked at, or where the residual is white.
fn unexplained(run: &Run) -> Option<f64> {
    let judged = run.judged()?;
    let (found, window) = (judged.findings.as_ref()?, judged.diagnosis.window.as_ref()?);
    let n = window.pv.len().max(1) as f64;
    let mean = window.pv.iter().sum::<f64>() / n;
    let spread = (window.pv.iter().map(|pv| (pv - mean).powi(2)).sum::<f64>() / n).sqrt();
    let share = found.after.free_run_rmse / spread;
    (spread > 0.0 && share.is_finite()).then_some(if found.unexplained { share } else { 0.0 })
}

/// A collector, as its alarm sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceSeen {
    /// Its name.
    pub name: LoopId,
    /// Inside, why it is down, or nothing; `None` while that cannot be told.
    pub down: Option<Option<String>>,
}

/// A loop's tags, as its alarm sees them.
#[derive(Clone, Debug, PartialEq)]
pub struct TagsSeen {
    /// The loop.
    pub id: LoopId,
    /// What is wrong with which, if anything is.
    pub bad: Option<String>,
    /// The collectors that its tags come from.
    pub devices: Vec<LoopId>,
}

impl Results {
    /// The collectors whose alarms there are.
    pub fn watch_devices(&self, names: &[LoopId]) {
        let mut board = self.alarms.lock();
        board.devices = names.iter().cloned().collect();
        board.forget();
    }

    /// Takes what collectors and tags are like at `now`. Of a loop whose collector is down nothing is said of tags: that
    /// follows from the collector's own alarm.
    pub fn watch(&self, devices: Vec<DeviceSeen>, loops: Vec<TagsSeen>, now: f64) {
        self.with_board(|board, news| {
            for DeviceSeen { name, down } in devices {
                if let Some(down) = down {
                    board.level(&AlarmId::new(name, Kind::CollectorDown), down, now, news);
                }
            }
            let mut down = HashSet::new();
            for (id, own) in &board.alarms {
                if id.kind == Kind::CollectorDown && own.alarm.flags().active {
                    down.insert(id.subject.clone());
                }
            }
            for TagsSeen { id, bad, devices } in loops {
                let follows = devices.iter().any(|name| down.contains(name));
                let [tags, identifiable] =
                    [Kind::TagBad, Kind::NotIdentifiable].map(|kind| AlarmId::new(id.clone(), kind));
                if !follows && board.alarms.get(&tags).is_some_and(|own| own.follows) {
                    // The collector is back: what its tags were like without it says nothing.
                    board.level(&tags, None, now, news);
                }
                board.suppress(&tags, follows, now, news);
                board.suppress(&identifiable, follows, now, news);
                board.level(&tags, bad, now, news);
            }
        });
    }

    /// Takes whether a loop's write-back is closed by a fault.
    pub fn watch_trip(&self, id: &LoopId, tripped: Option<String>, now: f64) {
        let id = AlarmId::new(id.clone(), Kind::CompensationTripped);
        self.with_board(|board, news| board.level(&id, tripped, now, news));
    }

    /// The loops whose alarm of this kind is active.
    pub fn active(&self, kind: Kind) -> Vec<LoopId> {
        let board = self.alarms.lock();
        let of = |(id, own): (&AlarmId, &Standing)| {
            (id.kind == kind && own.alarm.flags().active).then(|| id.subject.clone())
        };
        board.alarms.iter().filter_map(of).collect()
    }

    /// All alarms that are or were anything, and the stiction of every loop, at `now`, by name.
    pub fn alarms(&self, now: f64) -> Vec<AlarmView> {
        self.tick(now);
        let board = self.alarms.lock();
        board.alarms.keys().map(|id| board.view(id, now)).collect()
    }

    /// One alarm at `now`; `None` when there is no such loop, collector or kind.
    pub fn alarm(&self, id: &AlarmId, now: f64) -> Option<AlarmView> {
        let board = self.alarms.lock();
        board.has(id).then(|| board.view(id, now))
    }

    /// The alarms of a loop that are not normal, and its stiction, which comes first, at `now`.
    pub fn alarms_of(&self, id: &LoopId, now: f64) -> Vec<AlarmView> {
        self.with_board(|board, news| {
            for id in Kind::ALL.map(|kind| AlarmId::new(id.clone(), kind)) {
                if board.alarms.get(&id).is_some_and(|own| own.is_over(now)) {
                    board.change(&id, None, None, news, |alarm, _| alarm.tick(now));
                }
            }
        });
        let board = self.alarms.lock();
        let views = Kind::ALL.into_iter().map(|kind| AlarmId::new(id.clone(), kind));
        let views = views.filter(|id| !id.kind.of_device()).map(|id| board.view(&id, now));
        views.filter(|view| view.id.kind == Kind::Stiction || view.state != State::Normal).collect()
    }

    /// Whether more alarms are raised than anybody can look at.
    pub fn flood(&self, now: f64) -> FloodView {
        let mut board = self.alarms.lock();
        let Board { flood, config, .. } = &mut *board;
        if flood.tick(now, config) {
            board.alarms.values_mut().for_each(|own| own.grouped = false);
        }
        board.flood.view()
    }

    /// Somebody acts on an alarm at `now`; `None` for an alarm that is not there.
    ///
    /// # Errors
    /// The alarm's [`Refusal`] when its state does not allow the action.
    pub fn act(
        &self,
        id: &AlarmId,
        action: Action,
        said: Said,
        now: f64,
    ) -> Option<Result<AlarmView, Refusal>> {
        let mut acted = None;
        self.with_board(|board, news| {
            if !board.has(id) {
                return;
            }
            // What time brings is nobody's doing.
            board.change(id, None, None, news, |alarm, _| alarm.tick(now));
            let ended = !news.told.is_empty();
            let mut result = Ok(());
            if let Some(own) = board.alarms.get(id) {
                // Tried on a copy: what is refused leaves no trace.
                result = own.alarm.clone().act(action, now, &board.config).1;
            }
            if result.is_ok() {
                board.change(id, Some(&said), None, news, |alarm, config| alarm.act(action, now, config).0);
            }
            let done_already = ended && action == Action::Unshelve;
            acted = Some(match result {
                Err(refusal) if !done_already => Err(refusal),
                _ => Ok(board.view(id, now)),
            });
        });
        acted
    }

    /// Lets time pass for all alarms: shelvings that have run out end, a flood too, and everybody hears of it.
    pub fn tick(&self, now: f64) {
        self.flood(now);
        self.with_board(|board, news| {
            let ids: Vec<_> =
                board.alarms.iter().filter(|(_, own)| own.is_over(now)).map(|(id, _)| id.clone()).collect();
            for id in ids {
                board.change(&id, None, None, news, |alarm, _| alarm.tick(now));
            }
        });
    }

    /// The changes of alarms that are remembered, newest first.
    pub fn alarm_log(&self) -> Vec<AlarmChange> {
        self.alarms.log.newest_first()
    }

    /// Takes back alarms as they were kept, and what they did; nothing where something has happened since.
    pub fn restore_alarms(&self, kept: Vec<RestoredAlarm>, log: Vec<AlarmChange>) {
        let mut board = self.alarms.lock();
        for RestoredAlarm { id, saved, by, comment, detail } in kept {
            let touched = board.alarms.get(&id).is_some_and(|own| !own.alarm.is_blank());
            if board.has(&id) && !touched {
                let follows = saved.flags.suppressed;
                let alarm = Alarm::restored(id.kind, &board.config, saved);
                let said = Said { by, comment };
                board.alarms.insert(id, Standing { alarm, said, detail, grouped: false, follows });
            }
        }
        self.alarms.log.restore(log);
    }

    /// The design that the configuration in force has for its alarms, from `now` on.
    pub fn apply_design(&self, now: f64) {
        self.with_board(|board, news| board.design(now, news));
    }

    pub(super) fn place_alarms(&self, loops: &[LoopId], config: &Config) {
        self.alarms.lock().place(loops, config);
    }

    /// What a run says to its loop's alarms; who calls keeps and tells it.
    pub(super) fn judge(&self, run: &Run, summary: &Summary) -> News {
        let mut news = News::default();
        self.alarms.lock().judge(run, summary, self.is_reinforced(&run.id), &mut news);
        news
    }

    pub(super) fn tell_alarms(&self, told: Vec<AlarmChange>) {
        for change in told {
            let change = Arc::new(self.alarms.log.push(change));
            self.tell(Event::Alarm(change));
        }
    }

    /// Changes alarms, has that kept in order, and tells it.
    fn with_board(&self, act: impl FnOnce(&mut Board, &mut News)) {
        let told = {
            let mut board = self.alarms.lock();
            let mut news = News::default();
            act(&mut board, &mut news);
            self.keep(None, None, news.kept);
            news.told
        };
        self.tell_alarms(told);
    }
}
