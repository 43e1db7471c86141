//! The plant as a whole: from time to time all rings are looked at together, on one thread that nobody waits for. What is
//! found is shown, feeds the work list, and is kept as indicators of each loop.

mod back;
mod dead_time;
mod health;
mod margins;
pub(super) mod rows;
mod said;
mod swings;
mod valve;

use super::persistence::Persistence;
use super::silence::sources;
use crate::config::Config;
use crate::history::{History, TagKind};
use crate::indicators::margins::Margins;
use crate::indicators::series::{SCORE, Values};
use crate::plantwide::window::{of_record, recent, silent_of};
use crate::plantwide::{Analysis, LoopFound, Plant, PlantLoop, analyse};
use crate::results::Results;
use crate::schedule::Clock;
use crate::serve::report::GroupPictures;
use crate::serve::{CauseSeen, GroupSeen, Health, LoopLook, Overview, PlantwidePort, Standing, WorkLine};
use crate::signal::{LoopId, Record, Role, Window};
use crate::work::{self, Act, CostConfig, Measure, Order, Refusal, WorkList};
pub use dead_time::DeadTime;
use health::HealthLog;
pub use margins::margins_of;
use said::{LookSaid, cost, cost_of, said};
use std::borrow::Cow;
use std::collections::{BTreeSet, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use swings::swings;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
pub use valve::{friction_of, untold_of};

/// Rows of a loop with more samples: as many as a ring has unless the configuration says otherwise, so that the usual ring is looked
/// at sample by sample. Rows between samples have less noise and a coloured one, and causes are told by the noise.
const MOST_SAMPLES: usize = 4096;
/// Samples of the recent part of a longer one: those of an hour at one a second.
const RECENT_SAMPLES: usize = 3600;
/// Groups that are drawn.
const DRAWN: usize = 64;
/// Loops whose indicators are kept in one go: whoever asks for any waits for no more than that, and so few have their days in memory
/// twice.
const AT_ONCE: usize = 64;
/// How far back a look goes, where the rings go further (s): a repair is judged once a window has nothing of before it.
const WEEK_S: f64 = 604_800.0;

/// Looks at the plant as a whole.
pub(super) struct Plantwide {
    clock: Clock,
    results: Arc<Results>,
    persistence: Arc<Persistence>,
    watched: Mutex<Watched>,
    list: Mutex<WorkList>,
    health: Mutex<HealthLog>,
    /// How every loop was by the latest look; of one that this could not look at nothing is known.
    measures: Mutex<HashMap<LoopId, Measure>>,
    /// What the latest look at every loop found beside its indicators.
    last: Mutex<HashMap<LoopId, LoopLook>>,
    overview: Mutex<Option<Arc<Overview>>>,
    looking: AtomicBool,
    wanted: Notify,
}

/// What a reload replaces.
#[derive(Clone)]
struct Watched {
    config: work::Config,
    history: Arc<History>,
    loops: Arc<Vec<WatchedLoop>>,
    costs: Arc<HashMap<LoopId, CostConfig>>,
}

struct WatchedLoop {
    id: LoopId,
    upstream: Vec<String>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The watched loops that are not silent, as their rings have them, one window in memory at a time.
struct Live<'a> {
    history: &'a History,
    /// Those with samples enough when the look began.
    loops: Vec<LiveLoop<'a>>,
    results: &'a Results,
    at: Moment,
}

/// When a look is made.
#[derive(Clone, Copy)]
struct Moment {
    /// By our clock (s).
    now: f64,
    /// Since the start (s).
    elapsed_s: f64,
    /// Time between two looks (s).
    period_s: f64,
}

impl Moment {
    /// What the clock shows that stamps a loop's PV (s), as its samples tell: a window is where PV is. Where nothing has come since
    /// the start, our own clock is all there is.
    fn by_stamps(self, history: &History, id: &LoopId) -> f64 {
        history.stamps_show(id, &TagKind::Role(Role::Pv), self.elapsed_s).unwrap_or(self.now)
    }

    /// How far the clock that stamps a loop's samples is ahead of ours (s); 0 where it is behind.
    fn ahead_s(self, history: &History, id: &LoopId) -> f64 {
        (self.by_stamps(history, id) - self.now).max(0.0)
    }
}

/// A loop and what its window was like when the look began.
struct LiveLoop<'a> {
    of: &'a WatchedLoop,
    /// The first of its samples, by our clock or earlier (s): repairs and terms of write-back are stamped by ours.
    from: f64,
    op_moves: bool,
    pv_moves: bool,
    /// Dead time of its process that its Harris index is for (s).
    dead_time_s: Option<f64>,
    /// Its margins by its latest diagnosis.
    margins: Option<Margins>,
}

