//! The poll loop of one device: a fixed rate, and for every tag one sample a poll.
//!
//! ```text
//!           a poll without any value                     pause over, one request asked
//! closed ----------------------------> open (not asked) ------------------------------> half open
//!    ^                                   ^                                                |  |
//!    |                                   +-------- no answer: a longer pause -------------+  |
//!    +------------------------------------ an answer: the others are asked too -------------+
//! ```
//! So a unit that is gone costs those who share its gateway one time-out a pause.

use super::line::{Line, State};
use super::link::{Answer, Link, Lost, Refusal};
use super::plan::{Plan, Tag};
use super::slots::Slots;
use super::wire::{Dial, sockets};
use crate::collect::backoff::Backoff;
use crate::collect::{Clock, DeviceHealth, Frozen, Poll, Reading, Sink};
use crate::signal::{BadReason, Quality, Sample};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval_at, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

/// A device that was busy is asked again after this long, where the period leaves the time.
const BUSY_PAUSE: Duration = Duration::from_millis(100);
/// After so many connections in a row that the device closed after one use each, each request gets one of its own.
const CLOSES: u32 = 3;
/// First polls of the devices spread over at most this long.
const LONGEST_STAGGER: Duration = Duration::from_secs(1);

/// Polls one device until it is told to stop.
pub struct Collector {
    plan: Plan,
    clock: Arc<dyn Clock>,
    dial: Dial,
    health: Arc<DeviceHealth>,
    slots: Slots,
    frozen: Vec<Option<Frozen>>,
    line: Arc<Line>,
    backoff: Backoff,
    /// Why the last poll brought nothing, while that is so.
    open_for: Option<BadReason>,
    random: Pcg32,
    down: bool,
    /// Connections in a row that were closed by the device before they could be used again.
    closes: u32,
}

/// What one poll has brought so far.
struct Round {
    deadline: Instant,
    good: usize,
    bad: usize,
    any_answer: bool,
    unanswered: Vec<(usize, BadReason)>,
    losses: usize,
    unreachable: bool,
    gateway_refused: bool,
    /// Requests for which the device was busy, and when that was said.
    busy: Vec<(usize, Instant)>,
}

/// What became of one request.
enum Asked {
    Answered(Answer),
    Lost(Lost),
    /// No connection could be made.
    Unreachable,
}

impl Collector {
    /// A collector for the plan. `seed` decides the jitter only: give each device another.
    pub fn new(plan: Plan, clock: Arc<dyn Clock>, seed: u64) -> Self {
        let mut random = Pcg32::seed_from_u64(seed);
        // Half a period, so that the first new attempt is due at the very next poll.
        let backoff =
            Backoff::new(plan.period / 2, plan.reconnect_max, Pcg32::seed_from_u64(random.random()));
        Self {
            clock,
            dial: sockets(),
            health: Arc::default(),
            slots: Slots::new(plan.requests.clone()),
            frozen: plan.tags.iter().map(|tag| tag.frozen_after_s.map(Frozen::new)).collect(),
            line: Line::of(&plan),
            backoff,
            open_for: None,
            random,
            down: false,
            closes: 0,
            plan,
        }
    }

    /// Connects by `dial` and not by TCP: a simulated network.
    pub fn dialling(self, dial: Dial) -> Self {
        Self { dial, ..self }
    }

    /// The device's counters, live.
    pub fn health(&self) -> Arc<DeviceHealth> {
        Arc::clone(&self.health)
    }

    /// Polls at the plan's period until `shutdown` is cancelled. Every poll hands each tag's sample to the
    /// sink exactly once. Stopping drops the connection and any answer still under way.
    pub async fn run(mut self, sink: Arc<dyn Sink>, shutdown: CancellationToken) {
        let health = self.health();
        shutdown.run_until_cancelled(self.poll_for_ever(&*sink)).await;
        health.disconnected();
    }

