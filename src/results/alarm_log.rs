//! What alarms did, the last changes over all of them.

use crate::alarm::{AlarmId, Priority, Transition};
use std::collections::VecDeque;
use std::sync::Arc;

/// Changes that are remembered.
pub const MOST_CHANGES: usize = 2000;

/// A change of an alarm, as it is remembered.
#[derive(Clone, Debug, PartialEq)]
pub struct AlarmChange {
    /// Counted up since the start; what was kept of before has smaller ones.
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
    /// People have been told of it by another machine.
    pub told: bool,
}

/// Numbers of changes of before the start: as many as are remembered.
const BEFORE: u64 = MOST_CHANGES as u64;

/// The last changes, and how many there were since the start.
#[derive(Debug, Default)]
pub(super) struct AlarmLog {
    since: u64,
    kept: VecDeque<Arc<AlarmChange>>,
}

impl AlarmLog {
    /// Numbers a change and remembers it.
    pub fn push(&mut self, change: AlarmChange) -> Arc<AlarmChange> {
        if self.kept.len() == MOST_CHANGES {
            self.kept.pop_front();
        }
        self.since += 1;
        let change = Arc::new(AlarmChange { number: self.latest(), ..change });
        self.kept.push_back(change.clone());
        change
    }

    /// Whether this change is remembered.
    pub fn has(&self, id: &AlarmId, transition: &Transition) -> bool {
        self.find(id, transition).is_some()
    }

    /// This change, where it is remembered.
    pub fn find(&self, id: &AlarmId, transition: &Transition) -> Option<&AlarmChange> {
        let same = |own: &&Arc<AlarmChange>| own.id == *id && own.transition == *transition;
        self.kept.iter().rev().find(same).map(|own| &**own)
    }

    /// Takes back what was kept, oldest first, before what there is: once or again, at the start or when it comes to light.
    pub fn restore(&mut self, kept: Vec<AlarmChange>) {
        let first = self.kept.front();
        let begun = first.map_or(f64::INFINITY, |first| first.transition.at);
        let first = first.map_or(BEFORE + 1, |first| first.number);
        let room = MOST_CHANGES - self.kept.len();
        // One of since the start is not of before, though its clock was behind then and set right later.
        let is_before = |own: &AlarmChange| own.transition.at < begun && !self.has(&own.id, &own.transition);
        let before: Vec<AlarmChange> = kept.into_iter().rev().filter(is_before).take(room).collect();
        for (number, change) in (1..first).rev().zip(before) {
            self.kept.push_front(Arc::new(AlarmChange { number, ..change }));
        }
    }

    /// Number of the latest change; what comes next has the one after it.
    pub fn latest(&self) -> u64 {
        BEFORE + self.since
    }

    pub fn newest_first(&self) -> Vec<Arc<AlarmChange>> {
        self.kept.iter().rev().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Cause, State};

    fn change(at: usize) -> AlarmChange {
        let (from, to) = (State::Normal, State::Unacknowledged);
        AlarmChange {
            number: 0,
            id: AlarmId::named("FIC1"),
            transition: Transition { from, to, at: at as f64, cause: Cause::Raised },
            priority: Priority::Low,
            grouped: false,
            detail: String::new(),
            by: None,
            comment: None,
            told: false,
        }
    }

    fn of(log: &AlarmLog) -> Vec<(usize, u64)> {
        log.newest_first().iter().map(|change| (change.transition.at as usize, change.number)).collect()
    }

    #[test]
    fn the_oldest_change_goes_when_there_is_no_room() {
        let mut log = AlarmLog::default();
        (0..MOST_CHANGES + 5).for_each(|k| drop(log.push(change(k))));
        let kept = of(&log);
        assert_eq!((kept.len(), log.latest()), (MOST_CHANGES, 4005));
        assert_eq!(kept[..2], [(MOST_CHANGES + 4, 4005), (MOST_CHANGES + 3, 4004)]);
        log.restore(vec![change(1)]);
        assert_eq!(of(&log), kept, "there is no room");
    }

    #[test]
    fn what_was_before_comes_before_whenever_it_comes_and_but_once() {
        let mut log = AlarmLog::default();
        log.push(change(10));
        for _ in 0..2 {
            log.restore([3, 5, 10].map(change).into());
            assert_eq!((of(&log), log.latest()), (vec![(10, 2001), (5, 2000), (3, 1999)], 2001));
        }
        // The clock said 1970 after a start, and was set right.
        let mut log = AlarmLog::default();
        log.restore(vec![change(9)]);
        log.push(change(2));
        log.push(change(11));
        let before = of(&log);
        log.restore([9, 2, 11].map(change).into());
        assert_eq!(of(&log), before);
        let mut log = AlarmLog::default();
        log.restore((0..MOST_CHANGES + 5).map(change).collect());
        let kept = of(&log);
        assert_eq!((kept.len(), kept[0], kept[1999]), (MOST_CHANGES, (2004, 2000), (5, 1)));
        log.push(change(3000));
        assert_eq!(of(&log)[..2], [(3000, 2001), (2004, 2000)]);
    }
}
