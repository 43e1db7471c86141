//! Which loops are expected to calm down with which, as standing orders of the work list and the latest look at the plant say.

use super::Results;
use crate::signal::LoopId;
use std::collections::HashMap;
use std::sync::PoisonError;

impl Results {
    /// Takes, of every loop that swings with a source, that source.
    pub fn swing(&self, sources: HashMap<LoopId, LoopId>) {
        *self.sources.write().unwrap_or_else(PoisonError::into_inner) = sources;
    }

    /// The loop that is expected to calm this one down when it is repaired; `None` where there is none.
    pub fn swings_with(&self, id: &LoopId) -> Option<LoopId> {
        self.sources.read().unwrap_or_else(PoisonError::into_inner).get(id).cloned()
    }

    /// Whether others are expected to calm down with this loop.
    pub fn is_source(&self, id: &LoopId) -> bool {
        self.sources.read().unwrap_or_else(PoisonError::into_inner).values().any(|source| source == id)
    }
}