    async fn poll_for_ever(&mut self, sink: &dyn Sink) {
        let period = self.plan.period;
        let stagger = period.min(LONGEST_STAGGER).mul_f64(self.random.random_range(0.0..1.0));
        let anchor = Instant::now() + stagger;
        let mut ticks = interval_at(anchor, period);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut next = 0;
        loop {
            let tick = ticks.tick().await;
            let number = tick_number(tick.saturating_duration_since(anchor), period);
            self.health.missed(number.saturating_sub(next));
            next = number + 1;
            let began = Instant::now();
            let round = self.poll(number, tick + period, sink).await;
            let took = began.elapsed();
            self.health.poll_done(took > period);
            let (good, bad) = (round.good, round.bad);
            sink.poll(self.plan.device, Poll { t: self.clock.now(), good, bad, took });
        }
    }

    async fn poll(&mut self, number: u64, deadline: Instant, sink: &dyn Sink) -> Round {
        let mut round = Round {
            deadline,
            good: 0,
            bad: 0,
            any_answer: false,
            unanswered: Vec::new(),
            losses: 0,
            unreachable: false,
            gateway_refused: false,
            busy: Vec::new(),
        };
        let order = self.slots.order(number);
        let mut due = order.due;
        if !self.backoff.due(Instant::now()) {
            due.extend(order.resting.into_iter().map(|(slot, _)| slot));
            self.give_up(&mut due, self.open_for.unwrap_or(BadReason::LinkDown), &mut round, sink);
        } else {
            let mut resting = order.resting;
            self.ask_all(due, &mut round, sink).await;
            if round.unreachable && !round.any_answer {
                resting.iter_mut().for_each(|(_, reason)| *reason = BadReason::LinkDown);
            }
            for (slot, reason) in resting {
                self.emit_bad(slot, reason, &mut round, sink);
            }
            self.judge(&round);
        }
        self.slots.poll_ended(number, &round.unanswered, round.any_answer);
        round
    }

    /// Opens or closes the breaker after a poll in which something was asked.
    fn judge(&mut self, round: &Round) {
        let silent = if round.any_answer {
            // Also when no second connection could be made: a device that answered is there.
            (round.gateway_refused && round.good == 0).then_some(BadReason::DeviceException)
        } else if round.unreachable {
            Some(BadReason::LinkDown)
        } else {
            round.unanswered.last().map(|(_, reason)| *reason)
        };
        self.open_for = silent;
        if silent.is_some() {
            self.backoff.failed(Instant::now());
        } else if round.any_answer {
            self.backoff.reset();
        }
    }

    /// Asks what is due. A lost link is opened again once a poll and within its period; when it is lost again,
    /// the rest waits for the next poll, so that a dead device costs two time-outs, not one a request.
    async fn ask_all(&mut self, mut due: VecDeque<usize>, round: &mut Round, sink: &dyn Sink) {
        let half_open = self.open_for.is_some();
        while let Some(slot) = due.pop_front() {
            if let Some((_, since)) = round.busy.iter().find(|(busy, _)| *busy == slot) {
                sleep_until((*since + BUSY_PAUSE).min(round.deadline)).await;
            }
            let lost = match self.ask(slot).await {
                Asked::Answered(answer) => {
                    round.any_answer = true;
                    match answer {
                        Ok(words) => self.emit(slot, &words, round, sink),
                        Err(refusal) => self.refused(slot, refusal, &mut due, round, sink),
                    }
                    continue;
                }
                Asked::Unreachable => {
                    round.unreachable = true;
                    due.push_front(slot);
                    return self.give_up(&mut due, BadReason::LinkDown, round, sink);
                }
                Asked::Lost(lost) => lost,
            };
            self.lost(&lost);
            round.losses += 1;
            let reason = match lost {
                Lost::Timeout => BadReason::Timeout,
                Lost::Closed | Lost::Broken(_) => BadReason::LinkDown,
            };
            let first = round.losses == 1;
            // One accident of the line costs no sample.
            if first && !matches!(lost, Lost::Timeout) {
                due.push_front(slot);
            } else {
                round.unanswered.push((slot, reason));
                self.emit_bad(slot, reason, round, sink);
            }
            let probed = half_open && !round.any_answer && matches!(lost, Lost::Timeout);
            if !first || probed || Instant::now() >= round.deadline {
                return self.give_up(&mut due, reason, round, sink);
            }
        }
    }

