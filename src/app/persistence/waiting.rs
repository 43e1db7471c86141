//! What waits for the writer, within its bounds. What happened may be dropped, oldest first; how a thing is stays, for nobody
//! says it again until it changes.

use crate::alarm::AlarmId;
use crate::results::{Change, KeptAlarm, ModelVersion};
use crate::signal::LoopId;
use crate::store::Row;
use std::borrow::Borrow;
use std::collections::{BTreeMap, HashSet, VecDeque};

/// Changes that wait for the writer's next round; rows are made of them there.
pub(super) const MAX_CHANGES: usize = 4096;

/// Changes that wait, and the states in which those that were dropped left alarms and models.
#[derive(Default)]
pub(super) struct Waiting {
    changes: VecDeque<Change>,
    alarms: BTreeMap<AlarmId, KeptAlarm>,
    models: BTreeMap<LoopId, ModelVersion>,
}

impl Waiting {
    /// Takes a change; how many were dropped for it.
    pub(super) fn put(&mut self, change: Change) -> u64 {
        let full = self.changes.len() >= MAX_CHANGES;
        if full && let Some(Change { run: _, model, alarms }) = self.changes.pop_front() {
            self.models.extend(model);
            self.alarms.extend(alarms.into_iter().map(|own| (own.id.clone(), own)));
        }
        self.changes.push_back(change);
        u64::from(full)
    }

    /// What waits, oldest first.
    pub(super) fn into_changes(self) -> impl Iterator<Item = Change> {
        let models =
            self.models.into_iter().map(|own| Change { run: None, model: Some(own), alarms: Vec::new() });
        let alarms = self.alarms.into_values().collect();
        models.chain([Change { run: None, model: None, alarms }]).chain(self.changes)
    }
}

/// What a row is the state of; `None` for what happened.
fn state_of(row: &Row) -> Option<(&str, &str)> {
    match row {
        Row::Alarm(row) => Some((&row.control_loop, &row.kind)),
        Row::Model(row) => Some((&row.control_loop, "")),
        Row::Diagnosis(_) | Row::Transition(_) => None,
    }
}

/// Drops each state that a later one of the same thing has taken the place of: nobody misses it. `gone` hears of each.
pub(super) fn keep_latest<T: Borrow<Row>>(rows: &mut VecDeque<T>, mut gone: impl FnMut(&Row)) {
    let mut known = HashSet::new();
    // From the newest on, so that the first of each is the latest.
    let newest_first = rows.iter().rev().map(Borrow::<Row>::borrow);
    let stay: Vec<bool> =
        newest_first.map(|row| state_of(row).is_none_or(|state| known.insert(state))).collect();
    let mut stay = stay.into_iter().rev();
    rows.retain(|row| {
        let stays = stay.next() == Some(true);
        if !stays {
            gone(row.borrow());
        }
        stays
    });
}

/// Drops rows of what happened for as long as `is_over` says so of the oldest that is left. States stay.
pub(super) fn drop_oldest<T: Borrow<Row>>(rows: &mut VecDeque<T>, mut is_over: impl FnMut(&Row) -> bool) {
    rows.retain(|own| {
        let row: &Row = own.borrow();
        row.is_state() || !is_over(row)
    });
}

/// Keeps at most so many rows of what happened, beside the latest state of each thing; how many were dropped for it. States count
/// to no bound: they may not go, and there are no more of them than there are things.
pub(super) fn bound(rows: &mut VecDeque<Row>, most: usize) -> u64 {
    if rows.len() <= most {
        return 0;
    }
    keep_latest(rows, |_| {});
    let dropped = rows.iter().filter(|row| !row.is_state()).count().saturating_sub(most);
    let mut left = dropped;
    drop_oldest(rows, |_| {
        let is_over = left > 0;
        left = left.saturating_sub(1);
        is_over
    });
    dropped as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Flags, Kind, Saved};
    use crate::store::{AlarmRow, TransitionRow};

    fn kept(subject: &str, acknowledged: bool) -> KeptAlarm {
        let flags = Flags { active: true, acknowledged, ..Flags::default() };
        KeptAlarm {
            id: AlarmId::new(LoopId::new(subject), Kind::Stiction),
            saved: Saved { flags, ..Saved::default() },
            transitions: Vec::new(),
            acted: acknowledged,
            by: None,
            comment: None,
            detail: String::new(),
        }
    }

    /// As at the end of a day, when the days of every loop are kept at once.
    #[test]
    fn states_drop_nothing_of_what_happened() {
        let state = |own: usize, acknowledged| {
            Row::Alarm(AlarmRow { control_loop: own.to_string(), acknowledged, ..AlarmRow::default() })
        };
        let moved =
            |at: u32| Row::Transition(TransitionRow { at: f64::from(at), ..TransitionRow::default() });
        let mut rows: VecDeque<Row> = [moved(0), moved(1), state(0, false)].into();
        rows.extend((0..9).map(|own| state(own, true)));
        assert_eq!(bound(&mut rows, 2), 0);
        let latest = (0..9).map(|own| state(own, true));
        assert_eq!(rows, [moved(0), moved(1)].into_iter().chain(latest).collect::<VecDeque<Row>>());
        rows.push_back(moved(2));
        assert_eq!(bound(&mut rows, 2), 1);
        let (first, last) = (rows.front(), rows.back());
        assert_eq!((rows.len(), first, last), (11, Some(&moved(1)), Some(&moved(2))));
    }

    #[test]
    fn the_state_that_a_dropped_change_left_still_waits() {
        let mut waiting = Waiting::default();
        let of = |alarms| Change { run: None, model: None, alarms };
        let model = |version| ModelVersion { version, ..ModelVersion::default() };
        let mut dropped = waiting.put(of(vec![kept("A", false)]));
        dropped += waiting.put(of(vec![kept("A", true), kept("B", true)]));
        for version in [1, 2] {
            let model = Some((LoopId::new("A"), model(version)));
            dropped += waiting.put(Change { run: None, model, alarms: Vec::new() });
        }
        for _ in 0..MAX_CHANGES - 1 {
            dropped += waiting.put(of(Vec::new()));
        }
        dropped += waiting.put(of(vec![kept("B", false)]));
        assert_eq!(dropped, 4);
        let (mut models, mut alarms) = (Vec::new(), Vec::new());
        for change in waiting.into_changes() {
            models.extend(change.model.map(|(_, own)| own.version));
            alarms.extend(change.alarms);
        }
        assert_eq!(models, [2]);
        assert_eq!(alarms, [kept("A", true), kept("B", true), kept("B", false)]);
    }
}
