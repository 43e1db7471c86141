//! One store, two places it can be in: a folder, or PostgreSQL with a folder for what waits. What both do, and the names that
//! everybody else uses.

pub(super) use super::sides::Reads;
pub use super::sides::{Beat, Found, Point, Spool, StoredTag, Usage, Writes};
use super::walk::{between, last, over};
use super::{
    AlarmRow, Batch, Checked, Config, DiagnosisRow, ModelRow, StoreError, TagName, TransitionRow, codec,
    embedded, postgresql,
};
use crate::signal::Sample;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;

/// The store, open for writing. There is one writer at a time.
#[derive(Debug)]
pub struct Store(Box<dyn Writes>);

/// Opens the store of a configuration; told whether who opens it goes on to read it.
pub type Opener = Arc<dyn Fn(&Config, bool) -> Result<Store, StoreError> + Send + Sync>;

impl Store {
    /// A store on a disk of somebody else's.
    pub fn over(writes: impl Writes + 'static) -> Self {
        Self(Box::new(writes))
    }

    /// Opens the store, makes what is not there, and brings it to this version. One in PostgreSQL opens also while the
    /// database is away, on its spool.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        Self::opened(config, true)
    }

    /// As [`Store::open`], for who does not read it after that: what a database elsewhere has and is not known here is found.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn reopen(config: &Config) -> Result<Self, StoreError> {
        Self::opened(config, false)
    }

    pub(super) fn opened(config: &Config, is_read: bool) -> Result<Self, StoreError> {
        Ok(Self(match config.url {
            None => Box::new(embedded::Store::open(config)?),
            Some(_) => Box::new(postgresql::Store::open(config, is_read)?),
        }))
    }

    /// As the daemon opens it, which goes on to collect: a folder that waited for a database elsewhere is a store of its own from then
    /// on. Tools leave it what it is.
    pub(super) fn taken_over(config: &Config, is_read: bool) -> Result<Self, StoreError> {
        if config.url.is_some() {
            return Self::opened(config, is_read);
        }
        let mut own = embedded::Store::open(config)?;
        own.forget_base()?;
        Ok(Self(Box::new(own)))
    }

    /// Makes a batch durable: when this returns it is on disk, whole.
    ///
    /// # Errors
    /// [`StoreError`]; then nothing of it counts as written, and it may be written again.
    pub fn write(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.0.write(batch)
    }

    /// Puts recorded history into its place at once; durable when this returns.
    ///
    /// # Errors
    /// [`StoreError`]; then nothing of it is there.
    pub fn insert(&mut self, batch: &Batch) -> Result<(), StoreError> {
        self.0.insert(batch)
    }

    /// Does what is due at `now` (s): puts what is new where it belongs, delivers what waits, thins what is old. True when
    /// there is more to do.
    ///
    /// # Errors
    /// [`StoreError`]; nothing is lost by it.
    pub fn tidy(&mut self, now: f64) -> Result<bool, StoreError> {
        self.0.tidy(now)
    }

    /// Gives room up that what is oldest takes, because a write has found none; true when there was any.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn make_room(&mut self, now: f64) -> Result<bool, StoreError> {
        self.0.make_room(now)
    }

    /// The clock was set back: what comes from now on is kept apart from what is there.
    pub fn begin_era(&mut self) {
        self.0.begin_era();
    }

    /// The era of what comes now.
    pub fn era(&self) -> i64 {
        self.0.era()
    }

    /// What the database takes.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn usage(&self) -> Result<Usage, StoreError> {
        self.0.usage()
    }

    /// Samples refused because no key holds their stamp, and blobs found damaged.
    pub fn refused_and_damaged(&self) -> (u64, u64) {
        self.0.refused_and_damaged()
    }

    /// Samples that were inserted at a time at which their tag had one, so that they do not count; `None` where a database elsewhere
    /// knows.
    pub fn twice(&self) -> Option<u64> {
        self.0.twice()
    }

    /// Seconds of samples that were thinned because of their age while the clock was more than a day ahead of the time by which
    /// age is measured: too early, if the clock was wrong.
    pub fn thinned_in_doubt_s(&self) -> u64 {
        self.0.thinned_in_doubt_s()
    }

    /// The share of its files in the folder that was compared with their checksums since it was opened (0..1); `None` once all
    /// of them were.
    pub fn checked(&self) -> Option<f64> {
        self.0.checked()
    }

    /// What waits for a database elsewhere; `None` for a store in a folder.
    pub fn spool(&self) -> Option<Spool> {
        self.0.spool()
    }

    /// What a database elsewhere was found to have, once: until it is [`Store::merged`] nothing there is replaced by what was
    /// made without it.
    pub fn found(&mut self) -> Option<Found> {
        self.0.found()
    }

    /// What was found is part of what has been written since, and is not found again.
    ///
    /// # Errors
    /// [`StoreError`]; then it is found again.
    pub fn merged(&mut self) -> Result<(), StoreError> {
        self.0.merged()
    }

    /// Has each answer of a database elsewhere told from now on.
    pub fn tell_answers(&mut self, to: Beat) {
        self.0.tell_answers(to);
    }

    /// Leaves a database elsewhere until it is needed: its connection is not to be dropped by another kind of thread.
    pub fn disconnect(&mut self) {
        self.0.disconnect();
    }
}

