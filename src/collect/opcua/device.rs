//! The task that keeps one server: connects, subscribes or polls, fills the gap, and does so again when it is lost.

use super::config::{Mode, Place};
use super::link::{Link, Lost};
use super::listener::Event;
use super::names::Pins;
use super::plan::{Plan, Sampling, Tag};
use super::value::{self, NoNumber};
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
    /// The sources' clock, against one that nobody sets.
    source: SourceClock,
    born: Instant,
    round: Round,
    /// The namespaces that plain numbers mean.
    pins: Pins,
    /// History of before the start has still to be read.
    starting: bool,
}

/// What is known of one tag.
struct State {
    series: Series,
    frozen: Option<Frozen>,
    node: Option<NodeId>,
    /// The last value as it was sent, to know a change.
    raw: Option<f64>,
    /// A session was lost since the newest sample.
    gap: bool,
    /// The newest sample is without a value, and its time is not the source's.
    marked: bool,
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
            frozen: tag.frozen_after_s.map(Frozen::new),
            node: None,
            raw: None,
            gap: false,
            marked: false,
            refused: false,
            no_number: None,
        };
        Self {
            clock,
            health: Arc::default(),
            tags: plan.tags.iter().map(state).collect(),
            backoff: Backoff::new(FIRST_PAUSE.min(longest), longest, Pcg32::seed_from_u64(random.random())),
            down: None,
            source: SourceClock::default(),
            born: Instant::now(),
            round: Round::default(),
            pins: Pins::default(),
            starting: false,
            plan,
        }
    }

    /// Before the first session: the time (s) of the newest sample that each tag has from before the start. With `backfill_s`
    /// what came since is read from the server's history.
    pub fn resume(&mut self, newest: &dyn Fn(usize) -> Option<f64>) {
        self.starting = self.plan.config.backfill_s > 0.0;
        if self.starting {
            for (tag, state) in self.plan.tags.iter().zip(&mut self.tags) {
                state.series = newest(tag.index).map_or_else(Series::default, Series::after);
                state.gap = true;
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
                    self.tags.iter_mut().for_each(|tag| tag.gap = true);
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

    /// The time that the sources' clocks show now (s), whatever is done to ours; ours before the first sample.
    fn source_now(&self) -> f64 {
        self.source.now(self.born.elapsed().as_secs_f64()).unwrap_or_else(|| self.clock.now())
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

    /// Nobody is there. While the gap may still be filled nothing is handed on, since a ring only goes forward.
    fn down_tick(&mut self, sink: &dyn Sink) {
        let now = self.source_now();
        let (fills, longest) = (self.plan.config.fill_gaps, self.longest_gap());
        for at in 0..self.tags.len() {
            // Before the first value there is no time line to mark.
            let waits = self.tags[at].series.last().is_none_or(|last| fills && now - last <= longest);
            if !waits && self.tags[at].series.filled(now).is_news() {
                self.hand_over(at, now, Reading::bad(BadReason::LinkDown), sink);
            } else {
                self.round.bad += 1;
            }
        }
        self.end_round(sink, Duration::ZERO);
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

    async fn listen(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Never, Lost> {
        let (subscription, mut events) = link.subscribe().await?;
        self.monitor(link, subscription, sink).await?;
        // What the subscription brings meanwhile waits in its queue: history comes first.
        self.fill(link, sink).await?;
        let silence = Duration::from_secs_f64(self.plan.config.silent_s);
        let (mut heard, mut retried) = (Instant::now(), Instant::now());
        let mut ticks = self.ticks();
        loop {
            tokio::select! {
                biased;
                event = events.recv() => match event {
                    Some(Event::Value(at, value)) => {
                        heard = Instant::now();
                        self.live(at, &value, sink);
                    }
                    Some(Event::Ended(status)) => {
                        return Err(Lost::Broken(format!("the server ended the subscription: {status}")));
                    }
                    None => return Err(Lost::Broken("the subscription is gone".into())),
                },
                () = link.ended() => return Err(Lost::Broken("the server ended the session".into())),
                _ = ticks.tick() => {
                    if heard.elapsed() > silence {
                        self.listen_closer(link, sink).await?;
                        heard = Instant::now();
                    }
                    if retried.elapsed() > RETRY {
                        self.monitor(link, subscription, sink).await?;
                        retried = Instant::now();
                    }
                    let dropped = link.take_dropped();
                    if dropped > 0 {
                        return Err(Lost::Broken(format!("{dropped} values came faster than they could be taken")));
                    }
                    self.end_round(sink, Duration::ZERO);
                }
            }
        }
    }

    /// Finds the nodes that have none yet and has them monitored. A refused one leaves the others alone.
    async fn monitor(&mut self, link: &mut Link, subscription: u32, sink: &dyn Sink) -> Result<(), Lost> {
        let fresh = self.resolve(link, sink).await?;
        let asked = |at: usize| Some((at, self.tags[at].node.clone()?, self.plan.tags[at].sampling));
        let nodes: Vec<(usize, NodeId, Sampling)> = fresh.into_iter().filter_map(asked).collect();
        let taken = link.monitor(subscription, &nodes).await?;
        for ((at, ..), status) in nodes.into_iter().zip(taken) {
            if status.is_bad() {
                self.tags[at].node = None;
                self.refused(at, &format!("not monitored: {status}"), sink);
            } else {
                self.tags[at].refused = false;
            }
        }
        Ok(())
    }

    /// Finds the nodes of tags that have none; returns which were found.
    async fn resolve(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Vec<usize>, Lost> {
        let missing: Vec<usize> = (0..self.tags.len()).filter(|at| self.tags[*at].node.is_none()).collect();
        let places: Vec<Place> = missing.iter().map(|at| self.plan.tags[*at].place.clone()).collect();
        let mut found = Vec::new();
        let pinned = self.pins.known().count();
        for (at, node) in missing.into_iter().zip(link.resolve(&places, &mut self.pins).await?) {
            match node {
                Ok(node) => {
                    self.tags[at].node = Some(node);
                    found.push(at);
                }
                Err(why) => self.refused(at, &why, sink),
            }
        }
        if self.pins.known().count() > pinned {
            let known: Vec<String> =
                self.pins.known().map(|(n, uri)| format!("ns={n} is nsu={uri}")).collect();
            info!(device = %self.name(), "namespaces named by number: {}", known.join(", "));
        }
        Ok(found)
    }

    /// The server is alive and refuses this node.
    fn refused(&mut self, at: usize, why: &str, sink: &dyn Sink) {
        self.health.refused();
        if !std::mem::replace(&mut self.tags[at].refused, true) {
            warn!(device = %self.name(), tag = %self.plan.tags[at].name, "{why}");
        }
        let now = self.source_now();
        if self.tags[at].series.filled(now).is_news() {
            self.hand_over(at, now, Reading::bad(BadReason::DeviceException), sink);
        }
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

    /// Nothing came for long. Either nothing has changed, or the subscription is dead: reading tells.
    async fn listen_closer(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<(), Lost> {
        let (places, values) = self.read(link).await?;
        let mut hidden = 0;
        for (at, value) in places.into_iter().zip(values) {
            let tag = &self.tags[at];
            let t = value::time(&value, self.plan.config.source_time_fallback, self.clock.now());
            let raw = value::number(&value, &self.plan.tags[at].meaning).ok();
            let source = value.source_timestamp.is_some();
            let newer = source && t.is_some_and(|t| tag.series.is_newer(t));
            let sent = self.plan.tags[at].sampling.deadband.lets_through(tag.raw, raw);
            hidden += usize::from(newer && sent);
            self.live(at, &value, sink);
        }
        if hidden > 0 {
            let silent_s = self.plan.config.silent_s;
            return Err(Lost::Broken(format!(
                "the subscription was silent for {silent_s} s while {hidden} values changed"
            )));
        }
        Ok(())
    }

    async fn poll(&mut self, link: &mut Link, sink: &dyn Sink) -> Result<Never, Lost> {
        self.find(link, sink).await?;
        self.fill(link, sink).await?;
        let mut resolved = Instant::now();
        let mut ticks = self.ticks();
        loop {
            ticks.tick().await;
            let began = Instant::now();
            if resolved.elapsed() > RETRY {
                self.find(link, sink).await?;
                resolved = began;
            }
            let (places, values) = self.read(link).await?;
            for (at, value) in places.into_iter().zip(values) {
                self.live(at, &value, sink);
            }
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
    async fn read(&self, link: &mut Link) -> Result<(Vec<usize>, Vec<DataValue>), Lost> {
        let known = self.tags.iter().enumerate().filter_map(|(at, tag)| Some((at, tag.node.clone()?)));
        let (places, nodes): (Vec<usize>, Vec<NodeId>) = known.unzip();
        let values = link.read(&nodes).await?;
        Ok((places, values))
    }

    /// A value that just came.
    fn live(&mut self, at: usize, value: &DataValue, sink: &dyn Sink) {
        let Some(tag) = self.plan.tags.get(at) else { return };
        self.backoff.reset();
        let now = self.clock.now();
        let reading = value::reading(value, &tag.meaning);
        let raw = value::number(value, &tag.meaning);
        if reading.quality == Quality::Bad(BadReason::NotANumber) {
            self.say_why(at, raw.as_ref().err().unwrap_or(&NoNumber::NotFinite));
        }
        let unusable = matches!(reading.quality, Quality::Bad(_)) && reading.value.is_nan();
        let own = value::time(value, self.plan.config.source_time_fallback, now);
        // What is bad has no value that a fresh stamp could make look fresh; its source often keeps the old stamp.
        let t = match own {
            Some(t) if !unusable || self.tags[at].series.is_newer(t) => t,
            _ if unusable => {
                let t = value::server_time(value).unwrap_or_else(|| self.source_now());
                self.tags[at].series.last().map_or(t, |last| t.max(last + STEP_S))
            }
            _ => {
                return self.refused(at, "a value without a time: see source_time_fallback", sink);
            }
        };
        self.tags[at].raw = raw.ok();
        let before = self.tags[at].series.last();
        // A value that did not change while it could not be had keeps its old source time, but comes after the mark.
        let t = match before {
            Some(mark) if self.tags[at].marked && !unusable && t <= mark => {
                value::server_time(value).unwrap_or_else(|| self.source_now()).max(mark + STEP_S)
            }
            _ => t,
        };
        let order = self.tags[at].series.live(t);
        let gap = std::mem::take(&mut self.tags[at].gap);
        if let Order::Old | Order::Again = order {
            if order == Order::Old {
                self.health.discarded();
            }
            // An old stray says nothing about the gap; the same value again says that nothing happened.
            self.tags[at].gap = gap && order == Order::Old;
            return;
        }
        if let Some(before) = before.filter(|before| gap && t > *before) {
            // Between the two nobody was listening: say so, rather than have them joined by a straight line.
            self.hand_over(at, before + (t - before) / 2.0, Reading::bad(BadReason::LinkDown), sink);
        }
        if !unusable {
            self.heard(at, t, order == Order::SetBack);
        }
        if let Some(since) = self.down.take() {
            info!(device = %self.name(), after_s = since.elapsed().as_secs_f64(), "data again");
        }
        self.hand_over(at, t, reading, sink);
    }

    /// Sets the sources' clock by a sample that just came, and says so when it has jumped.
    fn heard(&mut self, at: usize, t: f64, set_back: bool) {
        let steady = self.born.elapsed().as_secs_f64();
        if let Some(by_s) = self.source.heard(t, steady, self.clock.now(), set_back) {
            self.health.clock_jumped();
            let tag = &self.plan.tags[at].name;
            warn!(device = %self.name(), %tag, t, by_s, "the source's clock was set");
        }
    }

    fn hand_over(&mut self, at: usize, t: f64, mut reading: Reading, sink: &dyn Sink) {
        let (state, tag) = (&mut self.tags[at], &self.plan.tags[at]);
        if let (Quality::Good, Some(frozen)) = (reading.quality, &mut state.frozen)
            && frozen.update(t, reading.value)
        {
            reading.quality = Quality::Stale;
        }
        let Reading { value, quality } = reading;
        state.marked = value.is_nan();
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
mod tests;
