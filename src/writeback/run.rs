//! One task per loop: it shows the loop to the gate, puts on record what the gate says, and writes what it orders.

use super::config::{GRACE, TERM_REPEAT_S, Target};
use super::link::{Clocks, Writer};
use crate::audit::{ON_RECORD, Recorder};
use crate::compensation::gate::{
    Action, Event, Gate, Grant, Inputs, Limits, News, Order, Refusal, State, Status, WriteFault,
};
use crate::signal::{LoopId, Sample};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, oneshot, watch};
use tokio::task::JoinHandle;

/// Looks at a loop: the newest samples, the latest diagnosis, missed polls.
pub type Look = Arc<dyn Fn() -> Inputs + Send + Sync>;
/// Takes the term in force from a time on (OP unit).
pub type Keep = Arc<dyn Fn(Sample) + Send + Sync>;
/// How many samples of OP there have been.
pub type Heard = Arc<dyn Fn() -> u64 + Send + Sync>;
/// Told of everything that happens.
pub type Tell = Arc<dyn Fn(&LoopId, &News) + Send + Sync>;

/// One loop's write-back, before it runs.
pub struct LoopSetup {
    /// Which loop.
    pub id: LoopId,
    /// Its bounds.
    pub limits: Limits,
    /// Where it writes.
    pub target: Target,
    /// Longest pause between two steps.
    pub pause: Duration,
    /// Changes when OP's device has said something.
    pub polled: watch::Receiver<u64>,
    /// A step follows each sample of OP.
    pub heard: Heard,
    /// How it sees its loop.
    pub look: Look,
    /// Where the term in force is kept beside OP.
    pub keep: Keep,
    /// Longest time for which a term can be in force after it was last kept (s).
    pub lasts_s: f64,
}

/// Write-back of all loops that enable it.
pub struct Writeback {
    slots: HashMap<LoopId, Arc<Slot>>,
    tasks: Mutex<Vec<JoinHandle<()>>>,
    longest: Duration,
}

/// What the task of a loop shares with those who ask.
struct Slot {
    id: LoopId,
    gate: Mutex<Gate>,
    wake: Notify,
    /// What was said last of the term in force: since when (s, wall), and what (OP unit).
    said: Mutex<Option<(f64, f64)>>,
    keep: Keep,
    lasts_s: f64,
    percent: f64,
    clocks: Clocks,
    recorder: Arc<Recorder>,
    tell: Tell,
}

impl Writeback {
    /// Starts a task for each loop, in shadow.
    pub fn start(loops: Vec<LoopSetup>, clocks: Clocks, recorder: Arc<Recorder>, tell: Tell) -> Self {
        let limit = loops.iter().map(|own| own.limits.withdraw_limit_s + own.limits.max_step_s);
        let limit = Duration::try_from_secs_f64(limit.fold(0.0, f64::max)).unwrap_or_default();
        let (mut slots, mut tasks) = (HashMap::new(), Vec::new());
        for own in loops {
            // Before the task has its first turn: a stop that comes earlier must find something to stop.
            let mut gate = Gate::new(own.limits);
            gate.enable(clocks());
            let slot = Arc::new(Slot {
                id: own.id.clone(),
                gate: Mutex::new(gate),
                wake: Notify::new(),
                said: Mutex::default(),
                keep: own.keep,
                lasts_s: own.lasts_s,
                percent: 0.01 * own.limits.op_span,
                clocks: clocks.clone(),
                recorder: recorder.clone(),
                tell: tell.clone(),
            });
            slot.record(&mut slot.gate());
            let writer = Writer::new(own.target, clocks.clone());
            let task = Task {
                slot: slot.clone(),
                writer,
                look: own.look,
                polled: own.polled,
                heard: own.heard,
                seen: 0,
                pause: own.pause,
            };
            tasks.push(tokio::spawn(task.run()));
            slots.insert(own.id, slot);
        }
        Self { slots, tasks: Mutex::new(tasks), longest: limit + GRACE }
    }

    /// A loop's write-back; `None` where it is not enabled.
    pub fn status(&self, id: &LoopId) -> Option<Status> {
        self.slots.get(id).map(|slot| slot.gate().status())
    }

    /// Every grant that is good or waits for its approval.
    pub fn grants(&self) -> Vec<(LoopId, Grant)> {
        let granted = |slot: &Arc<Slot>| Some((slot.id.clone(), slot.gate().status().grant?));
        self.slots.values().filter_map(granted).collect()
    }

