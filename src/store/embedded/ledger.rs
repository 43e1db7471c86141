//! What the database must hold, told by somebody else than the database: a checksum of every page, and how far the
//! write-ahead log was acknowledged. SQLite takes a log as far as it fits and a page as it is; so a flipped bit ends the
//! log in silence, and a page that was overwritten is read as empty or as something else.
//!
//! ```text
//! commit     -> ACKNOWLEDGED: salts of the log, frames of it that are durable
//! checkpoint -> SUMS of the pages that the log carried over; then ACKNOWLEDGED: no frames, so many carried over, so many pages
//! ```
//! Each is written after what it tells of is on disk: it never promises more than there is. A page that the log holds is
//! not compared, for the log is what counts of it.
//!
//! Only a checkpoint waits for the disk to have ACKNOWLEDGED: after a power failure it may be as the last checkpoint left it, while
//! the log has more. So a log counts as carried over only as far as it was then: somebody who read may have kept it from being
//! cut, and what came next went behind it.

mod there;

pub(in crate::store) use there::ledger_in;

use super::DATABASE;
use super::frames::{Log, log_of};
use super::write::{self, PAGE_BYTES};
use crate::store::{StoreError, Upkeep};
use std::collections::HashSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Checksums of pages, four bytes each, in the order of the pages.
const SUMS: &str = "store.sum";
/// How far the log was acknowledged.
const ACKNOWLEDGED: &str = "store.ack";
/// What was found damaged: as long as it is there nothing is written.
pub(super) const DAMAGED: &str = "store.damaged";
const MAGIC: &[u8; 8] = b"stictic1";
/// Faults that are named.
const NAMED: usize = 5;

/// How far the log was acknowledged, and how many pages have a checksum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Acknowledged {
    salts: [u8; 8],
    frames: u32,
    pages: u32,
    /// Records of the second copy of the states.
    states: u64,
    /// Frames of the log that the last checkpoint carried over.
    carried: u32,
}

impl Acknowledged {
    const BYTES: usize = 40;

    fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        bytes[..8].copy_from_slice(MAGIC);
        bytes[8..16].copy_from_slice(&self.salts);
        bytes[16..20].copy_from_slice(&self.frames.to_le_bytes());
        bytes[20..24].copy_from_slice(&self.pages.to_le_bytes());
        bytes[24..32].copy_from_slice(&self.states.to_le_bytes());
        bytes[32..36].copy_from_slice(&self.carried.to_le_bytes());
        let sum = crc32fast::hash(&bytes[..36]);
        bytes[36..].copy_from_slice(&sum.to_le_bytes());
        bytes
    }

    fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let sum = crc32fast::hash(bytes.get(..36)?);
        let whole = bytes.len() == Self::BYTES && bytes[..8] == *MAGIC && bytes[36..] == sum.to_le_bytes();
        let number = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?));
        let states = u64::from_le_bytes(bytes[24..32].try_into().ok()?);
        let salts = bytes[8..16].try_into().ok()?;
        whole.then_some(Self { salts, frames: number(16)?, pages: number(20)?, states, carried: number(32)? })
    }

    /// Whether all of a log is in the database too: it was carried over, and nothing was committed behind that.
    fn is_carried_over(&self, log: &Log) -> bool {
        self.frames == 0 && log.salts == self.salts && log.frames <= self.carried
    }
}

/// The files beside a database.
#[derive(Debug)]
pub(super) struct Ledger {
    folder: PathBuf,
    /// Held open as long as the store is: closing a file of the database gives up the process's locks on it.
    database: File,
    sums: File,
    acknowledged: File,
    now: Acknowledged,
    upkeep: Upkeep,
    /// Next page that is looked at beside the work.
    next: u32,
    /// Every page was looked at since the store was opened.
    whole: bool,
    /// Nothing was carried over that is not noted.
    noted: bool,
}

fn open(path: &Path) -> Result<File, StoreError> {
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(path)
        .map_err(StoreError::io(path))
}

