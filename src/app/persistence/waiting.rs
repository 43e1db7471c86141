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

/// Drops rows for as long as `is_over` says so of the oldest that may go: all but the latest state of each thing.
pub(super) fn drop_oldest<T: Borrow<Row>>(rows: &mut VecDeque<T>, mut is_over: impl FnMut(&Row) -> bool) {
    let mut known = HashSet::new();
    // From the newest on, so that the first of each is the latest.
    let newest_first = rows.iter().rev().map(Borrow::<Row>::borrow);
    let stay: Vec<bool> =
        newest_first.map(|row| state_of(row).is_some_and(|state| known.insert(state))).collect();
    let mut stay = stay.into_iter().rev();
    rows.retain(|row| stay.next() == Some(true) || !is_over(row.borrow()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::{Flags, Kind, Saved};

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
