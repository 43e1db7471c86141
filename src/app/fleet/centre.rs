//! A centre: has the loops of all edges, takes what they forward into its own rings, results and store, and passes on what
//! people do about alarms. A message is acknowledged once what it brought is in the store.

use super::claims::ranked;
use super::forward::MOST_SAMPLES;
use super::inventory::{Composed, composed};
use super::lists::Lists;
use super::order::{Early, Making, Order, Origin, Strange, announcement_patience, patience};
use super::standing::reader;
use super::{Fleet, PAUSE, check_rings, lock};
use crate::app::{App, AppError};
use crate::config::Config;
use crate::fleet::link::{Incoming, Link, LinkError, Mark, Reading};
use crate::fleet::message::Samples;
use crate::fleet::ops::LOG;
use crate::fleet::streams::{ALARMS, DIAGNOSES, LATEST, SAMPLES};
use crate::fleet::subject::{Subject, What, all, of_site};
use crate::fleet::weights;
use crate::history::{History, TagKind};
use crate::signal::{LoopId, Role, Sample};
use crate::store::codec;
use futures::FutureExt;
use futures::future::BoxFuture;
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tokio::sync::{RwLock, RwLockReadGuard};

/// Messages that are taken in one go, and made durable together.
pub(super) const MOST: usize = 256;
/// Longest wait for the first of them.
pub(super) const WAIT: Duration = Duration::from_secs(1);
/// A message of a loop that is not known yet is looked at again after this time.
const UNKNOWN: Duration = Duration::from_secs(2);
/// How long what edges say of themselves is gathered before loops are added.
const GATHER: Duration = Duration::from_millis(500);
/// How often it is looked whether edges have stopped, or are forgotten.
const LOOK: Duration = Duration::from_secs(5);

/// What became of a message of samples.
enum Block {
    /// Taken: the most of one tag.
    Taken(usize),
    /// It waits, for an earlier one or for what its edge says.
    Early,
}

/// The latest message that was taken of each loop, or of each alarm, in the order of the stream.
#[derive(Default)]
pub(super) struct Taken(HashMap<String, Mark>);

