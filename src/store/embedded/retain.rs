//! What is old becomes a trend, and what is older goes: a little at a time, so that nobody waits for it.

use super::read::{decode_points, encode_points};
use super::room::beyond;
use super::write::damaged;
use super::{MAX_TAG, Store, TREND_SPAN, key, start_and_tag};
use crate::signal::Sample;
use crate::store::backend::Writes;
use crate::store::{Point, StoreError, codec};
use rusqlite::{OptionalExtension, Transaction, params};
use std::collections::BTreeMap;

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
/// Free pages that stay in the file for what comes next.
const SPARE_PAGES: i64 = 2048;
/// A run that may go: the latest of each loop stays, and the latest with a report. The last of all stays, too, however old its stamp
/// is: its number would be given again, and an edge of a fleet goes on behind that number.
const OLD_RUN: &str = "finished < (SELECT max(finished) FROM diagnoses WHERE control_loop = own.control_loop) AND finished <
    coalesce((SELECT max(finished) FROM diagnoses WHERE control_loop = own.control_loop AND report IS NOT NULL), 9e99)
    AND id < (SELECT max(id) FROM diagnoses)";
/// A change of an alarm that may go: the last of all stays, as of the runs.
const OLD_CHANGE: &str = "id < (SELECT max(id) FROM transitions)";
/// A model that may go: the latest of each loop stays.
const OLD_MODEL: &str =
    "version < (SELECT max(version) FROM models AS own WHERE own.control_loop = models.control_loop)";

/// Does at most one piece of work; true when there may be more.
pub(super) fn step(store: &mut Store, now: f64) -> Result<bool, StoreError> {
    // A clock that was set back counts as time that has passed.
    if (store.retained..store.retained + EVERY_S).contains(&now) {
        return Ok(false);
    }
    let worked = by_age(store, now)? || by_size(store, now)?;
    if !worked {
        store.retained = now;
        shrink(store)?;
    }
    Ok(worked)
}

/// Makes room at once, because a write has found none; true when some was made.
pub(super) fn make_room(store: &mut Store, now: f64) -> Result<bool, StoreError> {
    oldest_goes(store, now)
}

fn by_age(store: &mut Store, now: f64) -> Result<bool, StoreError> {
    if store.age.lags(now) {
        let due = due(store)?;
        store.age.skip(now, due);
    }
    let now = store.age.now(now);
    let day = |days: f64| now - days * DAY_S;
    let config = store.config.clone();
    if let Some(start) =
        first(store, "chunks")?.filter(|start| ((start + WINDOW) as f64) < day(config.samples_days))
    {
        thin(store, start)?;
        store.age.thinned(WINDOW);
        return Ok(true);
    }
    if let Some(start) =
        first(store, "trends")?.filter(|start| ((start + TREND_SPAN) as f64) < day(config.trend_days))
    {
        drop_trends(store, start)?;
        return Ok(true);
    }
    let changes = format!(
        "DELETE FROM transitions WHERE id IN (SELECT id FROM transitions WHERE at < ?1 AND {OLD_CHANGE} LIMIT ?2)"
    );
    let gone = drop_diagnoses(store, day(config.diagnoses_days))?
        + store.db.execute(&changes, params![day(config.alarms_days), ROWS])?;
    Ok(gone > 0)
}

/// When the first row of all has reached its days (s), of those that may go; infinite where there is none.
fn due(store: &Store) -> Result<f64, StoreError> {
    let start = |table: &str| Ok::<_, StoreError>(first(store, table)?.map(|start| start as f64));
    let row = |sql: &str| store.db.query_row(sql, [], |row| row.get::<_, Option<f64>>(0));
    let runs = format!("SELECT min(finished) FROM diagnoses AS own WHERE {OLD_RUN}");
    let models = format!("SELECT min(since) FROM models WHERE {OLD_MODEL}");
    let changes = format!("SELECT min(at) FROM transitions WHERE {OLD_CHANGE}");
    let config = &store.config;
    let oldest = [
        (start("chunks")?, config.samples_days),
        (start("trends")?, config.trend_days),
        (row(&changes)?, config.alarms_days),
        (row(&runs)?, config.diagnoses_days),
        (row(&models)?, config.diagnoses_days),
    ];
    let due = oldest.into_iter().filter_map(|(at, days)| at.map(|at| at + days * DAY_S));
    Ok(due.fold(f64::INFINITY, f64::min))
}

