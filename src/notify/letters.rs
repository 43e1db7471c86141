//! Messages on their way to one receiver, and those that never arrived: bounded, and on disk where there is a store. Calls
//! that write files wait for the disk; they do not belong on an async thread.

use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, VecDeque};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Largest file read back (bytes).
const MOST_BYTES: u64 = 1 << 22;

/// One message.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Letter {
    /// Its name for good: a receiver that hears it twice knows by it.
    pub id: String,
    /// When it was made (s).
    pub made: f64,
    /// Attempts that failed.
    pub attempts: u32,
    /// Why the last one did; empty before one did.
    pub why: String,
    /// Since when it is dead (s); `None` while it waits.
    pub dead_since: Option<f64>,
    /// What is sent.
    pub body: String,
    /// Those of its readers who do not have it, once others do; empty while nobody has it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lacking: Vec<String>,
}

impl Letter {
    /// A new message; `None` where the machine has no randomness for its name.
    pub(super) fn new(body: String, made: f64) -> Option<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).ok()?;
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Some(Self {
            id: format!("msg_{hex}"),
            made,
            attempts: 0,
            why: String::new(),
            dead_since: None,
            body,
            lacking: Vec::new(),
        })
    }
}

/// The letters of one receiver.
#[derive(Debug)]
pub struct Letters {
    folder: Option<PathBuf>,
    inner: Mutex<Inner>,
    changed: Notify,
    /// Number of the last change of an alarm that is in a letter or needs none; 0 before there is one.
    heard: AtomicU64,
}

#[derive(Debug, Default)]
struct Inner {
    most: usize,
    waiting: VecDeque<Letter>,
    dead: VecDeque<Letter>,
    /// Names of those that could not be written.
    unwritten: BTreeSet<String>,
}

impl Letters {
    /// The letters of a folder, with room for `most` dead ones; only in memory where there is no folder.
    pub fn open(folder: Option<PathBuf>, most: usize) -> Self {
        let mut inner = Inner { most, ..Inner::default() };
        let mut found = folder.as_deref().map(read_all).unwrap_or_default();
        found.sort_by(|a, b| a.made.total_cmp(&b.made).then_with(|| a.id.cmp(&b.id)));
        for letter in found {
            let list = if letter.dead_since.is_some() { &mut inner.dead } else { &mut inner.waiting };
            list.push_back(letter);
        }
        let letters = Self { folder, inner: Mutex::new(inner), changed: Notify::new(), heard: 0.into() };
        letters.keep_at_most(most);
        letters
    }

    /// Sets how many dead letters are kept; how many went for it.
    pub fn keep_at_most(&self, most: usize) -> usize {
        let mut inner = self.lock();
        inner.most = most;
        self.trim(&mut inner)
    }

    /// The dead ones, oldest first.
    pub fn dead(&self) -> Vec<Letter> {
        self.lock().dead.iter().cloned().collect()
    }

    /// How many wait, and how many are dead.
    pub fn counts(&self) -> (usize, usize) {
        let inner = self.lock();
        (inner.waiting.len(), inner.dead.len())
    }

    /// Lets one dead letter, or all, wait to be sent again; how many those are.
    pub fn replay(&self, id: Option<&str>) -> usize {
        let mut inner = self.lock();
        let all = std::mem::take(&mut inner.dead);
        let (chosen, rest): (VecDeque<Letter>, VecDeque<Letter>) =
            all.into_iter().partition(|letter| id.is_none_or(|id| letter.id == id));
        let count = chosen.len();
        inner.dead = rest;
        for letter in chosen {
            let letter = Letter { dead_since: None, ..letter };
            self.keep(&letter, &mut inner.unwritten);
            inner.waiting.push_back(letter);
        }
        drop(inner);
        self.changed.notify_one();
        count
    }

    pub(super) fn heard(&self) -> Option<u64> {
        Some(self.heard.load(Relaxed)).filter(|heard| *heard > 0)
    }

    pub(super) fn hear(&self, number: u64) {
        self.heard.store(number, Relaxed);
    }

    pub(super) async fn changed(&self) {
        self.changed.notified().await;
    }

    /// The letter of a name, if it waits.
    pub(super) fn waiting(&self, id: &str) -> Option<Letter> {
        self.lock().waiting.iter().find(|letter| letter.id == id).cloned()
    }

