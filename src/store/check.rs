//! Whether a store is whole: what its database says of itself, every report, the chain of each alarm's history, and the files
//! beside the database.

use super::{Config, Reader, StoreError, age, embedded, rows};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Rows read in one go.
const ROWS: usize = 1000;

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
    /// How many of the faults are of files beside the database that [`renew`] makes anew.
    pub renewable: usize,
    /// Of one that is damaged: what a repair would keep, and what it would give up.
    pub left: Option<String>,
}

/// What a repair has done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repaired {
    /// What was kept, and what was given up.
    pub left: String,
    /// Where the damaged files are.
    pub aside: PathBuf,
}

/// Makes a new store of what is left of one in a folder that is damaged; it must not be in use.
///
/// # Errors
/// [`StoreError`]; then it stays as it is.
pub fn repair(config: &Config) -> Result<Repaired, StoreError> {
    let (loss, aside) = embedded::repair(config)?;
    age::drop_damaged(&config.folder)?;
    Ok(Repaired { left: loss.to_string(), aside })
}

/// Ends a repair that was interrupted once its new store was whole; the store must not be in use. Where the damaged files are then;
/// `None` where there was no such repair.
///
/// # Errors
/// [`StoreError`]; then it is still to be ended.
pub fn finish_repair(config: &Config) -> Result<Option<PathBuf>, StoreError> {
    embedded::finish_repair(config)
}

/// Makes the damaged files beside the database of a store in a folder anew: the second copy of the states from the database, and
/// the time by which age is measured from the clock. The store must not be in use, and its database must be whole.
///
/// # Errors
/// [`StoreError`].
pub fn renew(config: &Config) -> Result<(), StoreError> {
    // Whoever opens it writes the second copy.
    let held = embedded::Store::open(config)?;
    age::drop_damaged(&config.folder)?;
    drop(held);
    Ok(())
}

/// Reads the whole store in a folder, in bounded memory.
///
/// # Errors
/// [`StoreError`] when it cannot be read at all.
pub fn check(folder: &Path) -> Result<Checked, StoreError> {
    check_of(&Config::new(folder))
}

/// Reads the whole store that is configured, in bounded memory.
///
/// # Errors
/// [`StoreError`] when it cannot be read at all.
pub fn check_of(config: &Config) -> Result<Checked, StoreError> {
    let mut reader = Reader::looked_at(config)?;
    let mut found = Checked::default();
    if let Some(loss) = reader.loss() {
        found.left = Some(loss.to_string());
        found.faults.push(loss.damage.clone());
    }
    beside(config, reader.loss().is_none(), &mut found)?;
    reader.examine(&mut found)?;
    diagnoses(&reader, &mut found)?;
    transitions(&reader, &mut found)?;
    Ok(found)
}

/// The files beside the database of a store in a folder, and what becomes of those that are damaged.
fn beside(config: &Config, database_is_whole: bool, found: &mut Checked) -> Result<(), StoreError> {
    if config.url.is_some() {
        return Ok(());
    }
    let embedded::Beside { copy, age } = embedded::beside(&config.folder)?;
    let anew = "; no state is lost: the next start, or `--repair`, writes it anew from the database";
    let of_copy = if database_is_whole { anew } else { "" };
    let told = [
        copy.map(|fault| fault + of_copy),
        age.map(|fault| fault + "; the next start, or `--repair`, begins it anew at the clock"),
    ];
    let before = found.faults.len();
    found.faults.extend(told.into_iter().flatten());
    found.renewable = found.faults.len() - before;
    Ok(())
}

fn diagnoses(reader: &Reader, found: &mut Checked) -> Result<(), StoreError> {
    let mut after = 0;
    loop {
        let some = reader.diagnoses(after, ROWS)?;
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
        let some = reader.transitions(after, ROWS)?;
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
