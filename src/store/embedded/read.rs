//! The reading side: beside the writer, chunk by chunk, so that memory and the time a snapshot is held stay small.

use super::ledger::{self, Damage};
use super::left::{self, Left};
use super::salvage::Loss;
use super::{APPLICATION, DATABASE, MAX_TAG, TREND_SPAN, key, repair, schema, start_and_tag, write};
use crate::signal::Sample;
use crate::store::backend::Reads;
use crate::store::rows::{AlarmRow, DiagnosisRow, ModelRow, TagName, TransitionRow, put_whole};
use crate::store::walk::over;
use crate::store::{Checked, Point, StoreError, StoredTag, codec};
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, params};
use std::collections::BTreeMap;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::{Arc, MutexGuard};
use std::time::Duration;

/// Rows that are read through sooner than one is looked up.
const NEAR: usize = 8;

/// The store, open for reading; a writer may be at work beside it.
#[derive(Debug)]
pub struct Reader {
    db: Database,
    damaged: u64,
    /// The column of what a run worked on, which a store that was not opened since for writing lacks.
    basis: &'static str,
    /// Whether it may hold states that another store is known to have.
    knows: bool,
}

/// What is read.
#[derive(Debug)]
enum Database {
    /// The database of a store.
    Own(Box<Connection>),
    /// What is left of one that is damaged.
    Left(Arc<Left>),
}

/// The database for one question: nobody else asks what is left of a store meanwhile, so none is asked within another.
pub(super) enum Asked<'d> {
    Own(&'d Connection),
    Left(MutexGuard<'d, Connection>),
}

impl Deref for Asked<'_> {
    type Target = Connection;

    fn deref(&self) -> &Connection {
        match self {
            Self::Own(db) => db,
            Self::Left(db) => db,
        }
    }
}

impl Reader {
    /// Opens the store in a folder; of one that is damaged, what is left of it.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Foreign`], [`StoreError::TooNew`], [`StoreError::Database`]; [`StoreError::InUse`]
    /// while somebody ends a repair.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        if let Some(repaired) = repair::unfinished(folder) {
            // Whoever holds the lock puts it into its place: a reader would outlive that.
            if write::is_in_use(folder) {
                return Err(StoreError::InUse(folder.to_path_buf()));
            }
            let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI;
            let db = Connection::open_with_flags(repair::unchanging(&repaired), flags)?;
            return Self::on(db, repaired);
        }
        if ledger::marked(folder).is_some() {
            return Self::of_what_is_left(folder);
        }
        left::forget(folder);
        Self::as_it_is(folder)
    }

    /// Opens the store in a folder after looking at all of it; where it is damaged what is left of it.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub fn looked_at(folder: &Path) -> Result<Self, StoreError> {
        let is_there = folder.join(DATABASE).is_file();
        let is_begun = repair::unfinished(folder).is_some();
        if is_begun || is_there && ledger::examine_beside(folder)? == Damage::default() {
            return Self::open(folder);
        }
        if is_there || ledger::marked(folder).is_some() {
            return Self::of_what_is_left(folder);
        }
        Err(StoreError::Missing(folder.to_path_buf()))
    }

    fn of_what_is_left(folder: &Path) -> Result<Self, StoreError> {
        let left = left::of(folder)?;
        let damaged = left.loss().blobs;
        Ok(Self { db: Database::Left(left), damaged, basis: "basis", knows: true })
    }

    /// Opens the database as SQLite reads it.
    ///
    /// # Errors
    /// As [`Reader::open`].
    pub(super) fn as_it_is(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(DATABASE);
        if !path.is_file() {
            return Err(StoreError::Missing(folder.to_path_buf()));
        }
        let db = Connection::open_with_flags(&path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
        Self::on(db, path)
    }

    fn on(db: Connection, path: PathBuf) -> Result<Self, StoreError> {
        db.busy_timeout(Duration::from_secs(5))?;
        let application: i64 = db.pragma_query_value(None, "application_id", |row| row.get(0))?;
        if application != APPLICATION {
            return Err(StoreError::Foreign(path));
        }
        let version = schema::version(&db)?;
        let basis = if version >= 2 { "basis" } else { "NULL AS basis" };
        db.set_prepared_statement_cache_capacity(32);
        Ok(Self { db: Database::Own(Box::new(db)), damaged: 0, basis, knows: version >= 5 })
    }

    pub(super) fn database(&self) -> Asked<'_> {
        match &self.db {
            Database::Own(db) => Asked::Own(db),
            Database::Left(left) => Asked::Left(left.database()),
        }
    }

    /// The models and states of alarms that were written here: of a spool, those that wait.
    pub fn written(&self) -> Result<(Vec<ModelRow>, Vec<AlarmRow>), StoreError> {
        Ok((self.models_in("models")?, self.alarms_in("alarms")?))
    }

    /// The models and states of alarms that the store which this one waits for is known to have.
    pub fn known(&self) -> Result<(Vec<ModelRow>, Vec<AlarmRow>), StoreError> {
        if !self.knows {
            return Ok(Default::default());
        }
        Ok((self.models_in("known_models")?, self.alarms_in("known_alarms")?))
    }

    fn alarms_in(&self, table: &str) -> Result<Vec<AlarmRow>, StoreError> {
        let db = self.database();
        let mut query = db.prepare_cached(&format!("SELECT * FROM {table} ORDER BY control_loop, kind"))?;
        let rows = query.query_map([], alarm)?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    fn models_in(&self, table: &str) -> Result<Vec<ModelRow>, StoreError> {
        let sql = format!(
            "SELECT control_loop, version, since, effects FROM {table} ORDER BY control_loop, version"
        );
        let db = self.database();
        let mut query = db.prepare_cached(&sql)?;
        let rows = query.query_map([], |row| {
            Ok(ModelRow {
                control_loop: row.get(0)?,
                version: row.get::<_, i64>(1)?.max(0) as u64,
                since: row.get(2)?,
                effects: row.get(3)?,
            })
        })?;
        Ok(rows.collect::<Result<_, _>>()?)
    }
}