impl<'a> LiveLoop<'a> {
    /// Of a window whose stamps are so far ahead of our clock (s).
    fn new(of: &'a WatchedLoop, window: &Window, ahead_s: f64) -> Self {
        let moves = |x: &[f64]| x.windows(2).any(|w| w[0] != w[1]);
        let (op_moves, pv_moves) = (moves(&window.op), moves(&window.pv));
        Self { of, from: window.t0 - ahead_s, op_moves, pv_moves, dead_time_s: None, margins: None }
    }
}

impl Plant for Live<'_> {
    fn count(&self) -> usize {
        self.loops.len()
    }

    fn get(&self, at: usize) -> Cow<'_, PlantLoop> {
        let own = self.loops[at].of;
        // One whose samples have all turned bad since is empty, and in no group.
        let of = window(self.history, &own.id, self.at);
        let mut of = of.and_then(Result::ok).unwrap_or_default();
        of.name = own.id.to_string();
        of.upstream.clone_from(&own.upstream);
        (of.dead_time_s, of.margins) = (self.loops[at].dead_time_s, self.loops[at].margins);
        let summary = self.results.get(&own.id, self.at.now).and_then(|known| known.summary);
        of.friction = summary.as_ref().and_then(|own| friction_of(own, of.op_span));
        of.untold = summary.as_ref().and_then(untold_of);
        Cow::Owned(of)
    }

    fn recent(&self, at: usize, hour_s: f64) -> Option<PlantLoop> {
        let of = |name: &str, record: &Record| recent(name, record, hour_s, RECENT_SAMPLES);
        let own = &self.loops[at];
        let of = of_rings(self.history, &own.of.id, self.at, of)?.ok()?;
        Some(PlantLoop { dead_time_s: own.dead_time_s, ..of })
    }
}

/// The window of a loop at a time; `None` where it has no ring. A loop that is silent has none: what
/// its rings still hold says nothing of it as it is now.
fn window(history: &History, id: &LoopId, at: Moment) -> Option<Result<PlantLoop, String>> {
    of_rings(history, id, at, |name, record| of_record(name, record, MOST_SAMPLES))
}

/// What `of` makes of a loop's rings.
fn of_rings(
    history: &History,
    id: &LoopId,
    at: Moment,
    of: impl Fn(&str, &Record) -> Result<PlantLoop, String>,
) -> Option<Result<PlantLoop, String>> {
    let mut record = history.snapshot(id)?;
    let now = at.by_stamps(history, id);
    // As the scheduler judges it.
    let sources = sources((history, id), (at.now, at.elapsed_s), at.period_s);
    if let Some((tag, since)) = silent_of(&record, at.period_s, sources) {
        return Some(Err(format!("no good sample of {tag} since {}", told(since))));
    }
    // The window is where PV is: what is older of the others is held into it.
    let end = record.pv.last().map_or(f64::NEG_INFINITY, |last| last.t);
    record.pv.retain(|sample| sample.t >= end - WEEK_S);
    Some(of(id.as_str(), &record).map(|of| {
        let end = of.window.t0 + of.window.ts * (of.window.len() as f64 - 1.0);
        PlantLoop { silent_s: (now - end).max(0.0), ..of }
    }))
}

