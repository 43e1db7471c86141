//! Which loops are expected to calm down with which, as standing orders of the work list and the latest look at the plant say.

use super::Results;
use crate::signal::LoopId;
use std::collections::HashMap;
use std::sync::PoisonError;

/// The order of the work list on a loop with which others are expected to calm down.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceOrder {
    /// The loop.
    pub source: LoopId,
    /// `unexplained`, `open` or `ordered`.
    pub state: &'static str,
    /// Since when (s).
    pub since: f64,
    /// Who acted on it last.
    pub by: Option<String>,
    /// What they said, as the number of the order.
    pub note: Option<String>,
}

impl Results {
    /// Takes, of every loop that swings with a source, the order on that source.
    pub fn swing(&self, sources: HashMap<LoopId, SourceOrder>) {
        *self.sources.write().unwrap_or_else(PoisonError::into_inner) = sources;
    }

    /// The loop that is expected to calm this one down when it is repaired; `None` where there is none.
    pub fn swings_with(&self, id: &LoopId) -> Option<LoopId> {
        self.source_order(id).map(|order| order.source)
    }

    /// The order on the loop that is expected to calm this one down; `None` where there is none.
    pub fn source_order(&self, id: &LoopId) -> Option<SourceOrder> {
        self.sources.read().unwrap_or_else(PoisonError::into_inner).get(id).cloned()
    }

    /// Whether others are expected to calm down with this loop.
    pub fn is_source(&self, id: &LoopId) -> bool {
        let sources = self.sources.read().unwrap_or_else(PoisonError::into_inner);
        sources.values().any(|order| order.source == *id)
    }
}
