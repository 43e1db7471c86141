//! Who waits until what is new is durable.

use super::{Flusher, Inner};
use std::sync::PoisonError;
use std::time::Duration;

impl Flusher {
    /// Waits until everything that was there when this was called is durable; false when that failed, or took longer
    /// than `patience`.
    pub fn flush(&self, patience: Duration) -> bool {
        let mut inner = self.shared.lock();
        inner.asked += 1;
        let round = inner.asked;
        self.shared.changed.notify_all();
        drop(inner);
        self.round_by_hand();
        let inner = self.shared.lock();
        let waiting = |inner: &mut Inner| inner.done < round && !inner.stop;
        let waited = self.shared.changed.wait_timeout_while(inner, patience, waiting);
        let (inner, timed_out) = waited.unwrap_or_else(PoisonError::into_inner);
        // Where the end came first, what is known is of an earlier round.
        !timed_out.timed_out() && inner.done >= round && inner.good
    }

    pub(super) fn round_by_hand(&self) {
        if let Some(rounds) = &self.by_hand {
            rounds.lock().unwrap_or_else(PoisonError::into_inner).round();
        }
    }
}