/// A time for people, to the second; in seconds where no calendar holds it.
fn told(t: f64) -> String {
    let stamp = jiff::Timestamp::from_second(t.round() as i64);
    stamp.map_or_else(|_| format!("{t} s"), |stamp| stamp.to_string())
}

fn watched(config: &Config, history: &Arc<History>) -> Watched {
    let own = |own: &crate::config::LoopConfig| WatchedLoop {
        id: LoopId::new(own.id.as_str()),
        upstream: own.upstream.clone(),
    };
    let cost = |own: &crate::config::LoopConfig| Some((LoopId::new(own.id.as_str()), own.cost.clone()?));
    Watched {
        config: config.plantwide.clone(),
        history: history.clone(),
        loops: Arc::new(config.loops.iter().map(own).collect()),
        costs: Arc::new(config.loops.iter().filter_map(cost).collect()),
    }
}

impl Plantwide {
    /// Nothing is looked at before [`Plantwide::run`]; the work list is as it was kept.
    pub(super) fn new(
        config: &Config,
        clock: Clock,
        history: &Arc<History>,
        results: &Arc<Results>,
        persistence: &Arc<Persistence>,
    ) -> Arc<Self> {
        let own = Arc::new(Self {
            clock,
            results: results.clone(),
            persistence: persistence.clone(),
            watched: Mutex::new(watched(config, history)),
            list: Mutex::default(),
            health: Mutex::default(),
            measures: Mutex::default(),
            last: Mutex::default(),
            overview: Mutex::default(),
            looking: AtomicBool::new(false),
            wanted: Notify::new(),
        });
        // Weakly: this part holds the other.
        let taker = Arc::downgrade(&own);
        persistence.give_back_plantwide(Box::new(move |kept| {
            if let Some(own) = taker.upgrade() {
                own.take_back(kept);
            }
        }));
        let asked = Arc::downgrade(&own);
        persistence.keep_again_by(Box::new(move || {
            if let Some(own) = asked.upgrade() {
                own.keep_again();
            }
        }));
        own
    }

    /// Another configuration; a look that is under way ends with the old one.
    pub(super) fn reload(&self, config: &Config, history: &Arc<History>) {
        *lock(&self.watched) = watched(config, history);
        let ids: BTreeSet<LoopId> = config.loops.iter().map(|own| LoopId::new(own.id.as_str())).collect();
        lock(&self.health).keep_only(&ids);
        lock(&self.measures).retain(|id, _| ids.contains(id));
        lock(&self.last).retain(|id, _| ids.contains(id));
        let mut list = lock(&self.list);
        list.keep_only(&ids);
        if !config.plantwide.enabled {
            // No look will say any more how the plant swings.
            list.forget_victims(|_| true);
        }
        self.results.swing(swings(&list));
        drop(list);
        self.wanted.notify_one();
    }

    /// Looks at the plant every period until `stop` is cancelled.
    pub(super) async fn run(self: Arc<Self>, stop: CancellationToken) {
        let period =
            || Duration::try_from_secs_f64(lock(&self.watched).config.period_s).unwrap_or(Duration::MAX);
        let mut next = self.clock.elapsed() + period();
        while !stop.is_cancelled() {
            let asked = tokio::select! {
                () = stop.cancelled() => return,
                () = self.wanted.notified() => true,
                () = self.clock.sleep_until(next) => false,
            };
            // A reload wakes too, because the period may have changed; only a look that was asked for comes early.
            if asked && !self.looking.load(Relaxed) {
                next = next.min(self.clock.elapsed() + period());
                continue;
            }
            next = self.clock.elapsed() + period();
            let is_wanted = lock(&self.watched).config.enabled;
            self.looking.store(is_wanted, Relaxed);
            if !is_wanted {
                continue;
            }
            let own = self.clone();
            let look = move || catch_unwind(AssertUnwindSafe(|| own.look_once()));
            let look = tokio::task::spawn_blocking(look);
            let looked = tokio::select! {
                // Nobody waits for a look that nobody will see.
                () = stop.cancelled() => return,
                looked = look => looked,
            };
            self.looking.store(false, Relaxed);
            if !matches!(looked, Ok(Ok(()))) {
                tracing::error!("the look at the plant as a whole failed");
            }
        }
    }

