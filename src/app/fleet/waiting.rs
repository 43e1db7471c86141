//! Orders of people on their way to the streams: who answers them has to know that they are kept.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

#[derive(Debug, Default)]
struct Count {
    waiting: usize,
    given_up: u64,
}

/// Counts orders that are not kept yet, and those that were given up.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    count: Mutex<Count>,
    changed: Condvar,
}

impl Waiting {
    fn lock(&self) -> MutexGuard<'_, Count> {
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One more waits.
    pub(super) fn begin(&self) {
        self.lock().waiting += 1;
    }

    /// One is kept, or was given up.
    pub(super) fn end(&self, kept: bool) {
        let mut count = self.lock();
        count.waiting = count.waiting.saturating_sub(1);
        count.given_up += u64::from(!kept);
        self.changed.notify_all();
    }

    /// Waits until none is on its way; false where that takes longer than `patience`, or one was given up meanwhile. It blocks
    /// its thread.
    pub(super) fn are_kept(&self, patience: Duration) -> bool {
        let count = self.lock();
        let given_up = count.given_up;
        let waited = self.changed.wait_timeout_while(count, patience, |count| count.waiting > 0);
        let (count, late) = waited.unwrap_or_else(PoisonError::into_inner);
        !late.timed_out() && count.given_up == given_up
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn who_waits_hears_that_an_order_is_kept() {
        let waiting = Arc::new(Waiting::default());
        waiting.begin();
        let own = waiting.clone();
        let keeper = std::thread::spawn(move || own.end(true));
        assert!(waiting.are_kept(Duration::from_secs(60)));
        keeper.join().expect("no panic");
    }

    #[test]
    fn without_orders_nothing_is_waited_for_and_with_one_no_longer_than_told() {
        let waiting = Waiting::default();
        assert!(waiting.are_kept(Duration::ZERO));
        waiting.begin();
        assert!(!waiting.are_kept(Duration::ZERO));
        waiting.end(false);
        assert!(waiting.are_kept(Duration::ZERO), "what was given up before is no matter of this order");
    }
}
