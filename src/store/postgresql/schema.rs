//! The tables in PostgreSQL, and how those of an older version become those of this. The table `version` has one row, which
//! counts the steps taken.

use super::super::StoreError;
use super::client::{Ask, Client, Transaction};
use std::path::PathBuf;

/// Time that one partition of samples spans (s): what is old goes partition by partition, which costs nothing.
pub(super) const SAMPLES_S: i64 = 6 * 3600;
/// Time that one partition of trends spans (s).
pub(super) const TRENDS_S: i64 = 30 * 86_400;

/// Steps, each run once, in order, in a transaction of its own; one that was released is never changed.
const STEPS: [&str; 2] = [
    // 1: `at` is what people ask for; `t` is the stamp itself where it is finer than a microsecond, so that it comes back to
    // the last bit. A value that does not exist is null, a quality is a code of `codec::QUALITIES`.
    "CREATE TABLE tags (
        id integer GENERATED ALWAYS AS IDENTITY PRIMARY KEY, control_loop text NOT NULL, tag text NOT NULL,
        source text NOT NULL, era bigint NOT NULL, unit text NOT NULL, UNIQUE (control_loop, tag, source, era));
    CREATE TABLE diagnoses (
        id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY, control_loop text NOT NULL,
        finished double precision NOT NULL, took_s double precision NOT NULL, on_demand boolean NOT NULL,
        outcome text NOT NULL, reason_code text, reason text NOT NULL, f double precision, f_low double precision,
        f_high double precision, f_in_percent boolean NOT NULL, delta_aic double precision, version text NOT NULL,
        report text, basis text, UNIQUE (control_loop, finished));
    CREATE INDEX diagnoses_finished ON diagnoses (finished);
    CREATE TABLE models (
        control_loop text NOT NULL, version bigint NOT NULL, since double precision NOT NULL, effects text NOT NULL,
        PRIMARY KEY (control_loop, version));
    CREATE TABLE alarms (
        control_loop text NOT NULL, kind text NOT NULL, active boolean NOT NULL, acknowledged boolean NOT NULL,
        latched boolean NOT NULL, shelved_until double precision, one_shot boolean NOT NULL,
        suppressed boolean NOT NULL, out_of_service boolean NOT NULL, votes text NOT NULL, pending double precision,
        raises text NOT NULL, priority text, trend text NOT NULL, since double precision, raised_at double precision,
        detail text NOT NULL, by_whom text, comment text, PRIMARY KEY (control_loop, kind));
    CREATE TABLE transitions (
        id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY, control_loop text NOT NULL, kind text NOT NULL,
        at double precision NOT NULL, before text NOT NULL, after text NOT NULL, cause text NOT NULL, priority text,
        detail text NOT NULL, by_whom text, comment text, UNIQUE (control_loop, kind, at, before, after, cause));
    CREATE INDEX transitions_at ON transitions (at);",
    // 2: the same for people, with names and times instead of numbers.
    "CREATE VIEW measured AS SELECT own.at, tags.control_loop, tags.tag, own.value,
        (ARRAY['good', 'stale', 'bad:device_exception', 'bad:timeout', 'bad:link_down', 'bad:out_of_range',
            'bad:not_a_number'])[own.quality + 1] AS quality, tags.unit, tags.source, tags.era
        FROM samples AS own JOIN tags ON tags.id = own.tag;
    CREATE VIEW diagnosed AS SELECT to_timestamp(finished) AS at, control_loop, outcome, reason, f, f_low, f_high,
        CASE WHEN f_in_percent THEN '% OP' ELSE 'OP units' END AS f_unit, delta_aic, report::json AS report
        FROM diagnoses;
    CREATE VIEW alarmed AS SELECT to_timestamp(at) AS at, control_loop, kind, before, after, cause, priority, detail,
        by_whom, comment FROM transitions;",
];

/// Samples and trends, which depend on what the database can do: part of step 1. The wide columns come first, which leaves no
/// bytes between them.
const SAMPLES: &str =
    "(at timestamptz NOT NULL, value double precision, t double precision, tag integer NOT NULL,
    quality smallint NOT NULL, PRIMARY KEY (at, tag))";
const TRENDS: &str =
    "(at timestamptz NOT NULL, tag integer NOT NULL, least double precision, mean double precision,
    most double precision, PRIMARY KEY (at, tag))";

/// Number of this version's tables.
pub(super) const VERSION: i64 = STEPS.len() as i64;

/// Brings a schema to this version.
///
/// # Errors
/// [`StoreError::TooNew`], [`StoreError::Foreign`]; nothing is changed then.
pub(super) fn migrate(client: &mut Client, schema: &str) -> Result<(), StoreError> {
    let there = "SELECT EXISTS (SELECT 1 FROM information_schema.schemata WHERE schema_name = $1)";
    if !client.query_one(there, &[&schema])?.get::<_, bool>(0) {
        client.batch_execute(&format!("CREATE SCHEMA IF NOT EXISTS \"{schema}\""))?;
    }
    let mut version = version(client, schema)?.unwrap_or(0);
    while version < VERSION {
        let mut step = client.transaction()?;
        if version == 0 {
            step.batch_execute(
                "CREATE TABLE version (one boolean PRIMARY KEY CHECK (one), steps bigint NOT NULL)",
            )?;
            step.batch_execute("INSERT INTO version VALUES (true, 0)")?;
            by_time(&mut step)?;
        }
        step.batch_execute(STEPS[version as usize])?;
        version += 1;
        step.execute("UPDATE version SET steps = $1", &[&version])?;
        step.commit()?;
    }
    Ok(())
}

/// Tables by time: hypertables where the database has TimescaleDB, else partitions.
fn by_time(step: &mut Transaction<'_>) -> Result<(), StoreError> {
    let extension = "SELECT EXISTS (SELECT 1 FROM pg_extension WHERE extname = 'timescaledb')";
    let timescale: bool = step.query_one(extension, &[])?.get(0);
    for (table, columns, span) in [("samples", SAMPLES, SAMPLES_S), ("trends", TRENDS, TRENDS_S)] {
        if timescale {
            step.batch_execute(&format!("CREATE TABLE {table} {columns}"))?;
            step.query(
                &format!(
                "SELECT create_hypertable('{table}', 'at', chunk_time_interval => INTERVAL '{span} seconds',
                    create_default_indexes => false)"
            ),
                &[],
            )?;
        } else {
            step.batch_execute(&format!("CREATE TABLE {table} {columns} PARTITION BY RANGE (at)"))?;
        }
    }
    Ok(())
}

/// The schema's version; `None` where there is nothing in it.
///
/// # Errors
/// [`StoreError::TooNew`], [`StoreError::Foreign`].
pub(super) fn version(client: &mut impl Ask, schema: &str) -> Result<Option<i64>, StoreError> {
    let tables = "SELECT table_name::text FROM information_schema.tables WHERE table_schema = $1";
    let tables: Vec<String> = client.query(tables, &[&schema])?.iter().map(|row| row.get(0)).collect();
    if tables.is_empty() {
        return Ok(None);
    }
    if !["version", "tags", "transitions"].iter().all(|own| tables.iter().any(|table| table == own)) {
        return Err(StoreError::Foreign(PathBuf::from(schema)));
    }
    let steps: i64 = client.query_one("SELECT steps FROM version", &[])?.get(0);
    if (0..=VERSION).contains(&steps) { Ok(Some(steps)) } else { Err(StoreError::TooNew(steps)) }
}
