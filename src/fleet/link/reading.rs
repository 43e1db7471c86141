//! What a stream has for one reader, asked for in portions.

use super::again::{Again, Came, HELD, MARGIN};
use super::error::{LinkError, away};
use super::given::{Given, Mark};
use crate::fleet::ops::MOST_ANSWER;
use async_nats::jetstream;
use async_nats::jetstream::consumer::{Consumer, pull};
use async_nats::jetstream::message::AckKind;
use futures::StreamExt;
use prost::bytes::Bytes;
use std::time::{Duration, Instant};

/// Longest wait for one answer of a server (s).
pub(super) const ANSWER: Duration = Duration::from_secs(5);
/// A server that has nothing says so after the time that it was given; one that is silent for so much longer is gone, or has no
/// such reader any more. The client's own timer, of 5 s, would take that for nothing new.
const SILENT: Duration = Duration::from_secs(4);
/// Messages that are asked for at once. What comes for all readers together is to be less than [`MOST_ANSWER`].
const PORTION: usize = 32;
/// The same for what machines say of themselves: a part of a list of loops is larger than most messages.
const LARGE: usize = 1;
/// Shortest wait that is asked for: a server takes none at all for one without end.
const SHORTEST: Duration = Duration::from_millis(10);

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

    /// What it takes: its names, its head fields and its body (bytes).
    fn size(&self) -> usize {
        self.message.length
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

    /// What tells it apart from all others of its stream.
    pub fn mark(&self) -> Mark {
        self.message
            .info()
            .map_or((0, 0), |info| (info.stream_sequence, info.published.unix_timestamp_nanos()))
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

    /// How often it was delivered, with this time.
    pub fn times_given(&self) -> i64 {
        self.message.info().map_or(1, |info| info.delivered)
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
    /// Notes what was given, where this is the only reader of its name.
    given: Option<Given>,
    /// What was given before and not done: it comes first.
    again: Again<Incoming>,
    /// How many of the messages that the stream had when this reading began have not come yet.
    left: u64,
}

impl Reading {
    /// One of several readers.
    pub(super) fn shared(consumer: Consumer<pull::Config>) -> Self {
        let left = consumer.cached_info().num_pending;
        let again = Again::new(0, Instant::now());
        Self { consumer, portion: PORTION, broken: None, next: None, given: None, again, left }
    }

    /// The only reader.
    pub(super) fn alone(consumer: Consumer<pull::Config>) -> Self {
        let given = consumer.cached_info().delivered.consumer_sequence;
        Self { next: Some(given.saturating_add(1)), ..Self::shared(consumer) }
    }

    /// The only reader, of messages that are as large as a server keeps any.
    pub(super) fn of_large(consumer: Consumer<pull::Config>) -> Self {
        Self { portion: LARGE, ..Self::alone(consumer) }
    }

    /// The only reader, once what was given before and not done has come again.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub(super) async fn from_first(
        consumer: Consumer<pull::Config>,
        given: Option<Given>,
    ) -> Result<Self, LinkError> {
        let mut reading = Self { given, ..Self::alone(consumer) };
        // By then the server gives all of it again, in any order. One that was started meanwhile counts from its start, and gives
        // what is new before that.
        reading.again = Again::new(reading.consumer.cached_info().num_ack_pending, Instant::now());
        reading.gather(None).await?;
        Ok(reading)
    }

    /// Number of the last message of the stream that was done when this reading began, and with it all before.
    pub fn done_before(&self) -> u64 {
        self.consumer.cached_info().ack_floor.stream_sequence
    }

    /// Whether everything has come that the stream had when this reading began, with what was given before and not done.
    pub fn has_caught_up(&self) -> bool {
        self.left == 0 && self.again.is_over()
    }

    /// When the server made this reader (ns since the Unix epoch): it goes with its stream.
    pub fn made(&self) -> i128 {
        self.consumer.cached_info().created.unix_timestamp_nanos()
    }

    /// Up to `most` messages; those that are there after `patience`. While messages that were given before are still to come again,
    /// there may be none. Where the answer breaks off, or a message was lost on its way, what came before is the last of this
    /// reading: the rest comes to the next.
    ///
    /// # Errors
    /// [`LinkError::Away`]; then the reading is over.
    pub async fn next(&mut self, most: usize, patience: Duration) -> Result<Vec<Incoming>, LinkError> {
        let until = Instant::now() + patience;
        if !self.again.is_over() {
            self.gather(Some(until)).await?;
            return Ok(self.again.hand_on(most, Instant::now()));
        }
        let (mut all, mut bytes) = (Vec::new(), 0);
        loop {
            let (wanted, now) = (self.portion.min(most - all.len()), Instant::now());
            match self.ask(wanted, until.saturating_duration_since(now).max(SHORTEST)).await {
                Err(error) if all.is_empty() => return Err(error),
                Err(error) => self.broken = Some(error),
                Ok(some) => {
                    let is_whole = some.len() == wanted && self.broken.is_none();
                    bytes += some.iter().map(Incoming::size).sum::<usize>();
                    all.extend(some);
                    if is_whole && all.len() < most && bytes < HELD && Instant::now() < until {
                        continue;
                    }
                }
            }
            return Ok(all);
        }
    }

    /// Waits until what is given again can be handed on, or until then. What is still missing then comes to the next call.
    async fn gather(&mut self, until: Option<Instant>) -> Result<(), LinkError> {
        loop {
            let now = Instant::now();
            let left = until.map_or(Duration::MAX, |until| until.saturating_duration_since(now));
            if self.again.is_over() || self.again.is_ready(now) || left.is_zero() {
                return Ok(());
            }
            let wait = self.again.wait(now);
            if !wait.is_zero() {
                tokio::time::sleep(wait.min(left)).await;
                continue;
            }
            for message in self.ask(self.portion, MARGIN.min(left).max(SHORTEST)).await? {
                let (sequence, bytes) = (message.sequence(), message.size());
                let came = Came { sequence, bytes, is_again: message.is_again() };
                self.again.take(came, message, Instant::now());
            }
        }
    }

    async fn ask(&mut self, most: usize, patience: Duration) -> Result<Vec<Incoming>, LinkError> {
        if let Some(error) = self.broken.take() {
            return Err(error);
        }
        if let Some(given) = &self.given {
            given.is_connected()?;
        }
        let most = most.min(self.portion);
        let asked = self.consumer.batch().max_messages(most).expires(patience).messages();
        let mut messages = asked.await.map_err(away)?;
        let (mut all, mut bytes) = (Vec::new(), 0);
        let reading = async {
            while let Some(message) = messages.next().await {
                let message = Incoming { message: message.map_err(away)? };
                // The relay counts anew with each of our requests, also with those of other readers.
                bytes += message.size() as u64;
                if bytes > MOST_ANSWER {
                    return Err(away(format!("more than {MOST_ANSWER} bytes for one reader at once")));
                }
                if let Some(next) = &mut self.next {
                    if message.given() != *next {
                        return Err(away("a message was lost on its way"));
                    }
                    *next = next.saturating_add(1);
                }
                // A message that a newer one of its subject replaces never comes, so the server's own count is used, too.
                self.left = self.left.saturating_sub(1).min(message.pending());
                all.push(message);
            }
            Ok::<_, LinkError>(())
        };
        // A server that has gone says nothing more; what came before is taken all the same.
        let ended = tokio::time::timeout(patience + SILENT, reading).await;
        let last = all.iter().map(Incoming::mark).max();
        if let Some((given, last)) = self.given.as_mut().zip(last) {
            // Where it fails the connection is lost, and what is not noted comes again.
            let _ = given.note(last).await;
        }
        match ended.unwrap_or_else(|_| Err(away("no answer"))) {
            Err(error) if all.is_empty() => Err(error),
            ended => {
                self.broken = ended.err();
                Ok(all)
            }
        }
    }
}
