//! Has everything kept again that is a state. A store that is not the one that was written to has none of it, and nobody says it again
//! until it changes. One that is not empty, as an older copy, was left elsewhere: its histories are given the step from there.

use super::rows::{remembered_alarms, rows};
use super::{KeptPlant, Persistence, Shared, lock};
use crate::alarm::{AlarmId, Cause, Kind, State};
use crate::results::{Change, Results};
use crate::schedule::Clock;
use crate::signal::LoopId;
use crate::store::{AlarmRow, Config, Reader, Row, StoreError, TransitionRow};
use std::collections::BTreeMap;
use std::slice;
use std::sync::Arc;

/// Changes read in one go.
const ROWS: usize = 1000;

/// Has orders and indicators kept again.
pub(in crate::app) type KeepAgain = Box<dyn Fn() + Send + Sync>;

/// Has everything kept again; how the histories in the store end.
pub(super) type Again = Box<dyn Fn() -> Ends + Send>;

impl Persistence {
    /// Who has orders and indicators kept again.
    pub(in crate::app) fn keep_again_by(&self, keep_again: KeepAgain) {
        // There is one who has them.
        let _ = self.shared.keep_again.set(keep_again);
    }
}

/// What has everything kept again.
pub(super) fn of(shared: Arc<Shared>, results: Arc<Results>, (config, clock): (Config, Clock)) -> Again {
    Box::new(move || {
        results.keep_alarms();
        let of = |own| Change { run: None, model: Some(own), alarms: Vec::new() };
        let models = results.models().into_iter().map(of);
        lock(&shared.rows).extend(models.flat_map(rows));
        if let Some(keep_again) = shared.keep_again.get() {
            keep_again();
        }
        // Who delivers to a database elsewhere looks there how its histories end.
        if config.url.is_some() {
            return Ends::default();
        }
        Ends::of(&config, &results, clock.now()).unwrap_or_else(|error| {
            tracing::warn!(%error, "the histories of alarms in the store may lack a step");
            Ends::default()
        })
    })
}

/// Loop and kind of an alarm or an order.
type Key = (String, String);

/// How the histories in a store end.
#[derive(Default)]
pub(super) struct Ends(BTreeMap<Key, End>);

struct End {
    last: TransitionRow,
    /// It is an alarm that is known here, and normal: of one that never was anything else nothing is kept.
    is_normal: bool,
    /// Something happened to it that waits.
    is_moved: bool,
}

impl End {
    /// The step from where it was left to where it goes on; `None` where that is the same.
    fn step(&self, to: &str, at: f64) -> Option<Row> {
        let TransitionRow { control_loop, kind, after, .. } = &self.last;
        (after != to).then(|| {
            Row::Transition(TransitionRow {
                control_loop: control_loop.clone(),
                kind: kind.clone(),
                at,
                before: after.clone(),
                after: to.to_string(),
                cause: Cause::Forgotten.as_str().to_string(),
                ..TransitionRow::default()
            })
        })
    }
}

impl Ends {
    fn of(config: &Config, results: &Results, now: f64) -> Result<Self, StoreError> {
        let reader = Reader::open(&config.folder)?;
        let (mut ends, mut after) = (BTreeMap::new(), 0);
        loop {
            let some = reader.transitions(after, ROWS)?;
            let Some((number, _)) = some.last() else { break };
            after = *number;
            for (_, last) in some {
                let key = (last.control_loop.clone(), last.kind.clone());
                ends.insert(key, End { last, is_normal: false, is_moved: false });
            }
        }
        for ((own, kind), end) in &mut ends {
            let id = Kind::named(kind).map(|kind| AlarmId::new(LoopId::new(own.as_str()), kind));
            let known = id.and_then(|id| results.alarm(&id, now));
            end.is_normal = known.is_some_and(|own| own.state == State::Normal);
        }
        Ok(Self(ends))
    }

    /// The steps that rows that wait need before them, by place, and rows that come behind all of them; it is `now` (s).
    pub(super) fn steps<'r>(
        mut self,
        waiting: impl Iterator<Item = &'r Row> + Clone,
        now: f64,
    ) -> (BTreeMap<usize, Row>, Vec<Row>) {
        for row in waiting.clone() {
            let Row::Transition(row) = row else { continue };
            let key = (row.control_loop.clone(), row.kind.clone());
            // Where it was written already, what waits goes on from there.
            if self.0.get(&key).is_some_and(|end| end.last == *row) {
                self.0.remove(&key);
            } else if let Some(end) = self.0.get_mut(&key) {
                end.is_moved = true;
            }
        }
        let mut steps = BTreeMap::new();
        for (place, row) in waiting.enumerate() {
            let (own, kind, from, at) = match row {
                Row::Transition(row) => (&row.control_loop, &row.kind, Some(row.before.clone()), row.at),
                Row::Alarm(row) => (&row.control_loop, &row.kind, state_of(row), now),
                Row::Diagnosis(_) | Row::Model(_) => continue,
            };
            let key = (own.clone(), kind.clone());
            let is_due = |end: &End| matches!(row, Row::Transition(_)) || !end.is_moved;
            if let Some(from) = from.filter(|_| self.0.get(&key).is_some_and(is_due)) {
                let step = self.0.remove(&key).and_then(|end| end.step(&from, at));
                steps.extend(step.map(|step| (place, step)));
            }
        }
        let normal = State::Normal.as_str();
        let rest = self.0.into_values().filter(|end| end.is_normal && !end.is_moved);
        let behind = rest.filter_map(|end| Some([end.step(normal, now)?, Row::Alarm(blank(end.last))]));
        (steps, behind.flatten().collect())
    }
}

/// The alarm of a change, as it is made.
fn blank(TransitionRow { control_loop, kind, .. }: TransitionRow) -> AlarmRow {
    AlarmRow { control_loop, kind, acknowledged: true, ..AlarmRow::default() }
}

/// The state of an alarm or an order, as its history names it.
fn state_of(row: &AlarmRow) -> Option<String> {
    let alarm = remembered_alarms(vec![row.clone()]);
    let of_alarm = alarm.first().map(|own| own.saved.flags.state().as_str());
    let plant = KeptPlant::of(slice::from_ref(row));
    let of_order = plant.orders.first().map(|own| own.state.as_str());
    of_alarm.or(of_order).map(str::to_string)
}
