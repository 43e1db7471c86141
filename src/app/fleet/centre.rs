//! A centre: has the loops of all edges, takes what they forward into its own rings, results and store, and passes on what
//! people do about alarms. A message is acknowledged once what it brought is in the store.

use super::forward::MOST_SAMPLES;
use super::inventory::composed;
use super::lists::Lists;
use super::order::{Early, Making, Order, Origin, Strange, patience};
use super::orders::action;
use super::standing::reader;
use super::{Fleet, PAUSE, check_rings, lock, window};
use crate::alarm::{AlarmId, Cause};
use crate::app::persistence::rows::{remembered_alarms, remembered_change, remembered_model};
use crate::app::{App, AppError};
use crate::config::Config;
use crate::fleet::convert;
use crate::fleet::link::{Incoming, Link, LinkError, Outgoing, Reading};
use crate::fleet::message::{Alarm, Diagnosis, Samples};
use crate::fleet::streams::{EVENTS, LATEST, SAMPLES};
use crate::fleet::subject::{self, Subject, What, all, of_site};
use crate::fleet::weights;
use crate::history::{History, TagKind};
use crate::results::{AlarmChange, RestoredAlarm};
use crate::serve::AskDurable;
use crate::signal::{LoopId, Role, Sample};
use crate::store::{AlarmRow, codec};
use futures::FutureExt;
use futures::future::BoxFuture;
use prost::Message;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

/// Messages that are taken in one go, and made durable together.
const MOST: usize = 256;
/// Longest wait for the first of them.
const WAIT: Duration = Duration::from_secs(1);
/// A message of a loop that is not known yet is looked at again after this time.
const UNKNOWN: Duration = Duration::from_secs(2);
/// How long what edges say of themselves is gathered before loops are added.
const GATHER: Duration = Duration::from_millis(500);

/// Longest wait for an order to be kept: longer than one answer of the server takes.
const PATIENCE: Duration = Duration::from_secs(5);

/// What became of a message of samples.
enum Block {
    /// Taken: the most of one tag.
    Taken(usize),
    /// It waits, for an earlier one or for what its edge says.
    Early,
}

/// The latest message that was taken of each loop, or of each alarm, by the stream's numbers.
#[derive(Default)]
struct Taken(HashMap<String, u64>);

impl Taken {
    /// Whether this message or a later one was taken already. If not, it counts as taken from now on.
    fn is_past(&mut self, of: &str, sequence: u64) -> bool {
        match self.0.get_mut(of) {
            Some(last) if sequence <= *last => true,
            Some(last) => {
                *last = sequence;
                false
            }
            None => {
                self.0.insert(of.to_string(), sequence);
                false
            }
        }
    }
}

impl Fleet {
    pub(super) async fn centre(self: &Arc<Self>, link: &Link, app: &App) {
        let stop = app.stop.clone();
        while !stop.is_cancelled() {
            match link.make_streams(&self.config).await {
                Ok(()) => break,
                Err(error) => {
                    stop.run_until_cancelled(self.rest(&error, "the streams are not ready yet")).await;
                }
            }
        }
        tokio::join!(
            stop.run_until_cancelled(self.inventory(link, app)),
            stop.run_until_cancelled(async {
                self.loops_are_known().await;
                tokio::join!(self.take_samples(link, app), self.take_events(link, app));
            }),
            stop.run_until_cancelled(self.leading(link)),
            self.telling(link, &stop),
            stop.run_until_cancelled(self.pass_on(link)),
            stop.run_until_cancelled(self.watching(link)),
        );
    }

    /// The configuration with the loops of all edges, where this is a centre.
    pub(in crate::app) fn composed(&self, base: Config) -> Result<Config, AppError> {
        if !self.follows() {
            return Ok(base);
        }
        check_rings(&base).map_err(AppError::Fleet)?;
        let edges = lock(&self.edges);
        let (config, left) = composed(&base, &edges);
        for left in left {
            tracing::warn!("{left}");
        }
        Ok(config)
    }

    /// Waits until what edges have said of themselves before is in force.
    async fn loops_are_known(&self) {
        let mut known = self.known.subscribe();
        // An error here would mean that we are gone ourselves.
        let _ = known.wait_for(Option::is_some).await;
    }

