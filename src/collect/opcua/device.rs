//! The task that keeps one server: connects, subscribes or polls, fills the gap, and does so again when it is lost.

use super::config::{Mode, Place};
use super::link::{Link, Lost};
use super::pins::{Pinned, ServerPins};
use super::plan::{Plan, Tag};
use super::value::{NoNumber, Received};
use crate::collect::backoff::Backoff;
use crate::collect::series::{Order, Series, SourceClock};
use crate::collect::{Clock, DeviceHealth, Frozen, Poll, Reading, Sink};
use crate::signal::{BadReason, Quality, Sample};
use futures::future::BoxFuture;
use opcua::types::{DataValue, NodeId};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, Interval, MissedTickBehavior, interval, sleep_until};
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

mod fill;
mod listen;
mod marks;

/// First pause before a lost session is opened again.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// A mark that would come too late to be in order is put so far behind the newest sample (s).
const STEP_S: f64 = 1e-3;
/// Nodes that were refused are tried again this often.
const RETRY: Duration = Duration::from_secs(60);

/// Keeps one server's session until it is told to stop.
pub struct Collector {
    plan: Plan,
    clock: Arc<dyn Clock>,
    health: Arc<DeviceHealth>,
    tags: Vec<State>,
    backoff: Backoff,
    /// Since when the server is not there, as the last warning said.
    down: Option<Instant>,
    born: Instant,
    /// When a value last came, by a clock that nobody sets (s).
    heard_at: f64,
    /// Sessions in a row that were lost while history was read.
    lost_filling: u32,
    round: Round,
    /// The namespaces that plain numbers mean.
    pins: ServerPins,
    /// History of before the start has still to be read.
    starting: bool,
}

/// What is known of one tag.
struct State {
    series: Series,
    /// The clock of its source: tags of one server may come from controllers whose clocks differ.
    source: SourceClock,
    frozen: Option<Frozen>,
    node: Option<NodeId>,
    /// The last value as it was sent, to know a change.
    raw: Option<f64>,
    /// A session was lost since the newest sample.
    gap: bool,
    /// Up to when all of it came (s by its source), since a session was lost and until live values go on.
    gap_from: Option<f64>,
    /// The newest sample is without a value, and its time is not the source's.
    marked: bool,
    /// The newest sample is of before the start and has a value that is not good: its time is the source's, or that of a repetition.
    in_doubt: bool,
    /// The newest sample is good.
    good: bool,
    /// It was said that the node is refused.
    refused: bool,
    /// Why the newest value without a number had none, as it was said.
    no_number: Option<NoNumber>,
}

/// Samples since the sink last heard of a poll.
#[derive(Default)]
struct Round {
    good: usize,
    bad: usize,
}

impl Collector {
    /// A collector for the plan. `seed` decides the jitter only: give each device another.
    pub fn new(plan: Plan, clock: Arc<dyn Clock>, seed: u64) -> Self {
        let mut random = Pcg32::seed_from_u64(seed);
        let longest = Duration::from_millis(plan.config.reconnect_max_ms);
        let state = |tag: &Tag| State {
            series: Series::default(),
            source: SourceClock::default(),
            frozen: tag.frozen_after_s.map(Frozen::new),
            node: None,
            raw: None,
            gap: false,
            gap_from: None,
            marked: false,
            in_doubt: false,
            good: false,
            refused: false,
            no_number: None,
        };
        Self {
            clock,
            health: Arc::default(),
            tags: plan.tags.iter().map(state).collect(),
            backoff: Backoff::new(FIRST_PAUSE.min(longest), longest, Pcg32::seed_from_u64(random.random())),
            down: None,
            born: Instant::now(),
            heard_at: 0.0,
            lost_filling: 0,
            round: Round::default(),
            pins: ServerPins::default(),
            starting: false,
            plan,
        }
    }

    /// Takes plain numbers for the namespaces that all who share `pinned` take them for.
    pub fn pinning(mut self, pinned: &Pinned) -> Self {
        self.pins = pinned.of(&self.plan.config.url);
        self
    }

