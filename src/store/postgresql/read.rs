//! The reading side: minutes of rows where the store in a folder has chunks, so that whoever walks through one walks through
//! the other.

use super::super::backend::Reads;
use super::super::rows::{AlarmRow, DiagnosisRow, ModelRow, TagName, TransitionRow, pack, put_whole};
use super::super::{Checked, Config, Point, StoreError, StoredTag, codec};
use super::client::{Ask, Client};
use super::pages::{ALARMS, DIAGNOSES, IDS, LAST_TRANSITIONS, MODELS, SUMMARIES, TAGS, TRANSITIONS, TRENDS};
use super::write::{at, seconds};
use super::{link, schema};
use crate::signal::{Quality, Sample};
use std::cell::{RefCell, RefMut};
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::time::SystemTime;
use tokio_postgres::Row;
use tokio_postgres::types::ToSql;

/// Tags asked for at once: a minute of so many, ten samples a second, is within what an answer may be.
const AT_ONCE: usize = 100;
/// Time that is read as one chunk (s).
const CHUNK: i64 = 60;
/// A time no sample has (s), which the database can still count in microseconds.
const LATEST: i64 = 1 << 38;

/// The tables, open for reading.
pub struct Reader {
    client: RefCell<Client>,
    version: i64,
}

impl fmt::Debug for Reader {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Reader").field("version", &self.version).finish_non_exhaustive()
    }
}

fn time(t: i64) -> SystemTime {
    at(t.clamp(0, LATEST) as u64 * 1_000_000)
}

impl Reader {
    /// Connects for reading.
    ///
    /// # Errors
    /// [`StoreError::Away`], [`StoreError::Missing`], [`StoreError::Foreign`], [`StoreError::TooNew`].
    pub fn open(config: &Config) -> Result<Self, StoreError> {
        let mut client = link::connect(config, link::READS)?;
        let version = schema::version(&mut client, &config.schema)?;
        let missing = || StoreError::Missing(PathBuf::from(format!("schema {}", config.schema)));
        client.batch_execute("SET default_transaction_read_only TO on")?;
        Ok(Self { version: version.ok_or_else(missing)?, client: RefCell::new(client) })
    }

    fn client(&self) -> RefMut<'_, Client> {
        self.client.borrow_mut()
    }

    fn rows(&self, sql: &str, values: &[&(dyn ToSql + Sync)]) -> Result<Vec<Row>, StoreError> {
        self.client().query(sql, values)
    }

    /// Adds the samples of some tags to what was found: an answer is bounded, a plant is not.
    fn take(
        &self,
        sql: &str,
        span: (SystemTime, SystemTime),
        wanted: &[i32],
        found: &mut BTreeMap<u32, Vec<Sample>>,
    ) -> Result<(), StoreError> {
        for row in self.rows(sql, &[&span.0, &span.1, &wanted])? {
            let code = u8::try_from(row.get::<_, i16>(4)).ok();
            let Some(quality) = code.and_then(codec::quality) else { continue };
            let value = row.get::<_, Option<f64>>(3).unwrap_or(f64::NAN);
            let sample = Sample { t: seconds(row.get(1), row.get(2)), value, quality };
            found.entry(row.get::<_, i32>(0).max(0) as u32).or_default().push(sample);
        }
        Ok(())
    }

    /// Start of the minute of what an aggregate over `samples` says.
    fn minute(&self, sql: &str, t: i64) -> Result<Option<i64>, StoreError> {
        let found: Option<SystemTime> = self.client().query_one(sql, &[&time(t)])?.get(0);
        Ok(found.map(|at| (seconds(at, None) as i64).div_euclid(CHUNK) * CHUNK))
    }
}

impl Reads for Reader {
    fn damaged(&self) -> u64 {
        0
    }

    fn tags(&self) -> Result<Vec<StoredTag>, StoreError> {
        let tag = |row: &Row| {
            let name =
                TagName { control_loop: row.get(1), tag: row.get(2), source: row.get(3), unit: row.get(4) };
            StoredTag { id: row.get::<_, i32>(0).max(0) as u32, name, era: row.get(5) }
        };
        TAGS.read(&mut *self.client(), &[], None, usize::MAX, tag)
    }

    fn next_start(&self, from: i64) -> Result<Option<i64>, StoreError> {
        let from = from.clamp(0, LATEST);
        // A chunk that begins before is not asked for, whatever of it comes later.
        let first = (from + CHUNK - 1).div_euclid(CHUNK) * CHUNK;
        self.minute("SELECT min(at) FROM samples WHERE at >= $1", first)
    }

