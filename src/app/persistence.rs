//! Wires the store: follows the rings and what is said of the loops, and on start gives both back what was kept.
//!
//! No collector knows of it. Every ring has one more reader, which remembers how far it has come; while the store fails the
//! ring itself is what waits, and only what it overwrites before the store works again is lost, and counted.

mod feed;
mod room;
pub(super) mod rows;

use super::plantwide;
use crate::config::Config;
use crate::history::{History, Ring};
use crate::indicators::series::Values;
use crate::results::{Change, Results};
use crate::schedule::Clock;
use crate::serve::{AskDurable, AskStore, StoreState};
use crate::signal::LoopId;
use crate::store::{self, Flusher, Found, Reader, Store, StoreError, TagName, Writer};
use crate::work::Order;
use feed::StoreFeed;
use rows::{remembered, remembered_alarms, remembered_changes, remembered_model};
use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Changes that wait for the writer's next round; rows are made of them there.
const MAX_CHANGES: usize = 4096;
/// Rows of parts that make their own, which wait for it: one of each of 10,000 loops, twice.
const MAX_ROWS: usize = 20_000;
/// Longest wait for what is new to be durable, before rings are replaced.
const PATIENCE: Duration = Duration::from_secs(10);

/// The store of the daemon; without `[store]` there is none and nothing happens.
pub(super) struct Persistence {
    config: Option<store::Config>,
    clock: Clock,
    driven: store::Driven,
    shared: Arc<Shared>,
    /// Opened and not begun yet.
    opened: Mutex<Option<Result<Store, StoreError>>>,
    writer: Arc<Mutex<Option<Writer>>>,
}

/// A loop's indicators, day by day.
type Days = (LoopId, Vec<(f64, Values)>);

/// What the collectors' and the scheduler's side shares with the writer's thread.
#[derive(Default)]
struct Shared {
    taps: Mutex<Vec<Arc<Tap>>>,
    changes: Mutex<VecDeque<Change>>,
    /// Rows of parts that make their own.
    rows: Mutex<VecDeque<store::Row>>,
    /// Orders and indicators as they were kept, until somebody takes them.
    plantwide: Mutex<(Vec<Order>, Vec<Days>)>,
    /// The clock was set back, and what is of before is not written yet.
    leaving: AtomicBool,
    lost_samples: AtomicU64,
    dropped_rows: AtomicU64,
    /// What was left of a store that is damaged, and how many states are in neither copy.
    left: Mutex<Option<String>>,
    lost_states: AtomicU64,
}

/// The store's place in one ring.
struct Tap {
    tag: Arc<TagName>,
    ring: Arc<Ring>,
    /// Number of the first sample that is not durable.
    next: AtomicU64,
    /// Stamp of the last that is (s), as bits; NaN before there is one.
    last: AtomicU64,
    /// Nobody pushes any more: gone when it is drained.
    retired: AtomicBool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Who waits must not hold the writer: health and metrics ask it on the runtime's threads.
fn flusher(writer: &Mutex<Option<Writer>>) -> Option<Flusher> {
    lock(writer).as_ref().map(Writer::flusher)
}

impl Persistence {
    /// Opens the store and gives back what was kept: samples to the rings, diagnoses, models and alarms to the results. A
    /// store that cannot be opened is an entry in the log and in health; the daemon starts without.
    pub(super) fn new(
        config: &Config,
        clock: Clock,
        driven: store::Driven,
        (history, results): (&History, &Results),
    ) -> Arc<Self> {
        let persistence = Self {
            config: config.store.clone(),
            clock,
            driven,
            shared: Arc::default(),
            opened: Mutex::default(),
            writer: Arc::default(),
        };
        let Some(own) = &persistence.config else {
            tracing::warn!("no [store] is configured: a restart begins with an empty history");
            return Arc::new(persistence);
        };
        if let Some(why) = room::too_little(config, own) {
            tracing::warn!("{why}");
        }
        // On a thread of its own: a connection to a database waits, which a thread of the runtime must not.
        let opened = std::thread::scope(|scope| {
            let opening = scope.spawn(|| {
                let mut opened = (persistence.driven.open)(own, true);
                match &mut opened {
                    Ok(store) => store.disconnect(),
                    Err(error) if error.is_damage() => {}
                    Err(_) => return opened,
                }
                // Of one that is damaged, what is left.
                match persistence.give_back(history, results) {
                    Err(damage) => Err(damage),
                    Ok(()) => opened,
                }
            });
            let failed = || StoreError::Io { path: own.folder.clone(), source: io::Error::other("panicked") };
            opening.join().unwrap_or_else(|_| Err(failed()))
        });
        *lock(&persistence.opened) = Some(opened);
        persistence.follow(history, f64::INFINITY);
        let shared = persistence.shared.clone();
        results.keep_with(Arc::new(move |change| shared.note(change)));
        Arc::new(persistence)
    }

