//! What is asked of NATS, through its client; `relay` bounds what its servers say.

mod again;
mod error;
mod given;
mod hearing;
mod outgoing;
mod purging;
mod reading;

use super::config::Config;
pub use super::digest::digest;
use super::digest::hex;
use super::lease::Seen;
use super::login;
use super::ops::MOST_MESSAGE;
use super::relay::Relay;
use super::streams::{self, ACTIONS, LATEST, LEASE};
use again::{GIVEN_AGAIN, UNACKNOWLEDGED};
use async_nats::Client;
use async_nats::connection::State;
use async_nats::jetstream::consumer::{self, AckPolicy, Consumer, DeliverPolicy, pull};
use async_nats::jetstream::context::{ContextBuilder, PublishErrorKind};
use async_nats::jetstream::message::{PublishMessage, StreamMessage};
use async_nats::jetstream::stream::{self, LastRawMessageErrorKind, RawMessageError};
use async_nats::jetstream::{self, Context};
pub use error::LinkError;
use error::{away, unmade};
use futures::StreamExt;
pub use given::Mark;
use given::{Given, Standing};
use hearing::HEAD;
pub use hearing::Hearing;
pub use outgoing::Outgoing;
use purging::Reader;
use reading::ANSWER;
pub use reading::{Incoming, Reading};
use std::time::Duration;

/// Messages that are on their way at once.
const UNDER_WAY: usize = 128;
/// A consumer that nobody asked for longer is forgotten by the server.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(7 * 86_400);
/// The same for one that has no name, which is of use to one process only.
const NAMELESS_FORGOTTEN_AFTER: Duration = Duration::from_secs(300);
/// Readers of one stream that are asked about: as many as a server lists in one answer, and far more than there are centres.
const MOST_READERS: usize = 256;

/// What a stream is, and how far it has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamState {
    /// When it was made (ns since the Unix epoch): one that is made anew counts from 1 again.
    pub made: i128,
    /// Number of its last message, also where that was deleted. It falls where the server has lost its last messages.
    pub last: u64,
}

/// How full a stream is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Fill {
    /// Messages that it has.
    pub messages: u64,
    /// Bytes that they take.
    pub bytes: u64,
    /// Bytes that they may take; none where an operator took the bound away.
    pub room: Option<u64>,
}

impl Fill {
    /// The share of its room that is taken (0..1); `None` for a stream without a bound.
    pub fn share(&self) -> Option<f64> {
        self.room.map(|room| (self.bytes as f64 / room as f64).min(1.0))
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
    /// [`LinkError::Away`] and [`LinkError::NoRoom`].
    pub async fn make_streams(&self, config: &Config) -> Result<(), LinkError> {
        for wanted in streams::of(config) {
            let stream = self.js.get_or_create_stream(wanted.clone()).await;
            let stream = stream.map_err(|error| unmade(&error, &wanted))?;
            if let Some(mended) = streams::mended(&stream.cached_info().config, &wanted) {
                self.js.update_stream(mended).await.map_err(away)?;
                tracing::info!(stream = wanted.name, "a stream of an earlier version was updated");
            }
        }
        Ok(())
    }

    /// How a stream stands.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn state(&self, stream: &str) -> Result<StreamState, LinkError> {
        let info = self.js.get_stream(stream).await.map_err(away)?.cached_info().clone();
        Ok(StreamState { made: info.created.unix_timestamp_nanos(), last: info.state.last_sequence })
    }

    /// When a stream was made (ns since the Unix epoch).
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn made(&self, stream: &str) -> Result<i128, LinkError> {
        Ok(self.state(stream).await?.made)
    }

    /// Sends messages in order.
    ///
    /// # Errors
    /// How many from the first on are kept, and why the next is not.
    pub async fn send(&self, messages: &[Outgoing]) -> Result<(), (usize, LinkError)> {
        self.keep(messages).await.map(drop)
    }

    /// Sends messages in order; the number that the last of them has in its stream, 0 where there is none.
    ///
    /// # Errors
    /// As [`Link::send`].
    pub async fn keep(&self, messages: &[Outgoing]) -> Result<u64, (usize, LinkError)> {
        let mut last = 0;
        for (part, some) in messages.chunks(UNDER_WAY).enumerate() {
            let mut answers = Vec::with_capacity(some.len());
            for (at, message) in some.iter().enumerate() {
                let fail = |error| (UNDER_WAY * part + at, error);
                if !self.is_up() {
                    return Err(fail(away("not connected")));
                }
                if message.body.len() + HEAD > self.max_bytes() {
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
                let kept = answer.await.map_err(|error| (UNDER_WAY * part + at, away(error)))?;
                last = kept.sequence;
            }
        }
        Ok(last)
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

    /// Hears messages that nobody keeps. What comes faster than it is taken is left out.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn hear(&self, subject: String) -> Result<Hearing, LinkError> {
        self.client.subscribe(subject).await.map(Hearing::of).map_err(away)
    }

    /// The last message of a subject, with its number in the stream.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn last(&self, stream: &str, subject: &str) -> Result<Option<(u64, Vec<u8>)>, LinkError> {
        let last = self.last_of(stream, subject).await?;
        Ok(last.map(|message| (message.sequence, message.payload.to_vec())))
    }

