//! Whether a store is whole: the database's own check, every blob, and the chain of each alarm's history.

use super::read::{Reader, decode_points};
use super::{StoreError, codec, rows, start_and_tag};
use std::collections::HashMap;
use std::path::Path;

/// Rows read in one go.
const ROWS: i64 = 1000;
/// Faults of the database that are named.
const FAULTS: usize = 20;

/// What was found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checked {
    /// Version of the tables.
    pub version: i64,
    /// Tags.
    pub tags: usize,
    /// Samples in full.
    pub samples: u64,
    /// Bytes of their chunks.
    pub sample_bytes: u64,
    /// First and last start of a chunk (s).
    pub span: Option<(i64, i64)>,
    /// Points of trends.
    pub points: u64,
    /// Runs.
    pub diagnoses: u64,
    /// Things that happened to alarms.
    pub transitions: u64,
    /// Everything wrong, a line each; empty when the store is whole.
    pub faults: Vec<String>,
}

/// Reads the whole store, in bounded memory.
///
/// # Errors
/// [`StoreError`] when it cannot be read at all.
pub fn check(folder: &Path) -> Result<Checked, StoreError> {
    let mut reader = Reader::open(folder)?;
    let mut found = Checked { version: super::schema::version(reader.database())?, ..Checked::default() };
    {
        let mut pragma = reader.database().prepare(&format!("PRAGMA integrity_check({FAULTS})"))?;
        let lines = pragma.query_map([], |row| row.get::<_, String>(0))?;
        for line in lines {
            let line = line?;
            if line != "ok" {
                found.faults.push(format!("database: {line}"));
            }
        }
    }
    found.tags = reader.tags()?.len();
    samples(&mut reader, &mut found)?;
    trends(&reader, &mut found)?;
    diagnoses(&reader, &mut found)?;
    transitions(&reader, &mut found)?;
    Ok(found)
}

fn samples(reader: &mut Reader, found: &mut Checked) -> Result<(), StoreError> {
    let mut damaged = Vec::new();
    blobs(reader, "chunks", "samples", |key, blob| {
        found.sample_bytes += blob.len() as u64;
        let (start, tag) = start_and_tag(key);
        match codec::decode(blob) {
            Some(samples) if samples.windows(2).all(|pair| pair[0].t < pair[1].t) => {
                found.samples += samples.len() as u64;
            }
            Some(_) => damaged.push(format!("chunk {start} of tag {tag}: samples out of order or twice")),
            None => damaged.push(format!("chunk {start} of tag {tag}: the bytes are damaged")),
        }
        let (first, last) = found.span.unwrap_or((start, start));
        found.span = Some((first.min(start), last.max(start)));
    })?;
    let mut open = reader.database().prepare("SELECT seq, start, frame FROM journal ORDER BY seq")?;
    let mut rows = open.query([])?;
    while let Some(row) = rows.next()? {
        let start: i64 = row.get(1)?;
        match codec::decode_frame(row.get_ref(2)?.as_blob().unwrap_or_default()) {
            Some(samples) => found.samples += samples.len() as u64,
            None => damaged.push(format!("journal, row {}: the bytes are damaged", row.get::<_, i64>(0)?)),
        }
        let (first, last) = found.span.unwrap_or((start, start));
        found.span = Some((first.min(start), last.max(start)));
    }
    found.faults.extend(damaged);
    Ok(())
}

fn trends(reader: &Reader, found: &mut Checked) -> Result<(), StoreError> {
    blobs(reader, "trends", "points", |key, blob| {
        let (start, tag) = start_and_tag(key);
        match decode_points(blob) {
            Some(points) => found.points += points.len() as u64,
            None => found.faults.push(format!("trend {start} of tag {tag}: the bytes are damaged")),
        }
    })
}

/// Every blob of a table, some rows at a time.
fn blobs(
    reader: &Reader,
    table: &str,
    column: &str,
    mut each: impl FnMut(i64, &[u8]),
) -> Result<(), StoreError> {
    let sql = format!("SELECT key, {column} FROM {table} WHERE key > ?1 ORDER BY key LIMIT ?2");
    let mut query = reader.database().prepare(&sql)?;
    let mut after = -1;
    loop {
        let (mut rows, before) = (query.query([after, ROWS])?, after);
        while let Some(row) = rows.next()? {
            after = row.get(0)?;
            each(after, row.get_ref(1)?.as_blob().unwrap_or_default());
        }
        if after == before {
            return Ok(());
        }
    }
}

fn diagnoses(reader: &Reader, found: &mut Checked) -> Result<(), StoreError> {
    let mut after = 0;
    loop {
        let some = reader.diagnoses(after, ROWS as usize)?;
        let Some((last, _)) = some.last() else { return Ok(()) };
        after = *last;
        for (_, row) in &some {
            found.diagnoses += 1;
            if row.report.as_deref().is_some_and(|report| rows::unpack(report).is_none()) {
                found.faults.push(format!(
                    "diagnosis of {} at {}: the report is damaged",
                    row.control_loop, row.finished
                ));
            }
        }
    }
}

/// Each alarm begins where it was left.
fn transitions(reader: &Reader, found: &mut Checked) -> Result<(), StoreError> {
    let mut state: HashMap<(String, String), String> = HashMap::new();
    let mut after = 0;
    loop {
        let some = reader.transitions(after, ROWS as usize)?;
        let Some((last, _)) = some.last() else { return Ok(()) };
        after = *last;
        for (_, row) in some {
            found.transitions += 1;
            let before = state.insert((row.control_loop.clone(), row.kind.clone()), row.after);
            if before.as_ref().is_some_and(|before| *before != row.before) {
                let left = before.unwrap_or_default();
                found.faults.push(format!(
                    "alarm of {} ({}) at {}: it goes on from {}, and was left {left}",
                    row.control_loop, row.kind, row.at, row.before
                ));
            }
        }
    }
}
