//! An append-only log whose every line carries a hash over itself and the line before: what was changed, dropped or
//! swapped afterwards is found, and named by its line.
//!
//! ```text
//! 7 2026-11-21T06:00:00.250Z write loop="FIC101" term="1.5" heartbeat="12" #<sha256 of the hash before and of this line>
//! ```
//!
//! The first line of a file, `file previous="…"`, carries the last hash of the file before, so that rotation keeps the
//! chain. `FILE.head` holds number and hash of the last entry: lines dropped from the end are missed there.
//! Who can rewrite file and head together can forge both; the daemon's own log repeats the hash at every transition, for
//! a place that is out of reach.

mod config;
mod page;
mod recorder;
mod renew;
mod rights;
mod verify;

pub use config::Config;
pub use page::{Line, Page, page};
#[cfg(all(test, feature = "writeback"))]
pub(crate) use recorder::Hung;
pub use recorder::{Fault, ON_RECORD, Recorder};
pub use renew::{Renewed, renew};
pub use rights::remedy;
pub use verify::{Broken, Verified, verify};

use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// The hash before the very first line.
const GENESIS: &str = "0000000000000000000000000000000000000000000000000000000000000000";

/// What is before the very first line.
fn genesis() -> Entry {
    Entry { n: 0, hash: GENESIS.to_string() }
}

/// Why the log cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum AuditError {
    /// A file cannot be opened, written or synchronised.
    #[error("audit log {}: {source}{}", path.display(), remedy(path, source))]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Somebody else keeps it.
    #[error("audit log {}: another process is writing it; a log has one writer, and a plant one stictiond", .0.display())]
    InUse(PathBuf),
    /// What is there is no unbroken log.
    #[error(
        "{broken}; nothing is written to this log: stop stictiond, and `stictiond audit renew {}` puts it aside, with its .head and \
         its rotated files, and begins a new one",
        log.display()
    )]
    Broken {
        /// The log, by its newest file.
        log: PathBuf,
        /// What is wrong with it.
        broken: Broken,
    },
}

/// How large a log may grow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// A file is rotated once it is larger (bytes).
    pub max_bytes: u64,
    /// Rotated files kept, `FILE.1` the youngest.
    pub keep_files: usize,
}

/// A log being written.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    bounds: Bounds,
    file: File,
    head: File,
    size: u64,
    last: Entry,
}

/// Number and hash of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Number, from 1, through all files.
    pub n: u64,
    /// SHA-256, 64 hexadecimal digits.
    pub hash: String,
}

impl Log {
    /// Opens a log and goes on with it, or begins one. A last line that was cut off by a crash was never acknowledged: it
    /// is taken out, and an entry says so.
    ///
    /// # Errors
    /// [`AuditError::InUse`] while another process writes it, [`AuditError::Broken`] when what is there has been changed:
    /// nothing is written behind a broken chain.
    pub fn open(path: &Path, bounds: Bounds, now: &str) -> Result<Self, AuditError> {
        let head = open_head(path)?;
        Self::go_on(path, bounds, now, head, before(path)?)
    }

    /// Goes on with a log that is whole, or begins one.
    fn go_on(
        path: &Path,
        bounds: Bounds,
        now: &str,
        head: File,
        Before { last, whole, torn }: Before,
    ) -> Result<Self, AuditError> {
        let io = |source| AuditError::Io { path: path.to_path_buf(), source };
        if torn > 0 {
            let cut = OpenOptions::new().write(true).open(path).and_then(|file| file.set_len(whole));
            cut.map_err(io)?;
        }
        let file = OpenOptions::new().append(true).create(true).open(path).map_err(io)?;
        let mut log = Self { path: path.to_path_buf(), bounds, file, head, size: whole, last };
        if whole == 0 {
            log.begin_file(now)?;
        }
        if torn > 0 {
            log.append(now, "recovered", &[("torn_bytes", torn.to_string())])?;
        }
        log.sync()?;
        Ok(log)
    }

    /// The last entry.
    pub fn last(&self) -> &Entry {
        &self.last
    }

    /// Adds an entry; it is safe on disk after [`Log::sync`].
    ///
    /// # Errors
    /// [`AuditError::Io`].
    pub fn append(&mut self, at: &str, event: &str, fields: &[(&str, String)]) -> Result<(), AuditError> {
        if self.size > self.bounds.max_bytes {
            self.rotate(at)?;
        }
        self.line(at, event, fields)
    }

    /// Waits until everything is on disk, then moves the head.
    ///
    /// # Errors
    /// [`AuditError::Io`], also where the file is no longer in its place.
    pub fn sync(&mut self) -> Result<(), AuditError> {
        let head = format!("{:020} {}\n", self.last.n, self.last.hash);
        let written = self.look().and_then(|()| self.file.sync_data()).and_then(|()| {
            self.head.seek(SeekFrom::Start(0))?;
            self.head.write_all(head.as_bytes())?;
            self.head.sync_data()
        });
        written.map_err(|source| AuditError::Io { path: self.path.clone(), source })
    }

    /// Looks whether the file that is written is the one in its place, and whole. A program that rotates logs moves it or cuts it, and
    /// what is written to one that was deleted is on no record.
    fn look(&self) -> io::Result<()> {
        let own = self.file.metadata()?;
        if own.len() != self.size {
            return Err(io::Error::other(format!(
                "it has {} bytes where {} were written: something else has cut or changed it, or a write ended within a line, as on a \
                 disk that is full; a restart of stictiond takes half a line out; else put it back as it was, and leave its rotation \
                 to stictiond",
                own.len(),
                self.size
            )));
        }
        let is_own = |there: fs::Metadata| (there.dev(), there.ino()) == (own.dev(), own.ino());
        // A file system over a network may number its files anew.
        if fs::metadata(&self.path).is_ok_and(is_own) || self.ends_alike().unwrap_or(false) {
            return Ok(());
        }
        Err(io::Error::other(
            "something else has moved, deleted or replaced it while it was written; put it back as it was, and leave its rotation to \
             stictiond",
        ))
    }