/// A file, open for reading; `None` where there is none.
///
/// # Errors
/// [`StoreError::Io`] where it cannot be opened, as without a free descriptor: that says nothing of what it holds.
pub(super) fn existing(path: &Path) -> Result<Option<File>, StoreError> {
    match File::open(path) {
        Ok(file) => Ok(Some(file)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(StoreError::io(path)(error)),
    }
}

/// What can be read of a file; nothing where there is none. What lies behind a part that cannot be read is as good as cut off.
///
/// # Errors
/// As [`existing`].
pub(super) fn contents(path: &Path) -> Result<Vec<u8>, StoreError> {
    let mut bytes = Vec::new();
    if let Some(mut file) = existing(path)? {
        let _ = file.read_to_end(&mut bytes);
    }
    Ok(bytes)
}

/// What was found in the files of a store.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Damage {
    /// In words, one thing each.
    pub faults: Vec<String>,
    /// Pages of the database that are not what they were, in order.
    pub pages: Vec<u32>,
    /// The log lacks something that was acknowledged, or nobody can say whether it does.
    pub log: bool,
}

impl Damage {
    /// In one line.
    pub fn told(&self) -> String {
        let (named, more) = self.faults.split_at(self.faults.len().min(NAMED));
        let rest = if more.is_empty() { String::new() } else { format!("; {} more", more.len()) };
        format!("{}{rest}", named.join("; "))
    }

    fn add(&mut self, fault: String) {
        self.faults.push(fault);
    }

    /// What of it was found the time before too.
    fn confirms(mut self, before: &Self) -> Self {
        // They are in order: a store that is gone may have millions.
        self.pages.retain(|page| before.pages.binary_search(page).is_ok());
        self.faults.retain(|fault| before.faults.iter().any(|other| is_alike(fault, other)));
        self.log &= before.log;
        self
    }
}

/// Whether two faults are the same but for their numbers, which grow beside a writer.
fn is_alike(fault: &str, other: &str) -> bool {
    fn words(text: &str) -> impl Iterator<Item = char> {
        text.chars().filter(|c| !c.is_ascii_digit())
    }
    words(fault).eq(words(other))
}

/// Looks at the files of a store, at most at so many pages; nothing is changed. Nothing is said of a store that has no
/// ledger yet, of an older version.
///
/// # Errors
/// [`StoreError::Io`] where a file that is there cannot be opened.
pub(super) fn examine(folder: &Path, most: u32) -> Result<Damage, StoreError> {
    examine_some(folder, |pages| 1..=pages.min(most))
}

/// The same, at some pages of as many as there are.
fn examine_some<I: Iterator<Item = u32>>(
    folder: &Path,
    some: impl FnOnce(u32) -> I,
) -> Result<Damage, StoreError> {
    let mut found = Damage::default();
    let (path, of_log) = (folder.join(DATABASE), log_of(folder));
    let sums = contents(&folder.join(SUMS))?;
    let log = Log::read(&of_log).map_err(StoreError::io(&of_log))?;
    let Some(told) = told(folder, &sums, &log, &mut found)? else { return Ok(found) };
    if told.frames > 0 && (log.salts != told.salts || log.frames < told.frames) {
        let left = if log.salts == told.salts { log.frames } else { 0 };
        found.add(format!("the log: {left} of {} pages that were acknowledged can be read", told.frames));
        found.log = true;
    }
    let Some(database) = existing(&path)? else {
        found.add(format!("{DATABASE} is gone"));
        found.pages.extend(1..=told.pages);
        return Ok(found);
    };
    let length = database.metadata().map_err(StoreError::io(&path))?.len();
    let in_force = log.frames > 0 && !told.is_carried_over(&log);
    // One that has become shorter is cut when the log is carried over, a moment before that is noted.
    let pages = if in_force { told.pages.min(log.size) } else { told.pages };
    if length < u64::from(pages) * PAGE_BYTES {
        found.add(format!("{DATABASE} is cut: {} of {pages} pages are there", length / PAGE_BYTES));
    }
    if told.pages > 0 && sum_in(&sums, told.pages).is_none() {
        found.add(format!("{SUMS} is cut: not every page can be compared"));
    }
    // Of a log that is not whole nothing is believed: what it carries is not in the database yet.
    let skip = |page: &u32| in_force && log.pages.contains(page);
    found.pages = compared(&database, &sums, some(pages).filter(|page| !skip(page)));
    if let Some(first) = found.pages.first() {
        let count = found.pages.len();
        found.add(format!("{count} of {} pages are not what was written, the first is {first}", told.pages));
    }
    Ok(found)
}

