//! What is left of a store that is damaged, salvaged once and shared by everybody who reads it: salvaging reads the whole store,
//! and who reads it may do so every second. It is salvaged anew when a file of the store has changed. Where that failed it
//! is tried again after a minute too.

use super::DATABASE;
use super::frames::log_of;
use super::ledger::FILES;
use super::salvage::{Loss, salvage};
use super::second::STATES;
use crate::store::StoreError;
use rusqlite::Connection;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime};

/// Time for which a failure counts: without room for what is left the whole store may be read before that shows.
const FAILED: Duration = Duration::from_secs(60);

/// What is left of one store.
#[derive(Debug)]
pub(super) struct Left {
    database: Mutex<Connection>,
    loss: Loss,
}

impl Left {
    /// Its database, while nobody else asks it.
    pub fn database(&self) -> MutexGuard<'_, Connection> {
        lock(&self.database)
    }

    /// What was lost.
    pub fn loss(&self) -> &Loss {
        &self.loss
    }
}

/// The files of a store: number, length and time of change of each that is there.
type Files = Vec<Option<(u64, u64, Option<SystemTime>)>>;

/// What came of a salvage.
#[derive(Debug)]
enum Outcome {
    Left(Arc<Left>),
    /// Why it failed, and when.
    Failed(String, Instant),
}

/// The store that was salvaged last.
#[derive(Debug)]
struct Place {
    folder: PathBuf,
    /// Held while it is salvaged: who asks meanwhile waits for what comes of it.
    found: Mutex<Option<(Files, Outcome)>>,
}

/// What is left of the store that was salvaged last: a process has one store.
#[derive(Debug)]
struct Kept(Mutex<Option<Arc<Place>>>);

static KEPT: Kept = Kept(Mutex::new(None));

/// What is left of the store in a folder.
///
/// # Errors
/// [`StoreError`]; for a minute after that the same, unless a file of the store changes.
pub(super) fn of(folder: &Path) -> Result<Arc<Left>, StoreError> {
    KEPT.of(folder, Instant::now, || salvage(folder, None))
}

/// The store in a folder is no longer damaged: the room that was taken for what is left of it is given back.
pub(super) fn forget(folder: &Path) {
    KEPT.forget(folder);
}

impl Kept {
    /// What is left, by `salvage` where nobody knows; `now` tells the time by a clock that is never set.
    fn of(
        &self,
        folder: &Path,
        now: impl Fn() -> Instant,
        salvage: impl FnOnce() -> Result<(Connection, Loss), StoreError>,
    ) -> Result<Arc<Left>, StoreError> {
        let place = self.place(folder);
        let mut found = lock(&place.found);
        let files = files(folder);
        match &*found {
            Some((of, Outcome::Left(left))) if *of == files => return Ok(left.clone()),
            Some((of, Outcome::Failed(why, at)))
                if *of == files && now().saturating_duration_since(*at) < FAILED =>
            {
                return Err(failed_before(folder, why));
            }
            _ => {}
        }
        // There may be no room for two.
        *found = None;
        match salvage() {
            Ok((database, loss)) => {
                let left = Arc::new(Left { database: Mutex::new(database), loss });
                *found = Some((files, Outcome::Left(left.clone())));
                Ok(left)
            }
            Err(error) => {
                *found = Some((files, Outcome::Failed(error.to_string(), now())));
                Err(error)
            }
        }
    }

    fn place(&self, folder: &Path) -> Arc<Place> {
        let mut last = lock(&self.0);
        match &*last {
            Some(place) if place.folder == folder => place.clone(),
            _ => {
                let place = Arc::new(Place { folder: folder.to_path_buf(), found: Mutex::default() });
                *last = Some(place.clone());
                place
            }
        }
    }

    fn forget(&self, folder: &Path) {
        let mut last = lock(&self.0);
        if last.as_ref().is_some_and(|place| place.folder == folder) {
            *last = None;
        }
    }
}

/// What is told of a failure that still counts.
fn failed_before(folder: &Path, why: &str) -> StoreError {
    let why = format!(
        "what is left of the damaged store could not be read ({why}); it is tried again a minute after that, or when a file of \
         the store changes"
    );
    StoreError::io(folder)(io::Error::other(why))
}

/// The files as they are before they are read: what changes while they are is read again by who comes next.
fn files(folder: &Path) -> Files {
    let beside = FILES.into_iter().chain([DATABASE, STATES]).map(|name| folder.join(name));
    let told = |path: PathBuf| {
        let file = fs::metadata(path).ok()?;
        Some((file.ino(), file.len(), file.modified().ok()))
    };
    beside.chain([log_of(folder)]).map(told).collect()
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::embedded::ledger::{DAMAGED, mark};
    use crate::store::embedded::tests::Folder;
    use crate::store::{Config, Store};
    use std::cell::Cell;

    #[test]
    fn a_store_is_salvaged_once_until_its_files_change() {
        let folder = Folder::new();
        drop(Store::open(&Config::new(&folder.0)).expect("opens"));
        mark(&folder.0, "somebody is to decide");
        let kept = Kept(Mutex::new(None));
        let left = || kept.of(&folder.0, Instant::now, || salvage(&folder.0, None)).expect("can be read");
        let first = left();
        assert!(Arc::ptr_eq(&first, &left()));
        fs::write(folder.0.join(DAMAGED), "somebody else is to decide").expect("writable");
        let second = left();
        assert!(!Arc::ptr_eq(&first, &second));
        assert_eq!(second.loss().damage, "somebody else is to decide");
        kept.forget(&folder.0.join("elsewhere"));
        assert!(Arc::ptr_eq(&second, &left()));
        kept.forget(&folder.0);
        assert!(!Arc::ptr_eq(&second, &left()));
    }

    /// Without room for what is left, whoever reads would have the whole store read each second.
    #[test]
    fn a_store_that_cannot_be_salvaged_is_tried_again_after_a_minute_or_when_it_changes() {
        let folder = Folder::new();
        drop(Store::open(&Config::new(&folder.0)).expect("opens"));
        mark(&folder.0, "somebody is to decide");
        let kept = Kept(Mutex::new(None));
        let (begin, tries) = (Instant::now(), Cell::new(0));
        let after = |seconds: u64, has_room: bool| {
            let salvaged = || {
                tries.set(tries.get() + 1);
                if !has_room {
                    return Err(StoreError::Missing("room for it".into()));
                }
                salvage(&folder.0, None)
            };
            let found = kept.of(&folder.0, || begin + Duration::from_secs(seconds), salvaged);
            (tries.get(), found.map(drop).map_err(|error| error.to_string()))
        };
        let (count, first) = after(0, false);
        let why = first.expect_err("there is no room");
        assert_eq!(count, 1);
        let (count, again) = after(59, true);
        assert!(count == 1 && again.is_err_and(|told| told.contains(&why)), "it is remembered");
        assert_eq!(after(60, false).0, 2, "a minute has passed");
        fs::write(folder.0.join(DAMAGED), "somebody else is to decide").expect("writable");
        assert_eq!(after(61, false).0, 3, "a file has changed");
        assert_eq!(after(121, true), (4, Ok(())));
        assert_eq!(after(122, false), (4, Ok(())), "what is left is kept");
    }
}
