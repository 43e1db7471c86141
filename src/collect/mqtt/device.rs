//! One connection to one broker, whatever happens to it.
//!
//! ```text
//!          connected and subscribed               lost, refused, or silent for longer than silent_s
//! away -----------------------------> listening --------------------------------------------------> away
//!   ^                                                 all tags bad:link_down, once                    |
//!   +--------------------------------- back-off with jitter ------------------------------------------+
//! ```

use super::config::Place;
use super::json::{self, Refused, Where};
use super::plan::Plan;
use super::session::{Edge, News};
use super::tags::{Arrival, State, Taken};
use crate::collect::backoff::Backoff;
use crate::collect::{Clock, DeviceHealth, Poll, Sink};
use crate::mqtt::Takeovers;
use crate::mqtt::sparkplug::{Metric, Payload, REBIRTH, Topic, Value, datatype};
use crate::signal::{BadReason, Quality, Sample};
use futures::future::BoxFuture;
use prost::Message;
use rand::SeedableRng;
use rand_pcg::Pcg32;
use rumqttc::{
    AsyncClient, ConnectReturnCode, ConnectionError, Event, EventLoop, Packet, PublishOptions, QoS,
    SubscribeFilterInput,
};
use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

/// First pause before another attempt to connect.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// How often it is looked who has been silent for too long.
const LOOK: Duration = Duration::from_millis(200);
/// An edge node is asked for its births at most so often (s).
const REBIRTH_EVERY_S: f64 = 10.0;
/// Requests to the broker that wait to be sent, beside those to subscribe.
const REQUESTS: usize = 64;
/// Filters in one request to subscribe.
const FILTERS: usize = 100;

/// Listens to one broker until it is told to stop.
pub struct Collector {
    plan: Plan,
    clock: Arc<dyn Clock>,
    health: Arc<DeviceHealth>,
    began: Instant,
    tags: Vec<State>,
    edges: Vec<Edge>,
    /// When each edge node was last asked for its births, by the steady clock (s).
    asked: Vec<Option<f64>>,
    /// Tags by topic.
    topics: HashMap<String, Vec<usize>>,
    backoff: Backoff,
    /// When a message that could be read last came, by the steady clock (s).
    heard: f64,
    /// When the broker last sent anything, by the steady clock (s).
    alive: f64,
    down: bool,
    takeovers: Takeovers,
}

/// Why there is no connection any more.
enum Lost {
    /// Not the kind of identity or certificate that the broker wants, or we do.
    Untrusted(String),
    Broken(String),
    Silent,
}

impl Collector {
    /// A collector for the plan. `seed` decides the jitter only: give each device another.
    pub fn new(plan: Plan, clock: Arc<dyn Clock>, seed: u64) -> Self {
        let longest = Duration::from_millis(plan.config.reconnect_max_ms);
        let mut topics: HashMap<String, Vec<usize>> = HashMap::new();
        for (at, tag) in plan.tags.iter().enumerate() {
            if let Place::Topic { topic, .. } = &tag.place {
                topics.entry(topic.clone()).or_default().push(at);
            }
        }
        let edges = Edge::all(&plan.tags);
        Self {
            clock,
            health: Arc::default(),
            began: Instant::now(),
            tags: plan.tags.iter().map(State::new).collect(),
            asked: vec![None; edges.len()],
            edges,
            topics,
            backoff: Backoff::new(FIRST_PAUSE.min(longest), longest, Pcg32::seed_from_u64(seed)),
            heard: 0.0,
            alive: 0.0,
            down: false,
            takeovers: Takeovers::default(),
            plan,
        }
    }

    /// Before it runs: the newest sample that each tag has from before the start. A value that its source had told before that one,
    /// where it is a mark, comes behind it.
    pub fn resume(&mut self, newest: &dyn Fn(usize) -> Option<Sample>) {
        for (tag, state) in self.plan.tags.iter().zip(&mut self.tags) {
            if let Some(mark) = newest(tag.index).filter(|own| own.value.is_nan()) {
                state.resume(mark.t);
            }
        }
    }

    /// The device's counters, live.
    pub fn health(&self) -> Arc<DeviceHealth> {
        Arc::clone(&self.health)
    }

