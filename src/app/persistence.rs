//! Wires the store: follows the rings and what is said of the loops, and on start gives both back what was kept.
//!
//! No collector knows of it. Every ring has one more reader, which remembers how far it has come; while the store fails the
//! ring itself is what waits, and only what it overwrites before the store works again is lost, and counted.

mod again;
mod feed;
mod retired;
mod room;
pub(super) mod rows;
mod set_back;
mod terms;
mod waiting;

use super::plantwide::rows::KeptPlant;
use crate::config::Config;
use crate::history::{History, Ring};
use crate::results::{Remembered, Results};
use crate::schedule::Clock;
use crate::serve::{AskDurable, AskStore, StoreState};
use crate::signal::LoopId;
use crate::store::{self, AlarmRow, Flusher, Found, ModelRow, Reader, Store, StoreError, TagName, Writer};
use feed::{Merge, Now, StoreFeed};
use rows::{remembered, remembered_alarms, remembered_changes, remembered_model};
use set_back::SetBacks;
use std::collections::VecDeque;
use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};
use waiting::Waiting;

/// Rows of what happened in parts that make their own, which wait for the writer: one of each of 10,000 loops, twice.
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

/// Takes orders and indicators as they were kept.
pub(super) type TakeBack = Box<dyn Fn(KeptPlant) + Send + Sync>;