    /// Begins to write.
    pub(super) fn begin(&self, results: Arc<Results>) {
        let (Some(config), Some(opened)) = (&self.config, lock(&self.opened).take()) else { return };
        let (clock, own) = (self.clock, config.clone());
        let feed = StoreFeed::new(
            self.shared.clone(),
            Box::new(move || clock.now()),
            Box::new(move |found| merge(&own, &results, found, clock.now())),
            config.queue_mb as usize * 1_000_000,
        );
        match Writer::driven(&self.driven, config, opened, feed, move || clock.now()) {
            Ok(writer) => *lock(&self.writer) = Some(writer),
            Err(error) => tracing::error!(%error, "nothing is stored: there is no thread for it"),
        }
    }

    /// Writes what is left and ends.
    pub(super) async fn end(&self) {
        let writer = lock(&self.writer).take();
        let ended = tokio::task::spawn_blocking(move || writer.map(Writer::stop)).await;
        if let Err(error) = ended {
            tracing::error!(%error, "the store did not end well");
        }
    }

    /// Another configuration: rings that are new are filled with what was kept of their tags, and followed.
    pub(super) async fn replace(self: Arc<Self>, history: Arc<History>, results: Arc<Results>) {
        if self.config.is_none() {
            return;
        }
        let replaced = tokio::task::spawn_blocking(move || {
            // What the old rings hold belongs into the new ones too.
            let durable = flusher(&self.writer).is_none_or(|flusher| flusher.flush(PATIENCE));
            if !durable {
                tracing::warn!("the store fails: rings that are new begin empty");
            }
            if let Err(error) = self.give_back(&history, &results) {
                tracing::error!(%error, "the store fails");
            }
            // What is to be told apart still needs what it is told from.
            let leaving = self.shared.leaving.load(Relaxed);
            self.follow(&history, if leaving { f64::INFINITY } else { self.clock.now() });
        });
        if let Err(error) = replaced.await {
            tracing::error!(%error, "the store does not follow the new configuration");
        }
    }

    /// Keeps rows of a part that makes its own; waits for nobody.
    pub(super) fn note_rows(&self, rows: Vec<store::Row>) {
        if self.config.is_none() {
            return;
        }
        let mut waiting = lock(&self.shared.rows);
        waiting.extend(rows);
        let surplus = waiting.len().saturating_sub(MAX_ROWS);
        waiting.drain(..surplus);
        self.shared.dropped_rows.fetch_add(surplus as u64, Relaxed);
    }

    /// Orders and indicators as they were kept, once.
    pub(super) fn give_back_plantwide(&self) -> (Vec<Order>, Vec<Days>) {
        std::mem::take(&mut *lock(&self.shared.plantwide))
    }

    /// How the store is; `None` where there is none.
    pub(super) fn ask(&self) -> Option<AskStore> {
        self.config.as_ref()?;
        let (writer, shared) = (self.writer.clone(), self.shared.clone());
        Some(Arc::new(move || state(lock(&writer).as_ref().map(Writer::status).unwrap_or_default(), &shared)))
    }

    /// Waits until everything noted is durable; `None` where there is no store, so that nothing ever is.
    pub(super) fn ask_durable(&self) -> Option<AskDurable> {
        self.config.as_ref()?;
        let writer = self.writer.clone();
        Some(Arc::new(move || flusher(&writer).is_some_and(|flusher| flusher.flush(PATIENCE))))
    }

    /// Has everything noted made durable; false where that failed, or there is no store. It blocks its thread.
    pub(super) fn make_durable(&self) -> bool {
        self.ask_durable().is_some_and(|durable| durable())
    }

