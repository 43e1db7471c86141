//! A centre: has the loops of all edges, takes what they forward into its own rings, results and store, and passes on what
//! people do about alarms. A message is acknowledged once what it brought is in the store.

use super::inventory::{composed, kind};
use super::orders::action;
use super::standing::reader;
use super::{Fleet, PAUSE, Role, window};
use crate::app::App;
use crate::app::persistence::rows::{remembered_alarms, remembered_change, remembered_model};
use crate::config::Config;
use crate::fleet::convert;
use crate::fleet::link::{Incoming, Link, LinkError, Outgoing};
use crate::fleet::message::{Alarm, Diagnosis, Hello, Samples};
use crate::fleet::streams::{EVENTS, LATEST, SAMPLES};
use crate::fleet::subject::{self, Subject, What, all, of_site};
use crate::history::History;
use crate::results::AlarmChange;
use crate::serve::AskDurable;
use crate::signal::{LoopId, Sample};
use crate::store::codec;
use futures::FutureExt;
use futures::future::BoxFuture;
use prost::Message;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

/// Messages that are taken in one go, and made durable together.
const MOST: usize = 256;
/// Longest wait for the first of them.
const WAIT: Duration = Duration::from_secs(1);
/// A message that is not done within this time is delivered again.
const AGAIN: Duration = Duration::from_secs(60);
/// A message of a loop that is not known yet is looked at again after this time.
const UNKNOWN: Duration = Duration::from_secs(2);
/// A message of a loop that is still not known after this time (s) is dropped: its edge has it no more.
const GIVEN_UP_S: f64 = 600.0;
/// How long what edges say of themselves is gathered before loops are added.
const GATHER: Duration = Duration::from_millis(500);

/// Longest wait for an order to be kept, and how often that is looked at: whoever asks is on a thread that may wait.
const PATIENCE: Duration = Duration::from_secs(5);
/// See [`PATIENCE`].
const LOOK: Duration = Duration::from_millis(10);

/// Up to which message what a loop said has been taken, by the stream's numbers.
#[derive(Default)]
struct Taken(HashMap<LoopId, u64>);

impl Taken {
    /// Whether this was taken already; if not, it is now.
    fn before(&mut self, id: &LoopId, sequence: u64) -> bool {
        let last = self.0.entry(id.clone()).or_default();
        let known = sequence <= *last;
        *last = sequence.max(*last);
        known
    }
}

impl Fleet {
    pub(super) async fn centre(self: &Arc<Self>, link: &Link, app: &App) {
        let stop = app.stop.clone();
        while !stop.is_cancelled() {
            match link.make_streams(&self.config).await {
                Ok(()) => break,
                Err(error) => {
                    stop.run_until_cancelled(self.rest(&error, "there are no streams yet")).await;
                }
            }
        }
        tokio::join!(
            stop.run_until_cancelled(self.inventory(link, app)),
            stop.run_until_cancelled(self.take_samples(link, app)),
            stop.run_until_cancelled(self.take_events(link, app)),
            stop.run_until_cancelled(self.leading(link)),
            stop.run_until_cancelled(self.pass_on(link)),
            stop.run_until_cancelled(self.watching(link)),
        );
    }

    /// The configuration with the loops of all edges, where this is a centre.
    pub(in crate::app) fn composed(&self, base: Config) -> Config {
        if self.role != Role::Centre {
            return base;
        }
        let edges = self.edges.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let (config, left) = composed(&base, &edges);
        for left in left {
            tracing::warn!("{left}");
        }
        config
    }