/// What the collectors' and the scheduler's side shares with the writer's thread.
#[derive(Default)]
struct Shared {
    taps: Mutex<Vec<Arc<Tap>>>,
    set_backs: Mutex<SetBacks>,
    changes: Mutex<Waiting>,
    /// Rows of parts that make their own.
    rows: Mutex<VecDeque<store::Row>>,
    /// Orders and indicators as they were kept, until there is somebody who takes them.
    plantwide: Mutex<KeptPlant>,
    take_back: OnceLock<TakeBack>,
    keep_again: OnceLock<again::KeepAgain>,
    /// What is there was read, though it could not be opened.
    has_read: AtomicBool,
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
    /// How often the clock was set back before this ring was followed: its samples belong to no earlier era.
    set_backs: u32,
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
    /// store that cannot be opened is an entry in the log and in health; the daemon starts with what can be read of it.
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
                    // Who has it open may change it, and of a database elsewhere who opens the spool says what is known.
                    Err(StoreError::InUse(_)) => return opened,
                    // Nobody opens this spool before somebody has decided, and until then alarms are to go on from where they were.
                    Err(StoreError::OwnStore { .. }) => {}
                    Err(error) if own.url.is_some() && !error.is_damage() => return opened,
                    Err(_) => {}
                }
                // Of one that is damaged, what is left; of one without room for its files, all.
                let given = persistence.give_back(history, results);
                match (given, &opened) {
                    // Opened once more it is read first, and until then nothing is written over.
                    (Err(error), Ok(_)) => return Err(error),
                    (Ok(()), Err(error)) => persistence.shared.has_read.store(!error.is_damage(), Relaxed),
                    _ => {}
                }
                opened
            });
            let failed = || StoreError::Io { path: own.folder.clone(), source: io::Error::other("panicked") };
            opening.join().unwrap_or_else(|_| Err(failed()))
        });
        *lock(&persistence.opened) = Some(opened);
        persistence.follow(history, f64::INFINITY);
        super::silence::tell_ahead(history, clock.now());
        let shared = persistence.shared.clone();
        results.keep_with(Arc::new(move |change| {
            let dropped = lock(&shared.changes).put(change);
            shared.dropped_rows.fetch_add(dropped, Relaxed);
        }));
        Arc::new(persistence)
    }

    /// Begins to write.
    pub(super) fn begin(&self, results: Arc<Results>) {
        let (Some(config), Some(opened)) = (&self.config, lock(&self.opened).take()) else { return };
        let (clock, own, shared) = (self.clock, config.clone(), self.shared.clone());
        let again = again::of(self.shared.clone(), results.clone(), (config.clone(), self.clock));
        let merge: Merge = Box::new(move |found| {
            shared.give_back(&found.alarms);
            merge(&own, &results, found, clock.now());
        });
        let now: Now = Box::new(move || clock.now());
        let room = config.queue_mb as usize * 1_000_000;
        let feed = StoreFeed::new(self.shared.clone(), now, (merge, again), room);
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
        let mut all = lock(&self.shared.rows);
        all.extend(rows);
        let dropped = waiting::bound(&mut all, MAX_ROWS);
        self.shared.dropped_rows.fetch_add(dropped, Relaxed);
    }

    /// Gives orders and indicators back to `take_back`: as they were kept, and whatever is found later that was not known, as
    /// of a loop that is configured again, or once a store works that could not be read at the start.
    pub(super) fn give_back_plantwide(&self, take_back: TakeBack) {
        let kept = std::mem::take(&mut *lock(&self.shared.plantwide));
        take_back(kept);
        // There is one who takes them.
        let _ = self.shared.take_back.set(take_back);
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

    /// Whether nothing new is made durable: the store fails, or there is no thread that writes. Waits for no disk.
    pub(super) fn fails(&self) -> bool {
        let works = |writer: &Writer| writer.status().failing.is_none();
        self.config.is_some() && !lock(&self.writer).as_ref().is_some_and(works)
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

    /// What was kept, as far as it can be read; an error where that is not all and nobody had said so, or where no state could
    /// be read, which then is not to be written over.
    fn give_back(&self, history: &History, results: &Results) -> Result<(), StoreError> {
        let Some(config) = &self.config else { return Ok(()) };
        let began = Instant::now();
        // Samples last: a database that goes away meanwhile is more likely to do so while they are read.
        let given = Reader::at_hand(config).and_then(|mut reader| {
            let mut back = self.restore(&reader, history, results)?;
            match refill(&mut reader, history, Reader::together(config)) {
                Ok(samples) => back.samples = samples,
                Err(error) => back.lacks(error),
            }
            Ok((back, reader.damaged(), reader.lost()))
        });
        // Somebody has to hear of it now, and what is left to be read another way.
        let is_told = store::is_damaged(config) || config.url.is_some();
        let found = match &given {
            _ if is_told => None,
            Ok((Back { lacking: Some(error), .. }, ..)) | Err(error) if error.is_damage() => error.damage(),
            Ok((_, damaged, None)) if *damaged > 0 => Some(format!("{damaged} blobs of samples are damaged")),
            _ => None,
        };
        if let Some(why) = found {
            let damage = store::mark_damaged(config, &why);
            // What cannot be read of what is left is in the log.
            let _ = self.give_back(history, results);
            return Err(damage);
        }
        let took_s = began.elapsed().as_secs_f64();
        match given {
            Ok((Back { samples, loops, lacking }, damaged, lost)) => {
                match lacking {
                    None => tracing::info!(samples, loops, damaged, took_s, "store: history is back"),
                    Some(error) => tracing::error!(%error, samples, loops, "store: history is not complete"),
                }
                if let Some((left, states)) = &lost {
                    tracing::error!(
                        left,
                        "the store is damaged: what is left of it is back, and nothing is written"
                    );
                    self.shared.lost_states.store(*states, Relaxed);
                }
                *lock(&self.shared.left) = lost.map(|(left, _)| left);
                Ok(())
            }
            Err(error) => {
                tracing::error!(%error, "the store cannot be read");
                // Who opened the store is taken to know what the database has, which is remembered in the folder.
                let known = config.url.as_ref().map(|_| Reader::open(&config.folder));
                match known.map(|spool| self.restore(&spool?, history, results)) {
                    Some(known) => known.map(drop),
                    None => Err(error),
                }
            }
        }
    }

    /// Gives back what was kept of alarms and loops. All states are read before anything is given back: those that nobody has
    /// read are merged later, and none is merged into itself.
    fn restore(&self, reader: &Reader, history: &History, results: &Results) -> Result<Back, StoreError> {
        let alarms = reader.alarms()?;
        let model = |id: &LoopId| reader.model(id.as_str());
        let models: Vec<Option<ModelRow>> =
            history.loops().iter().map(|own| model(&own.id)).collect::<Result<_, _>>()?;
        self.shared.give_back(&alarms);
        // What happened and what was said is only told: where it cannot be read everything else is back all the same.
        let mut back = Back::default();
        let changes = remembered_changes(reader).unwrap_or_else(|error| {
            back.lacks(error);
            Vec::new()
        });
        results.restore_alarms(remembered_alarms(alarms), changes);
        for (own, model) in history.loops().iter().zip(models) {
            let said = remembered(reader, &own.id, results.room()).unwrap_or_else(|error| {
                back.lacks(error);
                Remembered::default()
            });
            back.loops += usize::from(!said.summaries.is_empty());
            let model = model.as_ref().map(remembered_model).unwrap_or_default();
            results.restore(&own.id, Remembered { model, ..said });
        }
        Ok(back)
    }

    /// Follows the rings of `history`, from where they are now unless they were followed before. What is stamped later than
    /// `now` (s) is of before a clock was set back, and no measure for what comes.
    fn follow(&self, history: &History, now: f64) {
        let is_damaged = self.is_damaged();
        let set_backs = lock(&self.shared.set_backs).look(self.clock.now());
        let mut taps = lock(&self.shared.taps);
        let old = std::mem::take(&mut *taps);
        // Those that are filled come first.
        let latest = old.iter().take_while(|tap| !tap.retired.load(Relaxed)).count();
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
                    set_backs,
                    ring,
                    retired: false.into(),
                }),
            });
        }
        let (waiting, lost) = retired::waiting(old, latest, &taps, is_damaged);
        taps.extend(waiting);
        self.shared.lost_samples.fetch_add(lost, Relaxed);
    }

    /// Whether nothing is written until somebody decides; that it is damaged may have found no room on the disk.
    fn is_damaged(&self) -> bool {
        self.config.as_ref().is_some_and(store::is_damaged)
            || lock(&self.writer).as_ref().is_some_and(|writer| writer.status().is_damaged)
    }
}

