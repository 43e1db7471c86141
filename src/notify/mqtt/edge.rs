//! The daemon as an edge node of Sparkplug B: each loop is a device, its diagnosis and its alarm are metrics.
//!
//! A connection begins with NBIRTH and one DBIRTH a loop and ends with the NDEATH left as a will; both carry the number of
//! the session. Messages are numbered 0 to 255. Asked for a rebirth, the node sends its births again.

use super::config::SparkplugConfig;
use super::message::{level, state};
use super::publisher::{Pauses, Publisher, connect};
use crate::alarm::Kind;
use crate::mqtt::sparkplug::{BDSEQ, Metric, Payload, REBIRTH, Value, datatype};
use crate::results::Event;
use crate::signal::LoopId;
use futures::StreamExt;
use futures::stream::unfold;
use prost::Message;
use rumqttc::{AsyncClient, EventLoop, LastWill, Packet, PublishOptions, QoS};
use std::pin::pin;
use std::time::Duration;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use tokio::time::{sleep, timeout};
use tokio_util::sync::CancellationToken;

/// Requests to the broker that may wait besides the births.
const REQUESTS: usize = 256;
/// Longest wait for the farewell to be sent.
const FAREWELL: Duration = Duration::from_secs(2);

/// The edge node.
pub(super) struct Edge<'p> {
    publisher: &'p Publisher,
    config: &'p SparkplugConfig,
    /// Number of the session, 0 to 255.
    bdseq: u64,
    /// Number of the next message.
    seq: u64,
}

impl<'p> Edge<'p> {
    /// The node of a publisher.
    pub(super) fn new(publisher: &'p Publisher, config: &'p SparkplugConfig) -> Self {
        // Nothing is kept between two runs; the time makes another number likely, so that an old will is not taken for ours.
        let bdseq = (publisher.now)().max(0.0) as u64 % 256;
        Self { publisher, config, bdseq, seq: 0 }
    }

    /// Keeps the node alive until `stop` is cancelled.
    pub(super) async fn run(&mut self, stop: CancellationToken) {
        let mut news = self.publisher.results.subscribe();
        let mut pauses = Pauses::new(&self.publisher.config, 2);
        while !stop.is_cancelled() {
            self.bdseq = (self.bdseq + 1) % 256;
            let mut broker = self.publisher.config.broker();
            broker.client_id = self.publisher.config.edge_client_id();
            let will = LastWill::new(self.topic("NDEATH", None), self.death(), QoS::AtLeastOnce, false);
            let room = (self.publisher.loops)().len() + REQUESTS;
            let connecting = connect(broker, will, self.publisher.config.timeout_s, room);
            let Some(connected) = stop.run_until_cancelled(connecting).await else { return };
            let lost = match connected {
                Err(why) => why,
                Ok((client, events)) => {
                    pauses.reset();
                    match self.live(client, events, &mut news, &stop).await {
                        Some(why) => why,
                        None => return,
                    }
                }
            };
            let config = &self.publisher.config;
            pauses.tell(&config.address, &config.edge_client_id(), &lost);
            let pause = pauses.next();
            stop.run_until_cancelled(sleep(pause)).await;
        }
    }

    /// One session: `None` when the daemon stops, else why it ended.
    async fn live(
        &mut self,
        client: AsyncClient,
        events: EventLoop,
        news: &mut Receiver<Event>,
        stop: &CancellationToken,
    ) -> Option<String> {
        let mut events = pin!(unfold(events, |mut events| async move {
            let event = events.poll().await;
            Some((event, events))
        }));
        if let Err(error) = client.try_subscribe(self.topic("NCMD", None), QoS::AtLeastOnce) {
            return Some(error.to_string());
        }
        if let Err(why) = self.births(&client) {
            return Some(why);
        }
        loop {
            let sent = tokio::select! {
                () = stop.cancelled() => {
                    let _ = client.try_publish(self.topic("NDEATH", None), self.death(), PublishOptions::at_least_once());
                    let _ = client.try_disconnect();
                    let farewell = async { while let Some(Ok(_)) = events.next().await {} };
                    let _ = timeout(FAREWELL, farewell).await;
                    return None;
                }
                event = events.next() => match event {
                    Some(Ok(rumqttc::Event::Incoming(Packet::Publish(publish)))) if asks_for_births(&publish.payload) => {
                        self.births(&client)
                    }
                    Some(Ok(_)) => Ok(()),
                    Some(Err(error)) => Err(error.to_string()),
                    None => Err("closed".into()),
                },
                event = news.recv() => match event {
                    Ok(Event::Run(id, _)) => self.say(&client, "DDATA", &id),
                    Ok(Event::Alarm(change)) => match change.id.kind {
                        Kind::Stiction => self.say(&client, "DDATA", &change.id.subject),
                        _ => Ok(()),
                    },
                    Ok(Event::Reloaded { .. }) | Err(RecvError::Lagged(_)) => self.births(&client),
                    Ok(Event::Writeback(..) | Event::Backfill { .. }) => Ok(()),
                    Err(RecvError::Closed) => return None,
                },
            };
            if let Err(why) = sent {
                return Some(why);
            }
        }
    }

