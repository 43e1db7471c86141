//! What is asked of NATS, through its client; `relay` bounds what its servers say.

mod again;
mod error;
mod hearing;
mod outgoing;
mod reading;

use super::config::Config;
pub use super::digest::digest;
use super::digest::hex;
use super::lease::Seen;
use super::login;
use super::ops::MOST_MESSAGE;
use super::relay::Relay;
use super::streams::{self, LATEST, LEASE};
use again::{GIVEN_AGAIN, UNACKNOWLEDGED};
use async_nats::Client;
use async_nats::connection::State;
use async_nats::jetstream::consumer::{AckPolicy, Consumer, DeliverPolicy, pull};
use async_nats::jetstream::context::{ContextBuilder, PublishErrorKind};
use async_nats::jetstream::message::PublishMessage;
use async_nats::jetstream::stream::LastRawMessageErrorKind;
use async_nats::jetstream::{self, Context};
pub use error::LinkError;
use error::away;
use futures::StreamExt;
use hearing::HEAD;
pub use hearing::Hearing;
pub use outgoing::Outgoing;
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
        let stream = self.js.get_stream_no_info(stream).await.map_err(away)?;
        match stream.get_last_raw_message_by_subject(subject).await {
            Ok(message) => Ok(Some((message.sequence, message.payload.to_vec()))),
            Err(error) if error.kind() == LastRawMessageErrorKind::NoMessageFound => Ok(None),
            Err(error) => Err(away(error)),
        }
    }

    /// What a stream has for the only reader called `name`, from the first message on that it has not done, in the order of the
    /// stream. Where messages were given to it before and it has not done them, it waits until the server gives them again. Where
    /// those take more than may be held, the reading waits once more for each portion of them.
    ///
    /// # Errors
    /// [`LinkError::Away`].
    pub async fn read(&self, stream: &str, name: &str, filter: &str) -> Result<Reading, LinkError> {
        Reading::from_first(self.consumer(stream, name, filter, (GIVEN_AGAIN, -1)).await?).await
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
            max_ack_pending: i64::from(UNACKNOWLEDGED),
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
            inactive_threshold: NAMELESS_FORGOTTEN_AFTER,
            ..pull::Config::default()
        };
        Ok(Reading::of_large(stream.create_consumer(config).await.map_err(away)?))
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
    /// [`LinkError::Away`], also where the stream has more than 256 readers.
    pub async fn purge_done(&self, stream: &str, part: &str) -> Result<(), LinkError> {
        let stream = self.js.get_stream(stream).await.map_err(away)?;
        let (mut consumers, mut done) = (stream.consumers().enumerate(), None::<u64>);
        while let Some((at, consumer)) = consumers.next().await {
            // A server may list readers without end.
            if at >= MOST_READERS {
                return Err(away(format!("a stream has more than {MOST_READERS} readers")));
            }
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
            stream.purge().sequence(done.saturating_add(1)).await.map_err(away)?;
        }
        Ok(())
    }
}
