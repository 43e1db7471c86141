//! What outlives a restart: samples, diagnoses, models, alarms. One writer, any number of readers.
//!
//! ```text
//! rings --sample--> journal (the open chunks, one row a second) --roll, once a chunk--> chunks --thin--> trends
//! results --change--> diagnoses, models, alarms, transitions
//! ```
//!
//! # Where
//! By default in a folder, in the `embedded` SQLite database. With `[store] url` in PostgreSQL: then the folder holds the spool, a
//! store of its own in which everything waits, durable and in order, while that database is away.
//!
//! # What is guaranteed
//! - What [`Store::write`] said `Ok` to is there after `kill -9` and after a power failure (write-ahead log, synchronous
//!   FULL: each commit waits for the disk). A batch is there whole or not at all.
//! - Nothing is there twice: the key of a sample is tag and stamp, of a run loop and time. Writing again changes nothing;
//!   only a good sample takes the place of one that is not.
//! - A blob that was damaged on disk is noticed by its checksum and left out, never read as something else, and never written
//!   over: the store fails until somebody decides.
//! - The database stays below [`Config::max_mb`]; what waits to be written is bounded too.
//! - A clock that is set back begins another era: its samples never mix with those that were stamped before.
//!
//! # What it costs
//! `docs/store.md` has numbers: processor, bytes a sample, bytes written for each byte kept.

mod age;
pub mod archive;
mod backend;
mod bits;
mod check;
pub mod codec;
mod config;
mod embedded;
mod postgresql;
mod rows;
mod sides;
mod walk;
mod writer;

pub use backend::{Beat, Found, Opener, Point, Reader, Spool, Store, StoredTag, Usage, Writes};
pub use check::{Checked, Repaired, check, check_of, finish_repair, renew, repair};
pub use config::{Config, Upkeep};
pub use rows::{AlarmRow, Batch, DiagnosisRow, ModelRow, Row, Series, TagName, TransitionRow, pack, unpack};
pub use walk::first_start;
pub use writer::{Driven, Feed, Flusher, Status, Writer};

use std::io;
use std::path::{Path, PathBuf};

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
    /// The folder for what waits for PostgreSQL is a store of its own, of which a part would be deleted instead of delivered.
    #[error(
        "{folder}: this folder is a store of its own, with {what}: PostgreSQL would not get all of it; {remedy}, see \
         docs/store.md"
    )]
    OwnStore {
        /// Which.
        folder: PathBuf,
        /// What would be deleted.
        what: String,
        /// What can be done.
        remedy: &'static str,
    },
    /// The database was made by a later version.
    #[error("the store has version {0}, made by a later stictiond than this, which reads up to {max}", max = embedded::VERSION)]
    TooNew(i64),
    /// The database that is open was moved or deleted, or another was put in its place.
    #[error("{path}: the database that was written to is no longer there")]
    Gone {
        /// Where it was.
        path: PathBuf,
        /// What its ledger said last, as a checksum: by that it is known when it is back.
        ledger: u32,
    },
    /// More tags than keys have room for.
    #[error("the store has as many tags as fit")]
    TooManyTags,
    /// The database failed.
    #[error("the store's database: {0}{hint}", hint = hint(.0))]
    Database(#[from] rusqlite::Error),
    /// What is on disk is not what was written: nothing is written until somebody decides.
    #[error(
        "the store is damaged: {0}; nothing is written until `stictiond store check --repair` has made a new one of what is left"
    )]
    Damaged(String),
    /// PostgreSQL cannot be reached, or does not let us in.
    #[error("PostgreSQL: {0}")]
    Away(String),
    /// PostgreSQL refused what it was asked.
    #[error("PostgreSQL: {}", postgresql::said(.0))]
    Refused(#[from] tokio_postgres::Error),
}

fn hint(error: &rusqlite::Error) -> &'static str {
    use rusqlite::ErrorCode::{DatabaseCorrupt, DiskFull, NotADatabase};
    match error.sqlite_error_code() {
        Some(DiskFull) => "; free some room, or lower [store] max_mb",
        Some(DatabaseCorrupt | NotADatabase) => DAMAGED,
        _ if is_read_error(error) => DAMAGED,
        _ => "",
    }
}

/// What can be done about a database that is damaged.
const DAMAGED: &str =
    "; `stictiond store check` says what is damaged, with `--repair` it makes a new one of what is left";