    /// An operator acts; `None` where write-back is not enabled. A grant, an approval and a reset are on record when this returns.
    /// Taking a term back is the safe direction, and waits for no record.
    ///
    /// # Errors
    /// The gate's [`Refusal`]; [`Refusal::Unrecorded`] where the disk fails or keeps the record waiting for [`ON_RECORD`]: what was
    /// granted is taken back then.
    pub async fn act(&self, id: &LoopId, action: Action, by: &str) -> Option<Result<Status, Refusal>> {
        let slot = self.slots.get(id)?;
        let now = (slot.clocks)();
        let is_safe = action == Action::Withdraw;
        let grants = matches!(action, Action::Grant(_) | Action::Approve);
        let (acted, recorded) = {
            let mut gate = slot.gate();
            let acted = match action {
                Action::Grant(duration_s) => gate.grant(by, duration_s, now),
                Action::Approve => gate.approve(by, now),
                Action::Withdraw => gate.withdraw(by, now),
                Action::Reset => gate.reset(by, now),
            };
            (acted.map(|()| gate.status()), slot.record(&mut gate))
        };
        slot.wake.notify_one();
        if is_safe || acted.is_err() || recorded.wait().await {
            return Some(acted);
        }
        if grants {
            let mut gate = slot.gate();
            // Refused where it has ended meanwhile.
            let _ = gate.withdraw(by, (slot.clocks)());
            slot.record(&mut gate);
            slot.wake.notify_one();
        }
        Some(Err(Refusal::Unrecorded))
    }

    /// Ramps every term to zero and ends; it takes at most the longest `withdraw_limit_s`, one step and two seconds. What is not at
    /// zero by then is dropped by the DCS, because the heart has stopped.
    pub async fn end(&self) {
        for slot in self.slots.values() {
            let now = (slot.clocks)();
            let mut gate = slot.gate();
            gate.stop(now);
            slot.record(&mut gate);
            slot.wake.notify_one();
        }
        let tasks = std::mem::take(&mut *self.tasks.lock().unwrap_or_else(PoisonError::into_inner));
        let deadline = tokio::time::Instant::now() + self.longest;
        for mut task in tasks {
            match tokio::time::timeout_at(deadline, &mut task).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => tracing::error!(%error, "the task of a loop's write-back failed"),
                Err(_) => {
                    task.abort();
                    tracing::error!("a term could not be ramped to zero in time; the heartbeat has stopped");
                }
            }
        }
    }
}

impl Slot {
    /// A panic elsewhere leaves a gate that is judged anew at its next step; its order counts as failed.
    fn gate(&self) -> MutexGuard<'_, Gate> {
        self.gate.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells everybody and puts it on record, while the gate is held: so the order on record is the order it happened
    /// in. What comes back is to be waited for where nothing is in force yet; on the way to zero the plant comes first.
    fn record(&self, gate: &mut Gate) -> OnRecord {
        let follow = |one: &News| {
            let (event, fields) = self.told(one);
            self.recorder.follow(one.at, event, fields)
        };
        OnRecord(gate.take_news().iter().map(follow).collect())
    }

    fn told(&self, news: &News) -> (&'static str, Vec<(&'static str, String)>) {
        (self.tell)(&self.id, news);
        let (event, mut fields) = entry(&news.event);
        fields.insert(0, ("loop", self.id.to_string()));
        (event, fields)
    }

    fn put_order(&self, order: &Order, at: f64) -> bool {
        let fields = vec![
            ("loop", self.id.to_string()),
            ("term", order.term().to_string()),
            ("heartbeat", order.heartbeat().to_string()),
        ];
        self.recorder.put(at, "write", fields)
    }

    /// Puts the term in force beside the samples of OP: for the diagnosis, the store and whoever replays them.
    fn remember(&self, at: f64, term: f64) {
        self.lapse(at);
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let value = term * self.percent;
        // One of 0 stands until the next: repeated, it would take the place of those that acted in the ring.
        let stands_s = if value == 0.0 { f64::INFINITY } else { TERM_REPEAT_S };
        // A clock that was set back is no reason to be silent.
        let known =
            said.is_some_and(|(since, last)| last == value && (0.0..stands_s).contains(&(at - since)));
        if !known {
            *said = Some((at, value));
            (self.keep)(Sample::good(at, value));
        }
    }

    /// Ends a term that was not written for so long that the DCS has dropped it: as of when it had.
    fn lapse(&self, at: f64) {
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let dropped = said.filter(|(since, last)| *last != 0.0 && at - since > self.lasts_s);
        if let Some((since, _)) = dropped {
            let end = since + self.lasts_s;
            *said = Some((end, 0.0));
            (self.keep)(Sample::good(end, 0.0));
        }
    }
}

/// Entries on their way to the disk.
struct OnRecord(Vec<oneshot::Receiver<()>>);

