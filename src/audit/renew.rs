//! A new log in the place of one that is damaged. Somebody has decided so: nothing is ever written behind a broken chain.

use super::rights::folder_of;
use super::{
    AuditError, Bounds, Broken, Log, before, genesis, head_path, hex, open_head, open_own, with_suffix,
};
use sha2::{Digest, Sha256};
use std::ffi::{OsStr, OsString};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{MetadataExt, fchown};
use std::path::{Path, PathBuf};

/// Damaged logs that may lie beside a log.
const MOST_ASIDE: usize = 1000;
/// What a head begins with while its log is renewed. No number begins so, and it covers only leading zeros of the one that was there.
pub(super) const RENEWING: &str = "renewing";
/// Bytes that are read at once of a file that is hashed: few calls, little memory.
const BLOCK: usize = 64 * 1024;
/// Longest part of the old head that is put on record (characters): a whole one has 85.
const MOST_OF_HEAD: usize = 200;

/// What became of a damaged log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Renewed {
    /// What was wrong with it.
    pub damage: Broken,
    /// Where its files are now.
    pub aside: PathBuf,
}

/// Puts a damaged log aside, with its head and its rotated files, and begins a new one. The first entry of the new one says what was
/// wrong, where the old one is, what its head said, and the SHA-256 of each of its files. `None` where the log is whole; then it stays.
///
/// Wherever this is broken off, the log is still damaged for whoever opens it next: its head says that it is renewed until the new log
/// is on disk.
///
/// # Errors
/// [`AuditError::InUse`] while a process has the log, [`AuditError::Io`].
pub fn renew(path: &Path, now: &str) -> Result<Option<Renewed>, AuditError> {
    let mut head = open_head(path)?;
    let damage = match before(path) {
        Ok(_) => return Ok(None),
        Err(AuditError::Broken { broken, .. }) => broken,
        Err(error) => return Err(error),
    };
    let io = |source| AuditError::Io { path: path.to_path_buf(), source };
    let mut old = Vec::new();
    head.read_to_end(&mut old).map_err(io)?;
    let aside = copy_head(path, &old).map_err(io)?;
    mark(&mut head).map_err(io)?;
    let files = put_aside(path, &aside).map_err(io)?;
    let file = OpenOptions::new().append(true).create_new(true).open(path).map_err(io)?;
    owned_as(&file, &head).map_err(io)?;
    let bounds = Bounds { max_bytes: u64::MAX, keep_files: 0 };
    let mut log = Log { path: path.to_path_buf(), bounds, file, head, size: 0, last: genesis() };
    log.begin_file(now)?;
    let told = [
        ("damage", damage.to_string()),
        ("aside", aside.display().to_string()),
        ("head", String::from_utf8_lossy(&old).trim_end().chars().take(MOST_OF_HEAD).collect()),
        ("sha256", files.join(" ")),
    ];
    log.append(now, "renewed", &told)?;
    log.file.sync_data().and_then(|()| sync_folder(folder_of(path))).map_err(io)?;
    // Only now: a head that is empty says nothing of lines that are missing.
    log.head.set_len(0).map_err(io)?;
    log.sync()?;
    Ok(Some(Renewed { damage, aside }))
}

/// Makes a new folder beside the log, with the head as it was found.
fn copy_head(path: &Path, old: &[u8]) -> io::Result<PathBuf> {
    let aside = new_folder(path)?;
    let name = head_path(path);
    let mut copy = File::create_new(aside.join(name.file_name().unwrap_or_default()))?;
    copy.write_all(old)?;
    copy.sync_all()?;
    sync_folder(&aside)?;
    sync_folder(folder_of(path))?;
    Ok(aside)
}

/// Makes a head one that cannot be right. What it had is not cut off first: a crash would leave an empty one, which misses nothing.
pub(super) fn mark(head: &mut File) -> io::Result<()> {
    head.seek(SeekFrom::Start(0))?;
    head.write_all(RENEWING.as_bytes())?;
    head.sync_all()
}

/// Moves the files of a log into a folder; what comes back is each one's name and SHA-256.
fn put_aside(path: &Path, aside: &Path) -> io::Result<Vec<String>> {
    let (folder, name) = (folder_of(path), path.file_name().unwrap_or_default());
    let all = fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.file_name()));
    // All of them first: what is moved meanwhile must not be missed.
    let mut own: Vec<OsString> = all.collect::<io::Result<_>>()?;
    own.retain(|own| is_part(own, name));
    own.sort();
    own.iter().try_for_each(|own| fs::rename(folder.join(own), aside.join(own)))?;
    sync_folder(aside)?;
    sync_folder(folder)?;
    let hashed = |own: &OsString| format!("{}={}", own.to_string_lossy(), sha256(&aside.join(own)));
    Ok(own.iter().map(hashed).collect())
}

/// The SHA-256 of a file; why there is none where it cannot be read, which may be the damage.
fn sha256(path: &Path) -> String {
    let opened = open_own(OpenOptions::new().read(true), path);
    opened.and_then(sha256_of).unwrap_or_else(|error| format!("({error})"))
}

fn sha256_of(mut file: File) -> io::Result<String> {
    let (mut hash, mut block) = (Sha256::new(), vec![0_u8; BLOCK]);
    loop {
        match file.read(&mut block) {
            Ok(0) => return Ok(hex(hash.finalize().iter())),
            Ok(count) => hash.update(block.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
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

/// Root may act for the user that runs the daemon, who is to write the new log.
fn owned_as(file: &File, head: &File) -> io::Result<()> {
    let (own, wanted) = (file.metadata()?, head.metadata()?);
    if (own.uid(), own.gid()) != (wanted.uid(), wanted.gid()) {
        fchown(file, Some(wanted.uid()), Some(wanted.gid()))?;
    }
    file.set_permissions(wanted.permissions())
}
