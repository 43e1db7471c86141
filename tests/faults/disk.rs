//! A disk under the real store: writes that fail before or after they are done, a disk that is full, and what a crash leaves
//! of the files. It remembers what was acknowledged.

use crate::crash;
use crate::truth::Truth;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use stictiond::signal::Sample;
use stictiond::store::{
    Batch, Config, Driven, Found, Row, Spool, Store, StoreError, TransitionRow, Usage, Writes,
};

/// A deliberate bug, to show that it is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bug {
    /// None.
    #[default]
    None,
    /// The store acknowledges what it does not write.
    AcknowledgesBeforeWriting,
    /// The store writes what it was given twice, under another stamp.
    WritesTwice,
    /// The store makes a sample up.
    Invents,
    /// The store raises an alarm on stiction by itself.
    RaisesByItself,
    /// The store raises an alarm on bad tags by itself.
    RaisesTagBad,
    /// The store acknowledges models and does not write them.
    LosesModel,
    /// A device's answer is taken for the next one.
    TakesAnswerForNext,
}

struct State {
    folder: PathBuf,
    random: Pcg64,
    bug: Bug,
    /// How likely one write fails.
    fails: f64,
    /// Every write fails for want of room.
    full: bool,
    /// The process dies within the next write, or the next piece of tidying.
    dies: bool,
    /// What it left on the disk.
    image: Option<PathBuf>,
    lives: u32,
    truth: Truth,
    counts: BTreeMap<&'static str, u64>,
}

impl State {
    fn count(&mut self, what: &'static str) {
        *self.counts.entry(what).or_default() += 1;
    }
}

/// The disk.
#[derive(Clone)]
pub struct Disk {
    state: Arc<Mutex<State>>,
}

impl Disk {
    pub fn new(seed: u64, folder: &Path, bug: Bug) -> Self {
        let state = State {
            folder: folder.to_path_buf(),
            random: Pcg64::seed_from_u64(seed),
            bug,
            fails: 0.0,
            full: false,
            dies: false,
            image: None,
            lives: 0,
            truth: Truth::default(),
            counts: BTreeMap::new(),
        };
        fs::create_dir_all(folder.join("0")).expect("writable");
        Self { state: Arc::new(Mutex::new(state)) }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where the store of this life is.
    pub fn folder(&self) -> PathBuf {
        let state = self.lock();
        state.folder.join(state.lives.to_string())
    }

    pub fn set_faults(&self, fails: f64, full: bool) {
        let mut state = self.lock();
        (state.fails, state.full) = (fails, full);
    }

    /// The process is to die within the next write.
    pub fn die(&self) {
        self.lock().dies = true;
    }

    /// Whether it has died.
    pub fn is_dead(&self) -> bool {
        self.lock().image.is_some()
    }

    /// It is killed now, between two writes, at times in the middle of carrying the log over.
    pub fn kill(&self) {
        let folder = self.folder();
        let mut state = self.lock();
        if state.image.is_none() {
            let image = state.folder.join(format!("image-{}", state.lives));
            let kind = crash::at_rest(&folder, &image, &mut state.random);
            state.count(kind);
            state.image = Some(image);
        }
    }

    /// The next life begins on what the last one left; nothing fails.
    pub fn begin(&self) {
        let mut state = self.lock();
        let before = state.folder.join(state.lives.to_string());
        if let Some(image) = state.image.take() {
            state.lives += 1;
            let next = state.folder.join(state.lives.to_string());
            fs::rename(image, next).expect("renamed");
            fs::remove_dir_all(before).expect("removed");
        }
        (state.dies, state.full, state.fails) = (false, false, 0.0);
    }

    pub fn truth<T>(&self, look: impl FnOnce(&mut Truth) -> T) -> T {
        look(&mut self.lock().truth)
    }

    pub fn counts(&self) -> BTreeMap<&'static str, u64> {
        self.lock().counts.clone()
    }

    /// Opens the store on this disk, and has its rounds done by hand.
    pub fn driven(&self) -> Driven {
        let disk = self.clone();
        let open = move |config: &Config, is_read: bool| {
            if disk.is_dead() {
                return Err(failed());
            }
            let store = if is_read { Store::open(config) } else { Store::reopen(config) }?;
            Ok(Store::over(OnDisk { store, disk: disk.clone() }))
        };
        Driven { open: Arc::new(open), by_hand: true }
    }
}

fn failed() -> StoreError {
    StoreError::Io { path: PathBuf::from("disk"), source: io::Error::other("simulated") }
}

fn full() -> StoreError {
    let code = rusqlite::ffi::Error { code: rusqlite::ErrorCode::DiskFull, extended_code: 13 };
    StoreError::Database(rusqlite::Error::SqliteFailure(code, None))
}

/// What becomes of one write.
enum Fate {
    Done,
    FailsBefore(StoreError),
    FailsAfter,
    Dies,
}

/// The real store on the simulated disk.
#[derive(Debug)]
struct OnDisk {
    store: Store,
    disk: Disk,
}

impl std::fmt::Debug for Disk {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("Disk")
    }
}

impl OnDisk {
    fn fate(&self) -> Fate {
        let mut state = self.disk.lock();
        if state.image.is_some() {
            return Fate::FailsBefore(failed());
        }
        if state.dies {
            return Fate::Dies;
        }
        if state.full {
            state.count("writes without room");
            return Fate::FailsBefore(full());
        }
        let fails = state.fails;
        if !state.random.random_bool(fails) {
            return Fate::Done;
        }
        if state.random.random_bool(0.5) {
            state.count("writes that fail");
            return Fate::FailsBefore(failed());
        }
        state.count("writes that are done and reported as failed");
        Fate::FailsAfter
    }

