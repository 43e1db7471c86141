//! Batches into the tables, each in one transaction; written again they change nothing.

use super::super::rows::{
    AlarmRow, Batch, DiagnosisRow, ModelRow, Row, Series, TagName, TransitionRow, unpack,
};
use super::super::{StoreError, codec, start_of};
use super::client::{Ask, Client, Transaction, Values};
use super::schema::{SAMPLES_S, TRENDS_S};
use crate::signal::Sample;
use std::collections::{BTreeSet, HashMap};
use std::fmt;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio_postgres::Statement;
use tokio_postgres::error::SqlState;
use tokio_postgres::types::ToSql;

/// Samples of one statement.
const SAMPLES: usize = 50_000;

/// The connection that writes.
pub(super) struct Link {
    pub client: Client,
    /// Whether the tables by time are partitions of ours; else they are hypertables.
    pub partitioned: bool,
    statements: HashMap<&'static str, Statement>,
    ids: HashMap<(i64, Arc<TagName>), i32>,
    /// Partitions that are there, by begin (s).
    partitions: BTreeSet<i64>,
}

impl fmt::Debug for Link {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Link").field("partitioned", &self.partitioned).finish_non_exhaustive()
    }
}

/// A sample as a row: microseconds since 1970, and all else.
struct Stored {
    us: u64,
    tag: i32,
    sample: Sample,
    /// The stamp, where it is finer than a microsecond.
    fine: Option<f64>,
}

impl Link {
    pub fn new(mut client: Client) -> Result<Self, StoreError> {
        let kind = "SELECT relkind = 'p' FROM pg_class WHERE oid = 'samples'::regclass";
        let partitioned = client.query_one(kind, &[])?.get(0);
        let (statements, ids, partitions) = Default::default();
        Ok(Self { client, partitioned, statements, ids, partitions })
    }

    /// The latest era of all tags.
    pub fn era(&mut self) -> Result<i64, StoreError> {
        Ok(self.client.query_one("SELECT coalesce(max(era), 0) FROM tags", &[])?.get(0))
    }

    /// Writes series, each of an era, and rows. How many samples were refused because of their stamps.
    pub fn write<'s>(
        &mut self,
        series: impl Iterator<Item = (i64, &'s Series)>,
        rows: &[Row],
    ) -> Result<u64, StoreError> {
        let series: Vec<(i64, &Series)> = series.filter(|(_, own)| !own.samples.is_empty()).collect();
        let mut writing = self.client.transaction()?;
        let news = number(&mut writing, &self.ids, &series)?;
        let id = |era: i64, tag: &Arc<TagName>| {
            let key = (era, tag.clone());
            self.ids.get(&key).or_else(|| news.get(&key)).copied()
        };
        let (mut stored, mut refused) = (Vec::new(), 0);
        for (era, own) in &series {
            let Some(tag) = id(*era, &own.tag) else { return Err(StoreError::TooManyTags) };
            for &sample in &own.samples {
                match place(tag, sample) {
                    Some(one) => stored.push(one),
                    None => refused += 1,
                }
            }
        }
        // In the order of the key; of one stamp a good sample before any other, else the first that came.
        stored.sort_by_key(|one| (one.us, one.tag, !one.sample.quality.is_good()));
        stored.dedup_by_key(|one| (one.us, one.tag));
        let mut begins = BTreeSet::new();
        if self.partitioned {
            begins = stored.iter().map(|one| (one.us / 1_000_000) as i64 / SAMPLES_S * SAMPLES_S).collect();
            for begin in begins.difference(&self.partitions) {
                partition(&mut writing, "samples", *begin, SAMPLES_S)?;
            }
        }
        for part in stored.chunks(SAMPLES) {
            put_samples(&mut writing, &mut self.statements, part)?;
        }
        for row in rows {
            put_row(&mut writing, &mut self.statements, row)?;
        }
        writing.commit()?;
        self.ids.extend(news);
        self.partitions.extend(begins);
        Ok(refused)
    }

    /// Forgets which partitions there are, because one has gone.
    pub fn forget_partitions(&mut self) {
        self.partitions.clear();
    }
}

impl Link {
    /// Writes a batch of one era.
    pub fn write_batch(&mut self, batch: &Batch, era: i64) -> Result<u64, StoreError> {
        self.write(batch.series.iter().map(|series| (era, series)), &batch.rows)
    }
}