fn by_size(store: &mut Store, now: f64) -> Result<bool, StoreError> {
    let usage = store.usage()?;
    if (usage.used_bytes as f64) < FULL * usage.max_bytes as f64 {
        return Ok(false);
    }
    oldest_goes(store, now)
}

/// Samples are thinned until a day of them is left, then trends go, then more samples, then diagnoses.
fn oldest_goes(store: &mut Store, now: f64) -> Result<bool, StoreError> {
    let (chunk, trend) = (first(store, "chunks")?, first(store, "trends")?);
    match (chunk, trend) {
        (Some(start), _) if (start as f64) < now - DAY_S => thin(store, start)?,
        (_, Some(start)) => drop_trends(store, start)?,
        (Some(start), None) => drop_chunks(store, start)?,
        (None, None) => return Ok(drop_diagnoses(store, f64::INFINITY)? > 0),
    }
    Ok(true)
}

/// Start of the oldest row of a table.
fn first(store: &Store, table: &str) -> Result<Option<i64>, StoreError> {
    let oldest: Option<i64> =
        store.db.query_row(&format!("SELECT min(key) FROM {table}"), [], |row| row.get(0))?;
    Ok(oldest.map(|key| start_and_tag(key).0))
}

fn drop_trends(store: &mut Store, start: i64) -> Result<(), StoreError> {
    store
        .db
        .execute("DELETE FROM trends WHERE key BETWEEN ?1 AND ?2", [key(start, 0), key(start, MAX_TAG)])?;
    Ok(())
}

fn drop_chunks(store: &mut Store, start: i64) -> Result<(), StoreError> {
    {
        let mut going =
            store.db.prepare_cached("SELECT key, samples FROM chunks WHERE key BETWEEN ?1 AND ?2")?;
        let mut rows = going.query([key(start, 0), key(start, MAX_TAG)])?;
        while let Some(row) = rows.next()? {
            let (start, tag) = start_and_tag(row.get(0)?);
            let Some(samples) = codec::decode(row.get_ref(1)?.as_blob().unwrap_or_default()) else {
                store.damaged += 1;
                return Err(damaged(start, tag));
            };
            store.dropped += samples.len() as u64;
        }
    }
    store
        .db
        .execute("DELETE FROM chunks WHERE key BETWEEN ?1 AND ?2", [key(start, 0), key(start, MAX_TAG)])?;
    Ok(())
}

/// Runs and models that ended before a time, the latest of each loop left.
fn drop_diagnoses(store: &mut Store, before: f64) -> Result<usize, StoreError> {
    let runs = format!(
        "DELETE FROM diagnoses WHERE id IN (SELECT id FROM diagnoses AS own WHERE finished < ?1 AND {OLD_RUN}
         ORDER BY finished LIMIT ?2)"
    );
    let runs = store.db.execute(&runs, params![before, ROWS])?;
    let models =
        store.db.execute(&format!("DELETE FROM models WHERE since < ?1 AND {OLD_MODEL}"), [before])?;
    Ok(runs + models)
}

/// One point as it is gathered.
#[derive(Clone, Copy)]
struct Gathered {
    least: f64,
    most: f64,
    sum: f64,
    good: u32,
}