/// What was told of the files; `None` where there is nothing to hold them against. Where it cannot be read, the log counts as
/// far as it fits, and the database must be what the checksums say, as long as it is.
fn told(
    folder: &Path,
    sums: &[u8],
    log: &Log,
    found: &mut Damage,
) -> Result<Option<Acknowledged>, StoreError> {
    let bytes = contents(&folder.join(ACKNOWLEDGED))?;
    if bytes.is_empty() && sums.is_empty() {
        return Ok(None);
    }
    if let Some(told) = Acknowledged::of_bytes(&bytes) {
        return Ok((told != Acknowledged::default()).then_some(told));
    }
    found.add(format!("{ACKNOWLEDGED} is damaged: nobody can say what the log must hold"));
    found.log = true;
    let length = fs::metadata(folder.join(DATABASE)).map_or(0, |file| file.len());
    let pages = (sums.len() as u64 / 4).min(length / PAGE_BYTES);
    let pages = u32::try_from(pages).unwrap_or(u32::MAX);
    Ok(Some(Acknowledged { salts: log.salts, frames: log.frames, pages, states: 0, carried: 0 }))
}

/// Those of some pages that are not what their checksums say.
fn compared(database: &File, sums: &[u8], pages: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut bytes = vec![0; PAGE_BYTES as usize];
    let is_other = |page: &u32| {
        let is_there = database.read_exact_at(&mut bytes, u64::from(page - 1) * PAGE_BYTES).is_ok();
        sum_in(sums, *page).is_some_and(|sum| !is_there || crc32fast::hash(&bytes) != sum)
    };
    pages.filter(is_other).collect()
}

/// Those of some pages that are not what was noted of them in the database, whatever the log has of them.
///
/// # Errors
/// [`StoreError::Io`].
pub(super) fn unlike_noted(
    folder: &Path,
    database: &File,
    log: &Log,
    pages: impl Iterator<Item = u32>,
) -> Result<Vec<u32>, StoreError> {
    let sums = contents(&folder.join(SUMS))?;
    let noted = told(folder, &sums, log, &mut Damage::default())?.map_or(0, |told| told.pages);
    Ok(compared(database, &sums, pages.filter(|page| (1..=noted).contains(page))))
}

fn sum_in(sums: &[u8], page: u32) -> Option<u32> {
    let at = (page as usize).checked_sub(1)? * 4;
    Some(u32::from_le_bytes(sums.get(at..at + 4)?.try_into().ok()?))
}

/// As [`examine`], beside a writer that may be at work: what is found is looked at again, for the files are not read in one
/// moment. All pages are read once.
pub(super) fn examine_beside(folder: &Path) -> Result<Damage, StoreError> {
    let mut found = examine(folder, u32::MAX)?;
    for _ in 0..10 {
        if found == Damage::default() || !write::is_in_use(folder) {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(100));
        let these = |pages: u32| found.pages.iter().copied().filter(move |page| *page <= pages);
        found = examine_some(folder, these)?.confirms(&found);
    }
    Ok(found)
}

/// Has the store fail until somebody decides, over restarts too.
pub(in crate::store) fn mark(folder: &Path, why: &str) {
    let path = folder.join(DAMAGED);
    if path.exists() {
        return;
    }
    // Without room for it the store fails all the same, for as long as this process lives.
    let marked = fs::write(&path, why).and_then(|()| File::open(&path)?.sync_all());
    if let Err(error) = marked {
        tracing::error!(%error, "that the store is damaged could not be noted");
    }
}