    /// The oldest letter that nobody has.
    pub(super) fn whole(&self) -> Option<String> {
        self.lock().waiting.iter().find(|letter| letter.lacking.is_empty()).map(|letter| letter.id.clone())
    }

    /// Letters that some have and others lack, oldest first.
    pub(super) fn partly(&self) -> Vec<String> {
        let inner = self.lock();
        let partly = inner.waiting.iter().filter(|letter| !letter.lacking.is_empty());
        partly.map(|letter| letter.id.clone()).collect()
    }

    /// All have a letter but these: they alone get it from now on, after a restart too.
    pub(super) fn lack(&self, id: &str, lacking: Vec<String>) {
        let mut inner = self.lock();
        let Inner { waiting, unwritten, .. } = &mut *inner;
        if let Some(letter) = waiting.iter_mut().find(|letter| letter.id == id) {
            letter.lacking = lacking;
            self.keep(letter, unwritten);
        }
    }

    /// Writes a letter that is not finished: it waits to be sent only where it is found at the next start. Whether that could be
    /// done.
    pub(super) fn draft(&self, letter: &Letter) -> bool {
        self.write(letter).inspect_err(|error| warn_of(letter, error)).is_ok()
    }

    /// A letter waits to be sent; whether it does so after a restart, too.
    pub(super) fn put(&self, letter: Letter) -> bool {
        let mut inner = self.lock();
        let written = self.keep(&letter, &mut inner.unwritten);
        inner.waiting.push_back(letter);
        written
    }

    /// Whether a letter could not be written.
    pub(super) fn any_unwritten(&self) -> bool {
        !self.lock().unwritten.is_empty()
    }

    /// Writes what could not be written, up to the first letter that still cannot; the names of the others.
    pub(super) fn write_again(&self) -> Vec<String> {
        let mut inner = self.lock();
        let Inner { waiting, dead, unwritten, .. } = &mut *inner;
        let mut written = Vec::new();
        while let Some(id) = unwritten.first().cloned() {
            let letter = waiting.iter().chain(&*dead).find(|letter| letter.id == id);
            if letter.is_some_and(|letter| self.write(letter).is_err()) {
                break;
            }
            unwritten.remove(&id);
            written.push(id);
        }
        written
    }

    pub(super) fn done(&self, id: &str) {
        let mut inner = self.lock();
        inner.waiting.retain(|letter| letter.id != id);
        inner.unwritten.remove(id);
        self.remove(id);
    }

    pub(super) fn failed(&self, id: &str, why: &str) {
        if let Some(letter) = self.lock().waiting.iter_mut().find(|letter| letter.id == id) {
            (letter.attempts, letter.why) = (letter.attempts + 1, why.to_string());
        }
    }

    /// A letter is dead; how many older ones went for it.
    pub(super) fn bury(&self, id: &str, now: f64) -> usize {
        let mut inner = self.lock();
        let Some(at) = inner.waiting.iter().position(|letter| letter.id == id) else { return 0 };
        if let Some(letter) = inner.waiting.remove(at) {
            let letter = Letter { dead_since: Some(now), ..letter };
            self.keep(&letter, &mut inner.unwritten);
            inner.dead.push_back(letter);
        }
        self.trim(&mut inner)
    }

    fn trim(&self, inner: &mut Inner) -> usize {
        let surplus = inner.dead.len().saturating_sub(inner.most);
        for letter in inner.dead.drain(..surplus) {
            self.remove(&letter.id);
        }
        surplus
    }

    /// A panic elsewhere leaves the lists whole: each change to them is one call.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes a letter; whether that could be done. One that cannot be written stays in memory, and its name is noted.
    fn keep(&self, letter: &Letter, unwritten: &mut BTreeSet<String>) -> bool {
        let Err(error) = self.write(letter) else {
            unwritten.remove(&letter.id);
            return true;
        };
        warn_of(letter, &error);
        unwritten.insert(letter.id.clone());
        false
    }