impl Reads for Reader {
    fn damaged(&self) -> u64 {
        self.damaged
    }

    fn tags(&self) -> Result<Vec<StoredTag>, StoreError> {
        let db = self.database();
        let mut query =
            db.prepare_cached("SELECT id, control_loop, tag, source, unit, era FROM tags ORDER BY id")?;
        let tags = query.query_map([], |row| {
            let name = TagName {
                control_loop: row.get(1)?,
                tag: row.get(2)?,
                source: row.get(3)?,
                unit: row.get(4)?,
            };
            Ok(StoredTag { id: row.get(0)?, name, era: row.get(5)? })
        })?;
        Ok(tags.collect::<Result<_, _>>()?)
    }

    fn next_start(&self, from: i64) -> Result<Option<i64>, StoreError> {
        let db = self.database();
        let chunk: Option<i64> = db
            .prepare_cached("SELECT min(key) FROM chunks WHERE key >= ?1")?
            .query_row([key(from.max(0), 0)], |row| row.get(0))?;
        let open: Option<i64> = db
            .prepare_cached("SELECT min(start) FROM journal WHERE start >= ?1")?
            .query_row([from], |row| row.get(0))?;
        Ok(chunk.map(|key| start_and_tag(key).0).into_iter().chain(open).min())
    }

    fn previous_start(&self, before: i64) -> Result<Option<i64>, StoreError> {
        let db = self.database();
        let chunk: Option<i64> = db
            .prepare_cached("SELECT max(key) FROM chunks WHERE key < ?1")?
            .query_row([before.checked_mul(1 << 24).unwrap_or(i64::MAX)], |row| row.get(0))?;
        let open: Option<i64> = db
            .prepare_cached("SELECT max(start) FROM journal WHERE start < ?1")?
            .query_row([before], |row| row.get(0))?;
        Ok(chunk.map(|key| start_and_tag(key).0).into_iter().chain(open).max())
    }

