//! The one thread that writes. It asks for what is new at a steady pace, makes it durable, tidies up, and when the store
//! fails tries again, from a fresh opening, until it works: nobody else ever waits for the disk.

mod anew;
mod flusher;
mod running;

use super::{Batch, Beat, Config, Found, Opener, Reader, Spool, Store, StoreError, Usage, heed};
use anew::Anew;
use running::Running;
use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Shortest and longest pause between attempts on a store that fails.
const PAUSES: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(15));
/// Time between two looks at how much room is taken.
const USAGE_EVERY: Duration = Duration::from_secs(5);
/// Pieces of tidying after each write.
const TIDY: usize = 8;

/// Where what is to be written comes from. Called on the writer's thread only.
pub trait Feed: Send + 'static {
    /// Called each round, also while the store fails: what waits is to stay bounded.
    fn gather(&mut self);
    /// What is not durable yet, bounded; asked again after a failure it may say the same and more.
    fn take(&mut self) -> &Batch;
    /// What was taken last is durable. True when there is more at once.
    fn settled(&mut self) -> bool;
    /// Whether the clock was set back since this was asked last.
    fn set_back(&mut self) -> bool;
    /// The database has what was not known here: what is taken from now on has it in it.
    fn merge(&mut self, found: Found);
    /// The store was made anew, or is another than was written to: how everything is that it does not know is taken from now on.
    fn say_again(&mut self) {}
    /// Whether what is there was read at the start, though the store could not be opened then: merged once more it would undo
    /// what has happened since.
    fn has_read(&self) -> bool {
        false
    }
}

/// How the store is.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// Why it fails, and since when (s); `None` while it works.
    pub failing: Option<(String, f64)>,
    /// It fails because it is damaged: it goes on failing until somebody decides.
    pub is_damaged: bool,
    /// The share of its files that was compared with their checksums since it was opened (0..1); `None` once all of them were.
    pub checked: Option<f64>,
    /// When something was last made durable (s), as far as there was anything.
    pub written_at: Option<f64>,
    /// Samples made durable since the start.
    pub samples: u64,
    /// Other rows made durable since the start.
    pub rows: u64,
    /// Attempts that failed since the start.
    pub failures: u64,
    /// Samples refused, because of a stamp that no key holds.
    pub refused: u64,
    /// Blobs found damaged.
    pub damaged: u64,
    /// Seconds of samples thinned while the clock was far ahead, see [`Store::thinned_in_doubt_s`].
    pub thinned_in_doubt_s: u64,
    /// What the database takes.
    pub usage: Usage,
    /// What waits for a database elsewhere, and since when that is away (s); `None` for a store in a folder.
    pub spool: Option<(Spool, Option<f64>)>,
}

#[derive(Default)]
struct Shared {
    inner: Mutex<Inner>,
    changed: Condvar,
}

type Insert = (Batch, Sender<Result<(), String>>);

#[derive(Default)]
struct Inner {
    status: Status,
    stop: bool,
    /// Recorded history, and who waits for it to be durable.
    inserts: VecDeque<Insert>,
    /// Rounds asked for and rounds done, for those who wait.
    asked: u64,
    done: u64,
    /// Whether the last round that was done wrote everything.
    good: bool,
    /// The round that is under way.
    running: Option<Running>,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The round begins, or gets on; `now` as the clock has it (s).
    fn gets_on(&self, now: f64) {
        self.lock().running = Some(Running::new(Instant::now(), now));
    }

    /// The round got on: a database elsewhere has answered.
    fn answered(&self) {
        if let Some(running) = &mut self.lock().running {
            running.answered(Instant::now());
        }
    }
}

/// How the store is opened, and who has its rounds done.
#[derive(Clone)]
pub struct Driven {
    /// Opens it.
    pub open: Opener,
    /// No thread: a round is done when it is asked for and at no other time, by whoever asks. What is dropped without
    /// [`Writer::stop`] ends as a process that is killed does.
    pub by_hand: bool,
}

