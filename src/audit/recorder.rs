//! Puts everything on record: one thread that owns the audit log, so that waiting for the disk delays no timer.

use super::rights::try_folder;
use super::{self as audit, AuditError, Bounds, Log, before, open_head};
use std::collections::VecDeque;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Entries that may wait for the disk.
const QUEUE: usize = 4096;
/// Longest wait for an entry to be on disk, once those before it are: a disk that takes longer hangs. A batch that begins another file
/// waits for the disk four times, and a busy disk takes seconds each time.
pub const ON_RECORD: Duration = Duration::from_secs(15);
/// Entries that share one wait for the disk.
const BATCH: usize = 512;

/// Why a log takes no entries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// It was changed, or cannot be read: it takes none until somebody decides by `stictiond audit renew`.
    pub is_damaged: bool,
    /// Why, with the file and with what helps.
    pub reason: String,
}

/// Hands entries to the thread that writes them.
pub struct Recorder {
    path: PathBuf,
    entries: Mutex<Option<SyncSender<Entry>>>,
    state: State,
    thread: Mutex<Option<JoinHandle<()>>>,
    /// Of a log that is damaged: its head, whose lock keeps others out.
    _head: Option<File>,
}

/// How the log is, as its thread and whoever asks see it.
#[derive(Clone, Default)]
struct State {
    failed: Arc<AtomicBool>,
    /// Since when each entry waits that is not on disk yet, the oldest first; none for longer than since the batch before it was
    /// written.
    waiting: Arc<Mutex<VecDeque<Instant>>>,
    /// Why it failed for good, once that is known.
    fault: Arc<OnceLock<Fault>>,
}

impl State {
    fn fail(&self, fault: Fault) {
        // What failed first is the reason.
        let _ = self.fault.set(fault);
        self.failed.store(true, Relaxed);
    }

    fn waiting(&self) -> MutexGuard<'_, VecDeque<Instant>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The first of those that wait are on disk. What waits behind them begins to wait for the disk now: two syncs that each take
    /// their time are no disk that hangs.
    fn written(&self, count: usize) {
        let mut waiting = self.waiting();
        waiting.drain(..count);
        let now = Instant::now();
        waiting.iter_mut().for_each(|since| *since = now);
    }

    /// Whether the disk keeps an entry waiting for too long.
    fn hangs(&self) -> bool {
        self.waiting().front().is_some_and(|since| since.elapsed() >= ON_RECORD)
    }
}

struct Entry {
    at: String,
    event: &'static str,
    fields: Vec<(&'static str, String)>,
    done: Option<oneshot::Sender<()>>,
}

impl Recorder {
    /// Opens the log and begins. One that is damaged is held and takes no entries (see [`Self::fault`]): whoever needs it goes on
    /// without what needs a record.
    ///
    /// # Errors
    /// [`AuditError::InUse`] while another process has the log, [`AuditError::Io`] when it cannot be opened or written, or no file can
    /// be made in its folder.
    pub fn start(path: &Path, bounds: Bounds, now: f64) -> Result<Self, AuditError> {
        let head = open_head(path)?;
        match before(path) {
            Ok(before) => {
                try_folder(path)?;
                Ok(Self::of(Log::go_on(path, bounds, &stamp(now), head, before)?))
            }
            Err(error @ AuditError::Broken { .. }) => Ok(Self::damaged(path, head, &error)),
            Err(error) => Err(error),
        }
    }

    fn of(log: Log) -> Self {
        let (sender, receiver) = sync_channel(QUEUE);
        let (path, state) = (log.path.clone(), State::default());
        let own = state.clone();
        let thread = Mutex::new(Some(std::thread::spawn(move || keep(log, &receiver, &own))));
        Self { path, entries: Mutex::new(Some(sender)), state, thread, _head: None }
    }

    fn damaged(path: &Path, head: File, error: &AuditError) -> Self {
        let state = State::default();
        tracing::error!(%error, "this audit log is damaged: what needs a record in it is refused until somebody decides");
        state.fail(Fault { is_damaged: true, reason: error.to_string() });
        let (path, thread) = (path.to_path_buf(), Mutex::new(None));
        Self { path, entries: Mutex::new(None), state, thread, _head: Some(head) }
    }

