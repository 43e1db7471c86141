//! The writing side: batches in, chunks rolled.

use super::ledger::{self, Ledger};
use super::read::Reader;
use super::room::pages_of;
use super::second::{self, Second};
use super::{APPLICATION, DATABASE, LOCK, MAX_TAG, key, repair, retain, schema};
use crate::signal::Sample;
use crate::store::age::Age;
use crate::store::backend::{Reads, Writes};
use crate::store::rows::{AlarmRow, Batch, DiagnosisRow, ModelRow, Row, Series, TagName, TransitionRow};
use crate::store::{Config, StoreError, StoredTag, Usage, codec, start_of};
use rusqlite::config::DbConfig;
use rusqlite::hooks::Wal;
use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::{self, File, TryLockError};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Bytes of a page: large enough that a chunk of a minute leaves little of it empty.
pub(super) const PAGE_BYTES: u64 = 8192;
/// A chunk is rolled this long after its end (s), so that what comes a little late need not be merged.
const GRACE_S: f64 = 3.0;
/// Samples that are held open at most; more are rolled before their chunk is over.
const MAX_OPEN: usize = 4_000_000;

/// Samples of chunks that are not over, by start and tag.
pub(super) type Open = BTreeMap<i64, BTreeMap<u32, Vec<Sample>>>;

/// The store, open for writing. There is one writer at a time.
#[derive(Debug)]
pub struct Store {
    pub(super) db: Connection,
    pub(super) ledger: Arc<Mutex<Ledger>>,
    second: Second,
    /// When the log was carried over last.
    pub(super) carried: Instant,
    pub(super) config: Config,
    _lock: File,
    /// Tags of the present era.
    ids: HashMap<Arc<TagName>, u32>,
    pub(super) era: i64,
    pub(super) open: Open,
    pub(super) open_samples: usize,
    /// The chunk that the last roll stopped before.
    rolled: i64,
    /// When retention was last looked at (s).
    pub(super) retained: f64,
    pub(super) age: Age,
    /// Samples whose stamp no key holds, refused.
    pub(super) refused: u64,
    /// Samples that were inserted at a time at which their tag had one.
    twice: u64,
    /// Blobs that were found damaged.
    pub(super) damaged: u64,
    /// Samples that were thinned to nothing, because no trends are kept.
    pub(super) dropped: u64,
}

