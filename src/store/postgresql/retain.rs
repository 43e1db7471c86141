//! What is old becomes a trend in the database itself, and goes a partition at a time.

use super::super::age::Age;
use super::super::{Config, StoreError};
use super::client::{Ask, Client};
use super::link::{READS, WRITES};
use super::schema::{SAMPLES_S, TRENDS_S};
use super::write::{Link, at, partition, seconds};
use std::time::SystemTime;

/// Time between two looks at what is old (s), unless there is more to do.
const EVERY_S: f64 = 60.0;
/// Samples thinned in one go (s of their time).
const WINDOW: i64 = 600;
/// Rows deleted in one go.
const ROWS: i64 = 500;
/// Share of the room from which on what is oldest goes, whatever its age.
const FULL: f64 = 0.95;
/// Samples younger than this (s) outlast the trends when the room is full.
const DAY_S: f64 = 86_400.0;

/// A partition of samples that is thinned.
#[derive(Clone, Copy, Debug)]
struct Thinning {
    begin: i64,
    /// Where it goes on (s).
    from: i64,
    /// Because of its age, and not for room.
    by_age: bool,
}

impl Thinning {
    fn new(begin: i64, by_age: bool) -> Self {
        Self { begin, from: begin, by_age }
    }
}

/// A run that may go: the latest of each loop stays, and the latest with a report. The last of all stays, too, however old its stamp
/// is: an edge of a fleet goes on behind its number, and forwards everything once more where that is gone.
const OLD_RUN: &str = "finished < (SELECT max(finished) FROM diagnoses WHERE control_loop = own.control_loop) AND finished <
    coalesce((SELECT max(finished) FROM diagnoses WHERE control_loop = own.control_loop AND report IS NOT NULL), 'Infinity')
    AND id < (SELECT max(id) FROM diagnoses)";
/// A change of an alarm that may go: the last of all stays, as of the runs.
const OLD_CHANGE: &str = "id < (SELECT max(id) FROM transitions)";
/// A model that may go: the latest of each loop stays.
const OLD_MODEL: &str =
    "version < (SELECT max(version) FROM models AS own WHERE own.control_loop = models.control_loop)";

/// How far it has come.
#[derive(Debug)]
pub(super) struct Retention {
    /// When it was looked at last (s).
    looked: f64,
    thinning: Option<Thinning>,
    /// Bytes of all tables, as of then.
    pub bytes: u64,
    pub age: Age,
}

impl Retention {
    /// Nothing was looked at yet.
    pub fn of(config: &Config) -> Self {
        Self { looked: f64::NEG_INFINITY, thinning: None, bytes: 0, age: Age::of(config) }
    }

    /// Does at most one piece of work; true when there may be more.
    pub fn step(&mut self, link: &mut Link, config: &Config, now: f64) -> Result<bool, StoreError> {
        if (self.looked..self.looked + EVERY_S).contains(&now) {
            return Ok(false);
        }
        // Ten minutes of all tags in one statement take longer than any write.
        link.client.set_patience(READS)?;
        let worked = self.work(link, config, now);
        link.client.set_patience(WRITES)?;
        let worked = worked?;
        if !worked {
            self.looked = now;
        }
        Ok(worked)
    }

    fn work(&mut self, link: &mut Link, config: &Config, now: f64) -> Result<bool, StoreError> {
        match self.thinning {
            Some(thinning) => self.thin(link, config, thinning).map(|()| true),
            None => Ok(self.by_age(link, config, now)? || self.by_size(link, config, now)?),
        }
    }

    /// Leaves the rest for the next look: what was in the way, a dump for one, takes a while.
    pub fn put_off(&mut self, now: f64) {
        self.looked = now;
        self.thinning = None;
    }

