//! The latest events, numbered: whoever was away for a while goes on where they were.

use super::{Event, Results};
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;

/// Events remembered.
pub const MOST_EVENTS: usize = 1024;

/// Some events after a number.
#[derive(Clone, Debug, Default)]
pub struct Past {
    /// Number and event, oldest first; numbers count from 1 without gaps.
    pub events: Vec<(u64, Event)>,
    /// Events after the number that are forgotten already.
    pub lost: u64,
}

/// What has happened lately.
#[derive(Debug)]
pub(super) struct EventLog {
    kept: Mutex<Kept>,
    /// The latest number.
    latest: watch::Sender<u64>,
}

#[derive(Debug, Default)]
struct Kept {
    events: VecDeque<Event>,
    /// The number of the newest.
    latest: u64,
}

impl Default for EventLog {
    fn default() -> Self {
        Self { kept: Mutex::default(), latest: watch::channel(0).0 }
    }
}

impl EventLog {
    pub(super) fn note(&self, event: Event) {
        let mut kept = self.kept();
        if kept.events.len() == MOST_EVENTS {
            kept.events.pop_front();
        }
        kept.events.push_back(event);
        kept.latest += 1;
        // While the log is held, so that numbers are told in order.
        self.latest.send_replace(kept.latest);
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Results {
    /// The number of the latest event, now and whenever there is another.
    pub fn latest_event(&self) -> watch::Receiver<u64> {
        self.log.latest.subscribe()
    }

    /// Events after number `after`, oldest first, at most `most`; `None` for a number that was never given.
    pub fn events_after(&self, after: u64, most: usize) -> Option<Past> {
        let kept = self.log.kept();
        let missed = kept.latest.checked_sub(after)?;
        let lost = missed.saturating_sub(kept.events.len() as u64);
        let first = after + lost + 1;
        let skipped = kept.events.len().saturating_sub(missed as usize);
        let events = kept.events.iter().skip(skipped).take(most).cloned();
        Some(Past { events: (first..).zip(events).collect(), lost })
    }
}
