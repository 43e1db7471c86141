//! What is asked of NATS, through its client; `relay` bounds what its servers say.

mod outgoing;

use super::config::Config;
pub use super::digest::digest;
use super::digest::hex;
use super::lease::Seen;
use super::login;
use super::ops::MOST_MESSAGE;
use super::relay::Relay;
use super::streams::{self, LATEST, LEASE};
use async_nats::connection::State;
use async_nats::jetstream::consumer::{AckPolicy, Consumer, DeliverPolicy, pull};
use async_nats::jetstream::context::{ContextBuilder, PublishErrorKind};
use async_nats::jetstream::message::{AckKind, PublishMessage};
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use async_nats::jetstream::{self, Context};
use async_nats::{Client, Subscriber};
use futures::StreamExt;
pub use outgoing::Outgoing;
use prost::bytes::Bytes;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Longest wait for one answer of a server (s).
const ANSWER: Duration = Duration::from_secs(5);
/// A server that has nothing says so after the time that it was given; one that is silent for so much longer is gone, or has no
/// such reader any more. The client's own timer, of 5 s, would take that for nothing new.
const SILENT: Duration = Duration::from_secs(4);
/// Messages that are on their way at once.
const UNDER_WAY: usize = 128;
/// Messages that are asked for at once. What comes for all readers together is to be less than
/// [`MOST_ANSWER`](super::ops::MOST_ANSWER).
const PORTION: usize = 32;
/// The same for what machines say of themselves: a part of a list of loops is larger than most messages.
const LARGE: usize = 1;
/// Bytes after which no more are asked for before those are taken.
const HELD: usize = 1 << 23;
/// Shortest wait that is asked for: a server takes none at all for one without end.
const SHORTEST: Duration = Duration::from_millis(10);
/// A consumer that nobody asked for longer is forgotten by the server.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(7 * 86_400);
/// A message that its only reader has not done within this time is given to it again.
const GIVEN_AGAIN: Duration = Duration::from_secs(10);
/// How late a server may be with that.
const MARGIN: Duration = Duration::from_secs(1);

/// Why the link does not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// A file that it was told of cannot be used.
    #[error("[fleet] {0}")]
    Settings(String),
    /// Nobody answers.
    #[error("NATS: {0}")]
    Away(String),
    /// Somebody else wrote first.
    #[error("NATS: another message came first")]
    Overtaken,
    /// The message is larger than a server takes (bytes).
    #[error("NATS: a message of {0} bytes is larger than the server takes")]
    TooLarge(usize),
}

fn away(error: impl std::fmt::Display) -> LinkError {
    LinkError::Away(error.to_string())
}

/// A message that a stream kept.
#[derive(Debug)]
pub struct Incoming {
    message: jetstream::Message,
}

impl Incoming {
    /// Where it was sent to.
    pub fn subject(&self) -> &str {
        self.message.subject.as_str()
    }

    /// What was sent.
    pub fn body(&self) -> &[u8] {
        &self.message.payload
    }

    /// The same, shared: what is decoded from it need not copy.
    pub fn bytes(&self) -> Bytes {
        self.message.payload.clone()
    }

    /// Its number among all that were given to its reader.
    fn given(&self) -> u64 {
        self.message.info().map_or(0, |info| info.consumer_sequence)
    }

    /// How many more messages the stream had for its reader when it gave this one.
    fn pending(&self) -> u64 {
        self.message.info().map_or(u64::MAX, |info| info.pending)
    }

    /// Its number in the stream.
    pub fn sequence(&self) -> u64 {
        self.message.info().map_or(0, |info| info.stream_sequence)
    }

    /// When the stream took it (s since the Unix epoch), by the server's clock.
    pub fn taken_at(&self) -> Option<f64> {
        let taken = self.message.info().ok()?.published;
        Some(taken.unix_timestamp_nanos() as f64 * 1e-9)
    }

    /// Whether it was delivered before.
    pub fn is_again(&self) -> bool {
        self.message.info().is_ok_and(|info| info.delivered > 1)
    }

    /// It is done, and never delivered again.
    ///
    /// # Errors
    /// [`LinkError::Away`]; then it will be delivered again.
    pub async fn done(&self) -> Result<(), LinkError> {
        match tokio::time::timeout(ANSWER, self.message.double_ack()).await {
            Ok(done) => done.map_err(away),
            Err(late) => Err(away(late)),
        }
    }

    /// It is still being worked on.
    pub async fn under_way(&self) {
        // Where this fails it is delivered again, which is what happens without it too.
        let _ = tokio::time::timeout(ANSWER, self.message.ack_with(AckKind::Progress)).await;
    }