    fn previous_start(&self, before: i64) -> Result<Option<i64>, StoreError> {
        let before = before.clamp(0, LATEST);
        let end = (before + CHUNK - 1).div_euclid(CHUNK) * CHUNK;
        self.minute("SELECT max(at) FROM samples WHERE at < $1", end)
    }

    fn chunk(
        &mut self,
        start: i64,
        wanted: Option<&[u32]>,
    ) -> Result<BTreeMap<u32, Vec<Sample>>, StoreError> {
        let (from, to) = (time(start), time(start.saturating_add(CHUNK)));
        let sql = "SELECT tag, at, t, value, quality FROM samples WHERE at >= $1 AND at < $2";
        let sql = format!("{sql} AND tag = ANY ($3)");
        let wanted: Vec<i32> = match wanted {
            None => IDS.read(&mut *self.client(), &[], None, usize::MAX, |row| row.get::<_, i32>("id"))?,
            Some(wanted) => wanted.iter().filter_map(|id| i32::try_from(*id).ok()).collect(),
        };
        let mut found: BTreeMap<u32, Vec<Sample>> = BTreeMap::new();
        for some in wanted.chunks(AT_ONCE) {
            self.take(&sql, (from, to), some, &mut found)?;
        }
        found.values_mut().for_each(codec::unique);
        Ok(found)
    }

    fn trends(&mut self, tag: u32, from: i64, to: i64) -> Result<Vec<Point>, StoreError> {
        let number = |row: &Row, at| row.get::<_, Option<f64>>(at).unwrap_or(f64::NAN);
        let point = |row: &Row| Point {
            t: seconds(row.get(0), None),
            least: number(row, 1),
            mean: number(row, 2),
            most: number(row, 3),
        };
        let tag = i32::try_from(tag).unwrap_or(-1);
        TRENDS.read(&mut *self.client(), &[&tag, &time(from), &time(to)], None, usize::MAX, point)
    }

    fn diagnoses(&self, after: i64, limit: usize) -> Result<Vec<(i64, DiagnosisRow)>, StoreError> {
        let run = |row: &Row| (row.get::<_, i64>("id"), diagnosis(row, true));
        DIAGNOSES.read(&mut *self.client(), &[], Some([after]), limit, run)
    }

    fn last_diagnoses(&self, control_loop: &str, count: usize) -> Result<Vec<DiagnosisRow>, StoreError> {
        let run = |row: &Row| diagnosis(row, false);
        let mut rows = SUMMARIES.read(&mut *self.client(), &[&control_loop], None, count, run)?;
        rows.reverse();
        let said = rows.iter().rev().find(|row| row.is_verdict()).map(|row| row.finished);
        let whole = "SELECT * FROM diagnoses WHERE control_loop = $1 AND finished IN ($2,
            (SELECT finished FROM diagnoses WHERE control_loop = $1 AND report IS NOT NULL ORDER BY finished DESC LIMIT 1))";
        for own in self.rows(whole, &[&control_loop, &said])? {
            put_whole(&mut rows, diagnosis(&own, true));
        }
        Ok(rows)
    }

    fn basis(&self, control_loop: &str, finished: f64) -> Result<Option<Vec<u8>>, StoreError> {
        let sql = "SELECT basis FROM diagnoses WHERE control_loop = $1 AND finished = $2";
        let rows = self.rows(sql, &[&control_loop, &finished])?;
        let text = rows.first().and_then(|row| row.get::<_, Option<String>>(0));
        Ok(text.as_deref().and_then(pack))
    }

    fn model(&self, control_loop: &str) -> Result<Option<ModelRow>, StoreError> {
        let sql = "SELECT version, since, effects FROM models WHERE control_loop = $1 ORDER BY version DESC LIMIT 1";
        let rows = self.rows(sql, &[&control_loop])?;
        Ok(rows.first().map(|row| ModelRow {
            control_loop: control_loop.to_string(),
            version: row.get::<_, i64>(0).max(0) as u64,
            since: row.get(1),
            effects: row.get(2),
        }))
    }

    fn alarms(&self) -> Result<Vec<AlarmRow>, StoreError> {
        let mut rows = ALARMS.read(&mut *self.client(), &[], None, usize::MAX, alarm)?;
        // As bytes, which is how the store in a folder sorts.
        rows.sort_by(|a, b| (&a.control_loop, &a.kind).cmp(&(&b.control_loop, &b.kind)));
        Ok(rows)
    }

    fn alarm(&self, control_loop: &str, kind: &str) -> Result<Option<AlarmRow>, StoreError> {
        let sql = "SELECT * FROM alarms WHERE control_loop = $1 AND kind = $2";
        Ok(self.rows(sql, &[&control_loop, &kind])?.first().map(alarm))
    }

    fn last_transitions(&self, limit: usize) -> Result<Vec<TransitionRow>, StoreError> {
        let mut rows = LAST_TRANSITIONS.read(&mut *self.client(), &[], None, limit, transition)?;
        rows.reverse();
        Ok(rows)
    }

    fn transitions(&self, after: i64, limit: usize) -> Result<Vec<(i64, TransitionRow)>, StoreError> {
        let change = |row: &Row| (row.get::<_, i64>("id"), transition(row));
        TRANSITIONS.read(&mut *self.client(), &[], Some([after]), limit, change)
    }

    fn examine(&mut self, found: &mut Checked) -> Result<(), StoreError> {
        found.version = self.version;
        found.tags = self.tags()?.len();
        let sql = "SELECT count(*), min(at), max(at) FROM samples";
        let row = self.client().query_one(sql, &[])?;
        found.samples = row.get::<_, i64>(0).max(0) as u64;
        let minute = |at: SystemTime| (seconds(at, None) as i64).div_euclid(CHUNK) * CHUNK;
        let span: (Option<SystemTime>, Option<SystemTime>) = (row.get(1), row.get(2));
        found.span = span.0.zip(span.1).map(|(first, last)| (minute(first), minute(last)));
        found.points =
            self.client().query_one("SELECT count(*) FROM trends", &[])?.get::<_, i64>(0).max(0) as u64;
        let strays = "SELECT count(*) FROM samples WHERE quality < 0 OR quality >= $1 OR tag NOT IN (SELECT id FROM tags)";
        let strays: i64 = self.client().query_one(strays, &[&(Quality::ALL.len() as i16)])?.get(0);
        if strays > 0 {
            found.faults.push(format!("{strays} samples of no tag or with no quality"));
        }
        found.sample_bytes = super::retain::table_bytes(&mut self.client(), "samples")?;
        Ok(())
    }
}