impl Store {
    /// Opens the store in a folder, which is made when it is not there, and brings it to this version.
    ///
    /// # Errors
    /// [`StoreError`].
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        let folder = &config.folder;
        fs::create_dir_all(folder).map_err(StoreError::io(folder))?;
        let lock = lock(folder)?;
        if let Some(aside) = repair::finish(folder)? {
            let aside = aside.display();
            tracing::warn!(%aside, "a repair of the store was interrupted, and is ended now");
        }
        let path = folder.join(DATABASE);
        let ledger = Arc::new(Mutex::new(Ledger::open(folder, config.upkeep)?));
        let mut db = Connection::open(&path)?;
        prepare(&db, config, &path)?;
        let own = ledger.clone();
        let told = move |_: &mut Wal, frames: i32| {
            // What cannot be noted is not missed at the next start; the data are on disk all the same.
            if let Err(error) = lock_of(&own).acknowledge(u32::try_from(frames).unwrap_or(0)) {
                tracing::warn!(%error, "the store's ledger cannot be written");
            }
            Ok(())
        };
        db.wal_hook(Some(told))?;
        schema::migrate(&mut db)?;
        // A new file is lost with its folder's entry.
        File::open(folder).and_then(|folder| folder.sync_all()).map_err(StoreError::io(folder))?;
        second::tell_lacking(folder);
        let second = second_of(folder, &ledger)?;
        let era = db.query_row("SELECT coalesce(max(era), 0) FROM tags", [], |row| row.get(0))?;
        let mut store = Self {
            db,
            ledger,
            second,
            carried: Instant::now(),
            config: config.clone(),
            _lock: lock,
            ids: HashMap::new(),
            era,
            open: Open::new(),
            open_samples: 0,
            rolled: 0,
            retained: f64::NEG_INFINITY,
            age: Age::of(config),
            refused: 0,
            twice: 0,
            damaged: 0,
            dropped: 0,
        };
        store.reopen_chunks()?;
        store.carry_over()?;
        Ok(store)
    }

    /// Puts states into their second copy too.
    pub(super) fn keep_twice(
        &mut self,
        tags: &[(Arc<TagName>, u32)],
        rows: &[Row],
    ) -> Result<(), StoreError> {
        let stored =
            |(name, id): &(Arc<TagName>, u32)| StoredTag { id: *id, name: (**name).clone(), era: self.era };
        let tags: Vec<StoredTag> = tags.iter().map(stored).collect();
        if self.second.add(&tags, rows.iter())?.is_some() {
            if self.second.is_large() {
                self.second = second_of(&self.config.folder, &self.ledger)?;
                return Ok(());
            }
            let told = lock_of(&self.ledger).acknowledge_states(self.second.records());
            told.map_err(StoreError::io(&self.config.folder))?;
        }
        Ok(())
    }

    /// What was open when the last writer ended, however it ended.
    fn reopen_chunks(&mut self) -> Result<(), StoreError> {
        let mut frames = self.db.prepare("SELECT start, frame FROM journal ORDER BY seq")?;
        let mut rows = frames.query([])?;
        while let Some(row) = rows.next()? {
            let start: i64 = row.get(0)?;
            match codec::decode_frame(row.get_ref(1)?.as_blob().unwrap_or_default()) {
                Some(samples) => {
                    self.open_samples += samples.len();
                    hold(&mut self.open, start, samples);
                }
                // What is left is read by another way, and told.
                None => {
                    let why = format!("the journal of chunk {start}: the bytes are damaged");
                    ledger::mark(&self.config.folder, &why);
                    return Err(StoreError::Damaged(why));
                }
            }
        }
        Ok(())
    }

    /// Moves one chunk of every tag from the journal to its place.
    fn roll(&mut self, start: i64) -> Result<(), StoreError> {
        let Some(tags) = self.open.get_mut(&start) else { return Ok(()) };
        let rolling = self.db.transaction_with_behavior(TransactionBehavior::Immediate)?;
        // First what goes: a database that is full has its pages for what comes.
        rolling.execute("DELETE FROM journal WHERE start = ?1", [start])?;
        for (&tag, samples) in tags.iter() {
            merge(&rolling, start, tag, samples)
                .inspect_err(|error| self.damaged += u64::from(error.is_damage()))?;
        }
        rolling.commit()?;
        let gone = self.open.remove(&start).unwrap_or_default();
        self.open_samples = self.open_samples.saturating_sub(gone.values().map(Vec::len).sum());
        Ok(())
    }
}

pub(super) fn lock_of(ledger: &Mutex<Ledger>) -> MutexGuard<'_, Ledger> {
    ledger.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The second copy, made of what the database holds. While it takes the place of another none of its records counts as
/// acknowledged: so a crash meanwhile is no damage.
fn second_of(folder: &Path, ledger: &Mutex<Ledger>) -> Result<Second, StoreError> {
    let reader = Reader::as_it_is(folder)?;
    let models = reader.known()?.0.into_iter().chain(reader.written()?.0).map(Row::Model);
    let changes = reader.last_transitions(second::CHANGES)?.into_iter().map(Row::Transition);
    let alarms = reader.alarms()?.into_iter().map(Row::Alarm);
    let rows: Vec<Row> = models.chain(changes).chain(alarms).collect();
    let tags = reader.tags()?;
    lock_of(ledger).retract_states().map_err(StoreError::io(folder))?;
    let second = Second::begin(folder, &tags, rows.iter())?;
    lock_of(ledger).acknowledge_states(second.records()).map_err(StoreError::io(folder))?;
    Ok(second)
}