impl Default for Driven {
    fn default() -> Self {
        Self { open: Arc::new(Store::taken_over), by_hand: false }
    }
}

/// The writer: a thread, or rounds by hand.
pub struct Writer {
    flusher: Flusher,
    thread: Option<JoinHandle<()>>,
}

/// Who waits for what is new, while others ask the writer how the store is.
#[derive(Clone)]
pub struct Flusher {
    shared: Arc<Shared>,
    by_hand: Option<Arc<Mutex<Box<dyn Rounds>>>>,
}

/// What does one round.
trait Rounds: Send {
    fn round(&mut self);
}

impl Writer {
    /// Starts it on a store that was opened, or could not be: then it goes on trying. `now` tells the time (s).
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(
        config: &Config,
        opened: Result<Store, StoreError>,
        feed: impl Feed,
        now: impl Fn() -> f64 + Send + 'static,
    ) -> io::Result<Self> {
        Self::driven(&Driven::default(), config, opened, feed, now)
    }

    /// As [`Writer::start`], on a store that is opened and driven in another way.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn driven(
        driven: &Driven,
        config: &Config,
        opened: Result<Store, StoreError>,
        feed: impl Feed,
        now: impl Fn() -> f64 + Send + 'static,
    ) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let mut round = Round {
            config: config.clone(),
            open: driven.open.clone(),
            store: None,
            feed,
            now,
            shared: shared.clone(),
            pause: PAUSES.0,
            looked: None,
            counted: [0; 3],
            unread: false,
            anew: Anew::default(),
            era: 0,
        };
        round.unread = opened.is_err() && !round.feed.has_read();
        match opened {
            Ok(store) => round.take_on(store),
            Err(error) => round.failed(&error),
        }
        if driven.by_hand {
            let by_hand: Box<dyn Rounds> = Box::new(round);
            let flusher = Flusher { shared, by_hand: Some(Arc::new(Mutex::new(by_hand))) };
            return Ok(Self { flusher, thread: None });
        }
        let thread = std::thread::Builder::new().name("store".into()).spawn(move || round.run())?;
        Ok(Self { flusher: Flusher { shared, by_hand: None }, thread: Some(thread) })
    }

    /// How the store is. It also fails while a write lasts longer than three minutes, as on a network file system that hangs.
    pub fn status(&self) -> Status {
        self.status_at(Instant::now())
    }

    fn status_at(&self, now: Instant) -> Status {
        let mut inner = self.flusher.shared.lock();
        let ended =
            self.flusher.by_hand.is_none() && self.thread.as_ref().is_none_or(JoinHandle::is_finished);
        if ended && inner.status.failing.is_none() {
            let since = inner.status.written_at.unwrap_or(f64::NAN);
            inner.status.failing =
                Some(("the thread of the store has ended; start the daemon anew".to_string(), since));
        }
        let mut status = inner.status.clone();
        if status.failing.is_none() {
            status.failing = inner.running.as_mut().and_then(|running| running.hangs(now));
        }
        status
    }

    /// As [`Flusher::flush`].
    pub fn flush(&self, patience: Duration) -> bool {
        self.flusher.flush(patience)
    }

    /// Who waits without the writer.
    pub fn flusher(&self) -> Flusher {
        self.flusher.clone()
    }

    /// Has recorded history put into its place. The answer comes when it is durable, or why it is not; who asks again only
    /// then keeps what waits bounded.
    pub fn insert(&self, batch: Batch) -> Receiver<Result<(), String>> {
        let (told, answer) = channel();
        self.flusher.shared.lock().inserts.push_back((batch, told));
        self.flusher.shared.changed.notify_all();
        self.flusher.round_by_hand();
        answer
    }

    /// Writes what is left and ends; on a store that fails it is tried once.
    pub fn stop(mut self) {
        self.flusher.round_by_hand();
        self.end();
    }

    fn end(&mut self) {
        self.flusher.shared.lock().stop = true;
        self.flusher.shared.changed.notify_all();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the store failed");
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.end();
    }
}

