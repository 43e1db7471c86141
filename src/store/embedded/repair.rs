//! A new database of what is left of one that is damaged. Somebody has decided: what cannot be read is given up.

use super::ledger::FILES;
use super::salvage::{Loss, salvage};
use super::write::lock;
use super::{DATABASE, second};
use crate::store::{Config, StoreError};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The new database, until it takes the place of the other.
const NEW: &str = "store.new";

/// Makes the new database; the files of the old one go to a folder beside it, which is named. What was lost.
///
/// # Errors
/// [`StoreError`]; then the old one stays as it is.
pub(in crate::store) fn repair(config: &Config) -> Result<(Loss, PathBuf), StoreError> {
    let folder = &config.folder;
    let held = lock(folder)?;
    let new = folder.join(NEW);
    for end in ["", "-journal", "-wal", "-shm"] {
        gone(&folder.join(format!("{NEW}{end}")))?;
    }
    let (db, loss) = salvage(folder, Some(&new))?;
    db.close().map_err(|(_, error)| error)?;
    fs::File::open(&new).and_then(|file| file.sync_all()).map_err(StoreError::io(&new))?;
    let away = aside(folder)?;
    let of_database = ["", "-wal", "-shm"].map(|end| format!("{DATABASE}{end}"));
    let beside = FILES.into_iter().chain([second::STATES]).map(str::to_string);
    for name in of_database.into_iter().chain(beside) {
        let (from, to) = (folder.join(&name), away.join(&name));
        match fs::rename(&from, &to) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(StoreError::io(&from)(error));
            }
            _ => {}
        }
    }
    fs::rename(&new, folder.join(DATABASE)).map_err(StoreError::io(&new))?;
    fs::File::open(folder).and_then(|folder| folder.sync_all()).map_err(StoreError::io(folder))?;
    drop(held);
    // The new ledger and second copy are made when it is opened.
    drop(super::Store::open(config)?);
    Ok((loss, away))
}

fn gone(path: &Path) -> Result<(), StoreError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(StoreError::io(path)(error)),
        _ => Ok(()),
    }
}

/// A folder that is not there yet.
fn aside(folder: &Path) -> Result<PathBuf, StoreError> {
    for n in 1..1000 {
        let path = folder.join(format!("damaged-{n}"));
        match fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(StoreError::io(&path)(error)),
        }
    }
    Err(StoreError::io(folder)(io::Error::other("there are a thousand damaged stores already")))
}
