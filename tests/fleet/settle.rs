//! When a centre has all that an edge had at some moment.

use crate::daemon::Daemon;
use crate::rig::{Fleet, loops, newest, now, until_none};
use crate::told::{changes, of_site, reports};
use crate::wire::Wire;
use std::time::Duration;
use stictiond::fleet::message::Progress;
use stictiond::fleet::streams::{ALARMS, DIAGNOSES};
use stictiond::fleet::subject::escaped;

/// How far an edge had come at some moment: what it had by then a centre has to have, once.
pub struct Mark {
    pub site: String,
    /// When (s since the Unix epoch).
    pub at: f64,
    /// Numbers of the last diagnosis and of the last change of an alarm in the edge's store.
    pub diagnosis: u64,
    pub change: u64,
}

impl Mark {
    /// Of the edge of a site, now.
    pub fn of(fleet: &Fleet, site: &str) -> Self {
        let (at, store) = (now(), fleet.store_at(site));
        let diagnosis = reports(&store, site).values().map(|own| own.number).max();
        let change = changes(&store, site).into_iter().map(|(number, _)| number).max();
        Self {
            site: site.to_string(),
            at,
            diagnosis: diagnosis.expect("it has diagnosed"),
            change: change.expect("an alarm was raised"),
        }
    }

    /// Waits until a centre has all of it.
    pub fn reach(&self, centre: &Daemon, name: &str, wire: &Wire, patience: Duration) {
        until_none("what the edge found is forwarded", patience, || {
            let cursor = wire.cursor(&self.site);
            let number = |own: Option<Progress>| own.map_or(0, |own| own.number);
            let is_there = cursor.is_some_and(|own| {
                number(own.diagnoses) >= self.diagnosis && number(own.changes) >= self.change
            });
            if is_there { Vec::new() } else { vec![(cursor, self.diagnosis, self.change)] }
        });
        let reader = format!("centre_{}", escaped(name));
        for stream in [DIAGNOSES, ALARMS] {
            let last = wire.last(stream).expect("the hub is there");
            centre.until("what was forwarded is stored", patience, |_| wire.has_done(stream, &reader, last));
        }
        let mut left: Vec<String> = loops(centre).into_keys().collect();
        left.retain(|id| of_site(id, &self.site).is_some());
        assert!(!left.is_empty(), "the centre has no loop of {}", self.site);
        until_none("the samples of until then are there", patience, || {
            left.retain(|id| newest(centre, id) < self.at);
            left.clone()
        });
    }
}