struct Round<F, N> {
    config: Config,
    open: Opener,
    store: Option<Store>,
    feed: F,
    now: N,
    shared: Arc<Shared>,
    /// The next pause while the store fails.
    pause: Duration,
    looked: Option<Instant>,
    /// Counts of stores that were open before.
    counted: [u64; 3],
    /// Nobody could read at the start what is there.
    unread: bool,
    anew: Anew,
    /// The era that was begun: a store that is opened anew knows it only once something of it is there.
    era: i64,
}

impl<F: Feed, N: Fn() -> f64 + Send> Rounds for Round<F, N> {
    fn round(&mut self) {
        let asked = self.shared.lock().asked;
        self.do_one(asked);
    }
}

impl<F: Feed, N: Fn() -> f64> Round<F, N> {
    fn run(&mut self) {
        loop {
            let (stop, asked) = self.wait();
            self.do_one(asked);
            if stop {
                return;
            }
        }
    }

    /// Does the rounds up to the one with number `asked`, in one.
    fn do_one(&mut self, asked: u64) {
        self.shared.gets_on((self.now)());
        let good = self.write_all();
        self.insert_all();
        let mut inner = self.shared.lock();
        (inner.done, inner.good, inner.running) = (asked, good, None);
        drop(inner);
        self.shared.changed.notify_all();
    }