    fn chunk(
        &mut self,
        start: i64,
        wanted: Option<&[u32]>,
    ) -> Result<BTreeMap<u32, Vec<Sample>>, StoreError> {
        let mut damaged = 0;
        // One snapshot, so that a roll in between neither hides nor doubles a sample.
        let db = self.database();
        let snapshot = db.unchecked_transaction()?;
        let mut found: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
        let mut take = |tag: u32, blob: &[u8]| match codec::decode(blob) {
            Some(samples) => found.entry(tag).or_default().extend(samples),
            None => damaged += 1,
        };
        match wanted {
            Some(few) if is_scattered(few) => {
                let mut one = snapshot.prepare_cached("SELECT samples FROM chunks WHERE key = ?1")?;
                for &tag in few {
                    let blob = one.query_row([key(start, tag)], |row| row.get::<_, Vec<u8>>(0)).optional()?;
                    blob.iter().for_each(|blob| take(tag, blob));
                }
            }
            _ => {
                let mut all =
                    snapshot.prepare_cached("SELECT key, samples FROM chunks WHERE key BETWEEN ?1 AND ?2")?;
                let ends = wanted.and_then(|wanted| Some((*wanted.first()?, *wanted.last()?)));
                let (first, last) = ends.unwrap_or((0, MAX_TAG));
                let mut rows = all.query([key(start, first), key(start, last)])?;
                while let Some(row) = rows.next()? {
                    let tag = start_and_tag(row.get(0)?).1;
                    if wanted.is_none_or(|wanted| wanted.binary_search(&tag).is_ok()) {
                        take(tag, row.get_ref(1)?.as_blob().unwrap_or_default());
                    }
                }
            }
        }
        {
            let mut open =
                snapshot.prepare_cached("SELECT frame FROM journal WHERE start = ?1 ORDER BY seq")?;
            let mut rows = open.query([start])?;
            while let Some(row) = rows.next()? {
                let Some(frame) = codec::decode_frame(row.get_ref(0)?.as_blob().unwrap_or_default()) else {
                    damaged += 1;
                    continue;
                };
                for (tag, sample) in frame {
                    if wanted.is_none_or(|wanted| wanted.binary_search(&tag).is_ok()) {
                        found.entry(tag).or_default().push(sample);
                    }
                }
            }
        }
        drop(snapshot);
        drop(db);
        self.damaged += damaged;
        found.values_mut().for_each(codec::unique);
        Ok(found)
    }

    fn trends(&mut self, tag: u32, from: i64, to: i64) -> Result<Vec<Point>, StoreError> {
        let mut points = Vec::new();
        let mut start = from.max(0).div_euclid(TREND_SPAN) * TREND_SPAN;
        while start < to {
            // The next row of any tag says where there is something at all.
            let next: Option<i64> = self
                .database()
                .prepare_cached("SELECT min(key) FROM trends WHERE key >= ?1")?
                .query_row([key(start, tag)], |row| row.get(0))?;
            let Some((found, other)) = next.map(start_and_tag) else { break };
            if other == tag && found < to {
                let blob: Vec<u8> = self
                    .database()
                    .prepare_cached("SELECT points FROM trends WHERE key = ?1")?
                    .query_row([key(found, tag)], |row| row.get(0))?;
                match decode_points(&blob) {
                    Some(more) => points.extend(more),
                    None => self.damaged += 1,
                }
            }
            start = if other < tag { found } else { found + TREND_SPAN };
        }
        Ok(points)
    }

