//! The write-ahead log: when it is carried over into the database, and what is noted then.

use super::frames::log_of;
use super::ledger;
use super::write::{Store, lock_of};
use crate::store::StoreError;
use std::fs;
use std::time::{Duration, Instant};

/// Time after which it is carried over however short it is: the journal's pages are used anew each minute, and what was
/// overwritten meanwhile is carried over once.
const LOG_TIME: Duration = Duration::from_secs(60);

impl Store {
    /// Carries the log over into the database when it is time.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], also where somebody else has come upon it; [`StoreError::Gone`]; any other, then it is carried over
    /// the next time.
    pub fn carry_over_when_due(&mut self) -> Result<(), StoreError> {
        if let Some(why) = ledger::marked(&self.config.folder) {
            return Err(StoreError::Damaged(why));
        }
        lock_of(&self.ledger).is_there()?;
        let frames = lock_of(&self.ledger).frames();
        if frames >= self.config.upkeep.log || frames > 0 && self.carried.elapsed() >= LOG_TIME {
            self.carry_over()?;
        }
        Ok(())
    }

    /// Carries the log over, notes what every page is now, and compares some that were noted before.
    pub(super) fn carry_over(&mut self) -> Result<(), StoreError> {
        self.carried = Instant::now();
        let mut ledger = lock_of(&self.ledger);
        let log = ledger.log()?;
        ledger.before_carrying(&log.pages)?;
        let carry = |how: &str| {
            self.db.query_row(&format!("PRAGMA wal_checkpoint({how})"), [], |row| {
                Ok((row.get::<_, i64>(0)?, row.get::<_, i64>(1)?, row.get::<_, i64>(2)?))
            })
        };
        // Who reads may hold some of it back: then it is carried over the next time.
        let (busy, frames, done) = carry("PASSIVE")?;
        if busy != 0 || frames != done {
            return Ok(());
        }
        ledger.carried_over(log)?;
        // One that is not cut, because of who reads, is written over from its begin or goes on.
        let _ = carry("TRUNCATE");
        ledger.look()
    }

    /// Bytes of the log that is not carried over yet.
    pub fn log_bytes(&self) -> u64 {
        fs::metadata(log_of(&self.config.folder)).map_or(0, |file| file.len())
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        // What is not carried over now is in the log at the next start, and of one that is damaged it stays there. What another
        // database has in its place is none of ours.
        let is_whole = ledger::marked(&self.config.folder).is_none();
        let is_there = lock_of(&self.ledger).is_there().is_ok();
        if is_whole
            && is_there
            && let Err(error) = self.carry_over()
        {
            tracing::warn!(%error, "the store's log is carried over at the next start");
        }
    }
}