    /// Does something and dies of it: what is on disk then is of before, of after, or something in between.
    fn die_of(&mut self, what: impl FnOnce(&mut Store) -> Result<(), StoreError>) {
        let folder = self.disk.folder();
        let (image, before) = {
            let state = self.disk.lock();
            let name = |kind| state.folder.join(format!("{kind}-{}", state.lives));
            (name("image"), name("before"))
        };
        crash::copy(&folder, &before);
        let done = what(&mut self.store);
        let mut state = self.disk.lock();
        let kind = crash::within(&before, &folder, &image, &mut state.random);
        state.count(if done.is_ok() { kind } else { "kills in a write that failed" });
        state.image = Some(image);
        drop(state);
        fs::remove_dir_all(before).expect("removed");
    }

    /// What it is asked to write: with a bug, alarms that nobody had a reason for.
    fn asked<'b>(&self, batch: &'b Batch) -> Cow<'b, Batch> {
        let kind = match self.disk.lock().bug {
            Bug::RaisesByItself => "stiction",
            Bug::RaisesTagBad => "tag_bad",
            _ => return Cow::Borrowed(batch),
        };
        let sound = batch.rows.iter().find_map(|row| match row {
            Row::Diagnosis(run) if run.outcome == "no_stiction" => Some(run),
            _ => None,
        });
        let Some(run) = sound else { return Cow::Borrowed(batch) };
        let raised = TransitionRow {
            control_loop: run.control_loop.clone(),
            kind: kind.into(),
            at: run.finished,
            before: "normal".into(),
            after: "unacknowledged".into(),
            cause: "raised".into(),
            ..TransitionRow::default()
        };
        let mut batch = batch.clone();
        batch.rows.push(Row::Transition(raised));
        Cow::Owned(batch)
    }

    /// What the store is really given: with a bug, something else.
    fn given(&self, batch: &Batch) -> Option<Batch> {
        let mut given = batch.clone();
        match self.disk.lock().bug {
            Bug::AcknowledgesBeforeWriting => return None,
            Bug::WritesTwice => {
                let again = |sample: &Sample| Sample { t: sample.t + 0.25, ..*sample };
                for series in &mut given.series {
                    let twice: Vec<Sample> = series.samples.iter().map(again).collect();
                    series.samples.extend(twice);
                }
            }
            Bug::Invents => {
                for series in &mut given.series {
                    let newest = series.samples.last().copied();
                    series.samples.extend(newest.map(|s| Sample::good(s.t + 0.5, s.value + 0.5)));
                }
            }
            Bug::LosesModel => given.rows.retain(|row| !matches!(row, Row::Model(_))),
            Bug::None | Bug::RaisesByItself | Bug::RaisesTagBad | Bug::TakesAnswerForNext => {}
        }
        Some(given)
    }
}

impl Writes for OnDisk {
    fn write(&mut self, batch: &Batch) -> Result<(), StoreError> {
        let fate = self.fate();
        let asked = self.asked(batch);
        let batch = &*asked;
        let given = self.given(batch);
        let write = |store: &mut Store| given.as_ref().map_or(Ok(()), |given| store.write(given));
        // With a bug that changes what is written, the truth is what was asked for.
        match fate {
            Fate::FailsBefore(error) => Err(error),
            Fate::Dies => {
                self.disk.lock().truth.doubt(batch);
                self.die_of(write);
                Err(failed())
            }
            Fate::FailsAfter => {
                self.disk.lock().truth.doubt(batch);
                write(&mut self.store)?;
                Err(failed())
            }
            Fate::Done => {
                let written = write(&mut self.store);
                let truth = &mut self.disk.lock().truth;
                match &written {
                    Ok(()) => truth.acknowledge(batch),
                    Err(_) => truth.doubt(batch),
                }
                written
            }
        }
    }

    fn tidy(&mut self, now: f64) -> Result<bool, StoreError> {
        match self.fate() {
            Fate::FailsBefore(error) => Err(error),
            Fate::Dies => {
                self.die_of(|store| store.tidy(now).map(|_| ()));
                Err(failed())
            }
            Fate::FailsAfter => {
                self.store.tidy(now)?;
                Err(failed())
            }
            Fate::Done => self.store.tidy(now),
        }
    }

    fn insert(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.store.insert(batch)
    }

    fn make_room(&mut self, _now: f64) -> Result<bool, StoreError> {
        // It is the disk that is full: giving room up would not help.
        Ok(false)
    }

    fn begin_era(&mut self) {
        self.store.begin_era();
    }

    fn era(&self) -> i64 {
        self.store.era()
    }

    fn usage(&self) -> Result<Usage, StoreError> {
        self.store.usage()
    }

    fn refused_and_damaged(&self) -> (u64, u64) {
        self.store.refused_and_damaged()
    }

    fn checked(&self) -> Option<f64> {
        self.store.checked()
    }

    fn spool(&self) -> Option<Spool> {
        self.store.spool()
    }

    fn found(&mut self) -> Option<Found> {
        self.store.found()
    }

    fn merged(&mut self) -> Result<(), StoreError> {
        self.store.merged()
    }

    fn disconnect(&mut self) {
        self.store.disconnect();
    }
}
