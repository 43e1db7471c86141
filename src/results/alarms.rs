//! The alarms of the plant: what runs, tags and collectors say to them, and what people do about them.

use super::alarm_log::AlarmChange;
use super::board::{Board, News, Order, Standing, Wanted};
use super::kept::RestoredAlarm;
use super::{Event, ModelVersion, Results, Run, Summary};
use crate::alarm::{Action, AlarmId, Config, FloodView, Kind, Priority, Refusal, State, Transition};
use crate::signal::LoopId;
use std::collections::{HashMap, HashSet};
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
    /// What the condition is, or was when it last held, in one line; empty before it ever held.
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

/// All alarms, and what they did.
#[derive(Debug, Default)]
pub(super) struct Alarms(Mutex<Board>);

impl Alarms {
    /// A panic elsewhere leaves the board whole enough: every alarm is changed by one call.
    fn lock(&self) -> MutexGuard<'_, Board> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
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
    /// The collectors whose alarms there are from `now` on.
    pub fn watch_devices(&self, names: &[LoopId], now: f64) {
        self.with_board(|board, news| board.watch_devices(names, now, news));
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
                if !follows && board.alarms.get(&identifiable).is_some_and(|own| own.follows) {
                    // Nor does it that no diagnosis could be made then: else every loop would be told at once.
                    board.change(&identifiable, None, None, news, |alarm, _| alarm.leave_out(now));
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

    /// The states of the loops whose alarm on stiction is not normal, at `now`.
    pub(super) fn stiction_states(&self, now: f64) -> HashMap<LoopId, State> {
        self.tick(now);
        let board = self.alarms.lock();
        let of = |(id, own): (&AlarmId, &Standing)| (id.subject.clone(), own.alarm.state());
        let stiction = board.alarms.iter().filter(|(id, _)| id.kind == Kind::Stiction);
        stiction.map(of).filter(|(_, state)| *state != State::Normal).collect()
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

    /// Longest time that an alarm may be shelved (s).
    pub fn max_shelve_s(&self) -> f64 {
        self.alarms.lock().config.max_shelve_s
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
            if result.is_ok()
                && let Some(order) = board.orders.0.clone()
            {
                let seen = board.view(id, now);
                let (raised_at, since) = (seen.raised_at, seen.since);
                let wanted = Wanted { id: id.clone(), action, said: said.clone(), raised_at, since, at: now };
                if !order(wanted) {
                    result = Err(Refusal::NotLeading);
                }
            } else if result.is_ok() {
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

    /// Has all alarms kept as they stand: where that is done has none of them.
    pub fn keep_alarms(&self) {
        self.with_board(|board, news| news.kept = board.all());
    }

    /// The clock was set by so much (s): no condition has held for longer by that.
    pub fn clock_was_set(&self, by: f64) {
        self.with_board(|board, news| board.clock_was_set(by, news));
    }

    /// Lets time pass for all alarms: shelvings that have run out end, a flood too, and everybody hears of it.
    pub fn tick(&self, now: f64) {
        self.flood(now);
        self.with_board(|board, news| {
            // A clock that was set back keeps nothing silent for longer than anybody may.
            let latest = now + board.config.max_shelve_s;
            let is_due = |own: &Standing| {
                let until = own.alarm.flags().shelved_until;
                own.is_over(now) || until.is_some_and(|until| until > latest)
            };
            let due = board.alarms.iter().filter(|(_, own)| is_due(own));
            let ids: Vec<AlarmId> = due.map(|(id, _)| id.clone()).collect();
            for id in ids {
                board.change(&id, None, None, news, |alarm, config| {
                    alarm.bound_shelving(now, config);
                    alarm.tick(now)
                });
            }
        });
    }

    /// The changes of alarms that are remembered, newest first.
    pub fn alarm_log(&self) -> Vec<Arc<AlarmChange>> {
        self.alarms.lock().log.newest_first()
    }

    /// Number of the latest change: what comes to light of before the start has no larger one.
    pub fn latest_change(&self) -> u64 {
        self.alarms.lock().log.latest()
    }

    /// Takes back alarms as they were kept, unless something has happened to them since, and what they did before. Nobody is
    /// told: it is known, or was long ago.
    pub fn restore_alarms(&self, kept: Vec<RestoredAlarm>, log: Vec<AlarmChange>) {
        let mut board = self.alarms.lock();
        kept.into_iter().for_each(|kept| board.restore(kept));
        board.log.restore(log);
    }

    /// Takes alarms as they were left before a start that did not know them, at `now`: into what has happened since.
    pub fn merge_alarms(&self, kept: Vec<RestoredAlarm>, now: f64) {
        self.with_board(|board, news| {
            kept.into_iter().for_each(|kept| board.merge(kept, now, news));
            board.design(now, news);
        });
    }

    /// From now on the alarms are those of other machines: they change by [`Results::follow_alarm`] alone, and `order` is told
    /// what people want done.
    pub fn follow_others(&self, order: Order) {
        self.alarms.lock().orders.0 = Some(order);
    }

    /// Takes an alarm as another machine has it, which is the only one to change it, and what happened to it there; we hear of
    /// it at `now`.
    pub fn follow_alarm(&self, kept: RestoredAlarm, change: Option<AlarmChange>, now: f64) {
        self.with_board(|board, news| board.follow(kept, change, now, news));
    }

    /// Whether a change belongs to a flood; of one that is not remembered, whether its alarm does.
    pub fn is_grouped(&self, id: &AlarmId, transition: &Transition) -> bool {
        let board = self.alarms.lock();
        let own = board.alarms.get(id).is_some_and(|own| own.grouped);
        board.log.find(id, transition).map_or(own, |change| change.grouped)
    }

    /// Alarms that another configuration did not have begin anew at `now`: those of other loops and collectors than its, and of
    /// kinds that it had switched off.
    pub fn begin_anew(&self, (loops, devices): (&[LoopId], &[LoopId]), config: &Config, now: f64) {
        let (loops, devices): (HashSet<&LoopId>, HashSet<&LoopId>) =
            (loops.iter().collect(), devices.iter().collect());
        let was_there = |id: &AlarmId| {
            let known = if id.kind.of_device() { &devices } else { &loops };
            known.contains(&id.subject) && config.is_enabled(id.kind)
        };
        self.with_board(|board, news| board.begin_anew(was_there, now, news));
    }

    /// What diagnoses said of a loop until `now` was of another valve: it is no longer evidence for or against its alarms.
    pub fn forget_evidence(&self, id: &LoopId, now: f64) {
        self.with_board(|board, news| board.forget_evidence(id, now, news));
    }

    /// The design that the configuration in force has for its alarms, from `now` on.
    pub fn apply_design(&self, now: f64) {
        self.with_board(|board, news| board.design(now, news));
    }

    pub(super) fn place_alarms(&self, loops: &[LoopId], config: &Config, now: f64) {
        self.with_board(|board, news| board.place(loops, config, now, news));
    }

    /// What a run says to its loop's alarms, kept together with the run and told after it; `counts`: whether it is a vote.
    pub(super) fn judge(
        &self,
        run: &Arc<Run>,
        summary: Summary,
        new_model: Option<(LoopId, ModelVersion)>,
        counts: bool,
    ) {
        let reinforced = self.is_reinforced(&run.id);
        let mut board = self.alarms.lock();
        let mut news = News::default();
        board.judge(run.short(counts), &summary, reinforced, &mut news);
        self.keep(Some((run.clone(), summary.clone())), new_model, news.kept);
        self.tell(Event::Run(run.id.clone(), summary));
        self.tell_alarms(news.told);
    }

    /// Changes alarms, has that kept, and tells it.
    fn with_board(&self, act: impl FnOnce(&mut Board, &mut News)) {
        let mut board = self.alarms.lock();
        let mut news = News::default();
        act(&mut board, &mut news);
        self.keep(None, None, news.kept);
        self.tell_alarms(news.told);
    }

    /// Told while the board is held, so that what one does right after another comes after it everywhere.
    fn tell_alarms(&self, told: Vec<Arc<AlarmChange>>) {
        told.into_iter().for_each(|change| self.tell(Event::Alarm(change)));
    }
}
