//! When and where a diagnosis runs.
//!
//! Every loop has a period; within it the loops are spread evenly by position, so that 2,000 loops are a steady trickle
//! and never a burst. Runs wait in two queues for one of `parallelism` slots, each of which runs one diagnosis at a time on a
//! blocking thread. What somebody asks for goes before what is due. A loop waits or runs once at most, so the queue of due runs
//! is bounded by the number of loops. After a start every loop needs a full search, and runs are late. A run that falls due while
//! the previous one waits or runs is skipped and counted.
//!
//! A diagnosis cannot be interrupted. One past its deadline is reported as failed and its late result dropped, but its slot
//! and its loop count as busy until it returns: otherwise a diagnosis that hangs would take thread after thread.
//! A panic ends one run, is counted, and harms nothing else.
//!
//! A loop whose source is silent is not diagnosed: that is told in place of a verdict on old samples. A run counts for alarms
//! only where its record, and what was fitted of it, has gone on since the run that counted last.

mod clock;
mod config;
mod counters;
mod evidence;
mod queues;
mod stagger;

pub use clock::Clock;
pub use config::Config;
pub use counters::Counters;
pub use evidence::Silence;
pub use queues::Refused;
pub use stagger::{Job, next_due, stagger};

use crate::diagnosis::Settings;
use crate::residual::Structure;
use crate::results::{Basis, Judged, Outcome, Results, Run, Told, Trigger};
use crate::signal::{LoopId, Record};
use counters::Counts;
use evidence::{Before, Counted, Reach};
use futures::future::BoxFuture;
use queues::Queues;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Semaphore, oneshot, watch};
use tokio_util::sync::CancellationToken;

/// Callers that may wait for one run.
const MAX_WAITERS: usize = 16;
/// Later than anything is waited for.
const NEVER: Duration = Duration::from_secs(100 * 365 * 86_400);
/// Runs that may wait for another machine at the same time.
const MAX_ASKED: usize = 64;

/// The function that judges a record; it searches for nothing where the structure that the loop's last run found still holds.
pub type Diagnose = Arc<dyn Fn(&Record, &Settings, Option<&Structure>) -> Judged + Send + Sync>;

/// What somebody else is asked to diagnose.
#[derive(Clone)]
pub struct Asked {
    /// Which loop.
    pub id: LoopId,
    /// The copy of what is remembered of it.
    pub record: Arc<Record>,
    /// What a diagnosis of it depends on beside the samples.
    pub basis: Arc<Basis>,
    /// When the copy was made (s).
    pub started: f64,
    /// Who wants it.
    pub trigger: Trigger,
    /// Stamp of the newest good sample of OP and PV (s).
    pub newest: Option<f64>,
    /// Time between two runs of the loop (s).
    pub period_s: f64,
}

/// Asks another machine for a diagnosis; `None` when nobody answers: then it is made here.
pub type Elsewhere = Arc<dyn Fn(Asked) -> BoxFuture<'static, Option<Told>> + Send + Sync>;

/// Copies what is remembered of a loop.
pub type Snapshot = Arc<dyn Fn(&LoopId) -> Option<Record> + Send + Sync>;

/// What to run, on what, and how to judge it; replaced as a whole on reload.
#[derive(Clone)]
pub struct Plan {
    /// The loops, in the order that spreads them.
    pub jobs: Vec<Job>,
    /// Where the records come from.
    pub snapshot: Snapshot,
    /// Which loops nothing comes of any more.
    pub silence: Silence,
    /// Settings of the diagnosis.
    pub settings: Settings,
    /// Loops that have no job are those of other machines.
    pub follows: bool,
    /// Loops whose every run searches: write-back may act on them.
    pub searched: HashSet<LoopId>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Idle,
    Queued(Trigger),
    Running,
    Overrunning,
}

/// One loop in the scheduler; outlives reloads.
#[derive(Debug)]
struct Seat {
    id: LoopId,
    inner: Mutex<(Phase, Vec<oneshot::Sender<Arc<Run>>>)>,
    counted: Counted,
}