    /// Follows the announcements of edges: a list of loops is fetched once its last part has come.
    async fn inventory(&self, link: &Link, app: &App) {
        // Whether an edge has loops that are not in force yet.
        let mut is_new = false;
        let mut lists = Lists::default();
        loop {
            let mut reading = match link.follow(LATEST, &all(None, What::Hello)).await {
                Ok(reading) => reading,
                Err(error) => {
                    self.rest(&error, "what edges are is not heard").await;
                    continue;
                }
            };
            loop {
                if !lists.is_full() {
                    match reading.next(MOST, GATHER).await {
                        // The messages are dropped before the first list is fetched, so that both are not held at once.
                        Ok(heard) => heard.iter().for_each(|own| lists.hear(own.subject(), own.bytes())),
                        Err(error) => break self.rest(&error, "what edges are is not heard").await,
                    }
                }
                self.unsettle(&lists);
                let (is_changed, fetched) = self.fetch_lists(link, &mut lists).await;
                is_new |= is_changed;
                if is_new {
                    match app.take(None).await {
                        Ok(()) => is_new = false,
                        Err(error) => tracing::error!(%error, "the loops of the edges cannot be taken"),
                    }
                }
                // Until the reading has caught up, the stream may have lists that were not heard yet.
                if !is_new && reading.has_caught_up() {
                    self.settle_sites(&lists);
                }
                if let Err(error) = fetched {
                    self.rest(&error, "a list of loops cannot be fetched").await;
                }
            }
        }
    }

    async fn take_samples(&self, link: &Link, app: &App) {
        let (name, filter) = (reader(&self.name), all(None, What::Samples));
        let (mut taken, mut order, mut early) = (Taken::default(), Order::default(), Early::default());
        let (mut strange, mut making) = (Strange::default(), Making::default());
        loop {
            let (mut reading, made) = match begin(link, SAMPLES, (name.as_str(), filter.as_str())).await {
                Ok(begun) => begun,
                Err(error) => {
                    self.rest(&error, "no samples are taken").await;
                    continue;
                }
            };
            if making.is_another(made) {
                (taken, order, early) = (Taken::default(), Order::default(), Early::default());
            }
            loop {
                let messages = match reading.next(MOST, WAIT).await {
                    Ok(messages) => messages,
                    Err(error) => break self.rest(&error, "no samples are taken").await,
                };
                let _taking = self.taking.read().await;
                let history = self.scene.borrow().history.clone();
                let (mut done, mut pushed) = (Vec::new(), 0);
                for message in messages {
                    self.lag(message.taken_at().map_or(0.0, |taken| self.clock.now() - taken));
                    if !self.is_next(&message, &mut order) {
                        self.put_off(&message, &mut order).await;
                        continue;
                    }
                    match self.take_block(&message, &history, (&mut taken, &mut early, &mut strange)) {
                        Some(Block::Taken(count)) => {
                            pushed += count;
                            order.taken(message.subject(), message.sequence());
                            done.push(message);
                        }
                        Some(Block::Early) => self.put_off(&message, &mut order).await,
                        None => self.later(&message, &mut order).await,
                    }
                    // No ring may go round before the store has read it.
                    if pushed > self.scene.borrow().config.history.samples_per_tag / 2 {
                        self.settle(app, std::mem::take(&mut done), &mut order).await;
                        pushed = 0;
                    }
                }
                self.settle(app, done, &mut order).await;
            }
        }
    }