/// Whether a part of a file cannot be read, as on a sector that has gone bad. A write that fails is none, nor is a disk that is full:
/// what was written before is still there.
fn is_read_error(error: &rusqlite::Error) -> bool {
    use rusqlite::ffi::{
        SQLITE_IOERR_CORRUPTFS, SQLITE_IOERR_DATA, SQLITE_IOERR_READ, SQLITE_IOERR_SHORT_READ,
    };
    let codes = [SQLITE_IOERR_READ, SQLITE_IOERR_SHORT_READ, SQLITE_IOERR_DATA, SQLITE_IOERR_CORRUPTFS];
    error.sqlite_extended_error_code().is_some_and(|code| codes.contains(&code))
}

impl StoreError {
    /// Whether the disk, or the room the store may take on it, is full.
    pub fn is_full(&self) -> bool {
        matches!(self, Self::Database(e) if e.sqlite_error_code() == Some(rusqlite::ErrorCode::DiskFull))
    }

    /// Whether what is on disk is not what was written, or cannot be read.
    pub fn is_damage(&self) -> bool {
        use rusqlite::ErrorCode::{DatabaseCorrupt, NotADatabase};
        let code = |error: &rusqlite::Error| error.sqlite_error_code();
        match self {
            Self::Damaged(_) => true,
            Self::Database(error) => {
                matches!(code(error), Some(DatabaseCorrupt | NotADatabase)) || is_read_error(error)
            }
            _ => false,
        }
    }

    /// What is damaged, where that is why.
    pub fn damage(&self) -> Option<String> {
        match self {
            Self::Damaged(why) => Some(why.clone()),
            error => error.is_damage().then(|| error.to_string()),
        }
    }

    fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}

/// Has the store in a folder fail, over restarts too, until somebody decides what becomes of it.
pub fn mark_damaged(config: &Config, why: &str) -> StoreError {
    embedded::mark(&config.folder, why);
    StoreError::Damaged(why.to_string())
}

/// Has the store in a folder fail where whoever reads it comes upon damage: nobody else may have read there since it was opened.
pub fn heed(config: &Config, error: &StoreError) {
    if let Some(why) = error.damage() {
        embedded::mark(&config.folder, &why);
    }
}

/// As [`heed`], of so many blobs of samples that a reader had to leave out.
pub fn heed_blobs(config: &Config, blobs: u64) {
    if blobs > 0 {
        embedded::mark(&config.folder, &format!("{blobs} blobs of samples are damaged"));
    }
}

/// Whether the store in a folder is known to be damaged, and nobody has decided yet.
pub fn is_damaged(config: &Config) -> bool {
    embedded::marked(&config.folder).is_some()
}

/// First whole second of the chunk of `length` seconds that holds `t`; `None` for a time that no key holds.
fn start_of(t: f64, length: u32) -> Option<i64> {
    // 2^38 s after the epoch is the year 10680.
    let fits = (0.0..274_877_906_944.0).contains(&t);
    fits.then(|| (t as i64).div_euclid(i64::from(length)) * i64::from(length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rusqlite::ffi;

    #[test]
    fn what_cannot_be_read_is_damage_and_what_cannot_be_written_is_none() {
        let of = |code| StoreError::Database(rusqlite::Error::SqliteFailure(ffi::Error::new(code), None));
        let damage = [
            ffi::SQLITE_CORRUPT,
            ffi::SQLITE_NOTADB,
            ffi::SQLITE_IOERR_READ,
            ffi::SQLITE_IOERR_SHORT_READ,
            ffi::SQLITE_IOERR_DATA,
            ffi::SQLITE_IOERR_CORRUPTFS,
        ];
        for code in damage {
            let error = of(code);
            assert!(
                error.is_damage() && error.damage().is_some_and(|why| why.contains("--repair")),
                "{error}"
            );
        }
        let none = [
            ffi::SQLITE_FULL,
            ffi::SQLITE_BUSY,
            ffi::SQLITE_CANTOPEN,
            ffi::SQLITE_NOMEM,
            ffi::SQLITE_IOERR,
            ffi::SQLITE_IOERR_WRITE,
            ffi::SQLITE_IOERR_FSYNC,
            ffi::SQLITE_IOERR_TRUNCATE,
            ffi::SQLITE_IOERR_LOCK,
            ffi::SQLITE_IOERR_NOMEM,
        ];
        for code in none {
            assert!(!of(code).is_damage(), "{}", of(code));
        }
        assert!(of(ffi::SQLITE_FULL).is_full());
    }
}