    /// Whether the file in its place is as long and ends in the hash of the last entry, by which it is known.
    fn ends_alike(&self) -> io::Result<bool> {
        let there = File::open(&self.path)?;
        let end = format!("#{}\n", self.last.hash);
        let mut bytes = vec![0; end.len()];
        let Some(at) = self.size.checked_sub(end.len() as u64) else { return Ok(false) };
        there.read_exact_at(&mut bytes, at)?;
        Ok(there.metadata()?.len() == self.size && bytes == end.as_bytes())
    }

    fn line(&mut self, at: &str, event: &str, fields: &[(&str, String)]) -> Result<(), AuditError> {
        let n = self.last.n + 1;
        let mut body = format!("{n} {at} {event}");
        for (key, value) in fields {
            // Debug quotes and escapes, so that no value ends a line; writing to a String cannot fail.
            let _ = write!(body, " {key}={value:?}");
        }
        let hash = hash(&self.last.hash, &body);
        let line = format!("{body} #{hash}\n");
        let written = self.file.write_all(line.as_bytes());
        written.map_err(|source| AuditError::Io { path: self.path.clone(), source })?;
        self.size += line.len() as u64;
        self.last = Entry { n, hash };
        Ok(())
    }

    fn begin_file(&mut self, at: &str) -> Result<(), AuditError> {
        let previous = self.last.hash.clone();
        self.line(at, "file", &[("previous", previous)])
    }

    fn rotate(&mut self, at: &str) -> Result<(), AuditError> {
        self.sync()?;
        // Where fewer are kept than before, what lies behind them would no longer follow on them.
        let beyond = (self.bounds.keep_files + 1..).map(|k| rotated(&self.path, k));
        let beyond: Vec<PathBuf> = beyond.take_while(|file| file.exists()).collect();
        let removed = beyond.iter().rev().try_for_each(fs::remove_file);
        let moved = removed.and_then(|()| self.move_up());
        let begun = moved.and_then(|()| {
            if self.bounds.keep_files == 0 {
                fs::remove_file(&self.path)?;
            }
            OpenOptions::new().append(true).create_new(true).open(&self.path)
        });
        self.file = begun.map_err(|source| AuditError::Io { path: self.path.clone(), source })?;
        self.size = 0;
        self.begin_file(at)
    }

    /// Every file takes the place of the next older one.
    fn move_up(&self) -> io::Result<()> {
        (1..=self.bounds.keep_files).rev().try_for_each(|k| {
            let from = if k == 1 { self.path.clone() } else { rotated(&self.path, k - 1) };
            if from.exists() { fs::rename(from, rotated(&self.path, k)) } else { Ok(()) }
        })
    }
}

fn hash(before: &str, body: &str) -> String {
    let digest = Sha256::new().chain_update(before).chain_update(body).finalize();
    hex(digest.iter())
}

fn hex<'a>(bytes: impl Iterator<Item = &'a u8>) -> String {
    bytes.map(|byte| format!("{byte:02x}")).collect()
}

fn rotated(path: &Path, k: usize) -> PathBuf {
    with_suffix(path, &format!(".{k}"))
}

fn head_path(path: &Path) -> PathBuf {
    with_suffix(path, ".head")
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Opens the head, which is there as long as the log is and is never renamed, and keeps others out by its lock.
fn open_head(path: &Path) -> Result<File, AuditError> {
    let head_path = head_path(path);
    let io = |source| AuditError::Io { path: head_path.clone(), source };
    let head = open_own(OpenOptions::new().read(true).write(true).create(true).truncate(false), &head_path);
    let head = head.map_err(io)?;
    match head.try_lock() {
        Ok(()) => Ok(head),
        Err(TryLockError::WouldBlock) => Err(AuditError::InUse(path.to_path_buf())),
        Err(TryLockError::Error(source)) => Err(io(source)),
    }
}

/// Opens a file and follows no link: root may work in a folder where another user decides what a name stands for.
fn open_own(options: &mut OpenOptions, path: &Path) -> io::Result<File> {
    // What is no file must not keep whoever opens it waiting.
    let file = options.custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path)?;
    match file.metadata()?.is_file() {
        true => Ok(file),
        false => Err(io::Error::other("it is no file; move it away")),
    }
}

fn has_lines(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|meta| meta.len() > 0)
}

/// What a log has when it is opened.
struct Before {
    /// The last entry.
    last: Entry,
    /// Bytes of the newest file up to the end of its last line.
    whole: u64,
    /// Bytes behind that: of a line that a crash cut off.
    torn: u64,
}

/// Looks at a log, which stays as it is: of one that is damaged nothing is taken away.
fn before(path: &Path) -> Result<Before, AuditError> {
    let damaged = |broken| AuditError::Broken { log: path.to_path_buf(), broken };
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) => match error.kind() {
            io::ErrorKind::NotFound => Vec::new(),
            io::ErrorKind::PermissionDenied => {
                return Err(AuditError::Io { path: path.to_path_buf(), source: error });
            }
            _ => {
                return Err(damaged(Broken { path: path.to_path_buf(), line: 0, what: error.to_string() }));
            }
        },
    };
    let whole = bytes.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
    let last = verify::last(path, whole).map_err(damaged)?;
    Ok(Before { last, whole: whole as u64, torn: (bytes.len() - whole) as u64 })
}

#[cfg(test)]
mod tests;