    /// The log.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// False from the first entry on that could not be put on record, and while the disk keeps one waiting for [`ON_RECORD`].
    pub fn works(&self) -> bool {
        !self.state.failed.load(Relaxed) && !self.state.hangs()
    }

    /// Why it does not work; `None` while it does.
    pub fn fault(&self) -> Option<Fault> {
        if self.works() {
            return None;
        }
        let of = |why: &str| Fault {
            is_damaged: false,
            reason: format!("audit log {}: {why}", self.path.display()),
        };
        let known = self.state.fault.get().cloned();
        known.or_else(|| {
            Some(match self.state.failed.load(Relaxed) {
                true => of("too many entries wait for the disk; look at the disk and start stictiond again"),
                false => of("the disk keeps an entry waiting"),
            })
        })
    }

    /// Puts an entry in line; false when it cannot be recorded.
    pub fn put(&self, at: f64, event: &'static str, fields: Vec<(&'static str, String)>) -> bool {
        self.send(Entry { at: stamp(at), event, fields, done: None })
    }

    /// Puts an entry in line; what comes back hears when it, and everything before it, is on disk, or an error where it
    /// cannot be recorded.
    pub fn follow(
        &self,
        at: f64,
        event: &'static str,
        fields: Vec<(&'static str, String)>,
    ) -> oneshot::Receiver<()> {
        let (sender, receiver) = oneshot::channel();
        self.send(Entry { at: stamp(at), event, fields, done: Some(sender) });
        receiver
    }

    fn send(&self, entry: Entry) -> bool {
        let entries = self.entries.lock().unwrap_or_else(PoisonError::into_inner);
        // Held until it is counted: it may be on disk before.
        let mut waiting = self.state.waiting();
        // A full queue means a disk that hangs: that is a failure, not a reason to wait with it.
        let sent = entries.as_ref().is_some_and(|entries| entries.try_send(entry).is_ok());
        if sent {
            waiting.push_back(Instant::now());
        } else {
            self.state.failed.store(true, Relaxed);
        }
        drop(waiting);
        sent && self.works()
    }
}

impl Drop for Recorder {
    /// Everything in line is written first.
    fn drop(&mut self) {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the audit log failed");
        }
    }
}

fn keep(mut log: Log, entries: &Receiver<Entry>, state: &State) {
    while let Ok(first) = entries.recv() {
        let mut batch = vec![first];
        batch.extend(entries.try_iter().take(BATCH));
        let lines = match write(&mut log, &batch) {
            Ok(lines) => lines,
            Err(error) => {
                // What stands in the file now may end in half a line: nothing more is written behind it.
                let reason = format!("{error}; mend the cause and start stictiond again");
                state.fail(Fault { is_damaged: false, reason });
                tracing::error!(%error, "this audit log cannot be written: what needs a record in it is refused; mend the cause and start stictiond again");
                return;
            }
        };
        state.written(batch.len());
        for (entry, line) in batch.into_iter().zip(lines) {
            if let Some(done) = entry.done {
                // The hash in a log elsewhere is what a forger of the file cannot reach.
                tracing::info!(event = entry.event, n = line.n, hash = line.hash, "on record");
                // Whoever waited may have gone.
                let _ = done.send(());
            }
        }
    }
}

/// Puts entries on disk; number and hash of each one's line.
fn write(log: &mut Log, batch: &[Entry]) -> Result<Vec<audit::Entry>, AuditError> {
    let mut lines = Vec::with_capacity(batch.len());
    for entry in batch {
        log.append(&entry.at, entry.event, &entry.fields)?;
        lines.push(log.last().clone());
    }
    log.sync()?;
    Ok(lines)
}

/// A disk that hangs.
#[cfg(test)]
pub(crate) struct Hung {
    entries: Receiver<Entry>,
    state: State,
}