    fn by_age(&mut self, link: &mut Link, config: &Config, now: f64) -> Result<bool, StoreError> {
        if self.age.lags(now) {
            self.age.skip(now, due(link, config)?);
        }
        let now = self.age.now(now);
        let day = |days: f64| now - days * DAY_S;
        if let Some(begin) = oldest(link, "samples", SAMPLES_S)?
            && ((begin + SAMPLES_S) as f64) < day(config.samples_days)
        {
            self.thinning = Some(Thinning::new(begin, true));
            return Ok(true);
        }
        if let Some(begin) = oldest(link, "trends", TRENDS_S)?
            && ((begin + TRENDS_S) as f64) < day(config.trend_days)
        {
            drop_until(link, "trends", begin + TRENDS_S, TRENDS_S)?;
            return Ok(true);
        }
        let changes = format!(
            "DELETE FROM transitions WHERE id IN (SELECT id FROM transitions WHERE at < $1 AND {OLD_CHANGE} LIMIT $2)"
        );
        let old = link.client.execute(&changes, &[&day(config.alarms_days), &ROWS])?;
        Ok(drop_diagnoses(link, day(config.diagnoses_days))? + old > 0)
    }

    /// Samples are thinned until a day of them is left, then trends go, then more samples but those of now, then runs.
    fn by_size(&mut self, link: &mut Link, config: &Config, now: f64) -> Result<bool, StoreError> {
        self.bytes = all_bytes(link, &config.schema)?;
        if (self.bytes as f64) < FULL * (config.max_mb * 1_000_000) as f64 {
            return Ok(false);
        }
        let samples = oldest(link, "samples", SAMPLES_S)?.map(|begin| (begin, (begin + SAMPLES_S) as f64));
        match (samples, oldest(link, "trends", TRENDS_S)?) {
            (Some((begin, end)), _) if end < now - DAY_S => {
                self.thinning = Some(Thinning::new(begin, false));
            }
            (_, Some(begin)) if ((begin + TRENDS_S) as f64) < now => {
                drop_until(link, "trends", begin + TRENDS_S, TRENDS_S)?
            }
            (Some((begin, end)), _) if end < now => {
                drop_until(link, "samples", begin + SAMPLES_S, SAMPLES_S)?
            }
            _ => {
                let gone = drop_diagnoses(link, f64::INFINITY)?;
                if gone > 0 {
                    // Deleted rows keep their room until then, and more would go than has to.
                    link.client.batch_execute("VACUUM FULL diagnoses")?;
                }
                return Ok(gone > 0);
            }
        }
        Ok(true)
    }

    /// Turns one window of a partition into points; after the last one the partition goes. Broken off it is begun anew:
    /// a point that is there stays.
    fn thin(&mut self, link: &mut Link, config: &Config, thinning: Thinning) -> Result<(), StoreError> {
        let Thinning { begin, from, by_age } = thinning;
        let end = begin + SAMPLES_S;
        let next: Option<SystemTime> = link
            .client
            .query_one("SELECT min(at) FROM samples WHERE at >= $1 AND at < $2", &[&time(from), &time(end)])?
            .get(0);
        let Some(next) = next.filter(|_| config.trend_days > 0.0) else {
            drop_until(link, "samples", end, SAMPLES_S)?;
            self.thinning = None;
            // Only now: one that fails is begun anew.
            if by_age {
                self.age.thinned(SAMPLES_S);
            }
            return Ok(());
        };
        let from = (seconds(next, None) as i64).div_euclid(WINDOW) * WINDOW;
        let mut writing = link.client.transaction()?;
        if link.partitioned {
            partition(&mut writing, "trends", from.div_euclid(TRENDS_S) * TRENDS_S, TRENDS_S)?;
        }
        writing.execute(
            "INSERT INTO trends (at, tag, least, mean, most)
             SELECT date_bin(make_interval(secs => $3), at, timestamptz 'epoch') AS point, tag,
                min(value) FILTER (WHERE fits), avg(value) FILTER (WHERE fits), max(value) FILTER (WHERE fits)
             FROM (SELECT at, tag, value, quality = 0 AND abs(value) < 'Infinity' AS fits FROM samples
                WHERE at >= $1 AND at < $2) AS own
             GROUP BY point, tag ON CONFLICT DO NOTHING",
            &[&time(from), &time(from + WINDOW), &f64::from(config.trend_s)],
        )?;
        writing.commit()?;
        self.thinning = Some(Thinning { begin, from: from + WINDOW, by_age });
        Ok(())
    }
}

fn time(t: i64) -> SystemTime {
    at(t.max(0) as u64 * 1_000_000)
}

/// Begin of the partition that holds the oldest row.
fn oldest(link: &mut Link, table: &str, span: i64) -> Result<Option<i64>, StoreError> {
    let at: Option<SystemTime> = link.client.query_one(&format!("SELECT min(at) FROM {table}"), &[])?.get(0);
    Ok(at.map(|at| (seconds(at, None) as i64).div_euclid(span) * span))
}