    fn diagnoses(&self, after: i64, limit: usize) -> Result<Vec<(i64, DiagnosisRow)>, StoreError> {
        let basis = self.basis;
        let sql = format!(
            "SELECT {DIAGNOSIS}, report, {basis}, id FROM diagnoses WHERE id > ?1 ORDER BY id LIMIT ?2"
        );
        let db = self.database();
        let mut query = db.prepare_cached(&sql)?;
        let rows = query.query_map(params![after, limit as i64], |row| {
            Ok((
                row.get("id")?,
                DiagnosisRow { report: row.get("report")?, basis: row.get("basis")?, ..diagnosis(row)? },
            ))
        })?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    fn last_diagnoses(&self, control_loop: &str, count: usize) -> Result<Vec<DiagnosisRow>, StoreError> {
        let sql = format!(
            "SELECT {DIAGNOSIS} FROM diagnoses WHERE control_loop = ?1 ORDER BY finished DESC LIMIT ?2"
        );
        let db = self.database();
        let mut query = db.prepare_cached(&sql)?;
        let rows = query.query_map(params![control_loop, count as i64], diagnosis)?;
        let mut rows = rows.collect::<Result<Vec<_>, _>>()?;
        rows.reverse();
        let basis = self.basis;
        let said = rows.iter().rev().find(|row| row.is_verdict()).map(|row| row.finished);
        let mut query = db.prepare_cached(&format!(
            "SELECT {DIAGNOSIS}, report, {basis} FROM diagnoses WHERE control_loop = ?1 AND finished IN (?2,
             (SELECT finished FROM diagnoses WHERE control_loop = ?1 AND report IS NOT NULL ORDER BY finished DESC LIMIT 1))"
        ))?;
        let mut whole = query.query_map(params![control_loop, said], |row| {
            Ok(DiagnosisRow { report: row.get("report")?, basis: row.get("basis")?, ..diagnosis(row)? })
        })?;
        whole.try_for_each(|own| own.map(|own| put_whole(&mut rows, own)))?;
        Ok(rows)
    }

    fn basis(&self, control_loop: &str, finished: f64) -> Result<Option<Vec<u8>>, StoreError> {
        let basis = self.basis;
        let db = self.database();
        let sql = format!("SELECT {basis} FROM diagnoses WHERE control_loop = ?1 AND finished = ?2");
        let mut query = db.prepare_cached(&sql)?;
        let found = query.query_row(params![control_loop, finished], |row| row.get::<_, Option<Vec<u8>>>(0));
        Ok(found.optional()?.flatten())
    }

    fn model(&self, control_loop: &str) -> Result<Option<ModelRow>, StoreError> {
        let known = "UNION ALL SELECT version, since, effects FROM known_models WHERE control_loop = ?1";
        let db = self.database();
        let mut query = db.prepare_cached(&format!(
            "SELECT version, since, effects FROM models WHERE control_loop = ?1 {} ORDER BY version DESC LIMIT 1",
            if self.knows { known } else { "" }
        ))?;
        let model = query.query_row([control_loop], |row| {
            Ok(ModelRow {
                control_loop: control_loop.to_string(),
                version: row.get::<_, i64>(0)?.max(0) as u64,
                since: row.get(1)?,
                effects: row.get(2)?,
            })
        });
        Ok(model.optional()?)
    }

    fn alarms(&self) -> Result<Vec<AlarmRow>, StoreError> {
        Ok(over(self.known()?.1, self.alarms_in("alarms")?))
    }

    fn alarm(&self, control_loop: &str, kind: &str) -> Result<Option<AlarmRow>, StoreError> {
        let here = |table: &str| -> Result<Option<AlarmRow>, StoreError> {
            let sql = format!("SELECT * FROM {table} WHERE control_loop = ?1 AND kind = ?2");
            let db = self.database();
            let mut query = db.prepare_cached(&sql)?;
            Ok(query.query_row([control_loop, kind], alarm).optional()?)
        };
        match here("alarms")? {
            None if self.knows => here("known_alarms"),
            found => Ok(found),
        }
    }

    fn last_transitions(&self, limit: usize) -> Result<Vec<TransitionRow>, StoreError> {
        let db = self.database();
        let mut query = db.prepare_cached("SELECT * FROM transitions ORDER BY id DESC LIMIT ?1")?;
        let rows = query.query_map([limit as i64], transition)?;
        let mut rows: Vec<TransitionRow> = rows.collect::<Result<_, _>>()?;
        rows.reverse();
        Ok(rows)
    }

    fn transitions(&self, after: i64, limit: usize) -> Result<Vec<(i64, TransitionRow)>, StoreError> {
        let db = self.database();
        let mut query = db.prepare_cached("SELECT * FROM transitions WHERE id > ?1 ORDER BY id LIMIT ?2")?;
        let rows =
            query.query_map(params![after, limit as i64], |row| Ok((row.get("id")?, transition(row)?)))?;
        Ok(rows.collect::<Result<_, _>>()?)
    }

    fn examine(&mut self, found: &mut Checked) -> Result<(), StoreError> {
        super::check::examine(self, found)
    }