/// Makes a partition that begins at a time (s); nothing when it is there.
pub(super) fn partition(
    writing: &mut Transaction<'_>,
    table: &str,
    begin: i64,
    span: i64,
) -> Result<(), StoreError> {
    debug_assert!([SAMPLES_S, TRENDS_S].contains(&span));
    writing.batch_execute(&format!(
        "CREATE TABLE IF NOT EXISTS {table}_{begin} PARTITION OF {table}
            FOR VALUES FROM (to_timestamp({begin})) TO (to_timestamp({}))",
        begin + span
    ))?;
    Ok(())
}

/// A stamp (s) as the database has it.
pub(super) fn at(us: u64) -> SystemTime {
    UNIX_EPOCH + Duration::from_micros(us)
}

/// The stamp (s) of a time of the database.
pub(super) fn seconds(at: SystemTime, fine: Option<f64>) -> f64 {
    let us = at.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64);
    fine.unwrap_or(us as f64 / 1e6)
}

fn place(tag: i32, sample: Sample) -> Option<Stored> {
    start_of(sample.t, 1)?;
    let us = (sample.t * 1e6).round() as u64;
    let fine = Some(sample.t).filter(|t| (us as f64 / 1e6).to_bits() != t.to_bits());
    Some(Stored { us, tag, sample, fine })
}

/// Numbers of the tags that have none yet.
fn number(
    writing: &mut Transaction<'_>,
    known: &HashMap<(i64, Arc<TagName>), i32>,
    series: &[(i64, &Series)],
) -> Result<HashMap<(i64, Arc<TagName>), i32>, StoreError> {
    let unknown: BTreeSet<(i64, Arc<TagName>)> = series
        .iter()
        .map(|(era, own)| (*era, own.tag.clone()))
        .filter(|key| !known.contains_key(key))
        .collect();
    let mut news = HashMap::new();
    for key in unknown {
        let (era, name) = &key;
        let [own, tag, source, unit] =
            [&name.control_loop, &name.tag, &name.source, &name.unit].map(|t| text(t));
        let values: Values<'_> = &[&own, &tag, &source, era, &unit];
        // An insert takes a number for good, also where the tag is there: at each connection as many as there are tags.
        let there = "UPDATE tags SET unit = $5
            WHERE control_loop = $1 AND tag = $2 AND source = $3 AND era = $4 RETURNING id";
        let new = "INSERT INTO tags (control_loop, tag, source, era, unit) VALUES ($1, $2, $3, $4, $5)
            ON CONFLICT (control_loop, tag, source, era) DO UPDATE SET unit = excluded.unit RETURNING id";
        let id: i32 = match writing.query(there, values)?.first() {
            Some(row) => row.get(0),
            None => writing.query_one(new, values)?.get(0),
        };
        news.insert(key, id);
    }
    Ok(news)
}

/// The statement for a text, prepared once a connection.
fn prepared(
    writing: &mut Transaction<'_>,
    statements: &mut HashMap<&'static str, Statement>,
    sql: &'static str,
) -> Result<Statement, StoreError> {
    if let Some(known) = statements.get(sql) {
        return Ok(known.clone());
    }
    let statement = writing.prepare(sql)?;
    statements.insert(sql, statement.clone());
    Ok(statement)
}

fn put_samples(
    writing: &mut Transaction<'_>,
    statements: &mut HashMap<&'static str, Statement>,
    part: &[Stored],
) -> Result<(), StoreError> {
    let plain = prepared(
        writing,
        statements,
        "INSERT INTO samples (at, tag, value, quality, t)
         SELECT * FROM unnest($1::timestamptz[], $2::int4[], $3::float8[], $4::int2[], $5::float8[])",
    )?;
    let at: Vec<SystemTime> = part.iter().map(|one| at(one.us)).collect();
    let tag: Vec<i32> = part.iter().map(|one| one.tag).collect();
    let value = |one: &Stored| Some(one.sample.value).filter(|value| !value.is_nan());
    let value: Vec<Option<f64>> = part.iter().map(value).collect();
    let quality: Vec<i16> = part.iter().map(|one| codec::code(one.sample.quality).into()).collect();
    let fine: Vec<Option<f64>> = part.iter().map(|one| one.fine).collect();
    let values: Values<'_> = &[&at, &tag, &value, &quality, &fine];
    // Where each row is looked up before it is put, the database writes a third more; what comes is nearly always new.
    writing.batch_execute("SAVEPOINT plain")?;
    match writing.execute(&plain, values) {
        Err(StoreError::Refused(error)) if error.code() == Some(&SqlState::UNIQUE_VIOLATION) => {}
        done => return done.map(drop),
    }
    writing.batch_execute("ROLLBACK TO SAVEPOINT plain")?;
    let beside = prepared(
        writing,
        statements,
        "INSERT INTO samples AS own (at, tag, value, quality, t)
         SELECT * FROM unnest($1::timestamptz[], $2::int4[], $3::float8[], $4::int2[], $5::float8[])
         ON CONFLICT (at, tag) DO UPDATE SET value = excluded.value, quality = excluded.quality, t = excluded.t
         WHERE own.quality <> 0 AND excluded.quality = 0",
    )?;
    writing.execute(&beside, values)?;
    Ok(())
}