/// When the first row of all has reached its days (s), of those that may go; infinite where there is none.
fn due(link: &mut Link, config: &Config) -> Result<f64, StoreError> {
    let samples = oldest(link, "samples", SAMPLES_S)?.map(|begin| begin as f64);
    let trends = oldest(link, "trends", TRENDS_S)?.map(|begin| begin as f64);
    let mut due = f64::INFINITY;
    for (at, days) in [(samples, config.samples_days), (trends, config.trend_days)] {
        due = at.map_or(due, |at| due.min(at + days * DAY_S));
    }
    for (sql, days) in [
        (format!("SELECT min(at) FROM transitions WHERE {OLD_CHANGE}"), config.alarms_days),
        (format!("SELECT min(finished) FROM diagnoses AS own WHERE {OLD_RUN}"), config.diagnoses_days),
        (format!("SELECT min(since) FROM models WHERE {OLD_MODEL}"), config.diagnoses_days),
    ] {
        let at: Option<f64> = link.client.query_one(&sql, &[])?.get(0);
        due = at.map_or(due, |at| due.min(at + days * DAY_S));
    }
    Ok(due)
}

/// Drops every partition that ends at or before a time (s).
fn drop_until(link: &mut Link, table: &str, end: i64, span: i64) -> Result<(), StoreError> {
    if !link.partitioned {
        let older = format!("SELECT drop_chunks('{table}', older_than => to_timestamp({end}))");
        link.client.query(&older, &[])?;
        return Ok(());
    }
    let sql = "SELECT own.relname::text FROM pg_inherits JOIN pg_class AS own ON own.oid = inhrelid
        WHERE inhparent = $1::text::regclass";
    for row in link.client.query(sql, &[&table])? {
        let name: String = row.get(0);
        let begin = name.strip_prefix(table).and_then(|rest| rest.strip_prefix('_')?.parse::<i64>().ok());
        if begin.is_some_and(|begin| begin + span <= end) {
            link.client.batch_execute(&format!("DROP TABLE {name}"))?;
        }
    }
    link.forget_partitions();
    Ok(())
}

/// Runs and models that ended before a time, the latest of each loop left.
fn drop_diagnoses(link: &mut Link, before: f64) -> Result<u64, StoreError> {
    let runs = format!(
        "DELETE FROM diagnoses WHERE id IN (SELECT id FROM diagnoses AS own WHERE finished < $1 AND {OLD_RUN}
         ORDER BY finished LIMIT $2)"
    );
    let runs = link.client.execute(&runs, &[&before, &ROWS])?;
    let models = format!("DELETE FROM models WHERE since < $1 AND {OLD_MODEL}");
    let models = link.client.execute(&models, &[&before])?;
    Ok(runs + models)
}

/// Bytes of a table by time, with its partitions and indices.
pub(super) fn table_bytes(client: &mut Client, table: &str) -> Result<u64, StoreError> {
    let kind = "SELECT relkind = 'p' FROM pg_class WHERE oid = $1::text::regclass";
    let sql = if client.query_one(kind, &[&table])?.get(0) {
        "SELECT coalesce(sum(pg_total_relation_size(relid)), 0)::bigint FROM pg_partition_tree($1::text::regclass)"
    } else {
        "SELECT coalesce(hypertable_size($1::text::regclass), 0)::bigint"
    };
    Ok(client.query_one(sql, &[&table])?.get::<_, i64>(0).max(0) as u64)
}

fn all_bytes(link: &mut Link, schema: &str) -> Result<u64, StoreError> {
    let sql = "SELECT coalesce(sum(pg_total_relation_size(own.oid)), 0)::bigint FROM pg_class AS own
        JOIN pg_namespace AS space ON space.oid = relnamespace WHERE nspname = $1 AND relkind = 'r'";
    let mut bytes = link.client.query_one(sql, &[&schema])?.get::<_, i64>(0);
    if !link.partitioned {
        // The chunks of hypertables lie elsewhere.
        let sql = "SELECT coalesce(hypertable_size('samples') + hypertable_size('trends'), 0)::bigint";
        bytes += link.client.query_one(sql, &[])?.get::<_, i64>(0);
    }
    Ok(bytes.max(0) as u64)
}