#[cfg(test)]
impl Hung {
    /// Everything that waits is on disk.
    pub(crate) fn go_on(&self) {
        for entry in self.entries.try_iter() {
            self.state.waiting().pop_front();
            if let Some(done) = entry.done {
                let _ = done.send(());
            }
        }
    }
}

#[cfg(test)]
impl Recorder {
    /// One whose disk hangs until it is told to go on.
    pub(crate) fn hung(path: &Path) -> (Self, Hung) {
        let (sender, entries) = sync_channel(QUEUE);
        let (path, state, thread) = (path.to_path_buf(), State::default(), Mutex::new(None));
        let own = Self { path, entries: Mutex::new(Some(sender)), state: state.clone(), thread, _head: None };
        (own, Hung { entries, state })
    }
}

/// RFC 3339 in UTC; a time that is none is recorded as the number it is.
fn stamp(t: f64) -> String {
    let nanos = (t * 1e9).round();
    let stamp = jiff::Timestamp::from_nanosecond(nanos as i128).ok().filter(|_| t.is_finite());
    stamp.map_or_else(|| t.to_string(), |stamp| stamp.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disk_that_hangs_is_a_log_that_does_not_work_whoever_waits() {
        let (recorder, disk) = Recorder::hung(Path::new("audit.log"));
        assert!(recorder.put(1.0, "write", Vec::new()) && recorder.works());
        // As if that was so long ago.
        let long_ago = Instant::now().checked_sub(ON_RECORD).expect("this machine runs for longer");
        *recorder.state.waiting().front_mut().expect("it waits") = long_ago;
        assert!(!recorder.works() && !recorder.put(2.0, "write", Vec::new()));
        let fault = recorder.fault().expect("it hangs");
        assert!(!fault.is_damaged && fault.reason.contains("keeps an entry waiting"), "{}", fault.reason);
        disk.go_on();
        assert!(recorder.works(), "it has written what waited");
    }

    #[test]
    fn each_batch_waits_from_its_own_start() {
        let state = State::default();
        let long_ago = Instant::now().checked_sub(ON_RECORD).expect("this machine runs for longer");
        state.waiting().extend([long_ago; 3]);
        assert!(state.hangs());
        state.written(2);
        assert!(!state.hangs() && state.waiting().len() == 1);
        *state.waiting().front_mut().expect("it waits") = long_ago;
        assert!(state.hangs());
    }

    #[tokio::test]
    async fn what_is_on_disk_does_not_wait() {
        let folder = std::env::temp_dir().join(format!("stictiond-recorder-waits-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the temporary folder is writable");
        let bounds = Bounds { max_bytes: 1 << 20, keep_files: 1 };
        let recorder = Recorder::start(&folder.join("audit.log"), bounds, 0.0).expect("opens");
        for t in 0..3 {
            recorder.follow(f64::from(t), "change", Vec::new()).await.expect("written");
        }
        assert!(recorder.state.waiting().is_empty());
        drop(recorder);
        std::fs::remove_dir_all(&folder).expect("the folder is there");
    }

    #[test]
    fn each_entry_of_a_batch_has_the_number_and_the_hash_of_its_own_line() {
        let folder = std::env::temp_dir().join(format!("stictiond-recorder-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the temporary folder is writable");
        let path = folder.join("audit.log");
        let bounds = Bounds { max_bytes: 1 << 20, keep_files: 1 };
        let mut log = Log::open(&path, bounds, &stamp(0.0)).expect("opens");
        let entry = |event| Entry { at: stamp(0.0), event, fields: Vec::new(), done: None };
        let lines =
            write(&mut log, &[entry("grant"), entry("approval"), entry("transition")]).expect("written");
        let text = std::fs::read_to_string(&path).expect("text");
        std::fs::remove_dir_all(&folder).expect("the folder is there");
        // The first line of a file names the one before.
        assert_eq!(lines.iter().map(|line| line.n).collect::<Vec<_>>(), [2, 3, 4]);
        for (line, told) in text.lines().skip(1).zip(&lines) {
            assert!(line.ends_with(&format!("#{}", told.hash)), "{line}");
        }
    }
}