    /// Follows what edges say of themselves.
    async fn inventory(&self, link: &Link, app: &App) {
        loop {
            let reading = match link.follow(LATEST, &all(None, What::Hello)).await {
                Ok(reading) => reading,
                Err(error) => {
                    self.rest(&error, "what edges are is not heard").await;
                    continue;
                }
            };
            loop {
                let heard = match reading.next(MOST, GATHER).await {
                    Ok(heard) => heard,
                    Err(error) => break self.rest(&error, "what edges are is not heard").await,
                };
                let mut new = false;
                for message in heard {
                    let hello = Hello::decode(message.body()).ok();
                    let Some((own, hello)) = Subject::read(message.subject()).zip(hello) else { continue };
                    let mut edges = self.edges.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                    new |= edges.insert((own.site, own.name), hello.clone()).as_ref() != Some(&hello);
                }
                if new {
                    let base = app.state.lock().await.config.clone();
                    if let Err(error) = app.reload(base).await {
                        tracing::error!(%error, "the loops of the edges cannot be taken");
                    }
                }
            }
        }
    }

    async fn take_samples(&self, link: &Link, app: &App) {
        let (name, filter) = (reader(&self.name), all(None, What::Samples));
        let mut taken = Taken::default();
        loop {
            let reading = match link.read(SAMPLES, &name, &filter, (AGAIN, -1)).await {
                Ok(reading) => reading,
                Err(error) => {
                    self.rest(&error, "no samples are taken").await;
                    continue;
                }
            };
            loop {
                let messages = match reading.next(MOST, WAIT).await {
                    Ok(messages) => messages,
                    Err(error) => break self.rest(&error, "no samples are taken").await,
                };
                let history = self.scene.borrow().history.clone();
                let (mut done, mut pushed) = (Vec::new(), 0);
                for message in messages {
                    self.lag(message.taken_at().map_or(0.0, |taken| self.clock.now() - taken));
                    match self.take_block(&message, &history, &mut taken) {
                        Some(count) => {
                            pushed += count;
                            done.push(message);
                        }
                        None => self.later(&message).await,
                    }
                    // No ring may go round before the store has read it.
                    if pushed > self.scene.borrow().config.history.samples_per_tag / 2 {
                        self.settle(app, &mut done).await;
                        pushed = 0;
                    }
                }
                self.settle(app, &mut done).await;
            }
        }
    }