    /// Takes its turn on the line, opens the connection where there is none, and asks.
    async fn ask(&mut self, slot: usize) -> Asked {
        let line = Arc::clone(&self.line);
        let mut turn = line.turn(self.plan.min_gap).await;
        if let Some(link) = turn.link.take().filter(|_| self.closes < CLOSES) {
            match self.ask_over(link, slot, &mut turn).await {
                // Many devices close a connection after each answer, or one that idled: that is no fault.
                Asked::Lost(Lost::Closed) => self.closed(),
                asked => {
                    self.closes = 0;
                    return asked;
                }
            }
        }
        let plan = &self.plan;
        match Link::open(&self.dial, &plan.address, plan.framing, plan.timeout).await {
            Ok(link) => {
                debug!(device = %plan.name, address = %plan.address, "connected");
                self.health.connected();
                self.ask_over(link, slot, &mut turn).await
            }
            Err(lost) => {
                turn.used();
                self.lost(&lost);
                Asked::Unreachable
            }
        }
    }

    async fn ask_over(&self, link: Link, slot: usize, turn: &mut State) -> Asked {
        let (plan, span) = (&self.plan, self.slots.request(slot).span);
        let asked = link.read(plan.unit_id, span, &plan.tolerate, plan.timeout).await;
        turn.used();
        match asked {
            Ok((link, answer)) => {
                turn.link = Some(link);
                self.health.reached();
                Asked::Answered(answer)
            }
            Err(lost) => Asked::Lost(lost),
        }
    }

    /// The device closed a connection that it had answered over.
    fn closed(&mut self) {
        self.health.disconnected();
        self.closes += 1;
        if self.closes == CLOSES {
            info!(device = %self.plan.name, "the device closes its connections: each request gets one of its own");
        } else {
            debug!(device = %self.plan.name, "the device closed the connection: it is opened again");
        }
    }

    /// Counts and reports the loss of the link; only the first since the last answer is a warning.
    fn lost(&mut self, lost: &Lost) {
        self.health.disconnected();
        match lost {
            Lost::Timeout => self.health.timed_out(),
            Lost::Closed | Lost::Broken(_) => self.health.link_failed(),
        }
        if std::mem::replace(&mut self.down, true) {
            debug!(device = %self.plan.name, "{lost}");
        } else {
            warn!(device = %self.plan.name, "{lost}");
        }
    }

    /// The device is alive and refuses this request. It is divided when tags can be saved so.
    fn refused(
        &mut self,
        slot: usize,
        refusal: Refusal,
        due: &mut VecDeque<usize>,
        round: &mut Round,
        sink: &dyn Sink,
    ) {
        self.health.refused();
        // Once in a poll: a device that is busy for longer is asked by the next one.
        let again = refusal.is_busy() && round.busy.iter().all(|(busy, _)| *busy != slot);
        if again && Instant::now() + BUSY_PAUSE < round.deadline {
            round.busy.push((slot, Instant::now()));
            due.push_back(slot);
            return;
        }
        let span = self.slots.request(slot).span;
        let upper = if refusal.may_be_a_hole() { self.slots.split(slot, &self.plan.tags) } else { None };
        if let Some(upper) = upper {
            info!(device = %self.plan.name, register = %span.register, start = span.start, count = span.count,
                "request refused and divided: {refusal}");
            if Instant::now() < round.deadline {
                due.push_front(upper);
                due.push_front(slot);
            } else {
                self.emit_bad(slot, BadReason::DeviceException, round, sink);
                self.emit_bad(upper, BadReason::DeviceException, round, sink);
            }
            return;
        }
        if self.slots.refused(slot) {
            warn!(device = %self.plan.name, register = %span.register, start = span.start, count = span.count,
                "request refused: {refusal}");
        }
        self.emit_bad(slot, BadReason::DeviceException, round, sink);
        if refusal.is_gateway() {
            round.gateway_refused = true;
            self.give_up(due, BadReason::DeviceException, round, sink);
        }
    }

