//! A new log in the place of one that is damaged. Somebody has decided so: nothing is ever written behind a broken chain.

use super::{AuditError, Bounds, Broken, Log, before, genesis, head_path, open_head, with_suffix};
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt, chown};
use std::path::{Path, PathBuf};

/// Damaged logs that may lie beside a log.
const MOST_ASIDE: usize = 1000;

/// What became of a damaged log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Renewed {
    /// What was wrong with it.
    pub damage: Broken,
    /// Where its files are now.
    pub aside: PathBuf,
}

/// Puts a damaged log aside, with its head and its rotated files, and begins a new one. The first entry of the new one says what was
/// wrong and where the old one is. `None` where the log is whole; then it stays.
///
/// Wherever this is broken off, the log is still damaged for whoever opens it next: the old head, where there is one, is in force until
/// the new log is on disk.
///
/// # Errors
/// [`AuditError::InUse`] while a process has the log, [`AuditError::Io`].
pub fn renew(path: &Path, now: &str) -> Result<Option<Renewed>, AuditError> {
    let head = open_head(path)?;
    let damage = match before(path) {
        Ok(_) => return Ok(None),
        Err(AuditError::Broken { broken, .. }) => broken,
        Err(error) => return Err(error),
    };
    let io = |source| AuditError::Io { path: path.to_path_buf(), source };
    let aside = put_aside(path).map_err(io)?;
    let file = OpenOptions::new().append(true).create_new(true).open(path).map_err(io)?;
    owned_as(path, &head).map_err(io)?;
    let bounds = Bounds { max_bytes: u64::MAX, keep_files: 0 };
    let mut log = Log { path: path.to_path_buf(), bounds, file, head, size: 0, last: genesis() };
    log.begin_file(now)?;
    let told = [("damage", damage.to_string()), ("aside", aside.display().to_string())];
    log.append(now, "renewed", &told)?;
    // Only now: a head that is empty says nothing of lines that are missing.
    log.file.sync_data().and_then(|()| log.head.set_len(0)).map_err(io)?;
    log.sync()?;
    File::open(folder_of(path)).and_then(|folder| folder.sync_all()).map_err(io)?;
    Ok(Some(Renewed { damage, aside }))
}

/// Moves the files of a log into a new folder beside it; the head is copied.
fn put_aside(path: &Path) -> io::Result<PathBuf> {
    let aside = new_folder(path)?;
    let (folder, head) = (folder_of(path), head_path(path));
    fs::copy(&head, aside.join(head.file_name().unwrap_or_default()))?;
    let name = path.file_name().unwrap_or_default();
    let all = fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.file_name()));
    // All of them first: what is moved meanwhile must not be missed.
    for own in all.collect::<io::Result<Vec<_>>>()? {
        if is_part(&own, name) {
            fs::rename(folder.join(&own), aside.join(&own))?;
        }
    }
    Ok(aside)
}

/// Whether a file is the log called `name`, or one of its rotated files.
fn is_part(own: &OsStr, name: &OsStr) -> bool {
    match own.as_encoded_bytes().strip_prefix(name.as_encoded_bytes()) {
        Some([]) => true,
        Some([b'.', digits @ ..]) => !digits.is_empty() && digits.iter().all(u8::is_ascii_digit),
        _ => false,
    }
}

/// A folder that is not there yet.
fn new_folder(path: &Path) -> io::Result<PathBuf> {
    for n in 1..=MOST_ASIDE {
        let folder = with_suffix(path, &format!(".damaged-{n}"));
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::other(format!("there are {MOST_ASIDE} damaged logs beside it already")))
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."))
}

/// Root may act for the user that runs the daemon, who is to write the new log.
fn owned_as(path: &Path, head: &File) -> io::Result<()> {
    let (own, wanted) = (fs::metadata(path)?, head.metadata()?);
    if (own.uid(), own.gid()) != (wanted.uid(), wanted.gid()) {
        chown(path, Some(wanted.uid()), Some(wanted.gid()))?;
    }
    fs::set_permissions(path, wanted.permissions())
}