    /// As it is configured since the start; `None` where there is none.
    pub(super) fn configured(&self) -> Option<store::Config> {
        self.config.clone()
    }

    /// Puts recorded history into its place; durable when this returns.
    pub(super) fn insert(&self, batch: store::Batch) -> Result<(), String> {
        let asked = lock(&self.writer).as_ref().map(|writer| writer.insert(batch));
        asked.and_then(|answer| answer.recv().ok()).unwrap_or_else(|| Err("the store has ended".to_string()))
    }

    /// What was kept, as far as it can be read; an error where that is not all, and nobody had said so.
    fn give_back(&self, history: &History, results: &Results) -> Result<(), StoreError> {
        let Some(config) = &self.config else { return Ok(()) };
        let began = Instant::now();
        // Samples last: a database that goes away meanwhile is more likely to do so while they are read.
        let given = Reader::at_hand(config).and_then(|mut reader| {
            let loops = self.restore(&reader, history, results)?;
            let samples = refill(&mut reader, history, Reader::together(config))?;
            Ok((samples, loops, reader.damaged(), reader.lost()))
        });
        // Somebody has to hear of it now, and what is left to be read another way.
        let found = match &given {
            _ if store::is_damaged(config) => None,
            Ok((_, _, damaged, None)) if *damaged > 0 && config.url.is_none() => {
                Some(format!("{damaged} blobs of samples are damaged"))
            }
            Err(error) if error.is_damage() && config.url.is_none() => Some(error.to_string()),
            _ => None,
        };
        if let Some(why) = found {
            let damage = store::mark_damaged(config, &why);
            self.give_back(history, results)?;
            return Err(damage);
        }
        if given.is_err() && config.url.is_some() {
            // Who opened the store is taken to know what the database has, which is remembered in the folder.
            let known = Reader::open(&config.folder).and_then(|spool| self.restore(&spool, history, results));
            if let Err(error) = known {
                tracing::error!(%error, "nothing is known of alarms and models of before");
            }
        }
        let took_s = began.elapsed().as_secs_f64();
        match given {
            Ok((samples, loops, damaged, lost)) => {
                tracing::info!(samples, loops, damaged, took_s, "store: history is back");
                if let Some((left, states)) = &lost {
                    tracing::error!(
                        left,
                        "the store is damaged: what is left of it is back, and nothing is written"
                    );
                    self.shared.lost_states.store(*states, Relaxed);
                }
                *lock(&self.shared.left) = lost.map(|(left, _)| left);
            }
            Err(error) => tracing::error!(%error, "the store cannot be read: history is not complete"),
        }
        Ok(())
    }

    /// Gives back what was kept of alarms and loops; of how many loops there was anything.
    fn restore(&self, reader: &Reader, history: &History, results: &Results) -> Result<usize, StoreError> {
        let states = reader.alarms()?;
        let orders = states.iter().filter_map(plantwide::rows::order_of).collect();
        let days = states.iter().filter_map(plantwide::rows::health_of).collect();
        *lock(&self.shared.plantwide) = (orders, days);
        results.restore_alarms(remembered_alarms(states), remembered_changes(reader)?);
        let mut loops = 0;
        for own in history.loops() {
            let kept = remembered(reader, &own.id, results.room())?;
            loops += usize::from(!kept.summaries.is_empty());
            results.restore(&own.id, kept);
        }
        Ok(loops)
    }