    /// Until the next round is due or asked for, or the end.
    fn wait(&self) -> (bool, u64) {
        let usual = Duration::from_millis(self.config.sync_ms);
        let pause = if self.store.is_some() { usual } else { self.pause };
        let idle = |inner: &mut Inner| !inner.stop && inner.asked == inner.done && inner.inserts.is_empty();
        let waited = self.shared.changed.wait_timeout_while(self.shared.lock(), pause, idle);
        let (inner, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (inner.stop, inner.asked)
    }

    /// Writes until nothing is left; false when the store fails.
    fn write_all(&mut self) -> bool {
        self.feed.gather();
        if self.store.is_none()
            && let Err(error) = self.reopen()
        {
            self.failed(&error);
            return false;
        }
        let mut merging = false;
        while let Some(store) = &mut self.store {
            let now = (self.now)();
            self.shared.gets_on(now);
            if let Some(found) = store.found() {
                self.feed.merge(found);
                self.feed.gather();
                merging = true;
            }
            if self.feed.set_back() {
                tracing::warn!(
                    "the clock was set back: samples from now on are kept apart from those before"
                );
                store.begin_era();
                self.era = store.era();
            }
            let batch = self.feed.take();
            let (samples, rows) = (batch.samples() as u64, batch.rows.len() as u64);
            let written = if batch.is_empty() { Ok(()) } else { write(store, batch, now) };
            let more = written.is_ok() && self.feed.settled();
            let merged = written.and_then(|()| if merging && !more { store.merged() } else { Ok(()) });
            let done = merged.and_then(|()| tidy(store, &self.shared, now));
            match done {
                Ok(()) => self.worked(samples, rows, now),
                Err(error) => {
                    self.failed(&error);
                    return false;
                }
            }
            if !more {
                return true;
            }
        }
        false
    }

    /// Nothing is written before what is there has been read: it would be replaced by what was made without it.
    fn reopen(&mut self) -> Result<(), StoreError> {
        self.anew.look(&self.config);
        let store = (self.open)(&self.config, false)?;
        let has_written = self.shared.lock().status.written_at.is_some();
        if self.unread {
            let found = Reader::at_hand(&self.config)?.states()?;
            self.feed.merge(found);
            self.feed.gather();
            self.unread = false;
        } else if self.anew.is_other(&self.config, has_written) {
            tracing::warn!(
                "the store is not the one that was written to: how alarms, models and work orders are is written into it; what \
                 else was in that one is not"
            );
            self.feed.say_again();
        }
        self.anew = Anew::default();
        self.take_on(store);
        Ok(())
    }

    fn insert_all(&mut self) {
        let inserts = std::mem::take(&mut self.shared.lock().inserts);
        for (batch, told) in inserts {
            let now = (self.now)();
            self.shared.gets_on(now);
            let done = match &mut self.store {
                Some(store) => match store.insert(&batch) {
                    Err(error) if error.is_full() => store.make_room(now).and_then(|_| store.insert(&batch)),
                    done => done,
                }
                // The next round finds it marked.
                .inspect_err(|error| heed(&self.config, error))
                .map_err(|error| error.to_string()),
                None => Err("the store fails; its log says why".to_string()),
            };
            // Who asked may have gone.
            let _ = told.send(done);
        }
    }

    fn take_on(&mut self, mut store: Store) {
        if store.era() < self.era {
            store.begin_era();
            self.era = store.era();
        }
        let shared = self.shared.clone();
        store.tell_answers(Beat::new(move || shared.answered()));
        self.shared.lock().status.checked = store.checked();
        self.store = Some(store);
        self.looked = None;
    }

    /// Refused, damaged, and thinned in doubt, since the start.
    fn counts(&self) -> [u64; 3] {
        let Some(store) = &self.store else { return self.counted };
        let ((refused, damaged), in_doubt) = (store.refused_and_damaged(), store.thinned_in_doubt_s());
        let [before, own] = [self.counted, [refused, damaged, in_doubt]];
        std::array::from_fn(|at| before[at] + own[at])
    }

    fn worked(&mut self, samples: u64, rows: u64, now: f64) {
        let mut usage = None;
        if self.looked.is_none_or(|looked| looked.elapsed() > USAGE_EVERY) {
            self.looked = Some(Instant::now());
            usage = self.store.as_ref().and_then(|store| store.usage().ok());
        }
        let counts = self.counts();
        self.pause = PAUSES.0;
        let spool = self.store.as_ref().and_then(Store::spool);
        let checked = self.store.as_ref().and_then(Store::checked);
        let mut inner = self.shared.lock();
        let status = &mut inner.status;
        (status.is_damaged, status.checked) = (false, checked);
        let since = status.spool.as_ref().and_then(|(_, since)| *since).unwrap_or(now);
        status.spool = spool.map(|spool| {
            let since = (spool.away.is_some() || spool.waits).then_some(since);
            (spool, since)
        });
        if let Some((_, since)) = status.failing.take() {
            tracing::info!(after_s = now - since, "the store works again");
        }
        status.samples += samples;
        status.rows += rows;
        [status.refused, status.damaged, status.thinned_in_doubt_s] = counts;
        status.usage = usage.unwrap_or(status.usage);
        if samples + rows > 0 {
            status.written_at = Some(now);
        }
    }

    /// The database is left alone for a while and then opened anew: after a failed write nobody knows what state the
    /// connection is in.
    fn failed(&mut self, error: &StoreError) {
        let now = (self.now)();
        self.counted = self.counts();
        // First: of one that is damaged nothing is carried over when it is closed.
        heed(&self.config, error);
        self.anew.failed(error);
        self.store = None;
        let text = error.to_string();
        let mut inner = self.shared.lock();
        let status = &mut inner.status;
        status.failures += 1;
        if status.failing.as_ref().is_none_or(|(before, _)| *before != text) {
            tracing::error!(
                error = text,
                "the store fails; what is measured stays in memory until it works again"
            );
        }
        let since = status.failing.take().map_or(now, |(_, since)| since);
        status.failing = Some((text, since));
        status.is_damaged = error.is_damage();
        // Whatever is opened next begins anew to be looked at.
        status.checked = None;
        drop(inner);
        self.pause = (self.pause * 2).min(PAUSES.1);
    }
}

/// Writes; where the room that the store may take is full, makes some and tries once more.
fn write(store: &mut Store, batch: &Batch, now: f64) -> Result<(), StoreError> {
    match store.write(batch) {
        Err(error) if error.is_full() && store.make_room(now)? => store.write(batch),
        written => written,
    }
}

fn tidy(store: &mut Store, shared: &Shared, now: f64) -> Result<(), StoreError> {
    for _ in 0..TIDY {
        shared.gets_on(now);
        if !store.tidy(now)? {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
