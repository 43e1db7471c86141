//! A new database of what is left of one that is damaged. Somebody has decided: what cannot be read is given up.
//!
//! ```text
//! store.new -> store.repaired; the old files -> damaged-N; store.repaired -> store.db
//! ```
//! From the first of these steps on the new database is whole, and the decision is made. Wherever a crash comes between them,
//! whoever opens the store next takes the rest: as long as there is a `store.repaired` no other database is looked for.

use super::ledger::FILES;
use super::salvage::{Loss, salvage};
use super::write::lock;
use super::{DATABASE, left, second};
use crate::store::{Config, StoreError};
use std::fs;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

/// The new database, until it is whole.
const NEW: &str = "store.new";
/// The new database, until it takes the place of the other.
const REPAIRED: &str = "store.repaired";
/// Folders that damaged files are put into at most.
const MOST_ASIDE: u32 = 999;

/// Makes the new database; the files of the old one go to a folder beside it, which is named. What was lost.
///
/// # Errors
/// [`StoreError`]; then the old one stays as it is, or the next opening ends what was begun.
pub(in crate::store) fn repair(config: &Config) -> Result<(Loss, PathBuf), StoreError> {
    let folder = &config.folder;
    let held = lock(folder)?;
    // What was made of it before is what there is to be repaired.
    finish(folder)?;
    // There may be no room for two.
    left::forget(folder);
    let (loss, away) = prepare(folder)?;
    exchange(folder, &away)?;
    drop(held);
    // The new ledger and second copy are made when it is opened.
    drop(super::Store::open(config)?);
    Ok((loss, away))
}

/// As [`finish`], where nobody writes to the store.
///
/// # Errors
/// [`StoreError`].
pub(in crate::store) fn finish_repair(config: &Config) -> Result<Option<PathBuf>, StoreError> {
    match unfinished(&config.folder) {
        None => Ok(None),
        Some(_) => {
            let _held = lock(&config.folder)?;
            finish(&config.folder)
        }
    }
}

/// The database that a repair has made and not put into its place yet.
pub(super) fn unfinished(folder: &Path) -> Option<PathBuf> {
    let path = folder.join(REPAIRED);
    path.is_file().then_some(path)
}

/// The address by which SQLite reads a database that nobody changes, without locks and beside no other file.
pub(super) fn unchanging(path: &Path) -> String {
    let mut address = "file:".to_string();
    for &byte in path.as_os_str().as_bytes() {
        if byte.is_ascii_alphanumeric() || b"/.-_".contains(&byte) {
            address.push(char::from(byte));
        } else {
            address += &format!("%{byte:02x}");
        }
    }
    address + "?immutable=1"
}

/// Ends a repair that was begun: where the damaged files are then; `None` where none was. Who calls it holds the lock.
///
/// # Errors
/// [`StoreError::Io`]; then it is still to be ended.
pub(super) fn finish(folder: &Path) -> Result<Option<PathBuf>, StoreError> {
    if unfinished(folder).is_none() {
        return Ok(None);
    }
    // The last may be of a repair before, where somebody has removed the one that was begun: its files stay.
    let last = Some(last_aside(folder)).filter(|last| *last > 0).map(|last| folder_aside(folder, last));
    let away = match last.filter(|last| has_place(folder, last)) {
        Some(last) => last,
        None => aside(folder)?,
    };
    exchange(folder, &away)?;
    Ok(Some(away))
}

/// Makes the new database, whole and on disk, and a folder for the files of the old one.
fn prepare(folder: &Path) -> Result<(Loss, PathBuf), StoreError> {
    let new = folder.join(NEW);
    for end in ["", "-journal", "-wal", "-shm"] {
        gone(&folder.join(format!("{NEW}{end}")))?;
    }
    let (db, loss) = salvage(folder, Some(&new))?;
    db.close().map_err(|(_, error)| error)?;
    fs::File::open(&new).and_then(|file| file.sync_all()).map_err(StoreError::io(&new))?;
    let away = aside(folder)?;
    renamed(&new, &folder.join(REPAIRED)).map_err(StoreError::io(&new))?;
    Ok((loss, away))
}

/// Puts the old files away and the new database into its place, as far as that is not done yet.
fn exchange(folder: &Path, away: &Path) -> Result<(), StoreError> {
    for (from, to) in steps(folder, away) {
        match renamed(&from, &to) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            done => done.map_err(StoreError::io(&from))?,
        }
    }
    Ok(())
}

/// What is renamed to what, in this order: the new database last, and before it the mark of the damage.
fn steps(folder: &Path, away: &Path) -> Vec<(PathBuf, PathBuf)> {
    let of_database = ["-wal", "-shm", ""].map(|end| format!("{DATABASE}{end}"));
    let beside = [second::STATES].into_iter().chain(FILES).map(str::to_string);
    let old = of_database.into_iter().chain(beside).map(|name| (folder.join(&name), away.join(&name)));
    old.chain([(folder.join(REPAIRED), folder.join(DATABASE))]).collect()
}

/// Whether a folder has none of the files yet that are still to be put there.
fn has_place(folder: &Path, away: &Path) -> bool {
    let is_taken = |(from, to): (PathBuf, PathBuf)| to.starts_with(away) && from.exists() && to.exists();
    !steps(folder, away).into_iter().any(is_taken)
}

/// Renames a file; on disk when this returns, so that no later step is there without it.
fn renamed(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    let mut folders = [from, to].into_iter().filter_map(Path::parent);
    folders.try_for_each(|folder| fs::File::open(folder)?.sync_all())
}

fn gone(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(StoreError::io(path)(error)),
        _ => Ok(()),
    }
}

fn folder_aside(folder: &Path, number: u32) -> PathBuf {
    folder.join(format!("damaged-{number}"))
}

/// The number of the last folder of damaged files; 0 where there is none.
fn last_aside(folder: &Path) -> u32 {
    (1..=MOST_ASIDE).rev().find(|number| folder_aside(folder, *number).is_dir()).unwrap_or(0)
}

/// A folder behind all that there are.
fn aside(folder: &Path) -> Result<PathBuf, StoreError> {
    let number = last_aside(folder) + 1;
    let path = folder_aside(folder, number);
    if number > MOST_ASIDE {
        let why = "there are a thousand damaged stores beside it; remove those that nobody needs";
        return Err(StoreError::io(&path)(io::Error::other(why)));
    }
    fs::create_dir(&path).map_err(StoreError::io(&path))?;
    Ok(path)
}

#[cfg(test)]
mod tests;