/// Text as the database takes it: it knows no zero byte.
pub(super) fn text(text: &str) -> String {
    text.replace('\0', "")
}

fn maybe(own: Option<&String>) -> Option<String> {
    own.map(|own| text(own))
}

fn packed(bytes: Option<&Vec<u8>>) -> Option<String> {
    bytes.and_then(|bytes| unpack(bytes)).map(|own| text(&own))
}

fn put_row(
    writing: &mut Transaction<'_>,
    statements: &mut HashMap<&'static str, Statement>,
    row: &Row,
) -> Result<(), StoreError> {
    let mut put = |sql: &'static str, values: &[&(dyn ToSql + Sync)]| -> Result<(), StoreError> {
        let statement = prepared(writing, statements, sql)?;
        writing.execute(&statement, values)?;
        Ok(())
    };
    match row {
        Row::Diagnosis(row) => put_diagnosis(&mut put, row),
        Row::Model(ModelRow { control_loop, version, since, effects }) => put(
            "INSERT INTO models (control_loop, version, since, effects) VALUES ($1, $2, $3, $4) ON CONFLICT DO NOTHING",
            &[&text(control_loop), &i64::try_from(*version).unwrap_or(i64::MAX), since, &text(effects)],
        ),
        Row::Alarm(row) => put_alarm(&mut put, row),
        Row::Transition(row) => {
            let TransitionRow { control_loop, kind, at, before, after, cause, priority, detail, by, comment } =
                row;
            put(
                "INSERT INTO transitions (control_loop, kind, at, before, after, cause, priority, detail, by_whom, comment)
                 VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) ON CONFLICT DO NOTHING",
                &[
                    &text(control_loop),
                    &text(kind),
                    at,
                    &text(before),
                    &text(after),
                    &text(cause),
                    &maybe(priority.as_ref()),
                    &text(detail),
                    &maybe(by.as_ref()),
                    &maybe(comment.as_ref()),
                ],
            )
        }
    }
}

type Put<'p> = &'p mut dyn FnMut(&'static str, &[&(dyn ToSql + Sync)]) -> Result<(), StoreError>;

fn put_diagnosis(put: Put<'_>, row: &DiagnosisRow) -> Result<(), StoreError> {
    put(
        "INSERT INTO diagnoses (control_loop, finished, took_s, on_demand, outcome, reason_code, reason, f, f_low, f_high,
            f_in_percent, delta_aic, version, report, basis)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15) ON CONFLICT DO NOTHING",
        &[
            &text(&row.control_loop),
            &row.finished,
            &(if row.took_s.is_finite() { row.took_s } else { 0.0 }),
            &row.on_demand,
            &text(&row.outcome),
            &maybe(row.reason_code.as_ref()),
            &text(&row.reason),
            &row.f,
            &row.f_ci95.map(|[low, _]| low),
            &row.f_ci95.map(|[_, high]| high),
            &row.f_in_percent,
            &row.delta_aic,
            &text(&row.version),
            &packed(row.report.as_ref()),
            &packed(row.basis.as_ref()),
        ],
    )
}

fn put_alarm(put: Put<'_>, row: &AlarmRow) -> Result<(), StoreError> {
    let (own, kind) = (text(&row.control_loop), text(&row.kind));
    put("DELETE FROM alarms WHERE control_loop = $1 AND kind = $2", &[&own, &kind])?;
    put(
        "INSERT INTO alarms (control_loop, kind, active, acknowledged, latched, shelved_until, one_shot, suppressed,
            out_of_service, votes, pending, raises, priority, trend, since, raised_at, detail, by_whom, comment)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, $19)",
        &[
            &own,
            &kind,
            &row.active,
            &row.acknowledged,
            &row.latched,
            &row.shelved_until,
            &row.one_shot,
            &row.suppressed,
            &row.out_of_service,
            &text(&row.votes),
            &row.pending,
            &text(&row.raises),
            &maybe(row.priority.as_ref()),
            &text(&row.trend),
            &row.since,
            &row.raised_at,
            &text(&row.detail),
            &maybe(row.by.as_ref()),
            &maybe(row.comment.as_ref()),
        ],
    )
}