impl Seat {
    fn new(id: LoopId) -> Self {
        Self { id, inner: Mutex::new((Phase::Idle, Vec::new())), counted: Counted::default() }
    }

    fn lock(&self) -> MutexGuard<'_, (Phase, Vec<oneshot::Sender<Arc<Run>>>)> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Enters a phase; leaving the run behind, its waiters are taken along.
    fn enter(&self, phase: Phase) -> Vec<oneshot::Sender<Arc<Run>>> {
        let mut inner = self.lock();
        inner.0 = phase;
        match phase {
            Phase::Idle | Phase::Overrunning => std::mem::take(&mut inner.1),
            _ => Vec::new(),
        }
    }
}

struct Table {
    plan: Plan,
    seats: Vec<Arc<Seat>>,
    by_id: HashMap<LoopId, usize>,
}

/// Runs diagnoses by period and on demand.
pub struct Scheduler {
    config: Config,
    clock: Clock,
    diagnose: Diagnose,
    results: Arc<Results>,
    table: watch::Sender<Arc<Table>>,
    queues: Queues<Arc<Seat>>,
    elsewhere: Option<Elsewhere>,
    /// Diagnoses that may be made here at the same time.
    here: Semaphore,
    counts: Counts,
}

impl Scheduler {
    /// A scheduler that does nothing until [`Scheduler::run`].
    pub fn new(config: Config, clock: Clock, diagnose: Diagnose, results: Arc<Results>, plan: Plan) -> Self {
        let queues = Queues::new(config.queue);
        Self {
            table: watch::Sender::new(Arc::new(Table::new(plan, None))),
            here: Semaphore::new(config.parallelism.max(1)),
            elsewhere: None,
            config,
            clock,
            diagnose,
            results,
            queues,
            counts: Counts::default(),
        }
    }

    /// Asks another machine first.
    #[must_use]
    pub fn asking(mut self, elsewhere: Elsewhere) -> Self {
        self.elsewhere = Some(elsewhere);
        self
    }

    /// Takes another plan; runs in progress end as they would have. `parallelism`, `deadline_s` and `queue` stay as they
    /// were at the start.
    pub fn replace(&self, plan: Plan) {
        self.table.send_modify(|table| *table = Arc::new(Table::new(plan, Some(table))));
    }

    /// What happened so far.
    pub fn counters(&self) -> Counters {
        self.counts.with(self.queues.waiting())
    }

    /// Asks for a diagnosis now. If the loop is already queued or running the caller waits for that run. The run goes on
    /// when the receiver is dropped.
    ///
    /// # Errors
    /// [`Refused`], when nothing was begun.
    pub fn request(&self, id: &LoopId) -> Result<oneshot::Receiver<Arc<Run>>, Refused> {
        self.ask(id, Trigger::OnDemand)
    }

    /// The same, in the name of whoever it was: a replay asks for what was due.
    ///
    /// # Errors
    /// [`Refused`], when nothing was begun.
    pub fn ask(&self, id: &LoopId, trigger: Trigger) -> Result<oneshot::Receiver<Arc<Run>>, Refused> {
        let table = self.table.borrow().clone();
        let unknown = if table.plan.follows { Refused::NotHere } else { Refused::UnknownLoop };
        let seat = &table.seats[*table.by_id.get(id).ok_or(unknown)?];
        let (done, receiver) = oneshot::channel();
        let mut inner = seat.lock();
        inner.1.retain(|waiter| !waiter.is_closed());
        match inner.0 {
            Phase::Overrunning => return Err(Refused::Overrunning),
            _ if inner.1.len() >= MAX_WAITERS => return Err(Refused::Busy),
            // Who asks wants a search, and at once.
            Phase::Queued(Trigger::Periodic) if trigger == Trigger::OnDemand => {
                self.enqueue(seat, &mut inner.0, trigger)?;
            }
            Phase::Queued(_) | Phase::Running => {}
            Phase::Idle => self.enqueue(seat, &mut inner.0, trigger)?,
        }
        inner.1.push(done);
        Ok(receiver)
    }