    /// It is to be delivered again, after `pause`.
    pub async fn again(&self, pause: Duration) {
        let _ = tokio::time::timeout(ANSWER, self.message.ack_with(AckKind::Nak(Some(pause)))).await;
    }
}

/// What a stream has for one reader, which it remembers by name.
#[derive(Debug)]
pub struct Reading {
    consumer: Consumer<pull::Config>,
    /// Messages that are asked for at once.
    portion: usize,
    /// Why the last answer broke off.
    broken: Option<LinkError>,
    /// The number that the server gives to the next message, where this is the only reader.
    next: Option<u64>,
    /// What was given before and not done, in the order of the stream: it comes first.
    again: Vec<Incoming>,
    /// How many of the messages that the stream had when this reading began have not come yet.
    left: u64,
}

impl Reading {
    fn shared(consumer: Consumer<pull::Config>) -> Self {
        let left = consumer.cached_info().num_pending;
        Self { consumer, portion: PORTION, broken: None, next: None, again: Vec::new(), left }
    }

    fn alone(consumer: Consumer<pull::Config>) -> Self {
        let given = consumer.cached_info().delivered.consumer_sequence;
        Self { next: Some(given + 1), ..Self::shared(consumer) }
    }

    /// Number of the last message of the stream that was done when this reading began, and with it all before.
    pub fn done_before(&self) -> u64 {
        self.consumer.cached_info().ack_floor.stream_sequence
    }

    /// Whether everything has come that the stream had when this reading began.
    pub fn has_caught_up(&self) -> bool {
        self.left == 0
    }

    /// When the server made this reader (ns since the Unix epoch): it goes with its stream.
    pub fn made(&self) -> i128 {
        self.consumer.cached_info().created.unix_timestamp_nanos()
    }

    /// Up to `most` messages; those that are there after `patience`. Where the answer breaks off, or a message was lost on its
    /// way, what came before is the last of this reading: the rest comes to the next.
    ///
    /// # Errors
    /// [`LinkError::Away`]; then the reading is over.
    pub async fn next(&mut self, most: usize, patience: Duration) -> Result<Vec<Incoming>, LinkError> {
        if !self.again.is_empty() {
            return Ok(self.again.drain(..most.min(self.again.len())).collect());
        }
        let (until, mut all, mut bytes) = (Instant::now() + patience, Vec::new(), 0);
        loop {
            let (wanted, now) = (self.portion.min(most - all.len()), Instant::now());
            match self.ask(wanted, until.saturating_duration_since(now).max(SHORTEST)).await {
                Err(error) if all.is_empty() => return Err(error),
                Err(error) => self.broken = Some(error),
                Ok(some) => {
                    let is_whole = some.len() == wanted && self.broken.is_none();
                    bytes += some.iter().map(|message| message.body().len()).sum::<usize>();
                    all.extend(some);
                    if is_whole && all.len() < most && bytes < HELD && Instant::now() < until {
                        continue;
                    }
                }
            }
            return Ok(all);
        }
    }

    async fn ask(&mut self, most: usize, patience: Duration) -> Result<Vec<Incoming>, LinkError> {
        if let Some(error) = self.broken.take() {
            return Err(error);
        }
        let most = most.min(self.portion);
        let asked = self.consumer.batch().max_messages(most).expires(patience).messages();
        let mut messages = asked.await.map_err(away)?;
        let mut all = Vec::new();
        let reading = async {
            while let Some(message) = messages.next().await {
                let message = Incoming { message: message.map_err(away)? };
                if let Some(next) = &mut self.next {
                    if message.given() != *next {
                        return Err(away("a message was lost on its way"));
                    }
                    *next += 1;
                }
                // A message that a newer one of its subject replaces never comes, so the server's own count is used, too.
                self.left = self.left.saturating_sub(1).min(message.pending());
                all.push(message);
            }
            Ok::<_, LinkError>(())
        };
        // A server that has gone says nothing more; what came before is taken all the same.
        let ended = tokio::time::timeout(patience + SILENT, reading).await;
        match ended.unwrap_or_else(|_| Err(away("no answer"))) {
            Err(error) if all.is_empty() => Err(error),
            ended => {
                self.broken = ended.err();
                Ok(all)
            }
        }
    }
}

/// A connection to the fleet.
#[derive(Clone, Debug)]
pub struct Link {
    client: Client,
    js: Context,
}

