//! Terms of loops whose write-back was removed. While they were in force, the valve got OP plus the term. So a diagnosis needs them
//! as long as OP of that time is in memory.

use crate::signal::{LoopId, Sample, Series};
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The terms of each such loop; the last of them is 0.
#[derive(Debug, Default)]
pub struct PastTerms(Mutex<HashMap<LoopId, Series>>);

impl PastTerms {
    /// Keeps the terms of a loop, unless it has some already, or none of the new ones acted on `op`. A term that was never ended,
    /// because the daemon was killed, counts for `lasts` (s) after its last sample.
    pub fn keep(&self, id: &LoopId, mut terms: Series, op: &[Sample], lasts: f64) {
        if let Some(last) = terms.last().copied().filter(|last| last.value != 0.0) {
            terms.push(Sample::good(last.t + lasts, 0.0));
        }
        let acted = terms.iter().rposition(|own| own.value != 0.0);
        let end = acted.and_then(|at| terms.get(at + 1)).map(|next| next.t);
        if end.is_some_and(|end| op.first().is_none_or(|first| first.t < end)) {
            self.lock().entry(id.clone()).or_insert(terms);
        }
    }

    /// The terms of a loop, in order of arrival.
    pub fn of(&self, id: &LoopId) -> Option<Series> {
        self.lock().get(id).cloned()
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<LoopId, Series>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