    /// Without a folder there is nothing to write.
    fn write(&self, letter: &Letter) -> io::Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        fs::create_dir_all(folder)?;
        let text = serde_json::to_vec(letter)?;
        let (new, path) = (folder.join(format!("{}.new", letter.id)), path(folder, &letter.id));
        let mut file = fs::File::create(&new)?;
        file.write_all(&text)?;
        file.sync_all()?;
        fs::rename(&new, path)?;
        fs::File::open(folder)?.sync_all()
    }

    fn remove(&self, id: &str) {
        if let Some(folder) = &self.folder {
            // What is not there was never written.
            let _ = fs::remove_file(path(folder, id));
        }
    }
}

fn warn_of(letter: &Letter, error: &io::Error) {
    tracing::warn!(letter = letter.id, %error, "a message is kept in memory only");
}

fn path(folder: &Path, id: &str) -> PathBuf {
    folder.join(format!("{id}.json"))
}

fn read_all(folder: &Path) -> Vec<Letter> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let mut found = Vec::new();
    for path in entries.flatten().map(|entry| entry.path()) {
        if path.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let small = fs::metadata(&path).is_ok_and(|about| about.len() <= MOST_BYTES);
        let bytes = if small { fs::read(&path).ok() } else { None };
        let letter = bytes.and_then(|bytes| serde_json::from_slice::<Letter>(&bytes).ok());
        // A name from a file is part of a path later.
        let named = letter.filter(|letter| path.file_stem().is_some_and(|stem| *stem == *letter.id));
        match named {
            Some(letter) => found.push(letter),
            None => tracing::warn!(path = %path.display(), "this is no message"),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn letter(body: &str, made: f64) -> Letter {
        Letter::new(body.into(), made).unwrap()
    }

    fn next(letters: &Letters) -> Letter {
        letters.waiting(&letters.whole().unwrap()).unwrap()
    }

    fn bodies(letters: &[Letter]) -> Vec<&str> {
        letters.iter().map(|letter| letter.body.as_str()).collect()
    }

    #[test]
    fn letters_outlive_a_restart_and_the_dead_are_bounded() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tmp/letters");
        let _ = fs::remove_dir_all(&folder);
        let letters = Letters::open(Some(folder.clone()), 2);
        for (body, made) in [("a", 1.0), ("b", 2.0), ("c", 3.0), ("d", 4.0)] {
            letters.put(letter(body, made));
        }
        for _ in 0..3 {
            let id = letters.whole().unwrap();
            letters.failed(&id, "refused");
            letters.bury(&id, 10.0);
        }
        assert_eq!((letters.counts(), bodies(&letters.dead())), ((1, 2), vec!["b", "c"]));

        fs::write(folder.join("other.json"), "{}").unwrap();
        fs::write(folder.join("half.new"), "{\"id\"").unwrap();
        let letters = Letters::open(Some(folder.clone()), 2);
        assert_eq!((letters.counts(), bodies(&letters.dead())), ((1, 2), vec!["b", "c"]));
        assert_eq!((letters.dead()[0].attempts, letters.dead()[0].why.as_str()), (1, "refused"));
        let id = letters.dead()[1].id.clone();
        assert_eq!((letters.replay(Some("msg_none")), letters.replay(Some(&id))), (0, 1));
        assert_eq!((letters.counts(), next(&letters).body.as_str()), ((2, 1), "d"));
        letters.done(&next(&letters).id);

        let letters = Letters::open(Some(folder), 1);
        assert_eq!((letters.counts(), next(&letters).body.as_str()), ((1, 1), "c"));
        assert_eq!((letters.replay(None), letters.counts()), (1, (2, 0)));
    }

    #[test]
    fn who_lacks_a_letter_is_known_after_a_restart_and_when_it_is_replayed() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tmp/letters_partly");
        let _ = fs::remove_dir_all(&folder);
        let letters = Letters::open(Some(folder.clone()), 2);
        let own = letter("a", 1.0);
        let id = own.id.clone();
        letters.put(own);
        letters.lack(&id, vec!["b@plant".into()]);
        assert_eq!((letters.whole(), letters.partly()), (None, vec![id.clone()]));
        letters.bury(&id, 2.0);
        let letters = Letters::open(Some(folder), 2);
        assert_eq!((letters.partly(), letters.replay(None)), (vec![], 1));
        assert_eq!(letters.waiting(&id).unwrap().lacking, ["b@plant"]);
    }
}