    /// When a stream took the last message of a subject (s since the Unix epoch), by the server's clock.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn last_taken_at(&self, stream: &str, subject: &str) -> Result<Option<f64>, LinkError> {
        let last = self.last_of(stream, subject).await?;
        Ok(last.map(|message| message.time.unix_timestamp_nanos() as f64 * 1e-9))
    }

    async fn last_of(&self, stream: &str, subject: &str) -> Result<Option<StreamMessage>, LinkError> {
        let stream = self.js.get_stream_no_info(stream).await.map_err(away)?;
        found(stream.get_last_raw_message_by_subject(subject).await)
    }

    /// The message with this number in a stream: its subject and its body.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn at(&self, stream: &str, sequence: u64) -> Result<Option<(String, Vec<u8>)>, LinkError> {
        let message = self.message(stream, sequence).await?;
        Ok(message.map(|message| (message.subject.to_string(), message.payload.to_vec())))
    }

    async fn message(&self, stream: &str, sequence: u64) -> Result<Option<StreamMessage>, LinkError> {
        let stream = self.js.get_stream_no_info(stream).await.map_err(away)?;
        found(stream.get_raw_message(sequence).await)
    }

    /// What a stream has for the only reader called `name`, from the first message on that it has not done, in the order of the
    /// stream. Where messages were given to it before and it has not done them, it waits until the server gives them again. Where
    /// those take more than may be held, the reading waits once more for each portion of them. Where the server has lost messages
    /// that it was given, and uses their numbers again, all that is left may come again.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn read(&self, stream: &str, name: &str, filter: &str) -> Result<Reading, LinkError> {
        // An edge may not look at single orders: they may be those of another site.
        let given = (stream != ACTIONS).then(|| Given::new(&self.client, stream, name));
        let consumer = self.consumer(stream, name, filter, (GIVEN_AGAIN, -1), given.as_ref()).await?;
        Reading::from_first(consumer, given).await
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
        Ok(Reading::shared(self.consumer(stream, name, filter, limits, None).await?))
    }

    async fn consumer(
        &self,
        stream: &str,
        name: &str,
        filter: &str,
        (patience, attempts): (Duration, i64),
        given: Option<&Given>,
    ) -> Result<Consumer<pull::Config>, LinkError> {
        let own = self.js.get_stream_no_info(stream).await.map_err(away)?;
        let config = pull::Config {
            durable_name: Some(name.to_string()),
            filter_subject: filter.to_string(),
            deliver_policy: DeliverPolicy::All,
            ack_policy: AckPolicy::Explicit,
            ack_wait: patience,
            max_deliver: attempts,
            max_ack_pending: i64::from(UNACKNOWLEDGED),
            inactive_threshold: FORGOTTEN_AFTER,
            ..pull::Config::default()
        };
        let consumer = own.get_or_create_consumer(name, config.clone()).await.map_err(away)?;
        // Asked after the reader, so that what comes meanwhile counts for the stream.
        let last = self.state(stream).await?.last;
        let Some(behind) = self.begins_behind((stream, last), consumer.cached_info(), given).await? else {
            return Ok(consumer);
        };
        // It would be given nothing until the stream has come to the numbers that it counts.
        tracing::warn!(
            stream,
            reader = name,
            behind,
            "the server may have lost its last messages: this reader begins anew, and what is behind this number comes again"
        );
        own.delete_consumer(name).await.map_err(away)?;
        let deliver_policy = match behind {
            0 => DeliverPolicy::All,
            _ => DeliverPolicy::ByStartSequence { start_sequence: behind.saturating_add(1) },
        };
        own.get_or_create_consumer(name, pull::Config { deliver_policy, ..config }).await.map_err(away)
    }

    /// Behind which number a reader has to begin anew, of a stream that has come so far: see [`given`].
    async fn begins_behind(
        &self,
        (stream, last): (&str, u64),
        info: &consumer::Info,
        given: Option<&Given>,
    ) -> Result<Option<u64>, LinkError> {
        let own = Standing {
            delivered: info.delivered.stream_sequence,
            done: info.ack_floor.stream_sequence,
            // Who notes nothing cannot tell.
            is_active: given.is_none() || info.delivered.last_active.is_some(),
            last,
        };
        let Some(given) = given.filter(|_| own.delivered > 0) else {
            return Ok(given::begins_behind(own, None));
        };
        let noted = self.last(LATEST, given.subject()).await?.and_then(|(_, body)| given::read(&body));
        let Some((number, at)) = noted else { return Ok(given::begins_behind(own, None)) };
        let there = self.message(stream, number).await?.map(|message| message.time.unix_timestamp_nanos());
        // What every reader has done is deleted.
        let is_kept = number <= last && there.is_none_or(|own| own == at);
        Ok(given::begins_behind(own, Some((number, is_kept))))
    }

    /// The latest message of each subject, and every one that comes after, for this process alone.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn follow(&self, stream: &str, filter: &str) -> Result<Reading, LinkError> {
        let own = self.js.get_stream_no_info(stream).await.map_err(away)?;
        let config = pull::Config {
            filter_subject: filter.to_string(),
            deliver_policy: DeliverPolicy::LastPerSubject,
            ack_policy: AckPolicy::None,
            inactive_threshold: NAMELESS_FORGOTTEN_AFTER,
            ..pull::Config::default()
        };
        let consumer = own.create_consumer(config).await.map_err(away)?;
        Ok(if stream == LATEST { Reading::of_large(consumer) } else { Reading::alone(consumer) })
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

    /// How full a stream is.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn fill(&self, stream: &str) -> Result<Fill, LinkError> {
        let stream = self.js.get_stream(stream).await.map_err(away)?;
        let info = stream.cached_info();
        let room = u64::try_from(info.config.max_bytes).ok().filter(|room| *room > 0);
        Ok(Fill { messages: info.state.messages, bytes: info.state.bytes, room })
    }

    /// Deletes what every reader of a stream has done, where those that are `needed` are there. With a server before 2.9.15 nothing is
    /// deleted while a message is under way: it would forget that message then.
    ///
    /// # Errors
    /// [`LinkError::Away`], also where the stream has more than 256 readers.
    pub async fn purge_done(&self, stream: &str, needed: &[&str]) -> Result<(), LinkError> {
        let stream = self.js.get_stream(stream).await.map_err(away)?;
        let forgets = !self.client.is_server_compatible(2, 9, 15);
        match purging::done_by_all(&readers(&stream).await?, needed, forgets) {
            Some(done) => purge(&stream, done).await,
            None => Ok(()),
        }
    }

    /// Deletes what the reader `own` has done, where a stream is nearly full, whoever else has not done it: these readers are
    /// returned. A server before 2.9.15 forgets what is under way then, so that a message which a reader has put off, or loses at this
    /// moment, does not come to it again: there nothing is deleted while `own` holds a message, unless the stream is almost full.
    ///
    /// # Errors
    /// [`LinkError::Away`], also where the stream has more than 256 readers.
    pub async fn make_room(&self, stream: &str, own: &str) -> Result<Vec<String>, LinkError> {
        let stream = self.js.get_stream(stream).await.map_err(away)?;
        let info = stream.cached_info();
        if !purging::is_nearly_full(info.state.bytes, info.config.max_bytes) {
            return Ok(Vec::new());
        }
        let readers = readers(&stream).await?;
        let waits = !self.client.is_server_compatible(2, 9, 15)
            && !purging::is_almost_full(info.state.bytes, info.config.max_bytes);
        let Some((done, behind)) = purging::done_by(&readers, own, waits) else { return Ok(Vec::new()) };
        purge(&stream, done).await?;
        Ok(behind.into_iter().map(str::to_string).collect())
    }
}

/// A message of a stream, where there is one.
fn found(asked: Result<StreamMessage, RawMessageError>) -> Result<Option<StreamMessage>, LinkError> {
    match asked {
        Ok(message) => Ok(Some(message)),
        Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => Ok(None),
        Err(error) => Err(away(error)),
    }
}

/// All readers of a stream.
async fn readers(stream: &stream::Stream) -> Result<Vec<Reader>, LinkError> {
    let (mut consumers, mut readers) = (stream.consumers(), Vec::new());
    while let Some(consumer) = consumers.next().await {
        // A server may list readers without end.
        if readers.len() >= MOST_READERS {
            return Err(away(format!("a stream has more than {MOST_READERS} readers")));
        }
        let info = consumer.map_err(away)?;
        let (floor, under_way) = (info.ack_floor.stream_sequence, info.num_ack_pending);
        readers.push(Reader { name: info.name, floor, under_way });
    }
    Ok(readers)
}

/// Deletes all messages of a stream up to this number.
async fn purge(stream: &stream::Stream, done: u64) -> Result<(), LinkError> {
    stream.purge().sequence(done.saturating_add(1)).await.map_err(away)?;
    Ok(())
}