    fn loss(&self) -> Option<&Loss> {
        match &self.db {
            Database::Own(_) => None,
            Database::Left(left) => Some(left.loss()),
        }
    }
}

fn alarm(row: &Row<'_>) -> rusqlite::Result<AlarmRow> {
    Ok(AlarmRow {
        control_loop: row.get("control_loop")?,
        kind: row.get("kind")?,
        active: row.get("active")?,
        acknowledged: row.get("acknowledged")?,
        latched: row.get("latched")?,
        shelved_until: row.get("shelved_until")?,
        one_shot: row.get("one_shot")?,
        suppressed: row.get("suppressed")?,
        out_of_service: row.get("out_of_service")?,
        votes: row.get("votes")?,
        pending: row.get("pending")?,
        raises: row.get("raises")?,
        priority: row.get("priority")?,
        trend: row.get("trend")?,
        since: row.get("since")?,
        raised_at: row.get("raised_at")?,
        detail: row.get("detail")?,
        by: row.get("by_whom")?,
        comment: row.get("comment")?,
    })
}

fn transition(row: &Row<'_>) -> rusqlite::Result<TransitionRow> {
    Ok(TransitionRow {
        control_loop: row.get("control_loop")?,
        kind: row.get("kind")?,
        at: row.get("at")?,
        before: row.get("before")?,
        after: row.get("after")?,
        cause: row.get("cause")?,
        priority: row.get("priority")?,
        detail: row.get("detail")?,
        by: row.get("by_whom")?,
        comment: row.get("comment")?,
    })
}

/// Whether wanted tags, which are sorted, lie so far apart that each is looked up sooner than all between are read.
fn is_scattered(wanted: &[u32]) -> bool {
    let (Some(first), Some(last)) = (wanted.first(), wanted.last()) else { return true };
    (last - first) as usize > NEAR * wanted.len()
}

/// Columns of a run, without its report.
const DIAGNOSIS: &str = "control_loop, finished, took_s, on_demand, outcome, reason_code, reason, f, f_low, f_high, \
                         f_in_percent, delta_aic, version";

fn diagnosis(row: &Row<'_>) -> rusqlite::Result<DiagnosisRow> {
    let interval: (Option<f64>, Option<f64>) = (row.get("f_low")?, row.get("f_high")?);
    Ok(DiagnosisRow {
        control_loop: row.get("control_loop")?,
        finished: row.get("finished")?,
        took_s: row.get("took_s")?,
        on_demand: row.get("on_demand")?,
        outcome: row.get("outcome")?,
        reason_code: row.get("reason_code")?,
        reason: row.get("reason")?,
        f: row.get("f")?,
        f_ci95: interval.0.zip(interval.1).map(|(low, high)| [low, high]),
        f_in_percent: row.get("f_in_percent")?,
        delta_aic: row.get("delta_aic")?,
        version: row.get("version")?,
        report: None,
        basis: None,
    })
}

/// Least, mean and most as three blobs, each behind its length.
pub(super) fn encode_points(points: &[Point]) -> Vec<u8> {
    let column = |of: fn(&Point) -> f64| {
        let samples: Vec<Sample> = points.iter().map(|point| Sample::good(point.t, of(point))).collect();
        codec::encode(&samples)
    };
    let mut out = Vec::new();
    for blob in [column(|p| p.least), column(|p| p.mean), column(|p| p.most)] {
        out.extend((blob.len() as u32).to_le_bytes());
        out.extend(blob);
    }
    out
}

/// The points of [`encode_points`]; `None` when these are not its bytes.
pub(super) fn decode_points(bytes: &[u8]) -> Option<Vec<Point>> {
    let mut rest = bytes;
    let mut column = || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (blob, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        rest = after;
        codec::decode(blob)
    };
    let (least, mean, most) = (column()?, column()?, column()?);
    if least.len() != mean.len() || mean.len() != most.len() || !rest.is_empty() {
        return None;
    }
    let joined = least.iter().zip(&mean).zip(&most);
    Some(joined.map(|((l, m), h)| Point { t: m.t, least: l.value, mean: m.value, most: h.value }).collect())
}