/// What came back.
#[derive(Default)]
struct Back {
    samples: usize,
    /// Of which anything was said.
    loops: usize,
    /// Why not everything did.
    lacking: Option<StoreError>,
}

impl Back {
    /// Something could not be read; that it is damaged goes before all else.
    fn lacks(&mut self, error: StoreError) {
        if error.is_damage() || self.lacking.is_none() {
            self.lacking = Some(error);
        }
    }
}

/// Takes what a store has that could not be read at the start, and was not known here, into what there is.
fn merge(config: &store::Config, results: &Results, found: Found, now: f64) {
    for model in &found.models {
        results.merge_model(&LoopId::new(model.control_loop.as_str()), remembered_model(model));
    }
    results.merge_alarms(remembered_alarms(found.alarms), now);
    let past = Reader::of(config).and_then(|reader| {
        results.restore_alarms(Vec::new(), remembered_changes(&reader)?);
        for id in found.models.iter().map(|model| LoopId::new(model.control_loop.as_str())) {
            if !results.restore(&id, remembered(&reader, &id, results.room())?) {
                results.forget_evidence(&id, now);
            }
        }
        Ok(())
    });
    if let Err(error) = past {
        store::heed(config, &error);
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
    let mut empty: Vec<_> = named(history).filter(|(_, ring)| ring.pushed() == 0).collect();
    // Each is asked for as much as the largest of those that are asked for together.
    empty.sort_by_key(|(_, ring)| ring.capacity());
    let alike = empty.chunk_by(|a, b| a.1.capacity() == b.1.capacity());
    let mut count = 0;
    for some in alike.flat_map(|alike| alike.chunks(together)) {
        let names: Vec<TagName> = some.iter().map(|(name, _)| name.clone()).collect();
        let room = some.iter().map(|(_, ring)| ring.capacity()).max().unwrap_or(0);
        let mut kept = reader.last(&names, room)?;
        for (name, ring) in some {
            let samples = kept.remove(name).unwrap_or_default();
            count += samples.len();
            samples.into_iter().for_each(|sample| ring.push(sample));
        }
    }
    terms::give_back(reader, history)?;
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
        is_damaged: status.is_damaged,
        lost_states: shared.lost_states.load(Relaxed),
        checked: status.checked,
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
            ("thinned_in_doubt_s", status.thinned_in_doubt_s),
            ("lost_states", shared.lost_states.load(Relaxed)),
            ("delivered_samples", of_spool[0]),
            ("dropped_samples", of_spool[1]),
        ],
    }
}

impl Shared {
    /// Gives the orders and indicators among some states to who takes them.
    fn give_back(&self, states: &[AlarmRow]) {
        let kept = KeptPlant::of(states);
        match self.take_back.get() {
            Some(take_back) => take_back(kept),
            None => *lock(&self.plantwide) = kept,
        }
    }
}

#[cfg(test)]
mod tests;