    /// Listens until `shutdown` is cancelled.
    pub fn run(self, sink: Arc<dyn Sink>, shutdown: CancellationToken) -> BoxFuture<'static, ()> {
        // Boxed here, so that a binary that calls it does not compile the collector once more.
        Box::pin(self.until(sink, shutdown))
    }

    async fn until(mut self, sink: Arc<dyn Sink>, shutdown: CancellationToken) {
        let health = self.health();
        shutdown.run_until_cancelled(self.listen_for_ever(&*sink)).await;
        health.disconnected();
    }

    async fn listen_for_ever(&mut self, sink: &dyn Sink) {
        loop {
            let lost = self.listen(sink).await;
            self.lost(&lost);
            self.edges.iter_mut().for_each(Edge::forget);
            self.asked.fill(None);
            let reason = if matches!(lost, Lost::Silent) { BadReason::Timeout } else { BadReason::LinkDown };
            // A dead connection is noticed late: what the broker kept meanwhile is newer than its last sign of life.
            self.lose(0..self.tags.len(), reason, self.alive, sink);
            let pause = self.backoff.failed(Instant::now());
            tokio::time::sleep(pause).await;
        }
    }

    fn steady(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Connects, subscribes and takes messages until the connection is lost.
    async fn listen(&mut self, sink: &dyn Sink) -> Lost {
        let (client, mut events) = match self.connect().await {
            Ok(pair) => pair,
            Err(lost) => {
                self.takeovers.refused();
                return lost;
            }
        };
        let filters: Vec<String> = self.plan.filters().into_iter().collect();
        for some in filters.chunks(FILTERS) {
            let some = some.iter().map(|filter| SubscribeFilterInput::new(filter.clone(), QoS::AtLeastOnce));
            if let Err(error) = client.try_subscribe_many(some) {
                return Lost::Broken(format!("cannot subscribe: {error}"));
            }
        }
        (0..self.edges.len()).for_each(|edge| self.ask_for_births(edge, &client));
        self.heard = self.steady();
        self.alive = self.heard;
        let mut look = interval(LOOK);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            // It outlasts a look at the clock, so that this drops nothing that is half received. It is large and stays in its
            // place: in a build that is not optimised, moving it took half of the time of a short message.
            let mut next = pin!(events.poll());
            let event = loop {
                tokio::select! {
                    event = &mut next => break event,
                    _ = look.tick() => {
                        let steady = self.steady();
                        if steady - self.heard > self.plan.config.silent_s {
                            return Lost::Silent;
                        }
                        self.look_for_stale(steady, sink);
                    }
                }
            };
            match self.noted(event) {
                Ok(Event::Incoming(Packet::Publish(publish))) => {
                    let (topic, payload) = (&publish.topic, &publish.payload);
                    if let Some(edge) = self.message(topic, payload, publish.retain, sink) {
                        self.ask_for_births(edge, &client);
                    }
                }
                Ok(Event::Incoming(Packet::SubAck(answer))) => self.subscribed(&answer.return_codes),
                Ok(_) => {}
                Err(error) => {
                    self.ended();
                    return broken(&error);
                }
            }
        }
    }

    /// Notes that the broker sent something.
    fn noted<E>(&mut self, event: Result<Event, E>) -> Result<Event, E> {
        if let Ok(Event::Incoming(_)) = event {
            self.alive = self.steady();
        }
        event
    }

    async fn connect(&mut self) -> Result<(AsyncClient, EventLoop), Lost> {
        // Secrets and certificates are files; reading them is short, but may not be.
        let broker = self.plan.config.broker();
        let options = tokio::task::spawn_blocking(move || broker.options()).await;
        let options = options.map_err(|error| Lost::Broken(error.to_string()))?;
        let options = options.map_err(|error| Lost::Untrusted(error.to_string()))?;
        // All requests to subscribe wait before the first is sent.
        let room = REQUESTS + self.plan.filters().len().div_ceil(FILTERS) + self.edges.len();
        let (client, mut events) = AsyncClient::builder(options)
            .capacity(room)
            .try_build()
            .map_err(|error| Lost::Broken(error.to_string()))?;
        let limit = self.plan.config.timeout_s;
        events.network_options.set_connection_timeout(limit).set_tcp_nodelay(true);
        loop {
            match timeout(Duration::from_secs(limit), events.poll()).await {
                Err(_) => return Err(Lost::Broken(format!("no connection within {limit} s"))),
                Ok(Err(error)) => return Err(broken(&error)),
                Ok(Ok(Event::Incoming(Packet::ConnAck(_)))) => {
                    self.health.connected();
                    debug!(device = %self.plan.config.name, "connected");
                    return Ok((client, events));
                }
                Ok(Ok(_)) => {}
            }
        }
    }

    fn subscribed(&self, codes: &[rumqttc::SubscribeReasonCode]) {
        let refused =
            codes.iter().filter(|code| !matches!(code, rumqttc::SubscribeReasonCode::Success(_))).count();
        for _ in 0..refused {
            self.health.refused();
        }
        if refused > 0 {
            warn!(device = %self.plan.config.name, refused, "the broker refuses to send some topics");
        }
    }

    /// The broker ended a connection that it had taken.
    fn ended(&mut self) {
        let steady = self.steady();
        if let Some(why) = self.takeovers.ended(steady, &self.plan.config.client_id()) {
            warn!(device = %self.plan.config.name, "{why}");
        }
    }

    /// Counts and reports the loss; only the first since the last message is a warning.
    fn lost(&mut self, lost: &Lost) {
        self.health.disconnected();
        let why = match lost {
            Lost::Untrusted(why) => {
                self.health.untrusted();
                format!("refused: {why}")
            }
            Lost::Broken(why) => {
                self.health.link_failed();
                format!("link: {why}")
            }
            Lost::Silent => {
                self.health.timed_out();
                format!("no readable message for {} s", self.plan.config.silent_s)
            }
        };
        if std::mem::replace(&mut self.down, true) {
            debug!(device = %self.plan.config.name, "{why}");
        } else {
            warn!(device = %self.plan.config.name, "{why}");
        }
    }

    /// Takes one message as a broker sends it. Which edge node, by number, has to be asked for its births.
    pub fn message(
        &mut self,
        topic: &[u8],
        payload: &[u8],
        retained: bool,
        sink: &dyn Sink,
    ) -> Option<usize> {
        let began = Instant::now();
        self.health.poll_done(false);
        let came = Arrival { t: self.clock.now(), steady: self.steady(), retained };
        let Ok(topic) = std::str::from_utf8(topic) else {
            self.refuse("?", "the topic is no text", 1);
            return None;
        };
        if payload.len() > self.plan.config.max_payload_bytes {
            self.refuse(topic, "larger than max_payload_bytes", 1);
            return None;
        }
        let mut births = None;
        let (good, bad) = match (self.topics.get(topic).cloned(), Topic::parse(topic)) {
            (Some(tags), _) => self.plain(topic, &tags, payload, came, sink),
            (None, Some(parsed)) => self.sparkplug(topic, &parsed, payload, came, &mut births, sink),
            // Commands to an edge node come with its other messages.
            (None, None) => return None,
        };
        if good + bad > 0 {
            self.heard = came.steady;
            self.backoff.reset();
            if std::mem::take(&mut self.down) {
                info!(device = %self.plan.config.name, "data again");
            }
            sink.poll(self.plan.device, Poll { t: came.t, good, bad, took: began.elapsed() });
        }
        births
    }

    fn plain(
        &mut self,
        topic: &str,
        tags: &[usize],
        payload: &[u8],
        came: Arrival,
        sink: &dyn Sink,
    ) -> (usize, usize) {
        let is_plain = |at: &usize| matches!(self.plan.tags[*at].place, Place::Topic { value: None, .. });
        let document = match json::parse(payload, tags.iter().any(is_plain)) {
            Ok(document) => document,
            Err(refused) => {
                self.refuse(topic, &refused.to_string(), 1);
                return (0, 0);
            }
        };
        let (mut good, mut bad) = (0, 0);
        for &at in tags {
            let Place::Topic { value, decimal, time, quality, .. } = &self.plan.tags[at].place else {
                continue;
            };
            let place = Where {
                value: value.as_ref(),
                decimal: *decimal,
                time: time.as_ref(),
                quality: quality.as_ref(),
                unit: self.plan.config.time_unit,
                good_values: self.plan.config.good_values.as_deref(),
            };
            match json::told(&document, &place).and_then(|told| self.take(at, told, came, sink)) {
                Ok(Some(true)) => good += 1,
                Ok(Some(false)) => bad += 1,
                Ok(None) => {}
                Err(refused) => self.refuse(topic, &refused.to_string(), 1),
            }
        }
        (good, bad)
    }

    fn sparkplug(
        &mut self,
        topic: &str,
        parsed: &Topic,
        payload: &[u8],
        came: Arrival,
        births: &mut Option<usize>,
        sink: &dyn Sink,
    ) -> (usize, usize) {
        let Some(at) = self.edges.iter().position(|edge| edge.is_of(parsed)) else { return (0, 0) };
        let payload = match Payload::read(payload) {
            Ok(payload) => payload,
            Err(why) => {
                self.refuse(topic, &format!("not taken as Sparkplug B: {why}"), 1);
                return (0, 0);
            }
        };
        let News { values, lost, wants_births, gap, refused } = self.edges[at].take(parsed, &payload);
        if refused > 0 {
            self.refuse(topic, "not born, or without a number, a value or a time that can be", refused);
        }
        if gap {
            self.health.missed_messages();
        }
        *births = wants_births.then_some(at);
        let (mut good, mut bad) = (0, 0);
        for (tag, told) in values {
            match self.take(tag, told, came, sink) {
                Ok(Some(true)) => good += 1,
                Ok(Some(false)) => bad += 1,
                Ok(None) => {}
                Err(refused) => self.refuse(topic, &refused.to_string(), 1),
            }
        }
        for (tag, reason) in lost {
            bad += self.lose(tag..tag + 1, reason, came.steady, sink);
        }
        (good, bad)
    }

    /// Hands a value on; tells whether it is usable, or `None` where it was no news.
    fn take(
        &mut self,
        at: usize,
        told: json::Told,
        came: Arrival,
        sink: &dyn Sink,
    ) -> Result<Option<bool>, Refused> {
        let tag = &self.plan.tags[at];
        let good =
            told.quality.is_good() && told.raw.is_some_and(|raw| tag.scaling.read(raw).quality.is_good());
        let taken = self.tags[at].take(tag, told, came, self.plan.config.time_fallback)?;
        let Taken::Sample { sample, jumped } = taken else {
            // A source that says the same again is no silent one; what the broker had kept, no source says.
            self.heard = came.steady;
            if good && !came.retained {
                self.health.still_good(came.t);
                if taken == Taken::Again {
                    sink.again(tag.index);
                }
            }
            if taken == Taken::Old {
                self.health.discarded();
            }
            return Ok(None);
        };
        if jumped {
            self.health.clock_jumped();
        }
        let bad = matches!(sample.quality, Quality::Bad(_));
        if bad {
            self.health.unusable();
        } else {
            self.health.usable(sample.quality.is_good().then_some(came.t));
        }
        sink.sample(tag.index, sample);
        Ok(Some(!bad))
    }

    /// Declares tags bad from `since` on (s by the steady clock); returns how many were not yet.
    fn lose(
        &mut self,
        tags: std::ops::Range<usize>,
        reason: BadReason,
        since: f64,
        sink: &dyn Sink,
    ) -> usize {
        let t = self.clock.now() - (self.steady() - since);
        let lost: Vec<(usize, Sample)> =
            tags.filter_map(|at| Some((at, self.tags[at].lose(reason, t, since)?))).collect();
        for (at, sample) in &lost {
            self.health.unusable();
            sink.sample(self.plan.tags[*at].index, *sample);
        }
        lost.len()
    }

    fn look_for_stale(&mut self, steady: f64, sink: &dyn Sink) {
        let Some(limit) = self.plan.config.stale_after_s else { return };
        for at in 0..self.tags.len() {
            if self.tags[at].is_overdue(steady, limit) {
                self.lose(at..at + 1, BadReason::Timeout, steady, sink);
            }
        }
    }

    /// What could not be read is counted; the first few lines say what it was.
    fn refuse(&self, topic: &str, why: &str, count: u64) {
        let before = self.health.snapshot().refused_payloads;
        self.health.unreadable(count);
        if before.is_power_of_two() || before == 0 {
            warn!(device = %self.plan.config.name, topic, refused = before + count, "{why}");
        }
    }

    fn ask_for_births(&mut self, at: usize, client: &AsyncClient) {
        let steady = self.steady();
        let recently = self.asked[at].is_some_and(|asked| steady - asked < REBIRTH_EVERY_S);
        if recently || !self.plan.config.request_rebirth {
            return;
        }
        self.asked[at] = Some(steady);
        let Edge { group, edge, .. } = &self.edges[at];
        let command = Payload {
            timestamp: Some((self.clock.now() * 1e3) as u64),
            metrics: vec![Metric::named(REBIRTH, datatype::BOOLEAN, Some(Value::Boolean(true)))],
            seq: None,
        };
        let topic = format!("spBv1.0/{group}/NCMD/{edge}");
        if let Err(error) = client.try_publish(topic, command.encode_to_vec(), PublishOptions::at_most_once())
        {
            debug!(device = %self.plan.config.name, %error, "cannot ask for births");
        }
    }
}

fn broken(error: &ConnectionError) -> Lost {
    use ConnectReturnCode::{BadClientId, BadUserNamePassword, NotAuthorized};
    match error {
        ConnectionError::ConnectionRefused(code @ (BadUserNamePassword | NotAuthorized | BadClientId)) => {
            Lost::Untrusted(match code {
                BadClientId => {
                    "the broker does not take this client_id; old ones take 1 to 23 letters and digits".into()
                }
                _ => "the broker does not take this user and password".into(),
            })
        }
        ConnectionError::Tls(error) if error.to_string().to_lowercase().contains("certificate") => {
            Lost::Untrusted(error.to_string())
        }
        error => Lost::Broken(error.to_string()),
    }
}

#[cfg(test)]
mod tests;
