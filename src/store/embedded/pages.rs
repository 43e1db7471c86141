//! The pages of a database that is damaged, read from its files one at a time: from the log where that has the page, else from
//! the database. Only which pages are not what was written, and where the log has a page, is held in memory: what a store holds
//! may be far larger than that.
//!
//! The log's frame of a page was made from the page as the database had it then. Where that had become something else, the
//! frame has what a transaction put there, and beside it what the page had become. So a page of the log is good only where the
//! database has what was noted of it, or what a frame of the log holds, which a process that was killed may have carried over.
//! A page that a power failure has torn while it was carried over cannot be told from one that had become something else.

use super::DATABASE;
use super::frames::{self, Log, log_of};
use super::ledger::{self, Damage};
use super::write::PAGE_BYTES;
use crate::store::StoreError;
use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Bound::{Excluded, Unbounded};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// A page as it was found.
#[derive(Debug)]
pub(super) struct Page {
    pub bytes: Vec<u8>,
    /// It is what was written.
    pub good: bool,
    /// It is of the log, behind something that is damaged or of a commit that is not whole: it was not in force together with
    /// the others.
    pub late: bool,
}

/// Every page as the database last had it, by its number from 1 on.
#[derive(Debug)]
pub(super) struct Pages {
    database: Option<File>,
    /// Pages of the database's file.
    length: u32,
    /// Those of them that are not what was written, in order.
    bad: Vec<u32>,
    log: Option<File>,
    salts: [u8; 8],
    /// Frames up to the last commit behind which nothing is damaged: what comes later is late.
    in_force: u32,
    /// Pages of the log, and the frames of each in order.
    frames: BTreeMap<u32, Vec<u32>>,
    /// Those of them that were made from something else than what was written, in order.
    rotten: Vec<u32>,
}

impl Pages {
    /// Those of a store in a folder in which damage was found.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn of(folder: &Path, found: &Damage) -> Result<Self, StoreError> {
        let (path, of_log) = (folder.join(DATABASE), log_of(folder));
        let (database, log) = (ledger::existing(&path)?, ledger::existing(&of_log)?);
        let length = match &database {
            Some(file) => file.metadata().map_err(StoreError::io(&path))?.len() / PAGE_BYTES,
            None => 0,
        };
        let whole = Log::read(&of_log).map_err(StoreError::io(&of_log))?;
        let mut frames: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        if !ledger::is_carried_over(folder, &whole)? {
            Log::frames(&of_log, true, |frame, page| {
                // There is no page 0: where one is named the frame is not one of the log.
                if page > 0 {
                    frames.entry(page).or_default().push(frame);
                }
            })
            .map_err(StoreError::io(&of_log))?;
        }
        let mut rotten = Vec::new();
        if let (Some(database), Some(log)) = (&database, &log) {
            rotten = ledger::unlike_noted(folder, database, &whole, frames.keys().copied())?;
            rotten.retain(|page| {
                // One that cannot be read could not be read by a transaction either: its frame is of before.
                page_of(database, *page).is_some_and(|own| {
                    let held = |frame: &u32| frames::page_in(log, *frame, *page, whole.salts);
                    frames.get(page).is_none_or(|all| all.iter().filter_map(held).all(|bytes| bytes != own))
                })
            });
        }
        Ok(Self {
            database,
            length: u32::try_from(length).unwrap_or(u32::MAX),
            bad: found.pages.clone(),
            log,
            salts: whole.salts,
            in_force: whole.frames,
            frames,
            rotten,
        })
    }

    /// Numbers of the pages that there are, in order.
    pub fn numbers(&self) -> impl Iterator<Item = u32> {
        (1..=self.length).chain(self.behind())
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.length as usize + self.behind().count()
    }

    /// Pages of the log behind the end of the database.
    fn behind(&self) -> impl Iterator<Item = u32> {
        self.frames.range((Excluded(self.length), Unbounded)).map(|(page, _)| *page)
    }

    /// A page; `None` where there is none, or it cannot be read.
    pub fn get(&self, number: u32) -> Option<Page> {
        self.in_log(number).or_else(|| self.in_database(number))
    }

    fn in_log(&self, number: u32) -> Option<Page> {
        let frame = *self.frames.get(&number)?.last()?;
        let bytes = frames::page_in(self.log.as_ref()?, frame, number, self.salts)?;
        let good = self.rotten.binary_search(&number).is_err();
        Some(Page { bytes, good, late: frame > self.in_force })
    }

    fn in_database(&self, number: u32) -> Option<Page> {
        let bytes = page_of(self.database.as_ref()?, number)?;
        Some(Page { bytes, good: self.bad.binary_search(&number).is_err(), late: false })
    }
}