impl Writes for Store {
    fn write(&mut self, batch: &Batch) -> Result<(), StoreError> {
        let chunk_s = self.config.chunk_s;
        let mut refused = 0;
        let mut parts: BTreeMap<i64, Vec<(u32, Sample)>> = BTreeMap::new();
        let taking = self.db.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let mut news = Vec::new();
        for series in batch.series.iter().filter(|series| !series.samples.is_empty()) {
            let id = tag_id(&taking, &self.ids, &mut news, &series.tag, self.era)?;
            for &sample in &series.samples {
                match start_of(sample.t, chunk_s) {
                    Some(start) => parts.entry(start).or_default().push((id, sample)),
                    None => refused += 1,
                }
            }
        }
        {
            let mut journal = taking.prepare_cached("INSERT INTO journal (start, frame) VALUES (?1, ?2)")?;
            for (start, samples) in &parts {
                for part in samples.chunks(codec::MAX_SAMPLES) {
                    journal.execute(params![start, codec::encode_frame(part)])?;
                }
            }
        }
        batch.rows.iter().try_for_each(|row| put_row(&taking, row))?;
        taking.commit()?;
        self.keep_twice(&news, &batch.rows)?;
        self.ids.extend(news);
        self.refused += refused;
        for (start, samples) in parts {
            self.open_samples += samples.len();
            hold(&mut self.open, start, samples);
        }
        // Of a folder that is gone the files that are open take everything, and nothing of it is durable.
        lock_of(&self.ledger).is_there()
    }

    fn tidy(&mut self, now: f64) -> Result<bool, StoreError> {
        let chunk_s = i64::from(self.config.chunk_s);
        let current = start_of((now - GRACE_S).max(0.0), self.config.chunk_s).unwrap_or(0);
        if current != self.rolled || self.open_samples > MAX_OPEN {
            // The chunk that is filled now, and the one that may have begun, stay open.
            let filled = current..=current + chunk_s;
            let over = |start: &i64| self.open_samples > MAX_OPEN || !filled.contains(start);
            let due: Vec<i64> = self.open.keys().copied().filter(over).collect();
            for start in due {
                self.roll(start)?;
            }
            self.rolled = current;
        }
        self.carry_over_when_due()?;
        retain::step(self, now)
    }

    fn insert(&mut self, batch: &Batch) -> Result<(), StoreError> {
        let (chunk_s, mut refused, mut twice) = (self.config.chunk_s, 0, 0);
        let putting = self.db.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let mut news = Vec::new();
        let mut chunks = Open::new();
        for Series { tag, samples } in &batch.series {
            let id = tag_id(&putting, &self.ids, &mut news, tag, self.era)?;
            for &sample in samples {
                match start_of(sample.t, chunk_s) {
                    Some(start) => hold(&mut chunks, start, vec![(id, sample)]),
                    None => refused += 1,
                }
            }
        }
        for (start, tags) in &chunks {
            for (&tag, samples) in tags {
                twice += merge(&putting, *start, tag, samples)
                    .inspect_err(|error| self.damaged += u64::from(error.is_damage()))?;
            }
        }
        batch.rows.iter().try_for_each(|row| put_row(&putting, row))?;
        putting.commit()?;
        self.keep_twice(&news, &batch.rows)?;
        self.ids.extend(news);
        self.refused += refused;
        self.twice += twice;
        lock_of(&self.ledger).is_there()
    }

    fn make_room(&mut self, now: f64) -> Result<bool, StoreError> {
        retain::make_room(self, now)
    }

    fn begin_era(&mut self) {
        self.era += 1;
        self.ids.clear();
    }

    fn era(&self) -> i64 {
        self.era
    }

    fn usage(&self) -> Result<Usage, StoreError> {
        let number = |name: &str| self.db.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
        let page = number("page_size")?.max(0) as u64;
        let (pages, free) = (number("page_count")?.max(0) as u64, number("freelist_count")?.max(0) as u64);
        Ok(Usage {
            used_bytes: pages.saturating_sub(free) * page,
            file_bytes: pages * page,
            max_bytes: self.config.max_mb * 1_000_000,
        })
    }

    fn refused_and_damaged(&self) -> (u64, u64) {
        (self.refused, self.damaged)
    }

    fn twice(&self) -> Option<u64> {
        Some(self.twice)
    }

    fn thinned_in_doubt_s(&self) -> u64 {
        self.age.in_doubt_s()
    }

    fn checked(&self) -> Option<f64> {
        lock_of(&self.ledger).checked()
    }
}

