//! Terms of loops that have no write-back any more. OP went to the valve with them, so a diagnosis needs them as long as OP of
//! that time is remembered.

use crate::signal::{LoopId, Sample, Series};
use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The terms of each such loop; the last of them is 0.
#[derive(Debug, Default)]
pub struct PastTerms(Mutex<HashMap<LoopId, Series>>);

impl PastTerms {
    /// Keeps the terms of a loop, unless there are some, or none of them acted on `op`. One that nobody ended, as of a daemon that
    /// was killed, ends `lasts` (s) after it was last said.
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
