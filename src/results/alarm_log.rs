//! What alarms did, the last changes over all of them.

use crate::alarm::{AlarmId, Priority, Transition};
use std::collections::VecDeque;
use std::sync::Arc;

/// Changes that are remembered.
pub const MOST_CHANGES: usize = 2000;

/// A change of an alarm, as it is remembered.
#[derive(Clone, Debug, PartialEq)]
pub struct AlarmChange {
    /// Counted up since the start; what was kept of before comes first.
    pub number: u64,
    /// Which alarm.
    pub id: AlarmId,
    /// What changed.
    pub transition: Transition,
    /// How soon somebody has to act.
    pub priority: Priority,
    /// Raised in a flood.
    pub grouped: bool,
    /// What the condition is, in one line.
    pub detail: String,
    /// Who did it, where somebody did.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// The last changes, and how many there were.
#[derive(Debug, Default)]
pub(super) struct AlarmLog {
    latest: u64,
    kept: VecDeque<Arc<AlarmChange>>,
}

impl AlarmLog {
    /// Numbers a change and remembers it.
    pub fn push(&mut self, change: AlarmChange) -> Arc<AlarmChange> {
        if self.kept.len() == MOST_CHANGES {
            self.kept.pop_front();
        }
        self.latest += 1;
        let change = Arc::new(AlarmChange { number: self.latest, ..change });
        self.kept.push_back(change.clone());
        change
    }

    /// Takes back what was kept, oldest first, unless something has happened since.
    pub fn restore(&mut self, kept: Vec<AlarmChange>) {
        if self.kept.is_empty() {
            kept.into_iter().for_each(|change| drop(self.push(change)));
        }
    }

    pub fn newest_first(&self) -> Vec<Arc<AlarmChange>> {
        self.kept.iter().rev().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Cause, State};

    #[test]
    fn the_oldest_change_goes_when_there_is_no_room() {
        let mut log = AlarmLog::default();
        for k in 0..MOST_CHANGES + 5 {
            let transition = Transition {
                from: State::Normal,
                to: State::Unacknowledged,
                at: k as f64,
                cause: Cause::Raised,
            };
            log.push(AlarmChange {
                number: 0,
                id: AlarmId::named("FIC1"),
                transition,
                priority: Priority::Low,
                grouped: false,
                detail: String::new(),
                by: None,
                comment: None,
            });
        }
        let kept = log.newest_first();
        assert_eq!((kept.len(), kept[0].transition.at), (MOST_CHANGES, (MOST_CHANGES + 4) as f64));
        assert_eq!((kept[0].number, kept[1].number), (2005, 2004));
    }
}