    /// Follows the rings of `history`, from where they are now unless they were followed before. What is stamped later than
    /// `now` (s) is of before a clock was set back, and no measure for what comes.
    fn follow(&self, history: &History, now: f64) {
        let mut taps = lock(&self.shared.taps);
        let old = std::mem::take(&mut *taps);
        for tap in &old {
            tap.retired.store(true, Relaxed);
        }
        for (tag, ring) in named(history) {
            let before = old.iter().find(|tap| Arc::ptr_eq(&tap.ring, &ring));
            taps.push(match before {
                Some(tap) => {
                    tap.retired.store(false, Relaxed);
                    tap.clone()
                }
                None => Arc::new(Tap {
                    tag: Arc::new(tag),
                    next: ring.pushed().into(),
                    last: ring.latest().filter(|s| s.t <= now).map_or(f64::NAN, |s| s.t).to_bits().into(),
                    ring,
                    retired: false.into(),
                }),
            });
        }
        taps.extend(old.into_iter().filter(|tap| tap.retired.load(Relaxed)));
    }
}

/// Takes what a database has that was away at the start, and was not known here, into what there is.
fn merge(config: &store::Config, results: &Results, found: Found, now: f64) {
    for model in &found.models {
        results.merge_model(&LoopId::new(model.control_loop.as_str()), remembered_model(model));
    }
    results.merge_alarms(remembered_alarms(found.alarms), now);
    let past = Reader::of(config).and_then(|reader| {
        results.restore_alarms(Vec::new(), remembered_changes(&reader)?);
        for id in found.models.iter().map(|model| LoopId::new(model.control_loop.as_str())) {
            results.restore(&id, remembered(&reader, &id, results.room())?);
        }
        Ok(())
    });
    if let Err(error) = past {
        tracing::warn!(%error, "what was said before the start cannot be read until the next one");
    }
}

/// Every ring, and the name its samples are kept under.
fn named(history: &History) -> impl Iterator<Item = (TagName, Arc<Ring>)> {
    let tags = history.loops().iter().flat_map(|own| own.tags.iter().map(move |tag| (&own.id, tag)));
    tags.enumerate().filter_map(|(at, (id, tag))| {
        let name = TagName {
            control_loop: id.to_string(),
            tag: tag.kind.name().to_string(),
            source: tag.source.clone(),
            unit: tag.unit.clone(),
        };
        Some((name, history.ring(at)?.clone()))
    })
}

/// Fills rings that are empty with what they held; how many samples that were.
fn refill(reader: &mut Reader, history: &History, together: usize) -> Result<usize, StoreError> {
    let empty: Vec<_> = named(history).filter(|(_, ring)| ring.pushed() == 0).collect();
    let mut count = 0;
    for some in empty.chunks(together) {
        let names: Vec<TagName> = some.iter().map(|(name, _)| name.clone()).collect();
        let room = some.iter().map(|(_, ring)| ring.capacity()).max().unwrap_or(0);
        let mut kept = reader.last(&names, room)?;
        for (name, ring) in some {
            let samples = kept.remove(name).unwrap_or_default();
            count += samples.len();
            samples.into_iter().for_each(|sample| ring.push(sample));
        }
    }
    Ok(count)
}

fn state(status: store::Status, shared: &Shared) -> StoreState {
    let spool = status.spool.as_ref().map(|(spool, _)| spool);
    let spooling = status.spool.as_ref().and_then(|(spool, since)| {
        let why = spool.away.clone().unwrap_or_else(|| "the database takes what waited".to_string());
        since.map(|since| (why, since))
    });
    let database = spool.map(|spool| (spool.away.is_none(), if spool.waits { spool.bytes } else { 0 }));
    let of_spool = spool.map_or([0, 0], |spool| [spool.delivered, spool.dropped]);
    let failing = status.failing.map(|(why, since)| match &*lock(&shared.left) {
        Some(left) => (format!("{why}; {left}"), since),
        None => (why, since),
    });
    StoreState {
        failing,
        spooling,
        database,
        written_at: status.written_at,
        used_bytes: status.usage.used_bytes,
        max_bytes: status.usage.max_bytes,
        counters: vec![
            ("samples", status.samples),
            ("rows", status.rows),
            ("failures", status.failures),
            ("lost_samples", shared.lost_samples.load(Relaxed)),
            ("dropped_rows", shared.dropped_rows.load(Relaxed)),
            ("refused_samples", status.refused),
            ("damaged_chunks", status.damaged),
            ("lost_states", shared.lost_states.load(Relaxed)),
            ("delivered_samples", of_spool[0]),
            ("dropped_samples", of_spool[1]),
        ],
    }
}

impl Shared {
    /// Takes a change; waits for nobody.
    fn note(&self, change: Change) {
        let mut changes = lock(&self.changes);
        if changes.len() == MAX_CHANGES {
            changes.pop_front();
            self.dropped_rows.fetch_add(1, Relaxed);
        }
        changes.push_back(change);
    }
}

#[cfg(test)]
mod tests;