impl Taken {
    /// Whether this message or a later one was taken already. If not, it counts as taken from now on. A server that has lost its
    /// last messages uses their numbers again: what it took later than the last one is no older, whatever its number is.
    pub(super) fn is_past(&mut self, of: &str, (sequence, at): Mark) -> bool {
        match self.0.get_mut(of) {
            Some(last) if sequence <= last.0 && at <= last.1 => true,
            Some(last) => {
                *last = (sequence, at);
                false
            }
            None => {
                self.0.insert(of.to_string(), (sequence, at));
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
                // Each by itself: what is many or large keeps no alarm waiting.
                tokio::join!(
                    self.take_samples(link, app),
                    self.take_events(link, app, ALARMS),
                    self.take_events(link, app, DIAGNOSES),
                    self.take_states(link),
                );
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
        let signs = self.signs();
        let edges = lock(&self.edges);
        let Composed { config, claims, left } = composed(&base, &ranked(&edges, &signs));
        for left in left.into_iter().chain(claims.remarks()) {
            tracing::warn!("{left}");
        }
        *lock(&self.claims) = claims;
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
        let (mut is_new, mut looked) = (false, self.clock.elapsed());
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
                        Ok(heard) => heard.iter().for_each(|own| self.hear_part(own, &mut lists)),
                        Err(error) => break self.rest(&error, "what edges are is not heard").await,
                    }
                }
                self.unsettle(&lists);
                let (is_changed, fetched) = self.fetch_lists(link, &mut lists).await;
                is_new |= is_changed;
                if self.clock.elapsed().saturating_sub(looked) >= LOOK {
                    looked = self.clock.elapsed();
                    is_new |= self.are_claims_outdated();
                }
                // Until every machine was heard that the stream has, one that has stopped would count as being there: its loops would
                // be taken from it, and what another edge of the site says of them would be left out.
                let is_watched = self.signs().now.is_some();
                if is_new && is_watched {
                    match app.take(None).await {
                        Ok(()) => is_new = false,
                        Err(error) => tracing::error!(%error, "the loops of the edges cannot be taken"),
                    }
                }
                // Until the reading has caught up, the stream may have lists that were not heard yet.
                if !is_new && is_watched && reading.has_caught_up() {
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
                let last = messages.last().map(|own| own.taken_at().unwrap_or_else(|| self.server_now()));
                self.note_lag(last, order.waiting() > 0 || !reading.has_caught_up());
                let mut guard = self.taking.read().await;
                let mut history = self.scene.borrow().history.clone();
                let (mut done, mut pushed) = (Vec::new(), 0);
                for message in messages {
                    let own = (message.subject(), message.sequence());
                    if !early.is_next(&mut order, own, self.clock.elapsed()) {
                        self.put_off(&message, &mut order).await;
                        continue;
                    }
                    let known = (&mut taken, &mut early, &mut strange);
                    match self.take_block(&message, &history, &order, known) {
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
                        let (again, blocked) = self.settle(app, guard, std::mem::take(&mut done)).await;
                        guard = again;
                        order.stood_still(blocked);
                        early.stood_still(blocked);
                        // The rings may have been replaced meanwhile.
                        (history, pushed) = (self.scene.borrow().history.clone(), 0);
                    }
                }
                let (_guard, blocked) = self.settle(app, guard, done).await;
                order.stood_still(blocked);
                early.stood_still(blocked);
            }
        }
    }

    /// Notes how far behind samples are taken: by the age of the last message that came, which its stream took at `last` (s). Where
    /// none came and none `waits` it is nothing, however old the last one was: its edge may have stopped.
    fn note_lag(&self, last: Option<f64>, waits: bool) {
        match last {
            Some(taken) => self.lag(self.server_now() - taken),
            None if waits => {}
            None => self.lag(0.0),
        }
    }

    /// Takes the samples of a message; `None` where its loop is not known.
    fn take_block(
        &self,
        message: &Incoming,
        history: &History,
        order: &Order,
        (taken, early, strange): (&mut Taken, &mut Early, &mut Strange),
    ) -> Option<Block> {
        let own = Subject::read(message.subject())?;
        let id = LoopId::new(of_site(&own.site, &own.name));
        history.tag_index(&id, &TagKind::Role(Role::Op))?;
        let Some(mut samples) = weights::read::<Samples>(message.subject(), message.bytes()) else {
            return Some(Block::Taken(0));
        };
        if self.is_foreign(id.as_str(), &samples.edge, message) {
            return Some(Block::Taken(0));
        }
        // A ring has the samples of one source: what the edge says of its tags may come after them, or before what is older.
        let (specs, now, mut waits) = (history.latest(&id), self.clock.elapsed(), false);
        let patience = || announcement_patience(order.waiting(), self.in_force_for(&own.site));
        samples.tags.retain(|tag| {
            if TagKind::named(&tag.tag) == TagKind::Role(Role::Term) {
                // No list has it.
                return false;
            }
            let spec = specs.iter().find(|(spec, _)| spec.kind.name() == tag.tag);
            let sources = (tag.source.as_str(), spec.map(|(spec, _)| spec.source.as_str()));
            let wait = if sources.1 == Some(sources.0) { Duration::ZERO } else { patience() };
            let origin = strange.origin((message.subject(), tag.tag.as_str()), sources, (wait, now));
            if origin == Origin::GivenUp {
                tracing::warn!(
                    control_loop = %id,
                    tag = tag.tag,
                    source = tag.source,
                    "samples are left out: their edge does not say that it has this tag, or says that it reads it elsewhere"
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
        if is_early && early.waits(message.subject(), now) {
            return Some(Block::Early);
        }
        if is_early {
            tracing::warn!(control_loop = %id, "samples are missing: they did not come, so they may have been deleted from the stream");
        }
        early.end(message.subject());
        let again = taken.is_past(id.as_str(), message.mark());
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

    /// Takes a message of an announcement.
    fn hear_part(&self, message: &Incoming, lists: &mut Lists) {
        let at = message.taken_at().unwrap_or_else(|| self.server_now());
        if let Some(edge) = lists.hear(message.subject(), message.bytes(), at) {
            self.renew(&edge, at);
        }
    }

    /// Whether what `edge` says of a loop or collector is left out because another edge has that, too; then it is counted.
    pub(super) fn is_foreign(&self, id: &str, edge: &str, message: &Incoming) -> bool {
        let is_foreign = lock(&self.claims).is_foreign(id, edge, message.taken_at());
        if is_foreign {
            self.left_out.fetch_add(1, Relaxed);
            tracing::warn!(target: LOG, id, edge, "a message is left out: this is taken from another edge of the site");
        }
        is_foreign
    }

    /// For how long all that the edges of a site say has been in force.
    fn in_force_for(&self, site: &str) -> Option<Duration> {
        let since = lock(&self.in_force).get(site).copied()?;
        Some(self.clock.elapsed().saturating_sub(since))
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

    /// Whether the loop of a message, which is not known, may still become known: that is waited for, but for `most` at most.
    pub(super) fn may_be_known(&self, message: &Incoming, order: &mut Order, most: Duration) -> bool {
        let site = Subject::read(message.subject()).map(|own| own.site);
        let in_force = site.as_ref().and_then(|site| self.in_force_for(site));
        let unknown_site = site.as_deref().filter(|_| in_force.is_none());
        let unknown_for = order.unknown_for(message.subject(), unknown_site, self.clock.elapsed());
        unknown_for < patience(order.waiting(), in_force).min(most)
    }

    /// Leaves a message of a loop that is not known for later, or for good where it has waited for long.
    pub(super) async fn later(&self, message: &Incoming, order: &mut Order) {
        if self.may_be_known(message, order, Duration::MAX) {
            return self.put_off(message, order).await;
        }
        order.end(message.subject(), message.sequence());
        self.left_out.fetch_add(1, Relaxed);
        tracing::warn!(
            subject = message.subject(),
            "a message is left out: no edge has announced its loop, or the list of its edge is too large or cannot be taken whole"
        );
        let _ = message.done().await;
    }

    /// Makes durable what was taken, however long that takes, and acknowledges it. Returns how long nothing was read for that.
    pub(super) async fn settle<'f>(
        &'f self,
        app: &App,
        guard: RwLockReadGuard<'f, ()>,
        done: Vec<Incoming>,
    ) -> (RwLockReadGuard<'f, ()>, Duration) {
        if done.is_empty() {
            return (guard, Duration::ZERO);
        }
        let begun = self.clock.elapsed();
        let guard = until_durable(&self.taking, guard, || self.is_durable(app)).await;
        let acknowledged: Vec<BoxFuture<'_, _>> = done.iter().map(|own| own.done().boxed()).collect();
        let results: Vec<Result<(), LinkError>> = futures::future::join_all(acknowledged).await;
        if let Some(error) = results.into_iter().find_map(Result::err) {
            tracing::debug!(%error, "what is stored comes again");
        }
        (guard, self.clock.elapsed().saturating_sub(begun))
    }
}

/// Asks until what was taken is durable. While the store fails, the guard is given back in between: rings are replaced all the
/// same, and the old ones wait for the store.
async fn until_durable<'g, F: Future<Output = bool>>(
    taking: &'g RwLock<()>,
    mut guard: RwLockReadGuard<'g, ()>,
    is_durable: impl Fn() -> F,
) -> RwLockReadGuard<'g, ()> {
    while !is_durable().await {
        tracing::warn!("the store fails: what edges forward stays in the streams");
        drop(guard);
        tokio::time::sleep(PAUSE).await;
        guard = taking.read().await;
    }
    guard
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::tests::centre;
    use std::sync::atomic::AtomicBool;

    #[test]
    fn a_centre_that_has_taken_everything_is_not_behind_however_old_the_last_message_was() {
        let (fleet, _results) = centre("north:FIC1");
        let lag_ms = || fleet.lag_ms.load(Relaxed);
        fleet.note_lag(Some(fleet.server_now() - 600.0), false);
        assert!((599_000..700_000).contains(&lag_ms()), "{} ms", lag_ms());
        fleet.note_lag(None, true);
        assert!(lag_ms() >= 599_000, "more is still to come");
        fleet.note_lag(None, false);
        assert_eq!(lag_ms(), 0);
    }

    #[test]
    fn a_number_that_a_server_uses_again_is_another_message() {
        let mut taken = Taken::default();
        assert!(!taken.is_past("a", (7, 100)) && !taken.is_past("a", (9, 120)));
        assert!(taken.is_past("a", (9, 120)) && taken.is_past("a", (7, 100)), "they come again");
        // It has lost 8 and 9.
        assert!(!taken.is_past("a", (8, 500)) && taken.is_past("a", (8, 500)));
        assert!(!taken.is_past("a", (9, 510)));
        assert!(!taken.is_past("a", (10, 400)), "its clock was set back");
        assert!(!taken.is_past("b", (1, 1)));
    }

    #[tokio::test(start_paused = true)]
    async fn rings_are_replaced_while_the_store_fails() {
        let (taking, is_replaced) = (RwLock::new(()), AtomicBool::new(false));
        let flag = &is_replaced;
        let settling = until_durable(&taking, taking.read().await, || async move { flag.load(Relaxed) });
        // The store works again once that is done, and not before.
        let replacing = async {
            let _paused = taking.write().await;
            is_replaced.store(true, Relaxed);
        };
        let both = async { tokio::join!(settling, replacing) };
        let (_guard, ()) = tokio::time::timeout(10 * PAUSE, both).await.expect("nobody waits for the other");
        assert!(taking.try_write().is_err(), "what is taken next is taken with the guard");
    }
}
