//! The connection that carries diagnoses and alarms as retained JSON.
//!
//! ```text
//!        connected: online, then the latest of every topic        lost: the broker says offline
//! away ------------------------------------------------> there ---------------------------------> away
//! ```
//! What happens while the broker is away waits, the newest of each topic only.

use super::config::Config;
use super::message;
use super::outbox::Outbox;
use crate::alarm::Kind;
use crate::mqtt::{Broker, Takeovers};
use crate::results::{Event, Results};
use crate::signal::LoopId;
use futures::StreamExt;
use futures::stream::{FuturesUnordered, unfold};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;
use rumqttc::{AsyncClient, EventLoop, LastWill, Packet, PublishOptions, QoS};
use std::collections::{HashMap, HashSet};
use std::pin::pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{Instant, sleep, timeout};
use tokio_util::sync::CancellationToken;
use tracing::{debug, info, warn};

/// Messages on their way at once.
const IN_FLIGHT: usize = 32;
/// First pause before another attempt to connect.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// Longest wait for the farewell to be sent.
const FAREWELL: Duration = Duration::from_secs(2);

/// A loop as topics name it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoopName {
    /// Its id.
    pub id: LoopId,
    /// Its group; empty where it has none.
    pub group: String,
}

/// The loops now watched.
pub type Loops = Arc<dyn Fn() -> Vec<LoopName> + Send + Sync>;

/// What has been published, live.
#[derive(Debug, Default)]
pub struct Counters {
    /// Messages that the broker has taken.
    pub published: AtomicU64,
    /// Connections that could not be made or were lost.
    pub losses: AtomicU64,
    /// Messages for which there was no room.
    pub dropped: AtomicU64,
    /// Messages that wait for the broker.
    pub queue: AtomicU64,
    /// Whether a connection is open.
    pub connected: AtomicBool,
    /// Why there is none, and since when (s).
    lost: Mutex<Option<(String, f64)>>,
    /// When the broker last took a message (s).
    taken_at: Mutex<Option<f64>>,
}