pub(super) fn lock(folder: &Path) -> Result<File, StoreError> {
    let path = folder.join(LOCK);
    let file = File::create(&path).map_err(StoreError::io(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse(folder.to_path_buf())),
        Err(TryLockError::Error(error)) => Err(StoreError::io(&path)(error)),
    }
}

/// Whether somebody writes to a store.
pub(super) fn is_in_use(folder: &Path) -> bool {
    File::open(folder.join(LOCK)).is_ok_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
}

fn prepare(db: &Connection, config: &Config, path: &Path) -> Result<(), StoreError> {
    db.busy_timeout(Duration::from_secs(5))?;
    let application: i64 = db.pragma_query_value(None, "application_id", |row| row.get(0))?;
    let tables: i64 = db.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
    if application != APPLICATION && (application != 0 || tables > 0) {
        return Err(StoreError::Foreign(path.to_path_buf()));
    }
    if tables == 0 {
        db.pragma_update(None, "page_size", PAGE_BYTES as i64)?;
        db.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
        db.pragma_update(None, "application_id", APPLICATION)?;
    }
    db.pragma_update(None, "journal_mode", "WAL")?;
    // FULL: a commit returns when the log is on disk, so that what was acknowledged survives a power failure.
    db.pragma_update(None, "synchronous", "FULL")?;
    // Carried over by us alone, who note what every page is then.
    db.pragma_update(None, "wal_autocheckpoint", 0)?;
    db.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
    let log_bytes = 2 * u64::from(config.upkeep.log) * PAGE_BYTES;
    db.pragma_update(None, "journal_size_limit", log_bytes as i64)?;
    db.pragma_update(None, "cache_size", -16_384)?;
    db.pragma_update(None, "max_page_count", pages_of(config.max_mb))?;
    db.set_prepared_statement_cache_capacity(64);
    Ok(())
}

/// A database with the pages of this store's, and nothing in it yet.
pub(super) fn fresh(path: &Path) -> Result<Connection, StoreError> {
    let db = Connection::open(path)?;
    db.pragma_update(None, "page_size", PAGE_BYTES as i64)?;
    db.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
    db.pragma_update(None, "application_id", APPLICATION)?;
    Ok(db)
}

fn hold(open: &mut Open, start: i64, samples: Vec<(u32, Sample)>) {
    let tags = open.entry(start).or_default();
    for (tag, sample) in samples {
        tags.entry(tag).or_default().push(sample);
    }
}

/// The number of a tag, which is made when it is new; 0 is none.
fn tag_id(
    db: &Transaction<'_>,
    known: &HashMap<Arc<TagName>, u32>,
    news: &mut Vec<(Arc<TagName>, u32)>,
    tag: &Arc<TagName>,
    era: i64,
) -> Result<u32, StoreError> {
    if let Some(&id) = known.get(tag) {
        return Ok(id);
    }
    db.prepare_cached(
        "INSERT INTO tags (control_loop, tag, source, era, unit) VALUES (?1, ?2, ?3, ?4, ?5)
         ON CONFLICT DO UPDATE SET unit = excluded.unit",
    )?
    .execute(params![tag.control_loop, tag.tag, tag.source, era, tag.unit])?;
    let id: i64 = db
        .prepare_cached(
            "SELECT id FROM tags WHERE control_loop = ?1 AND tag = ?2 AND source = ?3 AND era = ?4",
        )?
        .query_row(params![tag.control_loop, tag.tag, tag.source, era], |row| row.get(0))?;
    let id = u32::try_from(id).ok().filter(|id| *id <= MAX_TAG).ok_or(StoreError::TooManyTags)?;
    news.push((tag.clone(), id));
    Ok(id)
}