/// Turns the chunks of one window into points, and deletes them.
fn thin(store: &mut Store, start: i64) -> Result<(), StoreError> {
    let from = start.div_euclid(WINDOW) * WINDOW;
    let trend_s = i64::from(store.config.trend_s).max(1);
    let keeps = store.config.trend_days > 0.0;
    let ends = [key(from, 0), key(from + WINDOW, 0) - 1];
    let mut dropped = 0;
    let thinned = beyond(&mut store.db, store.config.max_mb, |thinning| {
        let mut gathered: BTreeMap<(u32, i64), Gathered> = BTreeMap::new();
        {
            let mut chunks =
                thinning.prepare_cached("SELECT key, samples FROM chunks WHERE key BETWEEN ?1 AND ?2")?;
            let mut rows = chunks.query(ends)?;
            while let Some(row) = rows.next()? {
                let (start, tag) = start_and_tag(row.get(0)?);
                match codec::decode(row.get_ref(1)?.as_blob().unwrap_or_default()) {
                    Some(samples) if keeps => gather(&mut gathered, tag, &samples, trend_s),
                    Some(samples) => dropped += samples.len() as u64,
                    None => return Err(damaged(start, tag)),
                }
            }
        }
        // First what goes: a database that is full has its pages for what comes.
        thinning.execute("DELETE FROM chunks WHERE key BETWEEN ?1 AND ?2", ends)?;
        put_points(thinning, gathered)
    });
    match &thinned {
        Ok(()) => store.dropped += dropped,
        Err(error) => store.damaged += u64::from(error.is_damage()),
    }
    thinned
}

fn gather(gathered: &mut BTreeMap<(u32, i64), Gathered>, tag: u32, samples: &[Sample], trend_s: i64) {
    for sample in samples {
        let t = (sample.t as i64).div_euclid(trend_s) * trend_s;
        let nothing = Gathered { least: f64::NAN, most: f64::NAN, sum: 0.0, good: 0 };
        let point = gathered.entry((tag, t)).or_insert(nothing);
        if sample.quality.is_good() && sample.value.is_finite() {
            // `min` and `max` take the number where the other is NaN.
            point.least = point.least.min(sample.value);
            point.most = point.most.max(sample.value);
            point.sum += sample.value;
            point.good += 1;
        }
    }
}

fn put_points(db: &Transaction<'_>, gathered: BTreeMap<(u32, i64), Gathered>) -> Result<(), StoreError> {
    let mut rows: BTreeMap<i64, Vec<Point>> = BTreeMap::new();
    for ((tag, t), Gathered { least, most, sum, good }) in gathered {
        let row = key(t.div_euclid(TREND_SPAN) * TREND_SPAN, tag);
        rows.entry(row).or_default().push(Point { t: t as f64, least, mean: sum / f64::from(good), most });
    }
    for (key, points) in rows {
        let there: Option<Vec<u8>> = db
            .prepare_cached("SELECT points FROM trends WHERE key = ?1")?
            .query_row([key], |row| row.get(0))
            .optional()?;
        let mut all = match there.as_deref() {
            None => Vec::new(),
            // What is damaged is not written over: nobody would ever know of it.
            Some(blob) => decode_points(blob).ok_or_else(|| damaged_trend(key))?,
        };
        all.extend(points);
        // A point made of more samples, those that came late being few, was made first.
        all.sort_by(|a, b| a.t.total_cmp(&b.t));
        all.dedup_by(|later, first| later.t == first.t);
        db.prepare_cached("INSERT OR REPLACE INTO trends (key, points) VALUES (?1, ?2)")?
            .execute(params![key, encode_points(&all)])?;
    }
    Ok(())
}

/// A row of trends whose bytes are not what was written.
fn damaged_trend(key: i64) -> StoreError {
    let (start, tag) = start_and_tag(key);
    StoreError::Damaged(format!("trend {start} of tag {tag}: the bytes are damaged"))
}

/// Gives pages back that nothing will soon fill again.
fn shrink(store: &Store) -> Result<(), StoreError> {
    let free: i64 = store.db.pragma_query_value(None, "freelist_count", |row| row.get(0))?;
    let pages: i64 = store.db.pragma_query_value(None, "page_count", |row| row.get(0))?;
    if free > SPARE_PAGES && free > pages / 4 {
        let mut vacuum = store.db.prepare("PRAGMA incremental_vacuum(1000)")?;
        let mut pages = vacuum.query([])?;
        // Each step gives back one page.
        while pages.next()?.is_some() {}
    }
    Ok(())
}

#[cfg(test)]
mod tests;
