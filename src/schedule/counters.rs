//! What a scheduler has done, in numbers.

use std::sync::atomic::AtomicU64;
use std::sync::atomic::Ordering::Relaxed;

/// Counters since the start, and what is going on now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counters {
    /// Runs that ended with a diagnosis.
    pub diagnosed: u64,
    /// Those of them that searched for nothing, because the last model still fits.
    pub confirmed: u64,
    /// Runs that passed their deadline.
    pub deadline_exceeded: u64,
    /// Runs that panicked.
    pub panicked: u64,
    /// Due, but the loop's previous run still waited or was not done.
    pub skipped_waiting: u64,
    /// Due while the scheduler itself was held up (a suspended machine).
    pub skipped_late: u64,
    /// Runs waiting for a slot, now.
    pub queued: u64,
    /// Runs in a slot, now.
    pub running: u64,
    /// Time spent in diagnoses (s on the wall clock).
    pub busy_s: f64,
}

/// The same while they are counted.
#[derive(Default)]
pub(super) struct Counts {
    pub(super) diagnosed: AtomicU64,
    pub(super) confirmed: AtomicU64,
    pub(super) deadline_exceeded: AtomicU64,
    pub(super) panicked: AtomicU64,
    pub(super) skipped_waiting: AtomicU64,
    pub(super) skipped_late: AtomicU64,
    pub(super) running: AtomicU64,
    pub(super) busy_us: AtomicU64,
}

impl Counts {
    /// As they are now, while so many runs wait.
    pub(super) fn with(&self, queued: u64) -> Counters {
        let count = |counter: &AtomicU64| counter.load(Relaxed);
        Counters {
            diagnosed: count(&self.diagnosed),
            confirmed: count(&self.confirmed),
            deadline_exceeded: count(&self.deadline_exceeded),
            panicked: count(&self.panicked),
            skipped_waiting: count(&self.skipped_waiting),
            skipped_late: count(&self.skipped_late),
            queued,
            running: count(&self.running),
            busy_s: count(&self.busy_us) as f64 * 1e-6,
        }
    }
}