    /// Runs until the token is cancelled. A diagnosis still running then is left to its thread.
    pub fn run(&self, token: CancellationToken) -> BoxFuture<'_, ()> {
        // Boxed here, so that a binary that calls it does not compile the scheduler once more.
        Box::pin(self.until(token))
    }

    async fn until(&self, token: CancellationToken) {
        let asked = if self.elsewhere.is_some() { MAX_ASKED } else { 0 };
        let slots = (0..self.config.parallelism.max(1) + asked).map(|_| self.slot(&token));
        tokio::join!(self.tick(&token), futures::future::join_all(slots));
        // Who waits is told that nothing comes.
        for seat in self.queues.close().await {
            drop(seat.enter(Phase::Idle));
        }
    }

    /// Begins what is due, when it is due.
    async fn tick(&self, token: &CancellationToken) {
        let mut changes = self.table.subscribe();
        while !token.is_cancelled() {
            let table = changes.borrow_and_update().clone();
            tokio::select! {
                () = token.cancelled() => return,
                changed = changes.changed() => if changed.is_err() { return },
                () = self.follow(&table) => {}
            }
        }
    }

    async fn follow(&self, table: &Table) {
        let schedule = stagger(&table.plan.jobs);
        let now = self.clock.elapsed();
        let mut due: BinaryHeap<_> = schedule
            .iter()
            .enumerate()
            .map(|(at, &(offset, period))| Reverse((next_due(offset, period, now).0, at)))
            .collect();
        while let Some(Reverse((when, at))) = due.pop() {
            self.clock.sleep_until(when).await;
            let (offset, period) = schedule[at];
            let (next, passed) = next_due(offset, period, self.clock.elapsed().max(when));
            let late = passed.saturating_sub(next_due(offset, period, when).1);
            self.counts.skipped_late.fetch_add(late, Relaxed);
            self.begin(&table.seats[at]);
            due.push(Reverse((next, at)));
        }
        std::future::pending::<()>().await;
    }

    fn begin(&self, seat: &Arc<Seat>) {
        let mut inner = seat.lock();
        if inner.0 != Phase::Idle {
            self.counts.skipped_waiting.fetch_add(1, Relaxed);
        } else if self.enqueue(seat, &mut inner.0, Trigger::Periodic).is_err() {
            tracing::debug!(r#loop = %seat.id, "due while the daemon shuts down");
        }
    }

    fn enqueue(&self, seat: &Arc<Seat>, phase: &mut Phase, trigger: Trigger) -> Result<(), Refused> {
        match trigger {
            Trigger::OnDemand => self.queues.ask(seat.clone())?,
            Trigger::Periodic => self.queues.due(seat.clone())?,
        }
        *phase = Phase::Queued(trigger);
        Ok(())
    }

    async fn slot(&self, token: &CancellationToken) {
        loop {
            let seat = tokio::select! {
                () = token.cancelled() => return,
                seat = self.queues.next() => match seat {
                    Some(seat) => seat,
                    None => return,
                },
            };
            self.counts.running.fetch_add(1, Relaxed);
            tokio::select! {
                () = token.cancelled() => return,
                () = self.run_one(&seat) => {}
            }
            self.counts.running.fetch_sub(1, Relaxed);
        }
    }

    async fn run_one(&self, seat: &Arc<Seat>) {
        // A loop that went away and came back while it waited has another seat now.
        let is_own = |table: &Table| table.by_id.get(&seat.id).map(|at| Arc::ptr_eq(&table.seats[*at], seat));
        if is_own(&self.table.borrow()) == Some(false) {
            return drop(seat.enter(Phase::Idle));
        }
        let trigger = {
            let mut inner = seat.lock();
            let Phase::Queued(trigger) = inner.0 else { return };
            inner.0 = Phase::Running;
            trigger
        };
        let (started, began) = (self.clock.now(), tokio::time::Instant::now());
        // The loop may have gone away between being due and being run.
        match self.copied(&seat.id, started, trigger).await {
            None => drop(seat.enter(Phase::Idle)),
            Some(asked) => self.answer(seat, &asked, began).await,
        }
        self.counts.busy_us.fetch_add(began.elapsed().as_micros() as u64, Relaxed);
    }

    /// Says what there is to say of a record: that nothing comes any more, what others say, or what is found here.
    async fn answer(&self, seat: &Arc<Seat>, asked: &Asked, began: tokio::time::Instant) {
        let finish = |outcome, finished| self.finish(seat, (asked, began, finished), outcome, Phase::Idle);
        if let Some(silent) = asked.basis.silent {
            self.count(None);
            return finish(evidence::of_silence(silent), self.clock.now());
        }
        match self.told(asked).await {
            Some(told) => {
                self.count_told(&told);
                // It ended when it says so: the same on every machine that keeps it.
                let finished = told.summary.time;
                finish(Outcome::Elsewhere(Box::new(told)), finished);
            }
            None => self.judge(seat, asked, began).await,
        }
    }

    /// What is remembered of a loop, and what a diagnosis of it depends on.
    async fn copied(&self, id: &LoopId, started: f64, trigger: Trigger) -> Option<Asked> {
        let (table, own) = (self.table.borrow().clone(), id.clone());
        // Who asks wants everything looked at.
        let given = trigger == Trigger::Periodic && !table.plan.searched.contains(id);
        let structure = given.then(|| self.results.structure(id)).flatten();
        let friction = self.results.before(id);
        // Of one that has gone there is nothing to copy.
        let period_s = table.by_id.get(id).map_or(f64::INFINITY, |at| table.plan.jobs[*at].period_s);
        let copied = tokio::task::spawn_blocking(move || {
            let record = (table.plan.snapshot)(&own)?;
            let silent = (table.plan.silence)(&own, &record, period_s);
            let basis = Basis::of(&record, &table.plan.settings, structure).after(friction).silent(silent);
            Some((evidence::newest(&record), Arc::new(record), Arc::new(basis)))
        });
        let (newest, record, basis) = match copied.await {
            Ok(copied) => copied?,
            Err(error) => {
                // Without one the runtime is going down.
                if let Ok(panic) = error.try_into_panic() {
                    self.counts.panicked.fetch_add(1, Relaxed);
                    let message = said(panic.as_ref());
                    tracing::error!(control_loop = %id, message, "the copy of a loop's samples panicked");
                }
                return None;
            }
        };
        Some(Asked { id: id.clone(), record, basis, started, trigger, newest, period_s })
    }

    async fn told(&self, asked: &Asked) -> Option<Told> {
        (self.elsewhere.as_ref()?)(asked.clone()).await
    }

    /// Diagnoses here.
    async fn judge(&self, seat: &Arc<Seat>, asked: &Asked, began: tokio::time::Instant) {
        let Ok(_permit) = self.here.acquire().await else { return };
        let (diagnose, own) = (self.diagnose.clone(), asked.clone());
        let mut work = tokio::task::spawn_blocking(move || {
            let Asked { record, basis, .. } = &own;
            let judged = || diagnose(record, &basis.settings, basis.structure.as_ref());
            let judged = catch_unwind(AssertUnwindSafe(judged));
            judged.map_err(|panic| said(panic.as_ref()))
        });
        let finish = |outcome, phase| self.finish(seat, (asked, began, self.clock.now()), outcome, phase);
        // What others took to answer counts for nothing.
        let from = if self.elsewhere.is_some() { tokio::time::Instant::now() } else { began };
        let deadline = Duration::try_from_secs_f64(self.config.deadline_s).unwrap_or(NEVER);
        match tokio::time::timeout_at(from + deadline, &mut work).await {
            Ok(Ok(Ok(judged))) => {
                self.count(judged.structure());
                let (before, after) = (self.results.effects(&asked.id), judged.effects());
                if after != before {
                    tracing::info!(control_loop = %seat.id, ?before, ?after, "the effects in a loop's model changed");
                }
                finish(Outcome::Diagnosed(Box::new(judged)), Phase::Idle);
            }
            Ok(Ok(Err(message))) => {
                self.counts.panicked.fetch_add(1, Relaxed);
                tracing::error!(control_loop = %seat.id, message, "a diagnosis panicked");
                finish(Outcome::Panicked(message), Phase::Idle);
            }
            // The runtime is going down.
            Ok(Err(_)) => drop(seat.enter(Phase::Idle)),
            Err(_) => {
                self.counts.deadline_exceeded.fetch_add(1, Relaxed);
                tracing::warn!(control_loop = %seat.id, deadline_s = self.config.deadline_s, "a diagnosis passed its deadline");
                finish(Outcome::DeadlineExceeded, Phase::Overrunning);
                // Its result, whatever it is, comes too late to be told.
                let _ = work.await;
                seat.enter(Phase::Idle);
            }
        }
    }

    /// Counts a run of another machine as one that ended so here.
    fn count_told(&self, told: &Told) {
        match &*told.summary.outcome {
            "panicked" => {
                self.counts.panicked.fetch_add(1, Relaxed);
            }
            "deadline_exceeded" => {
                self.counts.deadline_exceeded.fetch_add(1, Relaxed);
            }
            _ => self.count(told.structure.as_ref()),
        }
    }

    /// Counts a run that ended with a diagnosis.
    fn count(&self, structure: Option<&Structure>) {
        self.counts.diagnosed.fetch_add(1, Relaxed);
        let confirmed = structure.is_some_and(|structure| structure.confirmed > 0);
        self.counts.confirmed.fetch_add(u64::from(confirmed), Relaxed);
    }

    /// Records a run, and hands it to those who wait for it.
    fn finish(
        &self,
        seat: &Arc<Seat>,
        (asked, began, finished): (&Asked, tokio::time::Instant, f64),
        outcome: Outcome,
        phase: Phase,
    ) {
        let basis = (!matches!(outcome, Outcome::DeadlineExceeded)).then(|| asked.basis.clone());
        let run = Run {
            id: seat.id.clone(),
            started: asked.started,
            finished,
            took_s: began.elapsed().as_secs_f64(),
            trigger: asked.trigger,
            op_span: basis.as_ref().and_then(|basis| basis.op_span),
            basis,
            outcome,
        };
        let before = || {
            let ago_s = evidence::last_said(&self.results.summaries(&seat.id)?, finished)?;
            Some(Before { ago_s, fitted: self.results.fitted_before(&seat.id) })
        };
        let reach = || asked.newest.map(|newest| Reach { newest, fitted: run.fitted_until() });
        let again =
            evidence::says(run.outcome.as_str()) && !seat.counted.takes(reach(), asked.period_s, before);
        let run = if again { self.results.record_again(run) } else { self.results.record(run) };
        for waiter in seat.enter(phase) {
            // An error here only means that the caller did not wait.
            let _ = waiter.send(run.clone());
        }
    }
}

impl Table {
    fn new(plan: Plan, before: Option<&Arc<Table>>) -> Self {
        let seat = |job: &Job| {
            let known = before.and_then(|table| Some(table.seats[*table.by_id.get(&job.id)?].clone()));
            known.unwrap_or_else(|| Arc::new(Seat::new(job.id.clone())))
        };
        let seats = plan.jobs.iter().map(seat).collect();
        let by_id = plan.jobs.iter().enumerate().map(|(at, job)| (job.id.clone(), at)).collect();
        Self { seats, by_id, plan }
    }
}

/// What a panic said.
fn said(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_string());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "no message".to_string())
}

#[cfg(test)]
mod tests;
