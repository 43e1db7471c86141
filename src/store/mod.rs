//! What outlives a restart: samples, diagnoses, models, alarms. One folder, one SQLite database in it, one writer.
//!
//! ```text
//! rings --sample--> journal (the open chunks, one row a second) --roll, once a chunk--> chunks --thin--> trends
//! results --change--> diagnoses, models, alarms, transitions
//! ```
//!
//! # Layout
//! A chunk holds [`Config::chunk_s`] seconds of one tag as one blob (see [`codec`]); its key is `start << 24 | tag`, so that
//! all tags of a minute lie side by side and are appended. Rows by (tag, time) cost 400 times the writing, for every
//! sample then touches a page of its own. Until a chunk is over its samples lie in `journal`, one row for all tags each
//! [`Config::sync_ms`]; in one transaction they move to `chunks`. Late samples are merged into the chunk they belong to.
//!
//! # What is guaranteed
//! - What [`Store::write`] said `Ok` to is there after `kill -9` and after a power failure (write-ahead log, synchronous
//!   FULL: each commit waits for the disk). A batch is there whole or not at all.
//! - Nothing is there twice: the key of a sample is tag and stamp, of a run loop and time. Writing again changes nothing;
//!   only a good sample takes the place of one that is not.
//! - A blob that was damaged on disk is noticed by its checksum and left out, never read as something else.
//! - The database stays below [`Config::max_mb`]; what waits to be written is bounded too.
//! - A clock that is set back begins another era: its samples never mix with those that were stamped before.
//!
//! # What it costs
//! `docs/store.md` has numbers: processor, bytes a sample, bytes written for each byte kept.

pub mod archive;
mod bits;
mod check;
pub mod codec;
mod config;
mod read;
mod retain;
mod rows;
mod schema;
mod write;
mod writer;

pub use check::{Checked, check};
pub use config::Config;
pub use read::{Point, Reader, StoredTag};
pub use rows::{AlarmRow, Batch, DiagnosisRow, ModelRow, Row, Series, TagName, TransitionRow, pack, unpack};
pub use write::{Store, Usage};
pub use writer::{Feed, Status, Writer};

use std::io;
use std::path::{Path, PathBuf};

/// The database in the folder.
const DATABASE: &str = "store.db";
/// Held while somebody writes.
const LOCK: &str = "lock";
/// `PRAGMA application_id`: ours, so that no other program's database is written to.
const APPLICATION: i64 = 0x5374_6963;
/// Tags that fit into a key.
const MAX_TAG: u32 = (1 << TAG_BITS) - 1;
const TAG_BITS: u32 = 24;
/// Time that one row of trends spans (s).
const TREND_SPAN: i64 = 3600;
/// The longest chunk that any configuration makes (s).
const MAX_CHUNK: i64 = 600;

/// Why the store does not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The folder or a file in it cannot be used.
    #[error("{path}: {source}")]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Another process writes to it.
    #[error("{0}: in use by another process; a running stictiond must be stopped first")]
    InUse(PathBuf),
    /// There is no store in the folder.
    #[error("{0}: there is no store")]
    Missing(PathBuf),
    /// The database is another program's.
    #[error("{0}: not a store of stictiond")]
    Foreign(PathBuf),
    /// The database was made by a later version.
    #[error("the store has version {0}, made by a later stictiond than this, which reads up to {max}", max = schema::VERSION)]
    TooNew(i64),
    /// More tags than keys have room for.
    #[error("the store has {MAX_TAG} tags, no more fit")]
    TooManyTags,
    /// The database failed.
    #[error("the store's database: {0}{hint}", hint = hint(.0))]
    Database(#[from] rusqlite::Error),
}

fn hint(error: &rusqlite::Error) -> &'static str {
    use rusqlite::ErrorCode::{DatabaseCorrupt, DiskFull, NotADatabase};
    match error.sqlite_error_code() {
        Some(DiskFull) => "; free some room, or lower [store] max_mb",
        Some(DatabaseCorrupt | NotADatabase) => {
            "; `stictiond store check` says what is damaged; to begin anew, move the folder away"
        }
        _ => "",
    }
}

impl StoreError {
    /// Whether the disk, or the room the store may take on it, is full.
    pub fn is_full(&self) -> bool {
        matches!(self, Self::Database(e) if e.sqlite_error_code() == Some(rusqlite::ErrorCode::DiskFull))
    }

    fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}

/// First whole second of the chunk of `length` seconds that holds `t`; `None` for a time that no key holds.
fn start_of(t: f64, length: u32) -> Option<i64> {
    // 2^38 s after the epoch is the year 10680.
    let fits = (0.0..274_877_906_944.0).contains(&t);
    fits.then(|| (t as i64).div_euclid(i64::from(length)) * i64::from(length))
}

fn key(start: i64, tag: u32) -> i64 {
    start << TAG_BITS | i64::from(tag)
}

fn start_and_tag(key: i64) -> (i64, u32) {
    (key >> TAG_BITS, (key & i64::from(MAX_TAG)) as u32)
}

#[cfg(test)]
mod tests;