/// The latest version of each model, and the states of all alarms.
pub(super) fn states(client: &mut Client) -> Result<(Vec<ModelRow>, Vec<AlarmRow>), StoreError> {
    let model = |row: &Row| ModelRow {
        control_loop: row.get(0),
        version: row.get::<_, i64>(1).max(0) as u64,
        since: row.get(2),
        effects: row.get(3),
    };
    let models = MODELS.read(client, &[], None, usize::MAX, model)?;
    Ok((models, ALARMS.read(client, &[], None, usize::MAX, alarm)?))
}

fn diagnosis(row: &Row, whole: bool) -> DiagnosisRow {
    let interval: (Option<f64>, Option<f64>) = (row.get("f_low"), row.get("f_high"));
    // A summary is read without its report.
    let text = |name: &str| {
        let own = whole.then(|| row.get::<_, Option<String>>(name)).flatten();
        own.as_deref().and_then(pack)
    };
    DiagnosisRow {
        control_loop: row.get("control_loop"),
        finished: row.get("finished"),
        took_s: row.get("took_s"),
        on_demand: row.get("on_demand"),
        outcome: row.get("outcome"),
        reason_code: row.get("reason_code"),
        reason: row.get("reason"),
        f: row.get("f"),
        f_ci95: interval.0.zip(interval.1).map(|(low, high)| [low, high]),
        f_in_percent: row.get("f_in_percent"),
        delta_aic: row.get("delta_aic"),
        version: row.get("version"),
        report: text("report"),
        basis: text("basis"),
    }
}

fn alarm(row: &Row) -> AlarmRow {
    AlarmRow {
        control_loop: row.get("control_loop"),
        kind: row.get("kind"),
        active: row.get("active"),
        acknowledged: row.get("acknowledged"),
        latched: row.get("latched"),
        shelved_until: row.get("shelved_until"),
        one_shot: row.get("one_shot"),
        suppressed: row.get("suppressed"),
        out_of_service: row.get("out_of_service"),
        votes: row.get("votes"),
        pending: row.get("pending"),
        raises: row.get("raises"),
        priority: row.get("priority"),
        trend: row.get("trend"),
        since: row.get("since"),
        raised_at: row.get("raised_at"),
        detail: row.get("detail"),
        by: row.get("by_whom"),
        comment: row.get("comment"),
    }
}

fn transition(row: &Row) -> TransitionRow {
    TransitionRow {
        control_loop: row.get("control_loop"),
        kind: row.get("kind"),
        at: row.get("at"),
        before: row.get("before"),
        after: row.get("after"),
        cause: row.get("cause"),
        priority: row.get("priority"),
        detail: row.get("detail"),
        by: row.get("by_whom"),
        comment: row.get("comment"),
    }
}