    /// Takes the samples of a message; `None` where its loop is not known.
    fn take_block(
        &self,
        message: &Incoming,
        history: &History,
        (taken, early, strange): (&mut Taken, &mut Early, &mut Strange),
    ) -> Option<Block> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        history.tag_index(&id, &TagKind::Role(Role::Op))?;
        let Some(mut samples) = weights::read::<Samples>(message.subject(), message.bytes()) else {
            return Some(Block::Taken(0));
        };
        // A ring has the samples of one source: what the edge says of its tags may come after them, or before what is older.
        let (specs, now, mut waits) = (history.latest(&id), self.clock.elapsed(), false);
        samples.tags.retain(|tag| {
            let spec = specs.iter().find(|(spec, _)| spec.kind.name() == tag.tag);
            let Some((spec, _)) = spec else { return true };
            let sources = (tag.source.as_str(), spec.source.as_str());
            let origin = strange.origin((message.subject(), tag.tag.as_str()), sources, now);
            if origin == Origin::GivenUp {
                tracing::warn!(
                    control_loop = %id,
                    tag = tag.tag,
                    source = tag.source,
                    "samples are left out: their edge says that it reads this tag elsewhere"
                );
            }
            waits |= origin == Origin::Waits;
            matches!(origin, Origin::Own | Origin::Waits)
        });
        if waits {
            return Some(Block::Early);
        }
        let ring =
            |tag: &str| history.tag_index(&id, &TagKind::named(tag)).and_then(|index| history.ring(index));
        // What comes before it can still come: rings go forward only, so it would be lost then.
        let is_early = samples.tags.iter().any(|tag| {
            let last = ring(&tag.tag).and_then(|ring| ring.latest());
            last.zip(tag.after).is_some_and(|(last, after)| last.t < after)
        });
        if is_early && early.waits(message.subject(), message.sequence(), now) {
            return Some(Block::Early);
        }
        if is_early {
            tracing::warn!(control_loop = %id, "samples are missing: they did not come, so they may have been deleted from the stream");
        }
        early.end(message.subject());
        let again = taken.is_past(id.as_str(), message.sequence());
        let mut most = 0;
        for tag in samples.tags {
            let Some(ring) = ring(&tag.tag) else { continue };
            let Some(samples) = codec::decode_at_most(&tag.block, MOST_SAMPLES) else {
                weights::refuse(message.subject(), "its samples are damaged, or too many");
                continue;
            };
            // What is known is left out; only a clock that was set back makes what is earlier new, once: behind what came
            // before it.
            let last = ring.latest().map_or(f64::NEG_INFINITY, |last| last.t);
            let new = tag.set_back && tag.after.map_or(!again && !message.is_again(), |after| last == after);
            let known = if new { f64::NEG_INFINITY } else { last };
            most = most.max(samples.len());
            samples.iter().filter(|sample: &&Sample| sample.t > known).for_each(|sample| ring.push(*sample));
        }
        Some(Block::Taken(most))
    }

    async fn take_events(&self, link: &Link, app: &App) {
        let (name, mut making) = (reader(&self.name), Making::default());
        let (mut taken, mut order) = (Taken::default(), Order::default());
        loop {
            let (mut reading, made) = match begin(link, EVENTS, (name.as_str(), "")).await {
                Ok(begun) => begun,
                Err(error) => {
                    self.rest(&error, "no diagnoses and alarms are taken").await;
                    continue;
                }
            };
            if making.is_another(made) {
                (taken, order) = (Taken::default(), Order::default());
                self.looked_at.send_replace(0);
            }
            self.looked_at.send_modify(|known| *known = reading.done_before().max(*known));
            loop {
                let messages = match reading.next(MOST, WAIT).await {
                    Ok(messages) => messages,
                    Err(error) => break self.rest(&error, "no diagnoses and alarms are taken").await,
                };
                let _taking = self.taking.read().await;
                let mut done = Vec::new();
                let last = messages.last().map_or(0, Incoming::sequence);
                for message in messages {
                    if !self.is_next(&message, &mut order) {
                        self.put_off(&message, &mut order).await;
                        continue;
                    }
                    match self.take_event(&message, &mut taken, made) {
                        Some(()) => {
                            order.taken(message.subject(), message.sequence());
                            done.push(message);
                        }
                        None => self.later(&message, &mut order).await,
                    }
                }
                self.looked_at.send_modify(|known| *known = last.max(*known));
                self.settle(app, done, &mut order).await;
            }
        }
    }

    /// Takes a diagnosis or a change of an alarm, from the stream that was made then; `None` where its loop is not known.
    fn take_event(&self, message: &Incoming, taken: &mut Taken, made: i128) -> Option<()> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        match own.what {
            What::Diagnosis => {
                self.results.summaries(&id)?;
                let read = weights::read::<Diagnosis>(message.subject(), message.bytes());
                let Some(Diagnosis { run, model, .. }) = read else { return Some(()) };
                let Some(run) = run else {
                    weights::refuse(message.subject(), "it has no diagnosis");
                    return Some(());
                };
                let model = model.map(|model| remembered_model(&convert::model_row(id.as_str(), &model)));
                if let Some(run) = window::run(id, &run)
                    && self.results.learn(run, model, self.clock.now())
                {
                    self.diagnosed.fetch_add(1, Relaxed);
                }
            }
            What::Alarm => {
                let Some((kept, change)) = alarm(&id, message) else { return Some(()) };
                if let Some(change) = &change {
                    self.firsts.note(change, (made, message.sequence()));
                }
                if !change.as_ref().is_some_and(is_forgotten) && !self.is_known(&kept.id) {
                    return None;
                }
                // Else it is known how it stands since then.
                if !taken.is_past(&kept.id.to_string(), message.sequence()) {
                    self.results.follow_alarm(kept, change, self.clock.now());
                }
            }
            _ => {}
        }
        Some(())
    }

    /// Whether an edge has the loop or collector of an alarm, whatever its kind: one that is switched off here is not shown, and
    /// nothing waits for it.
    pub(super) fn is_known(&self, id: &AlarmId) -> bool {
        match id.of_loop() {
            Some(id) => self.results.summaries(id).is_some(),
            None => self.scene.borrow().config.forwarded.iter().any(|name| name == id.subject.as_str()),
        }
    }

    /// Whether a message need not wait for an earlier one of its subject.
    pub(super) fn is_next(&self, message: &Incoming, order: &mut Order) -> bool {
        order.is_next(message.subject(), message.sequence(), self.clock.elapsed())
    }

    /// Leaves a message for later.
    pub(super) async fn put_off(&self, message: &Incoming, order: &mut Order) {
        order.put_off(message.subject(), message.sequence(), self.clock.elapsed());
        message.again(UNKNOWN).await;
    }

    /// Leaves a message of a loop that is not known for later, or for good where it has waited for long.
    pub(super) async fn later(&self, message: &Incoming, order: &mut Order) {
        let now = self.clock.elapsed();
        let site = Subject::read(message.subject()).map(|own| own.site);
        let in_force = site.as_ref().and_then(|site| {
            let all = lock(&self.in_force);
            all.get(site).map(|since| now.saturating_sub(*since))
        });
        let unknown_site = site.as_deref().filter(|_| in_force.is_none());
        if order.unknown_for(message.subject(), unknown_site, now) < patience(order.waiting(), in_force) {
            return self.put_off(message, order).await;
        }
        order.end(message.subject(), message.sequence());
        tracing::warn!(subject = message.subject(), "a message of a loop that no edge has is dropped");
        let _ = message.done().await;
    }

    /// Makes durable what was taken, however long that takes, and acknowledges it.
    async fn settle(&self, app: &App, done: Vec<Incoming>, order: &mut Order) {
        if done.is_empty() {
            return;
        }
        let begun = self.clock.elapsed();
        while !self.is_durable(app).await {
            tracing::warn!("the store fails: what edges forward stays in the streams");
            tokio::time::sleep(PAUSE).await;
        }
        let acknowledged: Vec<BoxFuture<'_, _>> = done.iter().map(|own| own.done().boxed()).collect();
        let results: Vec<Result<(), LinkError>> = futures::future::join_all(acknowledged).await;
        if let Some(error) = results.into_iter().find_map(Result::err) {
            tracing::debug!(%error, "what is stored comes again");
        }
        order.stood_still(self.clock.elapsed().saturating_sub(begun));
    }

    /// Passes on what people want done about alarms.
    async fn pass_on(&self, link: &Link) {
        let mut wanted = self.wanted.lock().await;
        while let Some((own, epoch)) = wanted.recv().await {
            let subject = own.id.subject.to_string();
            let mut kept = false;
            if let Some((site, name)) = subject::split(&subject) {
                let to = Subject::new(site, name, What::Action).to_string();
                let message = [Outgoing::once(to, action(own, name, epoch).encode_to_vec())];
                let sending = async {
                    while let Err((_, error)) = link.send(&message).await {
                        self.rest(&error, "an order waits").await;
                    }
                };
                kept = tokio::time::timeout(PATIENCE, sending).await.is_ok();
                if !kept {
                    tracing::error!(subject, "an order is given up: the streams do not take it");
                }
            }
            self.orders_waiting.end(kept);
        }
    }

    /// Waits for orders of people to be in the streams too, where this is a centre.
    pub(in crate::app) fn with_orders(self: Arc<Self>, durable: AskDurable) -> AskDurable {
        Arc::new(move || self.orders_waiting.are_kept(PATIENCE) && durable())
    }
}

