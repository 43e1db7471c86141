//! The two sides of every store, writing and reading, and the values that go through them.

use super::{AlarmRow, Batch, Checked, DiagnosisRow, ModelRow, StoreError, TagName, TransitionRow, embedded};
#[cfg(doc)]
use super::{Reader, Store};
use crate::signal::Sample;
use std::collections::BTreeMap;
use std::fmt::{self, Debug};
use std::sync::Arc;

/// A tag as it is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredTag {
    /// Its number.
    pub id: u32,
    /// Its name.
    pub name: TagName,
    /// Counts how often the clock was set back before its samples were stamped.
    pub era: i64,
}

/// One point of a trend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Beginning of the time it stands for (s).
    pub t: f64,
    /// Least good value; NaN when there was none.
    pub least: f64,
    /// Mean of the good values.
    pub mean: f64,
    /// Largest good value.
    pub most: f64,
}

/// What the database takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Bytes in use.
    pub used_bytes: u64,
    /// Bytes of the file: those in use, and those that were and will be again.
    pub file_bytes: u64,
    /// Bytes it may take.
    pub max_bytes: u64,
}

/// What waits for a database that is away, or was until now.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spool {
    /// Why the database is not reached; `None` while it is, and takes what waits.
    pub away: Option<String>,
    /// Whether anything waits.
    pub waits: bool,
    /// Bytes that the spool takes, its log with it.
    pub bytes: u64,
    /// Samples that were dropped because the spool was full.
    pub dropped: u64,
    /// Samples delivered from it.
    pub delivered: u64,
}

/// What a database elsewhere says of alarms and models, and nobody here knew: what there is now was made without it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// The latest version of each model.
    pub models: Vec<ModelRow>,
    /// States of alarms.
    pub alarms: Vec<AlarmRow>,
}

/// Hears each answer of a database elsewhere: work that is answered does not hang, however long all of it lasts.
#[derive(Clone)]
pub struct Beat(Arc<dyn Fn() + Send + Sync>);

impl Beat {
    /// One that calls `heard` at each answer.
    pub fn new(heard: impl Fn() + Send + Sync + 'static) -> Self {
        Self(Arc::new(heard))
    }

    /// An answer has come.
    pub fn heard(&self) {
        (self.0)();
    }
}

impl Default for Beat {
    fn default() -> Self {
        Self::new(|| ())
    }
}

impl Debug for Beat {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Beat")
    }
}

/// The writing side of a store: one of ours, or what a simulated disk makes of it. See [`Store`] for what each promises.
pub trait Writes: Send + Debug {
    /// See [`Store::write`].
    fn write(&mut self, batch: &Batch) -> Result<(), StoreError>;
    /// See [`Store::insert`].
    fn insert(&mut self, batch: &Batch) -> Result<(), StoreError>;
    /// See [`Store::tidy`].
    fn tidy(&mut self, now: f64) -> Result<bool, StoreError>;
    /// See [`Store::make_room`].
    fn make_room(&mut self, now: f64) -> Result<bool, StoreError>;
    /// See [`Store::begin_era`].
    fn begin_era(&mut self);
    /// See [`Store::era`].
    fn era(&self) -> i64;
    /// See [`Store::usage`].
    fn usage(&self) -> Result<Usage, StoreError>;
    /// See [`Store::refused_and_damaged`].
    fn refused_and_damaged(&self) -> (u64, u64);
    /// See [`Store::twice`].
    fn twice(&self) -> Option<u64> {
        None
    }
    /// See [`Store::thinned_in_doubt_s`].
    fn thinned_in_doubt_s(&self) -> u64 {
        0
    }
    /// See [`Store::checked`].
    fn checked(&self) -> Option<f64> {
        None
    }
    /// See [`Store::spool`].
    fn spool(&self) -> Option<Spool> {
        None
    }
    /// See [`Store::found`].
    fn found(&mut self) -> Option<Found> {
        None
    }
    /// See [`Store::merged`].
    fn merged(&mut self) -> Result<(), StoreError> {
        Ok(())
    }
    /// See [`Store::tell_answers`].
    fn tell_answers(&mut self, _to: Beat) {}
    /// See [`Store::disconnect`].
    fn disconnect(&mut self) {}
}

/// The reading side. See [`Reader`] for what each says.
pub(super) trait Reads: Send + Debug {
    fn damaged(&self) -> u64;
    fn tags(&self) -> Result<Vec<StoredTag>, StoreError>;
    fn next_start(&self, from: i64) -> Result<Option<i64>, StoreError>;
    fn previous_start(&self, before: i64) -> Result<Option<i64>, StoreError>;
    fn chunk(&mut self, start: i64, wanted: Option<&[u32]>)
    -> Result<BTreeMap<u32, Vec<Sample>>, StoreError>;
    fn trends(&mut self, tag: u32, from: i64, to: i64) -> Result<Vec<Point>, StoreError>;
    fn diagnoses(&self, after: i64, limit: usize) -> Result<Vec<(i64, DiagnosisRow)>, StoreError>;
    fn last_diagnoses(&self, control_loop: &str, count: usize) -> Result<Vec<DiagnosisRow>, StoreError>;
    fn basis(&self, control_loop: &str, finished: f64) -> Result<Option<Vec<u8>>, StoreError>;
    fn model(&self, control_loop: &str) -> Result<Option<ModelRow>, StoreError>;
    fn alarms(&self) -> Result<Vec<AlarmRow>, StoreError>;
    fn alarm(&self, control_loop: &str, kind: &str) -> Result<Option<AlarmRow>, StoreError>;
    fn last_transitions(&self, limit: usize) -> Result<Vec<TransitionRow>, StoreError>;
    fn transitions(&self, after: i64, limit: usize) -> Result<Vec<(i64, TransitionRow)>, StoreError>;
    fn examine(&mut self, found: &mut Checked) -> Result<(), StoreError>;
    fn loss(&self) -> Option<&embedded::Loss> {
        None
    }
}
