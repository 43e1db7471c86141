//! How the alarms of all edges stand, as a centre learns it from the last message of each loop: one that begins anew, has lost its
//! disk or was away for long would hear only of alarms that change.

use super::centre::{MOST, WAIT};
use super::{Fleet, lock};
use crate::alarm::{AlarmId, Kind, Saved, State};
use crate::app::persistence::rows::remembered_alarms;
use crate::fleet::convert;
use crate::fleet::link::{Incoming, Link};
use crate::fleet::message::{AlarmState, States};
use crate::fleet::streams::STATES;
use crate::fleet::subject::{Subject, What, all, of_site};
use crate::fleet::weights;
use crate::results::RestoredAlarm;
use crate::signal::LoopId;
use crate::store::AlarmRow;
use std::sync::Arc;

impl Fleet {
    /// Takes how alarms stand. It is read again from the first message on once a loop may have become known that was not, or is
    /// taken from another edge.
    pub(super) async fn take_states(&self, link: &Link) {
        loop {
            let mut reading = match link.follow(STATES, &all(None, What::State)).await {
                Ok(reading) => reading,
                Err(error) => {
                    self.rest(&error, "how alarms stand is not heard").await;
                    continue;
                }
            };
            let (scene, mut is_left) = (self.scene.borrow().clone(), false);
            loop {
                if is_left && !Arc::ptr_eq(&scene, &self.scene.borrow()) {
                    break;
                }
                let messages = match reading.next(MOST, WAIT).await {
                    Ok(messages) => messages,
                    Err(error) => break self.rest(&error, "how alarms stand is not heard").await,
                };
                let _taking = self.taking.read().await;
                for message in messages {
                    is_left |= !self.hear_states(&message);
                }
            }
        }
    }

    /// Takes a message of how alarms stand; whether its loop or collector is known, and is taken from the edge that says so.
    fn hear_states(&self, message: &Incoming) -> bool {
        let Some(own) = Subject::read(message.subject()) else { return true };
        let id = LoopId::new(of_site(&own.site, &own.name));
        if !self.knows(&id) {
            return false;
        }
        let Some(States { alarms, edge }) = weights::read(message.subject(), message.bytes()) else {
            return true;
        };
        let is_taken =
            lock(&self.claims).is_state_taken((own.site.as_str(), id.as_str()), &edge, message.taken_at());
        if is_taken {
            self.take_states_of(&id, alarms);
        }
        is_taken
    }

    /// Whether an edge has a loop or a collector of this name.
    fn knows(&self, id: &LoopId) -> bool {
        Kind::ALL.into_iter().any(|kind| self.is_known(&AlarmId::new(id.clone(), kind)))
    }

    /// Takes how all alarms of a loop or collector stand; those that are not among them are normal, as far as its edge knows.
    fn take_states_of(&self, id: &LoopId, alarms: Vec<AlarmState>) {
        let now = self.clock.now();
        let row = |state| AlarmRow { control_loop: id.to_string(), ..convert::alarm_row(state) };
        let kept = remembered_alarms(alarms.into_iter().map(row).collect());
        let is_there = |kind: Kind| kept.iter().any(|own| own.id.kind == kind);
        let others = Kind::ALL.into_iter().filter(|kind| !is_there(*kind));
        let stands = |id: &AlarmId| self.results.alarm(id, now).is_some_and(|own| own.state != State::Normal);
        let over = others.map(|kind| AlarmId::new(id.clone(), kind)).filter(stands);
        let blank = |id| RestoredAlarm {
            id,
            saved: Saved::default(),
            by: None,
            comment: None,
            detail: String::new(),
        };
        let over: Vec<RestoredAlarm> = over.map(blank).collect();
        for own in kept.into_iter().chain(over) {
            self.results.follow_alarm(own, None, now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::tests::centre;

    fn state(kind: &str) -> AlarmState {
        let since = Some(1000.0);
        AlarmState { kind: kind.into(), active: true, since, raised_at: since, ..AlarmState::default() }
    }

    #[test]
    fn a_centre_that_begins_anew_knows_of_alarms_that_have_not_changed_since() {
        let (fleet, results) = centre("north:FIC1");
        let id = LoopId::new("north:FIC1");
        let stiction = AlarmId::new(id.clone(), Kind::Stiction);
        let view = || results.alarm(&stiction, fleet.clock.now()).expect("the loop is known");
        assert_eq!(view().state, State::Normal);
        fleet.take_states_of(&id, vec![state("stiction"), state("of_a_later_version")]);
        assert_eq!((view().state, view().raised_at), (State::Unacknowledged, Some(1000.0)));
        assert!(results.alarm_log().is_empty(), "nothing has happened now, so nobody is told");
        // An alarm that has become normal, and one of which its edge knows nothing any more.
        let cleared = AlarmState { active: false, acknowledged: true, ..state("stiction") };
        fleet.take_states_of(&id, vec![cleared]);
        assert_eq!(view().state, State::Normal);
        fleet.take_states_of(&id, vec![state("stiction")]);
        fleet.take_states_of(&id, Vec::new());
        assert_eq!((view().state, view().raised_at), (State::Normal, None));
    }

    #[test]
    fn a_loop_or_collector_that_no_edge_has_announced_is_not_known() {
        let (fleet, _results) = centre("north:FIC1");
        let knows = |name: &str| fleet.knows(&LoopId::new(name));
        assert!(knows("north:FIC1") && knows("north:dcs"));
        assert!(!knows("north:FIC2") && !knows("east:FIC1"));
    }
}