    /// Before the first session: the newest sample that each tag has from before the start. With `backfill_s` what came since is
    /// read from the server's history. Where that sample is a mark, or a value that was handed on once more, one that has not changed
    /// since before it comes behind it.
    pub fn resume(&mut self, newest: &dyn Fn(usize) -> Option<Sample>) {
        self.starting = self.plan.config.backfill_s > 0.0;
        for (tag, state) in self.plan.tags.iter().zip(&mut self.tags) {
            let newest = newest(tag.index);
            let last = newest.map(|sample| sample.t);
            let bad = newest.filter(|sample| !sample.quality.is_good());
            state.marked = bad.is_some_and(|sample| sample.value.is_nan());
            state.in_doubt = bad.is_some() && !state.marked;
            if self.starting || bad.is_some() {
                state.series = last.map_or_else(Series::default, Series::after);
            }
            if self.starting {
                (state.gap, state.gap_from) = (true, last);
            }
        }
    }

    /// Longest time that is read from history (s).
    fn longest_gap(&self) -> f64 {
        let config = &self.plan.config;
        if self.starting { config.backfill_s } else { config.history_max_s }
    }

    /// The device's counters, live.
    pub fn health(&self) -> Arc<DeviceHealth> {
        Arc::clone(&self.health)
    }

