//! What lists of many loops sort, filter and draw by, without the texts that a loop's page has.

use super::{Entry, Results, lock};
use crate::alarm::State;
use crate::signal::LoopId;
use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

/// A loop at a glance.
#[derive(Clone, Debug, PartialEq)]
pub struct Glance {
    /// The state of its alarm on stiction.
    pub alarm: State,
    /// The verdict of its latest diagnosis; `None` before the first.
    pub verdict: Option<Cow<'static, str>>,
    /// Friction (% of OP span, or OP units where the span is not known).
    pub f: Option<f64>,
    /// Evidence (-).
    pub delta_aic: Option<f64>,
    /// When it was diagnosed (s).
    pub time: Option<f64>,
}

impl Results {
    /// These loops at a glance at `now` (s), in their order: each lock is taken once for all of them. `None` for a loop that
    /// is not there.
    pub fn glances<'i>(&self, ids: impl IntoIterator<Item = &'i LoopId>, now: f64) -> Vec<Option<Glance>> {
        let entries: Vec<_> = {
            let all = self.entries.read().unwrap_or_else(PoisonError::into_inner);
            ids.into_iter()
                .map(|id| all.get_key_value(id).map(|(id, own)| (id.clone(), own.clone())))
                .collect()
        };
        let alarms = self.stiction_states(now);
        let glance = |own: Option<(LoopId, Arc<Mutex<Entry>>)>| {
            let (id, entry) = own?;
            let entry = lock(&entry);
            let summary = entry.summary();
            Some(Glance {
                alarm: alarms.get(&id).copied().unwrap_or(State::Normal),
                verdict: summary.map(|summary| summary.outcome.clone()),
                f: summary.and_then(|summary| summary.f),
                delta_aic: summary.and_then(|summary| summary.delta_aic),
                time: summary.map(|summary| summary.time),
            })
        };
        entries.into_iter().map(glance).collect()
    }
}