/// Puts samples of one tag into their chunk, beside those that are there. A chunk that is damaged is not written over: nobody
/// would ever know of it. How many of them have the time of another, and do not count.
pub(super) fn merge(
    db: &Transaction<'_>,
    start: i64,
    tag: u32,
    samples: &[Sample],
) -> Result<u64, StoreError> {
    let key = key(start, tag);
    let there: Option<Vec<u8>> = db
        .prepare_cached("SELECT samples FROM chunks WHERE key = ?1")?
        .query_row([key], |row| row.get(0))
        .optional()?;
    let mut all = match there.as_deref() {
        None => Vec::new(),
        Some(blob) => codec::decode(blob).ok_or_else(|| damaged(start, tag))?,
    };
    let bad: HashSet<u64> =
        all.iter().filter(|own| !own.quality.is_good()).map(|own| own.t.to_bits()).collect();
    all.extend_from_slice(samples);
    let count = all.len();
    codec::unique(&mut all);
    let is_in_place = |own: &&Sample| own.quality.is_good() && bad.contains(&own.t.to_bits());
    let twice = (count - all.len() - all.iter().filter(is_in_place).count()) as u64;
    all.truncate(codec::MAX_SAMPLES);
    db.prepare_cached("INSERT OR REPLACE INTO chunks (key, samples) VALUES (?1, ?2)")?
        .execute(params![key, codec::encode(&all)])?;
    Ok(twice)
}

/// A chunk whose bytes are not what was written.
pub(super) fn damaged(start: i64, tag: u32) -> StoreError {
    StoreError::Damaged(format!("chunk {start} of tag {tag}: the bytes are damaged"))
}

pub(super) fn put_row(db: &Transaction<'_>, row: &Row) -> Result<(), StoreError> {
    match row {
        Row::Diagnosis(row) => put_diagnosis(db, row),
        Row::Model(ModelRow { control_loop, version, since, effects }) => {
            let version = i64::try_from(*version).unwrap_or(i64::MAX);
            db.prepare_cached(
                "INSERT OR IGNORE INTO models (control_loop, version, since, effects) VALUES (?1, ?2, ?3, ?4)",
            )?
            .execute(params![control_loop, version, since, effects])?;
            Ok(())
        }
        Row::Alarm(row) => put_alarm(db, "alarms", row),
        Row::Transition(row) => {
            let TransitionRow { control_loop, kind, at, before, after, cause, priority, detail, by, comment } =
                row;
            db.prepare_cached(
                "INSERT OR IGNORE INTO transitions (control_loop, kind, at, before, after, cause, priority, detail,
                    by_whom, comment) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)",
            )?
            .execute(params![control_loop, kind, at, before, after, cause, priority, detail, by, comment])?;
            Ok(())
        }
    }
}

fn put_diagnosis(db: &Transaction<'_>, row: &DiagnosisRow) -> Result<(), StoreError> {
    db.prepare_cached(
        "INSERT OR IGNORE INTO diagnoses (control_loop, finished, took_s, on_demand, outcome, reason_code, reason,
            f, f_low, f_high, f_in_percent, delta_aic, version, report, basis)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15)",
    )?
    .execute(params![
        row.control_loop,
        row.finished,
        // NaN is NULL to the database, and a row that it refuses would hold up all that come after.
        if row.took_s.is_finite() { row.took_s } else { 0.0 },
        row.on_demand,
        row.outcome,
        row.reason_code,
        row.reason,
        row.f,
        row.f_ci95.map(|[low, _]| low),
        row.f_ci95.map(|[_, high]| high),
        row.f_in_percent,
        row.delta_aic,
        row.version,
        row.report,
        row.basis,
    ])?;
    Ok(())
}

pub(super) fn put_alarm(db: &Transaction<'_>, table: &str, row: &AlarmRow) -> Result<(), StoreError> {
    db.prepare_cached(&format!(
        "INSERT OR REPLACE INTO {table} (control_loop, kind, active, acknowledged, latched, shelved_until, one_shot,
            suppressed, out_of_service, votes, pending, raises, priority, trend, since, raised_at, detail, by_whom, comment)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, ?19)"
    ))?
    .execute(params![
        row.control_loop,
        row.kind,
        row.active,
        row.acknowledged,
        row.latched,
        row.shelved_until,
        row.one_shot,
        row.suppressed,
        row.out_of_service,
        row.votes,
        row.pending,
        row.raises,
        row.priority,
        row.trend,
        row.since,
        row.raised_at,
        row.detail,
        row.by,
        row.comment,
    ])?;
    Ok(())
}