/// A page of the database, whatever the log has of it; `None` where there is none, or it cannot be read.
fn page_of(database: &File, number: u32) -> Option<Vec<u8>> {
    let mut bytes = vec![0; PAGE_BYTES as usize];
    database.read_exact_at(&mut bytes, u64::from(number.checked_sub(1)?) * PAGE_BYTES).ok()?;
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::backend::{Reads, Writes};
    use crate::store::embedded::tests::Folder;
    use crate::store::embedded::{Reader, Store, mark};
    use crate::store::{Batch, DiagnosisRow, Row};
    use std::fs::OpenOptions;

    /// A run of a loop, which only the database has.
    fn run(control_loop: &str) -> Batch {
        let row = DiagnosisRow {
            control_loop: control_loop.into(),
            reason: "nothing is the matter".into(),
            ..DiagnosisRow::default()
        };
        Batch { series: Vec::new(), rows: vec![Row::Diagnosis(row)] }
    }

    fn root(store: &Store, name: &str) -> u32 {
        let sql = "SELECT rootpage FROM sqlite_schema WHERE name = ?1";
        store.db.query_row(sql, [name], |row| row.get(0)).expect("there is one")
    }

    fn opened(folder: &Folder) -> File {
        OpenOptions::new().read(true).write(true).open(folder.0.join(DATABASE)).expect("there")
    }

    /// Its other rows were read from what it had become: they are no more what was written than before.
    #[test]
    fn a_page_that_is_written_anew_from_a_rotten_one_is_not_believed() {
        let folder = Folder::new();
        let mut store = Store::open(&folder.config()).expect("opens");
        store.write(&run("A")).expect("writes");
        store.carry_over().expect("carried over");
        let [page, other] = ["diagnoses", "diagnoses_finished"].map(|name| root(&store, name));
        let database = opened(&folder);
        let begin = u64::from(page - 1) * PAGE_BYTES;
        let bytes = page_of(&database, page).expect("there");
        let at = bytes.windows(7).position(|own| own == b"nothing").expect("as it was written");
        database.write_all_at(b"the pen", begin + at as u64).expect("writable");
        // Nor does anybody remember the page.
        store.db.execute_batch("PRAGMA shrink_memory").expect("let go");
        store.write(&run("B")).expect("writes");
        let sql = "SELECT count(*) FROM diagnoses WHERE reason = 'the pen is the matter'";
        let read: i64 = store.db.query_row(sql, [], |row| row.get(0)).expect("reads");
        assert_eq!(read, 1, "the transaction has read what it had become");

        let pages = Pages::of(&folder.0, &Damage::default()).expect("can be read");
        assert!([page, other].iter().all(|own| pages.frames.contains_key(own)), "the log has both");
        assert_eq!([page, other].map(|own| pages.get(own).expect("there").good), [false, true]);
        mark(&folder.0, "somebody is to decide");
        let reader = Reader::open(&folder.0).expect("can be read");
        assert!(reader.diagnoses(0, 10).expect("reads").is_empty());
        assert!(reader.loss().is_some_and(|loss| loss.lacking.contains(&"runs")));
    }

    /// A process that was killed may have carried over any frame of the log, not only the last of a page.
    #[test]
    fn a_page_of_which_an_earlier_frame_was_carried_over_is_what_was_written() {
        let folder = Folder::new();
        let mut store = Store::open(&folder.config()).expect("opens");
        let page = root(&store, "diagnoses");
        let database = opened(&folder);
        let pages = || Pages::of(&folder.0, &Damage::default()).expect("can be read");
        store.write(&run("A")).expect("writes");
        let earlier = pages().get(page).expect("there").bytes;
        store.write(&run("B")).expect("writes");
        let is_good = || {
            let found = pages().get(page).expect("there");
            assert_ne!(found.bytes, earlier, "the log has the last of them");
            found.good
        };
        assert!(is_good(), "the database has what was noted");
        let begin = u64::from(page - 1) * PAGE_BYTES;
        database.write_all_at(&earlier, begin).expect("writable");
        assert!(is_good(), "the database has a frame of the log");
        let mut other = earlier.clone();
        other[4000] ^= 1;
        database.write_all_at(&other, begin).expect("writable");
        assert!(!is_good(), "the database has something else");
        database.set_len(begin).expect("cut");
        assert!(is_good(), "nobody could read it");
    }
}
