//! What alarms did, the last changes over all loops.

use crate::alarm::Transition;
use crate::signal::LoopId;
use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Changes that are remembered.
const MOST: usize = 2000;

/// A change of an alarm, as it is remembered.
#[derive(Clone, Debug, PartialEq)]
pub struct AlarmChange {
    /// Which loop.
    pub id: LoopId,
    /// What changed.
    pub transition: Transition,
    /// Who did it, where somebody did.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// The last changes.
#[derive(Debug, Default)]
pub(super) struct AlarmLog(Mutex<VecDeque<AlarmChange>>);

impl AlarmLog {
    pub(super) fn push(&self, change: AlarmChange) {
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if log.len() == MOST {
            log.pop_front();
        }
        log.push_back(change);
    }

    pub(super) fn newest_first(&self) -> Vec<AlarmChange> {
        let log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        log.iter().rev().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Cause, State};

    #[test]
    fn the_oldest_change_goes_when_there_is_no_room() {
        let log = AlarmLog::default();
        for k in 0..MOST + 5 {
            let transition = Transition {
                from: State::Normal,
                to: State::Unacknowledged,
                at: k as f64,
                cause: Cause::Raised,
            };
            log.push(AlarmChange { id: LoopId::new("FIC1"), transition, by: None, comment: None });
        }
        let kept = log.newest_first();
        assert_eq!((kept.len(), kept[0].transition.at), (MOST, (MOST + 4) as f64));
    }
}