    fn topic(&self, kind: &str, device: Option<&str>) -> String {
        let SparkplugConfig { group, edge } = self.config;
        let device = device.map(|device| format!("/{}", level(device))).unwrap_or_default();
        format!("spBv1.0/{group}/{kind}/{edge}{device}")
    }

    fn stamp(&self) -> u64 {
        ((self.publisher.now)().max(0.0) * 1e3) as u64
    }

    fn death(&self) -> Vec<u8> {
        let metrics = vec![Metric::named(BDSEQ, datatype::UINT64, Some(Value::Long(self.bdseq)))];
        Payload { timestamp: Some(self.stamp()), metrics, seq: None }.encode_to_vec()
    }

    fn births(&mut self, client: &AsyncClient) -> Result<(), String> {
        self.seq = 0;
        let metrics = vec![
            Metric::named(BDSEQ, datatype::UINT64, Some(Value::Long(self.bdseq))),
            Metric::named(REBIRTH, datatype::BOOLEAN, Some(Value::Boolean(false))),
        ];
        self.send(client, self.topic("NBIRTH", None), metrics)?;
        for name in (self.publisher.loops)() {
            self.say(client, "DBIRTH", &name.id)?;
        }
        Ok(())
    }

    /// All that is known of a loop.
    fn say(&mut self, client: &AsyncClient, kind: &str, id: &LoopId) -> Result<(), String> {
        let Some(known) = self.publisher.results.get(id, (self.publisher.now)()) else { return Ok(()) };
        let last = known.last.as_ref();
        let number = |value: Option<f64>| value.filter(|value| value.is_finite()).map(Value::Double);
        let interval = last.and_then(|summary| summary.f_ci95);
        let text = |text: &str| Some(Value::Text(text.into()));
        let metrics = vec![
            Metric::named("Friction/f", datatype::DOUBLE, number(last.and_then(|summary| summary.f))),
            Metric::named("Friction/low", datatype::DOUBLE, number(interval.map(|limits| limits[0]))),
            Metric::named("Friction/high", datatype::DOUBLE, number(interval.map(|limits| limits[1]))),
            Metric::named("Friction/evidence", datatype::DOUBLE, number(last.and_then(|s| s.delta_aic))),
            Metric::named("Outcome", datatype::STRING, last.and_then(|summary| text(&summary.outcome))),
            Metric::named("Alarm/state", datatype::STRING, text(state(known.alarm.state))),
            Metric::named("Alarm/active", datatype::BOOLEAN, Some(Value::Boolean(known.alarm.active))),
        ];
        let topic = self.topic(kind, Some(id.as_str()));
        self.send(client, topic, metrics)
    }

    fn send(&mut self, client: &AsyncClient, topic: String, mut metrics: Vec<Metric>) -> Result<(), String> {
        let stamp = self.stamp();
        metrics.iter_mut().for_each(|metric| metric.timestamp = Some(stamp));
        let payload = Payload { timestamp: Some(stamp), metrics, seq: Some(self.seq) };
        self.seq = (self.seq + 1) % 256;
        let sent = client.try_publish(topic, payload.encode_to_vec(), PublishOptions::at_most_once());
        sent.map_err(|error| error.to_string())
    }
}

/// Whether a command asks for the births; nothing else can be commanded.
fn asks_for_births(payload: &[u8]) -> bool {
    let asked = |metric: &Metric| {
        metric.name.as_deref() == Some(REBIRTH) && metric.value == Some(Value::Boolean(true))
    };
    Payload::read(payload).is_ok_and(|payload| payload.metrics.iter().any(asked))
}
