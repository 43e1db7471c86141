//! The store in a folder: one SQLite database, one writer.
//!
//! A chunk holds [`Config::chunk_s`](super::Config) seconds of one tag as one blob (see [`codec`](super::codec)); its key is
//! `start << 24 | tag`, so that all tags of a minute lie side by side and are appended. Rows by (tag, time) cost 400 times the
//! writing, for every sample then touches a page of its own. Until a chunk is over its samples lie in `journal`, one row for
//! all tags each [`Config::sync_ms`](super::Config); in one transaction they move to `chunks`. Late samples are merged into
//! the chunk they belong to.
//!
//! Beside the database lie its `ledger`, which knows of every page what it must be and of the log (`frames`) how far it must
//! go, and a `second` copy of what nobody could measure again. Of a database that is damaged `salvage` reads what is left, one
//! of its `pages` at a time, by its trees (`tree`) and beside them; `left` shares that among all who read, and `repair` makes a
//! new database of it.

mod check;
mod frames;
mod ledger;
mod left;
mod log;
mod pages;
mod read;
mod repair;
mod retain;
mod room;
mod salvage;
mod schema;
mod second;
mod spool;
mod tree;
mod write;

pub(super) use check::{Beside, beside};
pub(super) use ledger::{ledger_in, mark, marked};
pub(super) use read::Reader;
pub(super) use repair::{finish_repair, repair};
pub(super) use salvage::Loss;
pub(super) use spool::{Part, is_spool};
pub(super) use write::Store;

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
/// Number of this version's tables.
pub(super) const VERSION: i64 = schema::VERSION;

fn key(start: i64, tag: u32) -> i64 {
    start << TAG_BITS | i64::from(tag)
}

fn start_and_tag(key: i64) -> (i64, u32) {
    (key >> TAG_BITS, (key & i64::from(MAX_TAG)) as u32)
}

#[cfg(test)]
pub(super) mod tests;