impl Counters {
    /// Why there is no connection, and since when (s); `None` while there is one, and before it was tried.
    pub fn lost(&self) -> Option<(String, f64)> {
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// When the broker last took a message (s); `None` before it has taken one.
    pub fn taken_at(&self) -> Option<f64> {
        *self.taken_at.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The broker took a message at `now` (s).
    pub fn takes(&self, now: f64) {
        self.published.fetch_add(1, Relaxed);
        *self.taken_at.lock().unwrap_or_else(PoisonError::into_inner) = Some(now);
    }

    fn found(&self) {
        self.connected.store(true, Relaxed);
        *self.lost.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn loses(&self, why: &str, now: f64) {
        self.connected.store(false, Relaxed);
        self.losses.fetch_add(1, Relaxed);
        let mut lost = self.lost.lock().unwrap_or_else(PoisonError::into_inner);
        let since = lost.take().map_or(now, |(_, since)| since);
        *lost = Some((why.to_string(), since));
    }
}

/// Publishes results until it is told to stop.
pub struct Publisher {
    pub(super) config: Config,
    pub(super) results: Arc<Results>,
    pub(super) loops: Loops,
    pub(super) now: Arc<dyn Fn() -> f64 + Send + Sync>,
    counters: Arc<Counters>,
}

impl Publisher {
    /// A publisher of `results` for the loops that `loops` names; `now` is the daemon's clock (s).
    pub fn new(
        config: Config,
        results: Arc<Results>,
        loops: Loops,
        now: Arc<dyn Fn() -> f64 + Send + Sync>,
    ) -> Self {
        Self { config, results, loops, now, counters: Arc::default() }
    }

    /// What has been published, live.
    pub fn counters(&self) -> Arc<Counters> {
        Arc::clone(&self.counters)
    }

    /// Publishes JSON until `stop` is cancelled, and then says that it is offline.
    pub(super) async fn publish(&self, stop: CancellationToken) {
        let mut news = self.results.subscribe();
        let mut outbox = Outbox::new(self.config.max_topics);
        let mut pauses = Pauses::new(&self.config, 1);
        let will = LastWill::new(&self.config.status_topic, message::status(false), QoS::AtLeastOnce, true);
        while !stop.is_cancelled() {
            let connecting =
                connect(self.config.broker(), will.clone(), self.config.timeout_s, IN_FLIGHT * 2);
            let Some(connected) = stop.run_until_cancelled(connecting).await else { return };
            let lost = match connected {
                Err(why) => why,
                Ok((client, events)) => {
                    self.counters.found();
                    pauses.reset();
                    // What happened meanwhile comes first, or an old state would be sent before it.
                    let mut groups = self.refresh(&mut outbox);
                    outbox.again();
                    let carrying = self.carry(client, events, &mut news, &mut outbox, &mut groups, &stop);
                    match carrying.await {
                        Some(why) => why,
                        None => return,
                    }
                }
            };
            self.counters.loses(&lost, (self.now)());
            // What happens until there is a connection is taken over then, however much it is.
            self.counters.queue.store(outbox.waiting() as u64, Relaxed);
            pauses.tell(&self.config.address, &self.config.client_id(), &lost);
            let pause = pauses.next();
            stop.run_until_cancelled(sleep(pause)).await;
        }
    }

    /// Carries messages until the connection is lost (and why) or the daemon stops.
    async fn carry(
        &self,
        client: AsyncClient,
        events: EventLoop,
        news: &mut tokio::sync::broadcast::Receiver<Event>,
        outbox: &mut Outbox,
        groups: &mut HashMap<LoopId, String>,
        stop: &CancellationToken,
    ) -> Option<String> {
        let mut events = pin!(unfold(events, |mut events| async move {
            let event = events.poll().await;
            Some((event, events))
        }));
        let retained = PublishOptions::at_least_once().retained();
        if let Err(error) = client.try_publish(&*self.config.status_topic, message::status(true), retained) {
            return Some(error.to_string());
        }
        info!(address = %self.config.address, "publishing results");
        let mut on_their_way = FuturesUnordered::new();
        loop {
            while on_their_way.len() < IN_FLIGHT
                && let Some((topic, version, payload)) = outbox.next()
            {
                match client.try_publish_tracked(topic.clone(), payload, retained) {
                    Ok(notice) => {
                        on_their_way.push(async move { (topic, version, notice.wait_async().await.is_ok()) });
                    }
                    Err(error) => {
                        outbox.failed(&topic, version);
                        debug!(topic, %error, "not sent");
                        break;
                    }
                }
            }
            self.counters.queue.store((outbox.waiting() + on_their_way.len()) as u64, Relaxed);
            tokio::select! {
                () = stop.cancelled() => {
                    let _ = client.try_publish(&*self.config.status_topic, message::status(false), retained);
                    let _ = client.try_disconnect();
                    let farewell = async { while let Some(Ok(_)) = events.next().await {} };
                    let _ = timeout(FAREWELL, farewell).await;
                    return None;
                }
                event = events.next() => match event {
                    Some(Ok(_)) => {}
                    Some(Err(error)) => return Some(error.to_string()),
                    None => return Some("closed".into()),
                },
                Some((topic, version, taken)) = on_their_way.next() => {
                    if taken {
                        self.counters.takes((self.now)());
                        outbox.taken(&topic, version);
                    } else {
                        outbox.failed(&topic, version);
                    }
                }
                event = news.recv() => match event {
                    Ok(event) => self.hear(event, outbox, groups),
                    Err(RecvError::Lagged(_)) => *groups = self.refresh(outbox),
                    Err(RecvError::Closed) => return None,
                },
            }
        }
    }

    fn hear(&self, event: Event, outbox: &mut Outbox, groups: &mut HashMap<LoopId, String>) {
        match event {
            Event::Run(id, _) => self.put_known(&id, outbox, groups),
            Event::Alarm(change) if change.id.kind == Kind::Stiction => {
                self.put_known(&change.id.subject, outbox, groups);
            }
            Event::Alarm(_) => {}
            Event::Reloaded { .. } => *groups = self.refresh(outbox),
            Event::Writeback(..) | Event::Backfill { .. } => {}
        }
    }

    fn put_known(&self, id: &LoopId, outbox: &mut Outbox, groups: &mut HashMap<LoopId, String>) {
        match groups.get(id) {
            Some(group) => self.put(id, group, outbox),
            None => *groups = self.refresh(outbox),
        }
    }

    /// Takes over what is known of every loop; topics of loops that are gone become empty.
    fn refresh(&self, outbox: &mut Outbox) -> HashMap<LoopId, String> {
        let loops = (self.loops)();
        let topics: HashSet<String> =
            loops.iter().flat_map(|name| self.config.topics(name.id.as_str(), &name.group)).collect();
        outbox.empty_all_but(|topic| topics.contains(topic));
        for name in &loops {
            self.put(&name.id, &name.group, outbox);
        }
        loops.into_iter().map(|name| (name.id, name.group)).collect()
    }

    fn put(&self, id: &LoopId, group: &str, outbox: &mut Outbox) {
        let Some(known) = self.results.get(id, (self.now)()) else { return };
        let [diagnosis, alarm] = self.config.topics(id.as_str(), group);
        let diagnosed =
            known.last.map(|summary| (diagnosis, message::diagnosis(id.as_str(), group, &summary)));
        for (topic, payload) in diagnosed.into_iter().chain([(alarm, message::alarm(group, &known.alarm))]) {
            if !outbox.put(&topic, payload) {
                self.counters.dropped.fetch_add(1, Relaxed);
            }
        }
    }
}

/// Pauses between attempts to connect, longer and longer, with jitter; and the first line of each outage.
pub(super) struct Pauses {
    longest: Duration,
    failures: u32,
    random: Pcg32,
    takeovers: Takeovers,
    born: Instant,
}

impl Pauses {
    pub(super) fn new(config: &Config, seed: u64) -> Self {
        let longest = Duration::from_millis(config.reconnect_max_ms);
        let random = Pcg32::seed_from_u64(seed);
        Self { longest, failures: 0, random, takeovers: Takeovers::default(), born: Instant::now() }
    }

    pub(super) fn reset(&mut self) {
        self.failures = 0;
    }

    pub(super) fn tell(&mut self, address: &str, client_id: &str, why: &str) {
        if self.failures == 0 {
            warn!(address, "results are not published: {why}");
            if let Some(takeover) = self.takeovers.ended(self.born.elapsed().as_secs_f64(), client_id) {
                warn!(address, "{takeover}");
            }
        } else {
            self.takeovers.refused();
            debug!(address, "results are not published: {why}");
        }
    }

    pub(super) fn next(&mut self) -> Duration {
        let factor = 1u32.checked_shl(self.failures).unwrap_or(u32::MAX);
        self.failures = self.failures.saturating_add(1);
        FIRST_PAUSE.saturating_mul(factor).min(self.longest).mul_f64(self.random.random_range(0.5..1.0))
    }
}

/// Connects to the broker, leaving a will.
pub(super) async fn connect(
    broker: Broker,
    will: LastWill,
    limit_s: u64,
    requests: usize,
) -> Result<(AsyncClient, EventLoop), String> {
    let options = tokio::task::spawn_blocking(move || broker.options()).await;
    let mut options = options.map_err(|error| error.to_string())?.map_err(|error| error.to_string())?;
    options.set_last_will(will);
    let built = AsyncClient::builder(options).capacity(requests).try_build();
    let (client, mut events) = built.map_err(|error| error.to_string())?;
    events.network_options.set_connection_timeout(limit_s).set_tcp_nodelay(true);
    loop {
        match timeout(Duration::from_secs(limit_s), events.poll()).await {
            Err(_) => return Err(format!("no connection within {limit_s} s")),
            Ok(Err(error)) => return Err(error.to_string()),
            Ok(Ok(rumqttc::Event::Incoming(Packet::ConnAck(_)))) => return Ok((client, events)),
            Ok(Ok(_)) => {}
        }
    }
}