    fn emit(&mut self, slot: usize, words: &[u16], round: &mut Round, sink: &dyn Sink) {
        self.slots.answered(slot);
        if std::mem::take(&mut self.down) {
            info!(device = %self.plan.name, "answers again");
        }
        let t = self.clock.now();
        let request = self.slots.request(slot);
        for &at in &request.tags {
            let tag = &self.plan.tags[at];
            let from = usize::from(tag.span.start - request.span.start);
            let reading = words.get(from..).and_then(|words| tag.decoder.decode(words));
            let mut reading = reading.unwrap_or(Reading::bad(BadReason::DeviceException));
            if let (Quality::Good, Some(frozen)) = (reading.quality, &mut self.frozen[at])
                && frozen.update(t, reading.value)
            {
                reading.quality = Quality::Stale;
            }
            hand_over(&self.health, tag, t, reading, round, sink);
        }
    }

    fn emit_bad(&self, slot: usize, reason: BadReason, round: &mut Round, sink: &dyn Sink) {
        let t = self.clock.now();
        for &at in &self.slots.request(slot).tags {
            hand_over(&self.health, &self.plan.tags[at], t, Reading::bad(reason), round, sink);
        }
    }

    fn give_up(&self, due: &mut VecDeque<usize>, reason: BadReason, round: &mut Round, sink: &dyn Sink) {
        for slot in due.drain(..) {
            self.emit_bad(slot, reason, round, sink);
        }
    }
}

fn hand_over(health: &DeviceHealth, tag: &Tag, t: f64, reading: Reading, round: &mut Round, sink: &dyn Sink) {
    let Reading { value, quality } = reading;
    if let Quality::Bad(_) = quality {
        round.bad += 1;
        health.unusable();
    } else {
        round.good += 1;
        health.usable(quality.is_good().then_some(t));
    }
    sink.sample(tag.index, Sample { t, value, quality });
}

/// Which tick of the schedule this is, to the nearest: timers fire up to a millisecond late.
fn tick_number(since_anchor: Duration, period: Duration) -> u64 {
    let (since, period) = (since_anchor.as_nanos(), period.as_nanos().max(1));
    u64::try_from((since + period / 2) / period).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::super::config::Config;
    use super::super::plan::TagSpec;
    use super::*;

    #[test]
    fn ticks_are_numbered_to_the_nearest() {
        let ms = Duration::from_millis;
        let number = |since| tick_number(ms(since), ms(100));
        assert_eq!([0, 1, 49, 99, 100, 101, 249, 251].map(number), [0, 0, 0, 1, 1, 1, 2, 3]);
        assert_eq!(tick_number(ms(5), Duration::ZERO), 5_000_000);
    }

    #[tokio::test]
    async fn a_device_that_answered_is_asked_in_the_next_poll_though_no_second_connection_was_made() {
        let config: Config = toml::from_str("name = 'd'\naddress = 'h:1'\naddress_base = 0").unwrap();
        let spec = TagSpec {
            index: 0,
            name: "a".into(),
            role: None,
            config: toml::from_str("device = 'd'\nregister = 'holding'\naddress = 0\ntype = 'u16'").unwrap(),
            frozen_after_s: None,
        };
        let plan = Plan::new(0, &config, vec![spec]).unwrap();
        let mut collector = Collector::new(plan, Arc::new(|| 0.0), 1);
        let mut round = Round {
            deadline: Instant::now(),
            good: 1,
            bad: 1,
            any_answer: true,
            unanswered: Vec::new(),
            losses: 1,
            unreachable: true,
            gateway_refused: false,
            busy: Vec::new(),
        };
        collector.judge(&round);
        assert!(collector.open_for.is_none() && collector.backoff.due(Instant::now()));
        round.any_answer = false;
        collector.judge(&round);
        assert_eq!(collector.open_for, Some(BadReason::LinkDown));
        assert!(!collector.backoff.due(Instant::now()));
    }
}
