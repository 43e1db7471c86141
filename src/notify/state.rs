//! How a receiver is: counters, and whether it takes what it is sent.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// How one receiver is, live.
#[derive(Debug, Default)]
pub struct State {
    pub(super) sent: AtomicU64,
    pub(super) failed: AtomicU64,
    pub(super) dropped: AtomicU64,
    pub(super) queue: AtomicU64,
    /// It has said that it is gone, and has taken nothing since.
    pub(super) gone: AtomicBool,
    health: Mutex<Health>,
}

#[derive(Clone, Debug, Default)]
struct Health {
    failing: Option<(String, f64)>,
    sent_at: Option<f64>,
}

/// How one receiver is, at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Messages that it took.
    pub sent: u64,
    /// Attempts that failed.
    pub failed: u64,
    /// Notices that were not told one by one, or not at all.
    pub dropped: u64,
    /// Notices and messages that wait.
    pub queue: u64,
    /// Why the last attempt failed and since when they do (s); `None` while it takes what it is sent.
    pub failing: Option<(String, f64)>,
    /// When it last took something (s).
    pub sent_at: Option<f64>,
}

impl State {
    /// Something was taken; true where nothing was before.
    pub(super) fn took(&self, now: f64) -> bool {
        self.sent.fetch_add(1, Relaxed);
        self.gone.store(false, Relaxed);
        let mut health = self.health.lock().unwrap_or_else(PoisonError::into_inner);
        health.sent_at = Some(now);
        health.failing.take().is_some()
    }

    /// An attempt failed; true where the one before did not.
    pub(super) fn refused(&self, why: &str, now: f64) -> bool {
        self.failed.fetch_add(1, Relaxed);
        let mut health = self.health.lock().unwrap_or_else(PoisonError::into_inner);
        let since = health.failing.as_ref().map(|(_, since)| *since);
        health.failing = Some((why.to_string(), since.unwrap_or(now)));
        since.is_none()
    }

    /// Whether nothing more is sent to it.
    pub fn is_gone(&self) -> bool {
        self.gone.load(Relaxed)
    }

    /// Whether the last attempt failed.
    pub(super) fn is_failing(&self) -> bool {
        self.health.lock().unwrap_or_else(PoisonError::into_inner).failing.is_some()
    }

    /// How it is.
    pub fn snapshot(&self) -> Snapshot {
        let Health { failing, sent_at } = self.health.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Snapshot {
            sent: self.sent.load(Relaxed),
            failed: self.failed.load(Relaxed),
            dropped: self.dropped.load(Relaxed),
            queue: self.queue.load(Relaxed),
            failing,
            sent_at,
        }
    }
}
