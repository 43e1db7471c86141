//! Reads a log again and finds the first line that cannot be what was written.

use super::renew::RENEWING;
use super::{Entry, GENESIS, genesis, has_lines, hash, head_path, rotated};
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

/// A log that is whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Verified {
    /// Files read, rotated ones included.
    pub files: usize,
    /// Entries in them.
    pub entries: u64,
    /// The first entry's number: above 1 where older files are no longer kept.
    pub first: u64,
    /// The last entry.
    pub last: Entry,
    /// False when there is no `FILE.head`: then lines dropped from the end would not be missed.
    pub has_head: bool,
}

/// The first thing that is wrong with a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Broken {
    /// In which file.
    pub path: PathBuf,
    /// In which line, from 1; 0 for the file as a whole.
    pub line: usize,
    /// What.
    pub what: String,
}

impl fmt::Display for Broken {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            0 => write!(out, "audit log {}: {}", self.path.display(), self.what),
            line => write!(out, "audit log {}: line {line}: {}", self.path.display(), self.what),
        }
    }
}

/// Reads `path` and the rotated files beside it, oldest first.
///
/// # Errors
/// [`Broken`], the first that is found.
pub fn verify(path: &Path) -> Result<Verified, Broken> {
    up_to(path, None)
}

/// The last entry, where all before it is verified. Of the newest file only `whole` bytes are looked at: what a crash cut off lies
/// behind them.
pub(super) fn last(path: &Path, whole: usize) -> Result<Entry, Broken> {
    up_to(path, Some(whole)).map(|verified| verified.last)
}

fn up_to(path: &Path, whole: Option<usize>) -> Result<Verified, Broken> {
    let older: Vec<PathBuf> = (1..).map(|k| rotated(path, k)).take_while(|file| file.exists()).collect();
    let mut files: Vec<&Path> = older.iter().rev().map(PathBuf::as_path).collect();
    let mut head = Head::read(path)?;
    // Empty behind older ones: a crash came between the rotation and the first line. Empty behind a head: all of it is missing.
    let is_begun = files.is_empty() && head.is_none();
    if whole.map_or(has_lines(path) || is_begun, |whole| whole > 0) {
        files.push(path);
    }
    let (mut before, mut first, mut entries, mut lines) = (None, None, 0, 0);
    for file in &files {
        let most = whole.filter(|_| *file == path);
        let (from, last, count) = file_of((*file, most), before.as_ref(), head.as_mut())?;
        first.get_or_insert(from);
        entries += count as u64;
        (before, lines) = (Some(last), count);
    }
    let last = before.unwrap_or_else(genesis);
    if let Some(head) = head.as_ref().filter(|head| head.entry.n > last.n) {
        let what = format!(
            "missing: entries {} to {} were written and are no longer there",
            last.n.saturating_add(1),
            head.entry.n
        );
        let path = files.last().map_or(path, |file| *file).to_path_buf();
        return Err(Broken { path, line: lines + 1, what });
    }
    Ok(Verified { files: files.len(), entries, first: first.unwrap_or(0), last, has_head: head.is_some() })
}

struct Head {
    entry: Entry,
}

impl Head {
    fn read(path: &Path) -> Result<Option<Self>, Broken> {
        let head = head_path(path);
        let broken = |what: String| Broken { path: head.clone(), line: 1, what };
        let text = match fs::read_to_string(&head) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(broken(error.to_string())),
        };
        // Empty: begun and never synchronised.
        if text.is_empty() {
            return Ok(None);
        }
        if text.starts_with(RENEWING) {
            let what = "a renewal was broken off; what it put aside is in the folders beside the log";
            return Err(broken(what.to_string()));
        }
        let parts = text.strip_suffix('\n').and_then(|line| line.split_once(' '));
        let entry = parts.and_then(|(n, hash)| Some(Entry { n: n.parse().ok()?, hash: hash.to_string() }));
        let entry = entry.ok_or_else(|| broken("neither a number nor a hash".into()))?;
        Ok(Some(Self { entry }))
    }
}

/// One file, or so many bytes of it: its first number, its last entry, its lines.
fn file_of(
    (path, most): (&Path, Option<usize>),
    before: Option<&Entry>,
    mut head: Option<&mut Head>,
) -> Result<(u64, Entry, usize), Broken> {
    let broken = |line: usize, what: &str| Broken { path: path.to_path_buf(), line, what: what.to_string() };
    let mut bytes = fs::read(path).map_err(|error| broken(0, &error.to_string()))?;
    bytes.truncate(most.unwrap_or(usize::MAX));
    let mut entry: Option<Entry> = None;
    let (mut first, mut count) = (0, 0);
    for (at, line) in bytes.split_inclusive(|&byte| byte == b'\n').enumerate() {
        let number = at + 1;
        let wrong = |what: &str| broken(number, what);
        let text = std::str::from_utf8(line).ok().and_then(|line| line.strip_suffix('\n'));
        let text = text.ok_or_else(|| wrong("not a whole line of text"))?;
        let parts = text.rsplit_once(" #");
        let (body, said) = parts.ok_or_else(|| wrong("no entry: it has no hash"))?;
        let n = body.split(' ').next().and_then(|n| n.parse::<u64>().ok());
        let n = n.ok_or_else(|| wrong("no entry: it has no number"))?;
        let previous = match &entry {
            Some(entry) => entry.clone(),
            None => {
                let header = previous(body).ok_or_else(|| wrong("a file begins with the hash before it"))?;
                first = n;
                let previous = Entry { n: n.saturating_sub(1), hash: header };
                if before.is_some_and(|before| *before != previous) {
                    return Err(wrong("it does not follow the last line of the file before"));
                }
                if n == 1 && previous.hash != GENESIS {
                    return Err(wrong("the first entry of all follows nothing"));
                }
                previous
            }
        };
        let next = previous.n.saturating_add(1);
        if n != next {
            return Err(wrong(&format!("entry {n} where {next} belongs: lines are missing or swapped")));
        }
        if hash(&previous.hash, body) != said {
            return Err(wrong("changed: its hash is another"));
        }
        if let Some(head) = head.as_mut().filter(|head| head.entry.n == n)
            && head.entry.hash != said
        {
            return Err(wrong("not the line that was written: the head has another hash for it"));
        }
        entry = Some(Entry { n, hash: said.to_string() });
        count = number;
    }
    let last = entry.ok_or_else(|| broken(1, "missing: the file is empty"))?;
    Ok((first, last, count))
}

fn previous(body: &str) -> Option<String> {
    let (_, value) = body.split_once(" file previous=\"")?;
    value.strip_suffix('"').map(str::to_string)
}