impl Link {
    /// Begins to connect, for ever; files are read now.
    ///
    /// # Errors
    /// [`LinkError::Settings`].
    pub async fn connect(config: &Config, name: &str) -> Result<Self, LinkError> {
        let options = login::options(config).map_err(LinkError::Settings)?;
        let relay = Relay::start(config, format!("stictiond {name}")).await.map_err(LinkError::Settings)?;
        let url = relay.url();
        // The relay ends when the library drops this, with its connection.
        let options =
            options.name(relay.secret()).request_timeout(Some(ANSWER)).event_callback(move |event| {
                relay.tell(&event);
                std::future::ready(())
            });
        let client = options.connect(url).await.map_err(away)?;
        let js = ContextBuilder::new()
            .domain(&config.domain)
            .timeout(ANSWER)
            .ack_timeout(ANSWER)
            .build(client.clone());
        Ok(Self { client, js })
    }

    /// Whether a server is at the other end.
    pub fn is_up(&self) -> bool {
        self.client.connection_state() == State::Connected
    }

    /// Largest message that the server takes, and that whoever reads it takes from a server (bytes).
    pub fn max_bytes(&self) -> usize {
        self.client.max_payload().min(MOST_MESSAGE as usize)
    }

    /// Makes the streams that are missing. Streams that an earlier version made get our subjects and longest message, and keep their
    /// other limits. Two centres may do this at the same time: both make the same changes.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn make_streams(&self, config: &Config) -> Result<(), LinkError> {
        for wanted in streams::of(config) {
            let stream = self.js.get_or_create_stream(wanted.clone()).await.map_err(away)?;
            if let Some(mended) = streams::mended(&stream.cached_info().config, &wanted) {
                self.js.update_stream(mended).await.map_err(away)?;
                tracing::info!(stream = wanted.name, "a stream of an earlier version was updated");
            }
        }
        Ok(())
    }

    /// When a stream was made (ns since the Unix epoch): one that is made anew counts from 1 again.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn made(&self, stream: &str) -> Result<i128, LinkError> {
        let stream = self.js.get_stream(stream).await.map_err(away)?;
        Ok(stream.cached_info().created.unix_timestamp_nanos())
    }

    /// Sends messages in order.
    ///
    /// # Errors
    /// How many from the first on are kept, and why the next is not.
    pub async fn send(&self, messages: &[Outgoing]) -> Result<(), (usize, LinkError)> {
        for (part, some) in messages.chunks(UNDER_WAY).enumerate() {
            let mut answers = Vec::with_capacity(some.len());
            for (at, message) in some.iter().enumerate() {
                let fail = |error| (UNDER_WAY * part + at, error);
                if !self.is_up() {
                    return Err(fail(away("not connected")));
                }
                if message.body.len() + 512 > self.max_bytes() {
                    return Err(fail(LinkError::TooLarge(message.body.len())));
                }
                let outgoing = PublishMessage::build().payload(message.body.clone().into());
                let outgoing = match message.once {
                    true => outgoing.message_id(hex(&digest(&message.subject, &message.body))),
                    false => outgoing,
                };
                let sent = self.js.send_publish(message.subject.clone(), outgoing).await;
                answers.push(sent.map_err(|error| fail(away(error)))?);
            }
            for (at, answer) in answers.into_iter().enumerate() {
                answer.await.map_err(|error| (UNDER_WAY * part + at, away(error)))?;
            }
        }
        Ok(())
    }

    /// Sends a message that nobody keeps.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn tell(&self, subject: String, body: Vec<u8>) -> Result<(), LinkError> {
        self.client.publish(subject, body.into()).await.map_err(away)?;
        match tokio::time::timeout(ANSWER, self.client.flush()).await {
            Ok(flushed) => flushed.map_err(away),
            Err(late) => Err(away(late)),
        }
    }

    /// Hears messages that nobody keeps.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn hear(&self, subject: String) -> Result<Subscriber, LinkError> {
        self.client.subscribe(subject).await.map_err(away)
    }

    /// The last message of a subject, with its number in the stream.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn last(&self, stream: &str, subject: &str) -> Result<Option<(u64, Vec<u8>)>, LinkError> {
        let stream = self.js.get_stream_no_info(stream).await.map_err(away)?;
        match stream.get_last_raw_message_by_subject(subject).await {
            Ok(message) => Ok(Some((message.sequence, message.payload.to_vec()))),
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => Ok(None),
            Err(error) => Err(away(error)),
        }
    }

    /// What a stream has for the only reader called `name`, from the first message on that it has not done, in the order of the
    /// stream. Where messages were given to it before and it has not done them, it waits until the server gives them again.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn read(&self, stream: &str, name: &str, filter: &str) -> Result<Reading, LinkError> {
        let mut reading = Reading::alone(self.consumer(stream, name, filter, (GIVEN_AGAIN, -1)).await?);
        let pending = reading.consumer.cached_info().num_ack_pending;
        if pending > 0 {
            // By then the server gives all of it again, in any order. One that was started meanwhile counts from its start,
            // and gives what is new before that.
            tokio::time::sleep(GIVEN_AGAIN + MARGIN).await;
            let (mut again, mut left, mut since) = (BTreeMap::new(), pending, Instant::now());
            // What is still missing then was deleted from the stream.
            while left > 0 && since.elapsed() < GIVEN_AGAIN + MARGIN {
                for message in reading.ask(UNDER_WAY, MARGIN).await? {
                    if message.is_again() && !again.contains_key(&message.sequence()) {
                        (left, since) = (left.saturating_sub(1), Instant::now());
                    }
                    again.insert(message.sequence(), message);
                }
            }
            reading.again = again.into_values().collect();
        }
        Ok(reading)
    }

    /// What a stream has for all who read as `name`, each message for one of them. One that is not done within `patience` is
    /// given to another, `attempts` times in all.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn share(
        &self,
        stream: &str,
        name: &str,
        filter: &str,
        limits: (Duration, i64),
    ) -> Result<Reading, LinkError> {
        Ok(Reading::shared(self.consumer(stream, name, filter, limits).await?))
    }

    async fn consumer(
        &self,
        stream: &str,
        name: &str,
        filter: &str,
        (patience, attempts): (Duration, i64),
    ) -> Result<Consumer<pull::Config>, LinkError> {
        let stream = self.js.get_stream_no_info(stream).await.map_err(away)?;
        let config = pull::Config {
            durable_name: Some(name.to_string()),
            filter_subject: filter.to_string(),
            deliver_policy: DeliverPolicy::All,
            ack_policy: AckPolicy::Explicit,
            ack_wait: patience,
            max_deliver: attempts,
            max_ack_pending: 4096,
            inactive_threshold: FORGOTTEN_AFTER,
            ..pull::Config::default()
        };
        stream.get_or_create_consumer(name, config).await.map_err(away)
    }

    /// The latest message of each subject, and every one that comes after, for this process alone.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn follow(&self, stream: &str, filter: &str) -> Result<Reading, LinkError> {
        let stream = self.js.get_stream_no_info(stream).await.map_err(away)?;
        let config = pull::Config {
            filter_subject: filter.to_string(),
            deliver_policy: DeliverPolicy::LastPerSubject,
            ack_policy: AckPolicy::None,
            inactive_threshold: Duration::from_secs(300),
            ..pull::Config::default()
        };
        let reading = Reading::alone(stream.create_consumer(config).await.map_err(away)?);
        Ok(Reading { portion: LARGE, ..reading })
    }

    /// The lease as it stands.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn lease(&self) -> Result<Option<Seen>, LinkError> {
        let last = self.last(LATEST, LEASE).await?;
        Ok(last.and_then(|(sequence, body)| Seen::read(sequence, std::str::from_utf8(&body).ok()?)))
    }

    /// Writes the lease, if the last message still has the number `after`; the number of what was written.
    ///
    /// # Errors
    /// [`LinkError::Overtaken`], [`LinkError::Away`].
    pub async fn write_lease(&self, after: u64, text: String) -> Result<u64, LinkError> {
        let message = PublishMessage::build().payload(text.into()).expected_last_subject_sequence(after);
        let refused = |error: jetstream::context::PublishError| match error.kind() {
            PublishErrorKind::WrongLastSequence => LinkError::Overtaken,
            _ => away(error),
        };
        let sent = self.js.send_publish(LEASE, message).await.map_err(refused)?;
        Ok(sent.await.map_err(refused)?.sequence)
    }

    /// Deletes what every reader of a stream has done. One of them, `part`, reads some of the subjects only. Deletes nothing
    /// where that does not exist, or while a message is under way: servers before 2.9.15 forget such a message then.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn purge_done(&self, stream: &str, part: &str) -> Result<(), LinkError> {
        let stream = self.js.get_stream(stream).await.map_err(away)?;
        let (mut consumers, mut done) = (stream.consumers(), None::<u64>);
        while let Some(consumer) = consumers.next().await {
            let consumer = consumer.map_err(away)?;
            if consumer.num_ack_pending > 0 {
                return Ok(());
            }
            if consumer.name != part {
                let floor = consumer.ack_floor.stream_sequence;
                done = Some(done.map_or(floor, |least| least.min(floor)));
            }
        }
        // Asked after the others: where nothing is left for it now, it has done all that they have.
        let part = stream.consumer_info(part).await.map_err(away)?;
        if part.num_ack_pending > 0 {
            return Ok(());
        }
        if part.num_pending > 0 {
            done = done.map(|least| least.min(part.ack_floor.stream_sequence));
        }
        if let Some(done) = done.filter(|done| *done > 0) {
            stream.purge().sequence(done + 1).await.map_err(away)?;
        }
        Ok(())
    }
}