    fn look_once(&self) {
        let began = Instant::now();
        let watched = lock(&self.watched).clone();
        let (now, elapsed_s) = (self.clock.now(), self.clock.elapsed().as_secs_f64());
        let at = Moment { now, elapsed_s, period_s: watched.config.period_s };
        let (mut loops, mut skipped) = (Vec::new(), Vec::new());
        for own in watched.loops.iter() {
            match window(&watched.history, &own.id, at) {
                Some(Ok(of)) => {
                    let live = LiveLoop::new(own, &of.window, at.ahead_s(&watched.history, &own.id));
                    let margins = self.margins(&own.id, of.op_limits, now);
                    loops.push(LiveLoop { dead_time_s: self.dead_time(&own.id, now), margins, ..live });
                }
                Some(Err(why)) => skipped.push((own.id.clone(), why)),
                None => {}
            }
        }
        let plant = Live { history: &watched.history, loops, results: &self.results, at };
        let found = analyse(&plant);
        let mut said = said(&plant, &found);
        // What was taken out of the configuration meanwhile must not begin anew.
        let history = lock(&self.watched).history.clone();
        let there: BTreeSet<LoopId> = history.loops().iter().map(|own| own.id.clone()).collect();
        said.of_loops.retain(|own| there.contains(&own.id));
        said.measures.retain(|own| there.contains(&own.0));
        said.last.retain(|own| there.contains(&own.0));
        let of_loops = std::mem::take(&mut said.of_loops);
        self.keep_health(said, now);
        let mut list = lock(&self.list);
        let changed = list.take(&of_loops, now, &watched.config);
        self.results.swing(swings(&list));
        let moved = changed.iter().filter(|(_, moved)| moved.is_some()).count();
        let kept = changed.iter().flat_map(|(order, moved)| rows::order_rows(order, moved.as_ref()));
        // Noted while nobody else changes them, so that the last row of an order is how it is.
        self.persistence.note_rows(kept.collect());
        drop(list);
        let groups = groups(&plant, &found);
        let (looked_at, took_s) = (plant.count(), began.elapsed().as_secs_f64());
        tracing::info!(
            loops = looked_at,
            skipped = skipped.len(),
            groups = groups.len(),
            moved,
            took_s,
            "plant looked at"
        );
        let causes = causes(&found);
        *lock(&self.overview) =
            Some(Arc::new(Overview { at: now, took_s, looked_at, skipped, groups, causes }));
    }

    /// Dead time of a loop's process that its Harris index is for from now on (s).
    fn dead_time(&self, id: &LoopId, now: f64) -> Option<f64> {
        let before = lock(&self.health).dead_time(id);
        dead_time::kept(before, self.results.get(id, now).and_then(|known| DeadTime::of(&known)))
    }

    /// Margins of a loop by its latest diagnosis since the start.
    fn margins(&self, id: &LoopId, op_limits: Option<(f64, f64)>, now: f64) -> Option<Margins> {
        margins_of(self.results.get(id, now)?.diagnosed?.judged()?, op_limits)
    }

    /// Keeps the indicators of a look at `now` (s), and how the loops were by it.
    fn keep_health(&self, said: LookSaid, now: f64) {
        *lock(&self.measures) = said.measures.into_iter().collect();
        let mut last: HashMap<LoopId, LoopLook> = said.last.into_iter().collect();
        for some in said.values.chunks(AT_ONCE) {
            let mut health = lock(&self.health);
            // Before anybody else asks, so that both are of one look.
            lock(&self.last).extend(some.iter().filter_map(|(id, _)| last.remove_entry(id)));
            let keep = health.take(some, now);
            self.note_health(&keep, &lock(&self.measures));
        }
    }

