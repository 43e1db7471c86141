//! Whether the database is whole: its own check, and every blob; and the files beside it that are made of it.

use super::read::{Reader, decode_points};
use super::{repair, schema, second, start_and_tag, write};
use crate::store::backend::Reads;
use crate::store::{Checked, StoreError, age, codec};
use std::path::Path;
use std::time::Duration;

/// Rows read in one go.
const ROWS: i64 = 1000;
/// Faults of the database that are named.
const FAULTS: usize = 20;
/// Times that a fault beside a writer is looked at again, for the files are not read in one moment.
const LOOKS: usize = 10;

/// What lies beside a database and can be made anew, as far as it is damaged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::store) struct Beside {
    /// What the second copy of the states lacks.
    pub copy: Option<String>,
    /// The time by which age is measured.
    pub age: Option<String>,
}

/// Looks at what lies beside the database; a writer may be at work meanwhile.
///
/// # Errors
/// [`StoreError::Io`] where a file that is there cannot be opened.
pub(in crate::store) fn beside(folder: &Path) -> Result<Beside, StoreError> {
    // A repair that was interrupted has the copy of the damaged database there, or none.
    let copy = || if repair::unfinished(folder).is_some() { Ok(None) } else { second::lacking(folder) };
    let look = || -> Result<Beside, StoreError> { Ok(Beside { copy: copy()?, age: age::fault(folder) }) };
    let mut found = look()?;
    for _ in 0..LOOKS {
        if found == Beside::default() || !write::is_in_use(folder) {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
        found = look()?;
    }
    Ok(found)
}

pub(super) fn examine(reader: &mut Reader, found: &mut Checked) -> Result<(), StoreError> {
    found.version = schema::version(&reader.database())?;
    {
        let db = reader.database();
        let mut pragma = db.prepare(&format!("PRAGMA integrity_check({FAULTS})"))?;
        let lines = pragma.query_map([], |row| row.get::<_, String>(0))?;
        for line in lines {
            let line = line?;
            if line != "ok" {
                found.faults.push(format!("database: {line}"));
            }
        }
    }
    found.tags = reader.tags()?.len();
    samples(reader, found)?;
    trends(reader, found)
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
    let db = reader.database();
    let mut open = db.prepare("SELECT seq, start, frame FROM journal ORDER BY seq")?;
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
    let db = reader.database();
    let mut query = db.prepare(&sql)?;
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
