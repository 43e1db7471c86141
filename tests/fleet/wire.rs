//! What edges and workers say to each other, heard at the hub, and a look at its streams from a thread that may block.

use crate::nats::Nats;
use async_nats::jetstream::{self, Context, consumer};
use futures::StreamExt;
use prost::Message;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use stictiond::fleet::link::digest;
use stictiond::fleet::message::{Answer, Cursor};
use stictiond::fleet::streams::LATEST;
use stictiond::fleet::subject::{Subject, What, all};
use tokio::runtime::Handle;

/// What a window is known by.
pub type Key = [u8; 32];

/// A diagnosis as a store knows it: its loop, and when it ended (s, as bits).
pub type Made = (String, u64);

#[derive(Default)]
struct Heard {
    /// When each came, and of which loop it is.
    windows: BTreeMap<Key, (Instant, Subject)>,
    answers: Vec<(Subject, Answer)>,
}

impl Heard {
    fn take(&mut self, message: &async_nats::Message) {
        let subject = message.subject.as_str();
        let own = Subject::read(subject).expect("ours");
        match own.what {
            What::Window => {
                self.windows.insert(digest(subject, &message.payload), (Instant::now(), own));
            }
            _ => self.answers.push((own, Answer::decode(&message.payload[..]).expect("ours"))),
        }
    }
}

/// Who listens at the hub. What is said before it is connected again, after the hub was away, is not heard.
pub struct Wire {
    heard: Arc<Mutex<Heard>>,
    js: Context,
    handle: Handle,
}

impl Wire {
    pub async fn at(hub: &Nats) -> Self {
        let client = async_nats::connect(hub.url()).await.expect("the hub is there");
        let windows = client.subscribe(all(None, What::Window)).await.expect("it can be heard");
        let answers = client.subscribe(all(None, What::Answer)).await.expect("it can be heard");
        client.flush().await.expect("the hub is told");
        let heard = Arc::<Mutex<Heard>>::default();
        let (own, mut messages) = (heard.clone(), futures::stream::select(windows, answers));
        tokio::spawn(async move {
            while let Some(message) = messages.next().await {
                own.lock().expect("no panic").take(&message);
            }
        });
        Self { heard, js: jetstream::new(client), handle: Handle::current() }
    }

    fn heard(&self) -> MutexGuard<'_, Heard> {
        self.heard.lock().expect("no panic")
    }

    /// Windows of the last few seconds that nobody has answered.
    pub fn unanswered(&self, lately: Duration) -> Vec<Key> {
        let heard = self.heard();
        let answered: BTreeSet<&[u8]> = heard.answers.iter().map(|(_, own)| own.window.as_slice()).collect();
        let new = heard.windows.iter().filter(|(_, (came, _))| came.elapsed() < lately);
        new.map(|(key, _)| *key).filter(|key| !answered.contains(key.as_slice())).collect()
    }

    /// What was said of a window: of which site, by whom, and which diagnosis.
    pub fn answers(&self, key: &Key) -> Vec<(String, String, Made)> {
        let heard = self.heard();
        let own = heard.answers.iter().filter(|(_, own)| own.window == key.as_slice());
        own.filter_map(|(of, own)| Some((of.site.clone(), own.worker.clone(), made(own)?))).collect()
    }

    /// The diagnoses that workers made for a site, and by whom.
    pub fn made(&self, site: &str) -> BTreeMap<Made, String> {
        let heard = self.heard();
        let own = heard.answers.iter().filter(|(of, _)| of.site == site);
        own.filter_map(|(_, own)| Some((made(own)?, own.worker.clone()))).collect()
    }

    /// The loops of a site for which a worker was asked.
    #[cfg(feature = "writeback")]
    pub fn asked(&self, site: &str) -> BTreeSet<String> {
        let heard = self.heard();
        let own = heard.windows.values().filter(|(_, own)| own.site == site);
        own.map(|(_, own)| own.name.clone()).collect()
    }

    /// What a stream knows of a reader; `None` where it does not answer.
    fn reader(&self, stream: &str, name: &str) -> Option<consumer::Info> {
        self.handle.block_on(async {
            let stream = self.js.get_stream_no_info(stream).await.ok()?;
            stream.consumer_info(name).await.ok()
        })
    }

    /// Messages that a reader was given and has not done; `None` where the stream does not answer.
    pub fn under_way(&self, stream: &str, name: &str) -> Option<usize> {
        self.reader(stream, name).map(|own| own.num_ack_pending)
    }

    /// Whether a reader has done all that its stream has.
    pub fn is_done(&self, stream: &str, name: &str) -> bool {
        self.reader(stream, name).is_some_and(|own| own.num_pending == 0 && own.num_ack_pending == 0)
    }

    /// Whether a reader has done a message and all before it.
    pub fn has_done(&self, stream: &str, name: &str, sequence: u64) -> bool {
        let floor = self.reader(stream, name).map(|own| own.ack_floor.stream_sequence);
        floor.is_some_and(|floor| floor >= sequence) || self.is_done(stream, name)
    }

    /// Number of the last message of a stream.
    pub fn last(&self, stream: &str) -> Option<u64> {
        self.handle.block_on(async {
            let stream = self.js.get_stream(stream).await.ok()?;
            Some(stream.cached_info().state.last_sequence)
        })
    }

    /// How far the edge of a site says that it has forwarded.
    pub fn cursor(&self, site: &str) -> Option<Cursor> {
        let subject = Subject::new(site, &format!("edge-{site}"), What::Cursor).to_string();
        self.handle.block_on(async {
            let stream = self.js.get_stream_no_info(LATEST).await.ok()?;
            let last = stream.get_last_raw_message_by_subject(&subject).await.ok()?;
            Cursor::decode(&last.payload[..]).ok()
        })
    }
}

/// The diagnosis of an answer; `None` where the worker could not tell.
fn made(answer: &Answer) -> Option<Made> {
    answer.run.as_ref().map(|run| (run.control_loop.clone(), run.finished.to_bits()))
}