    /// Hands every sample to the sink, each once and in the order of time, until `shutdown` is cancelled.
    pub fn run(self, sink: Arc<dyn Sink>, shutdown: CancellationToken) -> BoxFuture<'static, ()> {
        // Boxed here, so that a binary that calls it does not compile the collector once more.
        Box::pin(self.until(sink, shutdown))
    }

    async fn until(mut self, sink: Arc<dyn Sink>, shutdown: CancellationToken) {
        let health = self.health();
        shutdown.run_until_cancelled(self.keep_for_ever(&*sink)).await;
        health.disconnected();
    }

    async fn keep_for_ever(&mut self, sink: &dyn Sink) {
        let config = Arc::new(self.plan.config.clone());
        let mut ticks = self.ticks();
        ticks.reset();
        loop {
            let lost = match self.meanwhile(&mut ticks, sink, Link::open(config.clone())).await {
                Ok(link) => {
                    self.health.connected();
                    debug!(device = %self.name(), url = %config.url, "session opened");
                    let lost = self.stay(link, sink).await;
                    self.left();
                    ticks.reset();
                    lost
                }
                Err(lost) => lost,
            };
            self.lost(&lost);
            let pause = self.backoff.failed(Instant::now());
            self.meanwhile(&mut ticks, sink, sleep_until(Instant::now() + pause)).await;
        }
    }

    fn name(&self) -> &str {
        &self.plan.config.name
    }

    fn period(&self) -> Duration {
        Duration::from_millis(match self.plan.config.mode {
            Mode::Subscribe => self.plan.config.publishing_ms,
            Mode::Poll => self.plan.config.sampling_ms,
        })
    }

    fn ticks(&self) -> Interval {
        let mut ticks = interval(self.period());
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        ticks
    }

    /// Counts and reports the loss of the session; only the first since the last data is a warning.
    fn lost(&mut self, lost: &Lost) {
        self.health.disconnected();
        match lost {
            Lost::Timeout(_) => self.health.timed_out(),
            Lost::Broken(_) => self.health.link_failed(),
            Lost::Untrusted(_) => self.health.untrusted(),
        }
        if self.down.is_some() {
            debug!(device = %self.name(), "{lost}");
        } else {
            warn!(device = %self.name(), "{lost}");
            self.down = Some(Instant::now());
        }
    }

    /// Waits for something without a session; the sink hears of every period without data.
    async fn meanwhile<T>(
        &mut self,
        ticks: &mut Interval,
        sink: &dyn Sink,
        waited: impl Future<Output = T>,
    ) -> T {
        tokio::pin!(waited);
        loop {
            tokio::select! {
                done = &mut waited => return done,
                _ = ticks.tick() => self.down_tick(sink),
            }
        }
    }

    fn end_round(&mut self, sink: &dyn Sink, took: Duration) {
        let Round { good, bad } = std::mem::take(&mut self.round);
        self.health.poll_done(took > self.period());
        sink.poll(self.plan.device, Poll { t: self.clock.now(), good, bad, took });
    }

    /// Collects over one session until it is lost.
    async fn stay(&mut self, mut link: Link, sink: &dyn Sink) -> Lost {
        // What was found before the loss may have moved, and nothing of it is monitored by this session yet.
        self.tags.iter_mut().for_each(|tag| tag.node = None);
        let ended = match self.plan.config.mode {
            Mode::Subscribe => self.listen(&mut link, sink).await,
            Mode::Poll => self.poll(&mut link, sink).await,
        };
        match ended {
            Err(lost) => lost,
            Ok(never) => match never {},
        }
    }

    /// Finds the nodes of tags that have none; returns which were found.
    async fn resolve(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Vec<usize>, Lost> {
        let missing: Vec<usize> = (0..self.tags.len()).filter(|at| self.tags[*at].node.is_none()).collect();
        let places: Vec<Place> = missing.iter().map(|at| self.plan.tags[*at].place.clone()).collect();
        let mut found = Vec::new();
        let pinned = self.pins.known().len();
        let nodes = link.resolve(&places, &self.pins).await?;
        for (at, node) in missing.into_iter().zip(nodes) {
            match node {
                Ok(node) => {
                    self.tags[at].node = Some(node);
                    found.push(at);
                }
                Err(why) => self.refused(at, &why, sink),
            }
        }
        let known = self.pins.known();
        if known.len() > pinned {
            let known: Vec<String> = known.iter().map(|(n, uri)| format!("ns={n} is nsu={uri}")).collect();
            info!(device = %self.name(), "namespaces named by number: {}", known.join(", "));
        }
        Ok(found)
    }

    /// A value is no number. It is said once, and again when the reason is another.
    fn say_why(&mut self, at: usize, why: &NoNumber) {
        let kind = std::mem::discriminant(why);
        let said = self.tags[at].no_number.as_ref().is_some_and(|said| std::mem::discriminant(said) == kind);
        if !said {
            warn!(device = %self.name(), tag = %self.plan.tags[at].name, "bad:not_a_number: {why}");
            self.tags[at].no_number = Some(why.clone());
        }
    }

    async fn poll(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Never, Lost> {
        self.find(link, sink).await?;
        // Nothing comes meanwhile that would have to be taken.
        self.fill(link, None, sink).await?;
        let mut resolved = Instant::now();
        let mut ticks = self.ticks();
        loop {
            ticks.tick().await;
            let began = Instant::now();
            if resolved.elapsed() > RETRY {
                self.find(link, sink).await?;
                resolved = began;
            }
            for (at, value) in self.read(link).await? {
                self.live(at, &value, sink);
            }
            // Live values go on: this session has lived through its history.
            self.lost_filling = 0;
            self.repeat_frozen(sink);
            self.end_round(sink, began.elapsed());
        }
    }

    /// Finds what is to be read; a tag that is found may be refused again, and that is news.
    async fn find(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<(), Lost> {
        for at in self.resolve(link, sink).await? {
            self.tags[at].refused = false;
        }
        Ok(())
    }

    /// Every tag that has a node, and its value.
    async fn read(&self, link: &mut Link) -> Result<Vec<(usize, Received)>, Lost> {
        let known = self.tags.iter().enumerate().filter_map(|(at, tag)| Some((at, tag.node.clone()?)));
        let (places, nodes): (Vec<usize>, Vec<NodeId>) = known.unzip();
        let (mut values, mut places) = (Vec::with_capacity(nodes.len()), places.into_iter());
        let take = |value: DataValue| {
            if let Some(at) = places.next() {
                values.push((at, Received::of(&value, &self.plan.tags[at].meaning)));
            }
        };
        link.read_each(&nodes, take).await?;
        Ok(values)
    }

    /// A value that just came.
    fn live(&mut self, at: usize, value: &Received, sink: &dyn Sink) {
        let Some(tag) = self.plan.tags.get(at) else { return };
        self.backoff.reset();
        self.heard_at = self.steady();
        let now = self.clock.now();
        let reading = value.reading(&tag.meaning);
        if reading.quality == Quality::Bad(BadReason::NotANumber) {
            self.say_why(at, value.number.as_ref().err().unwrap_or(&NoNumber::NotFinite));
        }
        let unusable = matches!(reading.quality, Quality::Bad(_)) && reading.value.is_nan();
        let own = value.time(self.plan.config.source_time_fallback, now);
        let before = self.tags[at].series.end();
        let behind = |t: f64| before.map_or(t, |end| t.max(end + STEP_S));
        // A value with the time of one in doubt is that one again.
        let State { marked, in_doubt, .. } = self.tags[at];
        let is_before_mark = |t: f64| before.is_some_and(|mark| marked && t <= mark || in_doubt && t < mark);
        // What is bad has no value that a fresh stamp could make look fresh; its source often keeps the old stamp.
        let (t, stamped) = match (value.source.filter(|t| self.tags[at].series.is_newer(*t)), own) {
            (Some(t), _) if unusable => (t, true),
            _ if unusable => (behind(self.came(at, value)), false),
            // A value that did not change while it could not be had keeps its old source time, but comes after the mark.
            (_, Some(t)) if is_before_mark(t) => (behind(self.came(at, value)), false),
            // What changed before its repetition, and came after it, is put behind that.
            (_, Some(t))
                if before.is_some_and(|end| t <= end)
                    && self.tags[at].series.last().is_some_and(|last| t > last) =>
            {
                (behind(t), false)
            }
            (_, Some(t)) => (t, true),
            (_, None) => {
                return self.refused(at, "a value without a time: see source_time_fallback", sink);
            }
        };
        self.tags[at].raw = value.number.as_ref().ok().copied();
        let order = self.tags[at].series.live(t);
        if !order.is_news() && reading.quality.is_good() {
            // By our clock: a value that does not change may keep its stamp for ever.
            self.health.still_good(now);
        }
        let gap = std::mem::take(&mut self.tags[at].gap);
        if order == Order::Old {
            self.health.discarded();
            // An old stray says nothing about the gap.
            self.tags[at].gap = gap;
            return;
        }
        let gap_from = self.tags[at].gap_from.take();
        // The same value again says that nothing happened.
        if order == Order::Again {
            return;
        }
        if let Some(before) = before.filter(|before| gap && t > *before) {
            self.mark_gap(at, (before, gap_from), t, sink);
        }
        if !unusable && stamped {
            self.heard(at, t, order == Order::SetBack);
        }
        if let Some(since) = self.down.take() {
            info!(device = %self.name(), after_s = since.elapsed().as_secs_f64(), "data again");
        }
        self.hand_over(at, t, reading, sink);
    }

    fn hand_over(&mut self, at: usize, t: f64, mut reading: Reading, sink: &dyn Sink) {
        let (state, tag) = (&mut self.tags[at], &self.plan.tags[at]);
        if let (Quality::Good, Some(frozen)) = (reading.quality, &mut state.frozen)
            && frozen.update(t, reading.value)
        {
            reading.quality = Quality::Stale;
        }
        let Reading { value, quality } = reading;
        (state.marked, state.in_doubt, state.good) = (value.is_nan(), false, quality.is_good());
        if let Quality::Bad(_) = quality {
            self.round.bad += 1;
            self.health.unusable();
        } else {
            self.round.good += 1;
            self.health.usable(quality.is_good().then_some(t));
        }
        sink.sample(tag.index, Sample { t, value, quality });
    }
}

/// Nothing: a session ends only by being lost.
enum Never {}

#[cfg(test)]
mod fill_tests;
#[cfg(test)]
mod outage_tests;
#[cfg(test)]
mod tests;