/// The store, open for reading; a writer may be at work beside it.
#[derive(Debug)]
pub struct Reader {
    main: Box<dyn Reads>,
    /// What waits for the database and is newer than what is there.
    spool: Option<embedded::Reader>,
}

impl Reader {
    /// Opens the store in a folder.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Foreign`], [`StoreError::TooNew`], [`StoreError::Database`].
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        Ok(Self { main: Box::new(embedded::Reader::open(folder)?), spool: None })
    }

    /// Opens the store that is configured, wherever it is.
    ///
    /// # Errors
    /// As [`Reader::open`], and [`StoreError::Away`].
    pub fn of(config: &Config) -> Result<Self, StoreError> {
        if config.url.is_none() {
            return Self::open(&config.folder);
        }
        let main = Box::new(postgresql::Reader::open(config)?);
        Ok(Self { main, spool: embedded::Reader::open(&config.folder).ok() })
    }

    /// As [`Reader::of`], after looking at all of a store in a folder: where it is damaged what is left of it.
    ///
    /// # Errors
    /// As [`Reader::of`].
    pub fn looked_at(config: &Config) -> Result<Self, StoreError> {
        if config.url.is_some() {
            return Self::of(config);
        }
        Ok(Self { main: Box::new(embedded::Reader::looked_at(&config.folder)?), spool: None })
    }

    /// What was lost of a store that is damaged.
    pub(super) fn loss(&self) -> Option<&embedded::Loss> {
        self.main.loss()
    }

    /// What was lost in one line, and how many states; `None` of a store that is whole.
    pub fn lost(&self) -> Option<(String, u64)> {
        self.loss().map(|loss| (loss.to_string(), loss.states))
    }

    /// Opens what is at hand of the store that is configured: while its database is away, what waits for it.
    ///
    /// # Errors
    /// As [`Reader::of`].
    pub fn at_hand(config: &Config) -> Result<Self, StoreError> {
        Self::of(config).or_else(|error| match error {
            StoreError::Away(_) => Self::open(&config.folder).map_err(|_| error),
            error => Err(error),
        })
    }

    /// Tags that are best asked for together, which bounds the memory it takes.
    pub fn together(config: &Config) -> usize {
        // PostgreSQL reads all tags of a time to find some.
        if config.url.is_some() { 1024 } else { 256 }
    }

    /// Blobs left out so far because their bytes were damaged.
    pub fn damaged(&self) -> u64 {
        self.main.damaged()
    }

    /// Every tag, by number.
    ///
    /// # Errors
    /// [`StoreError`], as everything below.
    pub fn tags(&self) -> Result<Vec<StoredTag>, StoreError> {
        self.main.tags()
    }

    /// Start of the first chunk at or after a time (s).
    pub fn next_start(&self, from: i64) -> Result<Option<i64>, StoreError> {
        self.main.next_start(from)
    }

    /// Start of the last chunk before a time (s).
    pub fn previous_start(&self, before: i64) -> Result<Option<i64>, StoreError> {
        self.main.previous_start(before)
    }

    /// The samples of one chunk of the wanted tags (all, when `None`; sorted), each tag's by time.
    pub fn chunk(
        &mut self,
        start: i64,
        wanted: Option<&[u32]>,
    ) -> Result<BTreeMap<u32, Vec<Sample>>, StoreError> {
        self.main.chunk(start, wanted)
    }

    /// The last `count` samples of each tag by name, by time: what a ring held. Samples of before the clock was set back
    /// count only as far as all of them are older than those of after.
    pub fn last(
        &mut self,
        names: &[TagName],
        count: usize,
    ) -> Result<HashMap<TagName, Vec<Sample>>, StoreError> {
        let mut found = last(self.main.as_mut(), names, count)?;
        if let Some(spool) = &mut self.spool {
            for (name, newer) in last(spool, names, count)? {
                let kept = found.entry(name).or_default();
                let newest = kept.last().map_or(f64::NEG_INFINITY, |sample| sample.t);
                kept.extend(newer.into_iter().filter(|sample| sample.t > newest));
                kept.drain(..kept.len().saturating_sub(count));
            }
        }
        Ok(found)
    }

    /// The samples of a tag between two stamps (s, inclusive), by time, whatever its source and era.
    pub fn between(
        &mut self,
        control_loop: &str,
        tag: &str,
        first: f64,
        last: f64,
    ) -> Result<Vec<Sample>, StoreError> {
        let mut found = between(self.main.as_mut(), control_loop, tag, [first, last])?;
        if let Some(spool) = &mut self.spool {
            found.extend(between(spool, control_loop, tag, [first, last])?);
        }
        codec::unique(&mut found);
        Ok(found)
    }

    /// The trends of one tag whose rows begin in `from..to` (s).
    pub fn trends(&mut self, tag: u32, from: i64, to: i64) -> Result<Vec<Point>, StoreError> {
        self.main.trends(tag, from, to)
    }

    /// Up to `limit` runs after the one with number `after`, each with its number and its report.
    pub fn diagnoses(&self, after: i64, limit: usize) -> Result<Vec<(i64, DiagnosisRow)>, StoreError> {
        self.main.diagnoses(after, limit)
    }

    /// The last runs of a loop, oldest first; whole are the latest that has a report, and the latest that says whether the valve
    /// sticks, the others are without report and without what they worked on.
    pub fn last_diagnoses(&self, control_loop: &str, count: usize) -> Result<Vec<DiagnosisRow>, StoreError> {
        self.main.last_diagnoses(control_loop, count)
    }

    /// What the run of a loop that ended then (s) worked on; `None` where that was not kept.
    pub fn basis(&self, control_loop: &str, finished: f64) -> Result<Option<Vec<u8>>, StoreError> {
        self.main.basis(control_loop, finished)
    }

    /// The present version of a loop's model.
    pub fn model(&self, control_loop: &str) -> Result<Option<ModelRow>, StoreError> {
        let waits = self.spool.as_ref().map(|spool| spool.model(control_loop)).transpose()?.flatten();
        let there = self.main.model(control_loop)?;
        Ok(there.into_iter().chain(waits).max_by_key(|model| model.version))
    }

    /// The state of every alarm, of loops and of collectors.
    pub fn alarms(&self) -> Result<Vec<AlarmRow>, StoreError> {
        let there = self.main.alarms()?;
        match &self.spool {
            Some(spool) => Ok(over(there, spool.written()?.1)),
            None => Ok(there),
        }
    }

    /// The state of an alarm.
    pub fn alarm(&self, control_loop: &str, kind: &str) -> Result<Option<AlarmRow>, StoreError> {
        let waits = self.spool.as_ref().map(embedded::Reader::written).transpose()?.unwrap_or_default().1;
        match waits.into_iter().find(|row| row.control_loop == control_loop && row.kind == kind) {
            None => self.main.alarm(control_loop, kind),
            waits => Ok(waits),
        }
    }

    /// The state of every alarm, and the present version of every model.
    pub fn states(&self) -> Result<Found, StoreError> {
        let alarms = self.alarms()?;
        let tagged = self.tags()?.into_iter().map(|tag| tag.name.control_loop);
        let loops: BTreeSet<String> =
            tagged.chain(alarms.iter().map(|row| row.control_loop.clone())).collect();
        let models = loops.iter().map(|own| self.model(own)).collect::<Result<Vec<_>, _>>()?;
        Ok(Found { models: models.into_iter().flatten().collect(), alarms })
    }

    /// The last `limit` things that happened to alarms, oldest first.
    pub fn last_transitions(&self, limit: usize) -> Result<Vec<TransitionRow>, StoreError> {
        self.main.last_transitions(limit)
    }

    /// Up to `limit` things that happened to alarms, after the one with number `after`, each with its number.
    pub fn transitions(&self, after: i64, limit: usize) -> Result<Vec<(i64, TransitionRow)>, StoreError> {
        self.main.transitions(after, limit)
    }

    pub(super) fn examine(&mut self, found: &mut Checked) -> Result<(), StoreError> {
        self.main.examine(found)
    }
}