/// What a stream has for us, and when that was made. Asked in this order: what is read is of that stream, or of none that is there
/// any more.
pub(super) async fn begin(
    link: &Link,
    stream: &str,
    (name, filter): (&str, &str),
) -> Result<(Reading, i128), LinkError> {
    let reading = link.read(stream, name, filter).await?;
    let made = link.made(stream).await?;
    if reading.made() < made {
        return Err(LinkError::Away("the stream was made anew".to_string()));
    }
    Ok((reading, made))
}

/// Whether a change ends the alarm of a loop or collector that its edge has no more.
pub(super) fn is_forgotten(change: &AlarmChange) -> bool {
    change.transition.cause == Cause::Forgotten
}

/// An alarm as its edge has it, and what happened to it, by a message of the loop or collector `id`.
pub(super) fn alarm(id: &LoopId, message: &Incoming) -> Option<(RestoredAlarm, Option<AlarmChange>)> {
    let read = weights::read::<Alarm>(message.subject(), message.bytes());
    let Alarm { state: Some(state), change, told, .. } = read? else {
        weights::refuse(message.subject(), "it has no state of an alarm");
        return None;
    };
    let row = AlarmRow { control_loop: id.to_string(), ..convert::alarm_row(state) };
    let change = change.map(|change| convert::change_row(id.as_str(), &row.kind, &change));
    let change = change.and_then(remembered_change).map(|change| AlarmChange { told, ..change });
    Some((remembered_alarms(vec![row]).pop()?, change))
}