    /// Takes the samples of a message; the most of one tag; `None` where its loop is not known.
    fn take_block(&self, message: &Incoming, history: &History, taken: &mut Taken) -> Option<usize> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        history.loops().iter().any(|known| known.id == id).then_some(())?;
        if taken.before(&id, message.sequence()) {
            return Some(0);
        }
        let Ok(samples) = Samples::decode(message.body()) else {
            tracing::warn!(control_loop = %id, "samples cannot be read");
            return Some(0);
        };
        let mut most = 0;
        for tag in samples.tags {
            let ring = history.tag_index(&id, &kind(&tag.tag)).and_then(|index| history.ring(index));
            let Some((ring, samples)) = ring.zip(codec::decode(&tag.block)) else { continue };
            // Of a message that was delivered before, perhaps to an earlier life, what is known is left out.
            let known = ring.latest().filter(|_| message.is_again()).map_or(f64::NEG_INFINITY, |last| last.t);
            let new = samples.iter().filter(|sample: &&Sample| sample.t > known);
            most = most.max(samples.len());
            new.for_each(|sample| ring.push(*sample));
        }
        Some(most)
    }

    async fn take_events(&self, link: &Link, app: &App) {
        let name = reader(&self.name);
        loop {
            let reading = match link.read(EVENTS, &name, "", (AGAIN, -1)).await {
                Ok(reading) => reading,
                Err(error) => {
                    self.rest(&error, "no diagnoses and alarms are taken").await;
                    continue;
                }
            };
            loop {
                let messages = match reading.next(MOST, WAIT).await {
                    Ok(messages) => messages,
                    Err(error) => break self.rest(&error, "no diagnoses and alarms are taken").await,
                };
                let mut done = Vec::new();
                for message in messages {
                    match self.take_event(&message) {
                        Some(()) => done.push(message),
                        None => self.later(&message).await,
                    }
                }
                self.settle(app, &mut done).await;
            }
        }
    }

    /// Takes a diagnosis or a change of an alarm; `None` where its loop is not known.
    fn take_event(&self, message: &Incoming) -> Option<()> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        match own.what {
            What::Diagnosis => {
                self.results.summaries(&id)?;
                let Ok(Diagnosis { run: Some(run), model, .. }) = Diagnosis::decode(message.body()) else {
                    tracing::warn!(control_loop = %id, "a diagnosis cannot be read");
                    return Some(());
                };
                let model = model.map(|model| remembered_model(&convert::model_row(id.as_str(), &model)));
                if let Some(run) = window::run(id, &run)
                    && self.results.learn(run, model)
                {
                    self.diagnosed.fetch_add(1, Relaxed);
                }
            }
            What::Alarm => {
                let Ok(Alarm { state: Some(state), change, told, .. }) = Alarm::decode(message.body()) else {
                    tracing::warn!(subject = %id, "an alarm cannot be read");
                    return Some(());
                };
                let row = convert::alarm_row(state);
                let change = change.map(|change| convert::change_row(id.as_str(), &row.kind, &change));
                let change = change.and_then(remembered_change).map(|change| AlarmChange { told, ..change });
                let row = crate::store::AlarmRow { control_loop: id.to_string(), ..row };
                for kept in remembered_alarms(vec![row]) {
                    self.results.alarm(&kept.id, self.clock.now())?;
                    if let Some(change) = self.results.follow_alarm(kept, change.clone())
                        && !change.told
                    {
                        self.tell_or_wait(message.sequence(), change);
                    }
                }
            }
            _ => {}
        }
        Some(())
    }

    /// Leaves a message of a loop that is not known for later, or for good.
    async fn later(&self, message: &Incoming) {
        let age = message.taken_at().map_or(0.0, |taken| self.clock.now() - taken);
        if age < GIVEN_UP_S {
            return message.again(UNKNOWN).await;
        }
        tracing::warn!(subject = message.subject(), "a message of a loop that no edge has is dropped");
        let _ = message.done().await;
    }

    /// Makes durable what was taken, and acknowledges it. What cannot be is delivered again.
    async fn settle(&self, app: &App, done: &mut Vec<Incoming>) {
        if done.is_empty() {
            return;
        }
        let persistence = app.persistence.clone();
        let durable =
            tokio::task::spawn_blocking(move || persistence.ask_durable().is_some_and(|durable| durable()));
        if durable.await.unwrap_or(false) {
            let acknowledged: Vec<BoxFuture<'_, _>> = done.iter().map(|own| own.done().boxed()).collect();
            let done: Vec<Result<(), LinkError>> = futures::future::join_all(acknowledged).await;
            if let Some(error) = done.into_iter().find_map(Result::err) {
                tracing::debug!(%error, "what is stored comes again");
            }
        } else {
            tracing::warn!("the store fails: what edges forward stays in the streams");
            tokio::time::sleep(PAUSE).await;
        }
        done.clear();
    }

    /// Passes on what people want done about alarms.
    async fn pass_on(&self, link: &Link) {
        let mut wanted = self.wanted.lock().await;
        while let Some(own) = wanted.recv().await {
            let subject = own.id.subject.to_string();
            if let Some((site, name)) = subject::split(&subject) {
                let to = Subject::new(site, name, What::Action).to_string();
                let body = action(own, name, self.standing.epoch().unwrap_or(0)).encode_to_vec();
                let message = [Outgoing { subject: to, body }];
                while let Err((_, error)) = link.send(&message).await {
                    self.rest(&error, "an order waits").await;
                }
            }
            self.orders_waiting.fetch_sub(1, Relaxed);
        }
    }

    /// Waits for orders of people to be in the streams too, where this is a centre.
    pub(in crate::app) fn with_orders(self: Arc<Self>, durable: AskDurable) -> AskDurable {
        Arc::new(move || self.orders_are_kept() && durable())
    }

    fn orders_are_kept(&self) -> bool {
        let begun = Instant::now();
        while self.orders_waiting.load(Relaxed) > 0 {
            if begun.elapsed() > PATIENCE {
                return false;
            }
            std::thread::sleep(LOOK);
        }
        true
    }
}