impl OnRecord {
    /// Waits for the disk; false when it failed, or hangs.
    async fn wait(self) -> bool {
        let all = async {
            for entry in self.0 {
                if entry.await.is_err() {
                    return false;
                }
            }
            true
        };
        tokio::time::timeout(ON_RECORD, all).await.unwrap_or(false)
    }
}

/// How an event stands in the log.
fn entry(event: &Event) -> (&'static str, Vec<(&'static str, String)>) {
    match event {
        Event::Moved { from, to, cause, by } => {
            let mut fields = vec![
                ("from", from.as_str().to_string()),
                ("to", to.as_str().to_string()),
                ("cause", cause.code().to_string()),
            ];
            fields.extend(by.iter().map(|by| ("by", by.clone())));
            ("transition", fields)
        }
        Event::Granted { by, until } => ("grant", vec![("by", by.clone()), ("until", until.to_string())]),
        Event::Approved { by } => ("approval", vec![("by", by.clone())]),
        Event::GrantExpired => ("grant_expired", Vec::new()),
        Event::GrantDropped { by } => ("grant_dropped", vec![("by", by.clone())]),
    }
}

struct Task {
    slot: Arc<Slot>,
    writer: Writer,
    look: Look,
    polled: watch::Receiver<u64>,
    heard: Heard,
    /// Samples of OP when there was last a new one.
    seen: u64,
    pause: Duration,
}

impl Task {
    async fn run(mut self) {
        while self.slot.gate().state() != State::Disabled {
            self.wait().await;
            self.step().await;
        }
    }

    /// Until there is another OP, somebody acted, or the pause is over. What else the device says is no reason to write: a broker
    /// may have much to say.
    async fn wait(&mut self) {
        let pause = tokio::time::sleep(self.pause);
        tokio::pin!(pause);
        let mut is_there = true;
        loop {
            tokio::select! {
                changed = self.polled.changed(), if is_there => match changed {
                    Ok(()) if self.has_new_op() => return,
                    Ok(()) => {}
                    // The device is gone; its samples grow old, which the gate sees.
                    Err(_) => is_there = false,
                },
                () = self.slot.wake.notified() => return,
                () = &mut pause => return,
            }
        }
    }

    fn has_new_op(&mut self) -> bool {
        let heard = (self.heard)();
        std::mem::replace(&mut self.seen, heard) != heard
    }

    async fn step(&mut self) {
        let inputs = Inputs { audited: self.slot.recorder.works(), ..(self.look)() };
        let now = (self.slot.clocks)();
        let (order, recorded, state) = {
            let mut gate = self.slot.gate();
            let order = gate.step(now, &inputs);
            (order, self.slot.record(&mut gate), gate.state())
        };
        let Some(order) = order else {
            // Whatever could not be written, the DCS has dropped, or will once the heart has stood still for long enough.
            self.slot.remember(now.wall, 0.0);
            self.writer.close();
            return;
        };
        let leaving = state == State::Withdrawing;
        let recorded = leaving || recorded.wait().await;
        let meanwhile = self.slot.gate().state();
        if meanwhile != state {
            // While the disk was waited for somebody has taken the term back.
            return self.done(order, Err(WriteFault::Withheld));
        }
        let recorded = self.slot.put_order(&order, now.wall) && recorded;
        let outcome =
            if recorded || leaving { self.writer.write(&order).await } else { Err(WriteFault::Audit) };
        self.done(order, outcome);
    }

    fn done(&mut self, order: Order, outcome: Result<(), WriteFault>) {
        let now = (self.slot.clocks)();
        match outcome {
            Ok(()) => self.slot.remember(now.wall, order.term()),
            Err(fault) => {
                let why = self.why(fault).to_string();
                tracing::warn!(id = %self.slot.id, ?fault, why, "a term was not written");
                let id = self.slot.id.to_string();
                self.slot.recorder.put(now.wall, "write_failed", vec![("loop", id), ("why", why)]);
                self.slot.lapse(now.wall);
            }
        }
        let mut gate = self.slot.gate();
        gate.report(order, outcome, now);
        self.slot.record(&mut gate);
        if outcome == Err(WriteFault::Withheld) {
            // The next step has another order, and must not wait for the next OP.
            self.slot.wake.notify_one();
        }
    }

    /// Why a term was not written. What cannot be put on record is not sent, so the writer knows nothing of it.
    fn why(&self, fault: WriteFault) -> &str {
        match fault {
            WriteFault::Audit => "it cannot be put on record",
            WriteFault::Withheld => "it had become too old, or somebody acted before it was sent",
            WriteFault::Failed | WriteFault::ReadBack => self.writer.why(),
        }
    }
}

#[cfg(test)]
mod tests;