/// Whether somebody has to decide, and why.
pub(in crate::store) fn marked(folder: &Path) -> Option<String> {
    let path = folder.join(DAMAGED);
    match fs::read(&path) {
        Ok(why) => Some(String::from_utf8_lossy(&why).into_owned()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        // Without a free descriptor nobody could tell, but whether it is there takes none.
        Err(error) => path.exists().then(|| format!("{DAMAGED} says why, and cannot be read: {error}")),
    }
}

fn acknowledged(folder: &Path) -> Result<Option<Acknowledged>, StoreError> {
    Ok(Acknowledged::of_bytes(&contents(&folder.join(ACKNOWLEDGED))?))
}

/// Whether all of a log is in the database: then what it still holds is of before.
///
/// # Errors
/// [`StoreError::Io`].
pub(super) fn is_carried_over(folder: &Path, log: &Log) -> Result<bool, StoreError> {
    Ok(acknowledged(folder)?.is_some_and(|told| told.is_carried_over(log)))
}

/// Records of the second copy that were acknowledged; `None` where nobody can say.
///
/// # Errors
/// [`StoreError::Io`].
pub(super) fn states_acknowledged(folder: &Path) -> Result<Option<u64>, StoreError> {
    Ok(acknowledged(folder)?.map(|told| told.states))
}

impl Ledger {
    /// Opens the ledger of a store before its database is opened, and looks whether that is whole.
    ///
    /// # Errors
    /// [`StoreError::Damaged`], [`StoreError::Io`].
    pub fn open(folder: &Path, upkeep: Upkeep) -> Result<Self, StoreError> {
        if let Some(why) = marked(folder) {
            return Err(StoreError::Damaged(why));
        }
        let found = examine(folder, upkeep.at_once)?;
        if found != Damage::default() {
            mark(folder, &found.told());
            return Err(StoreError::Damaged(found.told()));
        }
        let [database, sums, acknowledged] =
            [DATABASE, SUMS, ACKNOWLEDGED].map(|name| open(&folder.join(name)));
        let (database, sums, acknowledged) = (database?, sums?, acknowledged?);
        let mut bytes = [0; Acknowledged::BYTES];
        let told =
            acknowledged.read_exact_at(&mut bytes, 0).ok().and_then(|()| Acknowledged::of_bytes(&bytes));
        let now = told.unwrap_or_default();
        let own = Self {
            folder: folder.to_path_buf(),
            database,
            sums,
            acknowledged,
            now,
            upkeep,
            next: upkeep.at_once.saturating_add(1),
            whole: now.pages <= upkeep.at_once,
            // A process that was killed may have carried a part of the log over.
            noted: false,
        };
        own.drop_part_of_log()?;
        Ok(own)
    }

    /// A part of a log that was carried over would turn pages back, so it is cut. A whole one is the same again, and stays: who
    /// still reads it goes on with it, and what came next would lie behind a hole.
    fn drop_part_of_log(&self) -> Result<(), StoreError> {
        let path = log_of(&self.folder);
        let log = Log::read(&path).map_err(StoreError::io(&path))?;
        let is_empty = self.now.frames == 0 && log.frames == 0;
        let is_part = self.now.is_carried_over(&log) && log.frames < self.now.carried;
        if (is_empty || is_part) && self.now.salts != [0; 8] && path.exists() {
            let cut = OpenOptions::new().write(true).open(&path).and_then(|file| file.set_len(0));
            cut.map_err(StoreError::io(&path))?;
        }
        Ok(())
    }

    /// The log has so many frames, and all are on disk.
    pub fn acknowledge(&mut self, frames: u32) -> io::Result<()> {
        let mut salts = [0; 8];
        File::open(log_of(&self.folder))?.read_exact_at(&mut salts, 16)?;
        self.now = Acknowledged { salts, frames, ..self.now };
        self.acknowledged.write_all_at(&self.now.to_bytes(), 0)
    }

    /// The second copy of the states has so many records, and all are on disk.
    pub fn acknowledge_states(&mut self, states: u64) -> io::Result<()> {
        self.now.states = states;
        self.acknowledged.write_all_at(&self.now.to_bytes(), 0)
    }

    /// Nothing of the second copy is acknowledged any more, on disk when this returns: another takes its place, which may have
    /// fewer records.
    pub fn retract_states(&mut self) -> io::Result<()> {
        self.acknowledge_states(0)?;
        self.acknowledged.sync_data()
    }

    /// Frames of the log that are not carried over.
    pub fn frames(&self) -> u32 {
        self.now.frames
    }

    /// The log, before it is carried over.
    pub fn log(&self) -> Result<Log, StoreError> {
        let path = log_of(&self.folder);
        Log::read(&path).map_err(StoreError::io(&path))
    }

    /// Looks at what the log is about to be carried over: a page that is damaged there would be written over and be noted as it
    /// is then, and nobody would know what was made of it.
    ///
    /// # Errors
    /// [`StoreError::Damaged`]: then the store is marked.
    pub fn before_carrying(&mut self, changed: &HashSet<u32>) -> Result<(), StoreError> {
        if std::mem::take(&mut self.noted) {
            let mut bytes = vec![0; PAGE_BYTES as usize];
            let there = changed.iter().filter(|page| (1..=self.now.pages).contains(*page));
            there.copied().try_for_each(|page| self.compare(page, &mut bytes))?;
        }
        Ok(())
    }

    /// This log was carried over, whole and on disk; of a database that had no ledger all pages are taken as they are.
    pub fn carried_over(&mut self, log: Log) -> Result<(), StoreError> {
        let salts = if log.frames > 0 { log.salts } else { self.now.salts };
        let (carried, mut changed) = (log.frames, log.pages);
        let (of_database, of_sums) = (self.folder.join(DATABASE), self.folder.join(SUMS));
        let length = self.database.metadata().map_err(StoreError::io(&of_database))?.len();
        let pages = u32::try_from(length / PAGE_BYTES).unwrap_or(u32::MAX);
        changed.extend(self.now.pages + 1..=pages);
        let mut bytes = vec![0; PAGE_BYTES as usize];
        for page in changed.into_iter().filter(|page| (1..=pages).contains(page)) {
            let at = u64::from(page - 1);
            self.database.read_exact_at(&mut bytes, at * PAGE_BYTES).map_err(StoreError::io(&of_database))?;
            let sum = crc32fast::hash(&bytes).to_le_bytes();
            self.sums.write_all_at(&sum, at * 4).map_err(StoreError::io(&of_sums))?;
        }
        self.sums.sync_data().map_err(StoreError::io(&of_sums))?;
        self.now = Acknowledged { salts, frames: 0, pages, carried, ..self.now };
        let told = self.acknowledged.write_all_at(&self.now.to_bytes(), 0);
        told.and_then(|()| self.acknowledged.sync_data())
            .map_err(StoreError::io(&self.folder.join(ACKNOWLEDGED)))?;
        self.noted = true;
        Ok(())
    }

    /// Looks at some pages beside the work, one after the other; the log must be carried over, so that none is in it.
    ///
    /// # Errors
    /// [`StoreError::Damaged`]: then the store is marked.
    pub fn look(&mut self) -> Result<(), StoreError> {
        if self.now.frames > 0 || self.now.pages == 0 {
            return Ok(());
        }
        let mut bytes = vec![0; PAGE_BYTES as usize];
        for _ in 0..self.upkeep.each.min(self.now.pages) {
            self.next = if self.next > self.now.pages { 1 } else { self.next };
            self.compare(self.next, &mut bytes)?;
            self.next += 1;
            self.whole |= self.next > self.now.pages;
        }
        Ok(())
    }

    /// The share of the database that was looked at since it was opened (0..1); `None` once all of it was.
    pub fn checked(&self) -> Option<f64> {
        let of = f64::from(self.now.pages.max(1));
        (!self.whole).then(|| (f64::from(self.next - 1) / of).min(1.0))
    }

    fn compare(&self, page: u32, bytes: &mut [u8]) -> Result<(), StoreError> {
        let (at, mut sum) = (u64::from(page - 1), [0; 4]);
        let read = self.database.read_exact_at(bytes, at * PAGE_BYTES);
        let read = read.and_then(|()| self.sums.read_exact_at(&mut sum, at * 4));
        if read.is_ok() && crc32fast::hash(bytes).to_le_bytes() == sum {
            return Ok(());
        }
        let why = format!("page {page} of {} is not what was written", self.now.pages);
        mark(&self.folder, &why);
        Err(StoreError::Damaged(why))
    }
}

/// Files of a ledger, which goes with its database.
pub(super) const FILES: [&str; 3] = [SUMS, ACKNOWLEDGED, DAMAGED];

#[cfg(test)]
mod tests;