    /// Time between two looks (s).
    fn period_s(&self) -> f64 {
        lock(&self.watched).config.period_s
    }

    fn line(&self, order: Order) -> WorkLine {
        let costs = lock(&self.watched).costs.clone();
        let cost = cost(&order, &costs, &lock(&self.measures));
        WorkLine { order, cost }
    }
}

fn groups(plant: &dyn Plant, found: &Analysis) -> Vec<GroupSeen> {
    let id = |at: usize| LoopId::new(found.loops[at].name.as_str());
    let seen = |(number, group): (usize, &crate::plantwide::Group)| GroupSeen {
        period_s: group.period_s,
        members: group.members.iter().map(|at| id(*at)).collect(),
        suspects: group.suspects.iter().map(|s| (id(s.at), s.probability, s.evidence.clone())).collect(),
        pictures: (number < DRAWN).then(|| GroupPictures::of(number, group, plant, found)),
    };
    found.groups.iter().enumerate().map(seen).collect()
}

/// Why loops are not at rest.
fn causes(found: &Analysis) -> HashMap<LoopId, CauseSeen> {
    let id = |of: &LoopFound| LoopId::new(of.name.as_str());
    let seen = |of: &LoopFound| {
        let reason = of.reason.as_ref()?;
        let cause = CauseSeen {
            name: reason.cause.as_str(),
            probability: reason.probability,
            why: reason.why.clone(),
            neighbour: reason.neighbour.map(|at| id(&found.loops[at])),
            causes: of.causes.iter().map(|own| (own.as_str(), own.probability)).collect(),
        };
        Some((id(of), cause))
    };
    found.loops.iter().filter_map(seen).collect()
}

impl PlantwidePort for Plantwide {
    fn overview(&self) -> Option<Arc<Overview>> {
        lock(&self.overview).clone()
    }

    fn look(&self) -> bool {
        let may = lock(&self.watched).config.enabled && !self.looking.swap(true, Relaxed);
        if may {
            self.wanted.notify_one();
        }
        may
    }

    fn work(&self) -> Vec<WorkLine> {
        let orders: Vec<Order> = lock(&self.list).orders().cloned().collect();
        orders.into_iter().map(|order| self.line(order)).collect()
    }

    fn act(
        &self,
        id: &LoopId,
        act: Act,
        by: Option<String>,
        note: Option<String>,
    ) -> Option<Result<WorkLine, Refusal>> {
        let mut list = lock(&self.list);
        let acted = list.act(id, act, by, note, self.clock.now())?;
        self.results.swing(swings(&list));
        let acted = acted.map(|(order, moved)| {
            self.persistence.note_rows(rows::order_rows(&order, Some(&moved)));
            order
        });
        drop(list);
        Some(acted.map(|order| self.line(order)))
    }

    fn latest(&self, id: &LoopId) -> Option<Values> {
        let period_s = self.period_s();
        lock(&self.health).latest(id, self.clock.now(), period_s)
    }

    fn health(&self, id: &LoopId) -> Option<Health> {
        let (period_s, now) = (self.period_s(), self.clock.now());
        let log = lock(&self.health);
        let (found, is_fresh) = (log.of(id, now, period_s)?, log.latest(id, now, period_s).is_some());
        let last = lock(&self.last).get(id).filter(|_| is_fresh).cloned();
        Some(Health { last, ..found })
    }

    fn standing(&self, id: &LoopId) -> Standing {
        let score = self.latest(id).and_then(|values| values[SCORE]);
        let costs = lock(&self.watched).costs.clone();
        Standing { score, cost: cost_of(std::iter::once(id), &costs, &lock(&self.measures)) }
    }
}
