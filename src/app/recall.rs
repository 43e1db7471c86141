//! Finds the samples again that a run worked on: in the rings, and what those have overwritten in the store.

use crate::config::Neighbour;
use crate::results::{Basis, basis};
use crate::schedule::Snapshot;
use crate::serve::Recall;
use crate::signal::{LoopId, Record, Sample};
use crate::store::{self, Reader, StoreError};
use std::collections::HashMap;
use std::sync::Arc;

/// Looks into what `snapshot` copies and then into the store; `neighbours` says whose the other tags are.
pub(super) fn recall(
    snapshot: Snapshot,
    store: Option<store::Config>,
    neighbours: HashMap<LoopId, Vec<Neighbour>>,
) -> Recall {
    Arc::new(move |id, basis| {
        let rings = snapshot(id)?;
        let (record, lost) = basis.cut(rings.clone());
        if lost.is_empty() {
            return Some(record);
        }
        let own = neighbours.get(id).map_or(&[][..], Vec::as_slice);
        let kept = store.as_ref().map(|store| joined(store, id, basis, &rings, own))?;
        let kept = kept
            .inspect_err(|error| tracing::warn!(%error, "a bundle cannot be read from the store"))
            .ok()?;
        let (record, lost) = basis.cut(kept);
        lost.is_empty().then_some(record)
    })
}

/// What the store has of the run's tags and time, and after it what only the rings have.
fn joined(
    store: &store::Config,
    id: &LoopId,
    basis: &Basis,
    rings: &Record,
    neighbours: &[Neighbour],
) -> Result<Record, StoreError> {
    let mut reader = Reader::at_hand(store)?;
    let mut record = Record::default();
    for extent in &basis.extents {
        let mut all: Vec<Sample> = Vec::new();
        if let Some((first, last)) = extent.span {
            let (whose, tag) = whose(id, &extent.tag, neighbours);
            all = reader.between(&whose, &tag, first, last)?;
        }
        let newest = all.last().map_or(f64::NEG_INFINITY, |sample| sample.t);
        let own = basis::series(rings).find(|(tag, _)| *tag == extent.tag);
        all.extend(own.into_iter().flat_map(|(_, own)| own).filter(|sample| sample.t > newest));
        basis::put(&mut record, &extent.tag, all);
    }
    Ok(record)
}

/// The loop and tag behind a name in a record.
pub(super) fn whose(id: &LoopId, tag: &str, neighbours: &[Neighbour]) -> (String, String) {
    match neighbours.iter().find(|own| own.name == tag) {
        Some(own) => (own.id.to_string(), own.kind.name().to_string()),
        None => (id.to_string(), tag.to_string()),
    }
}
