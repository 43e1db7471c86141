//! Write-back under one name for the rest of `app`, whether or not this binary can write.

#[cfg(not(feature = "writeback"))]
mod absent;
#[cfg(feature = "writeback")]
mod enabled;

#[cfg(not(feature = "writeback"))]
pub(super) use absent::WritebackControl;
#[cfg(feature = "writeback")]
pub(super) use enabled::WritebackControl;

use crate::history::{History, TagKind};
use crate::signal::{LoopId, Role, Sample};

/// Ends, at `now` (s), every term that nobody writes. A daemon that was killed left its last one in the store; it came back with
/// the ring and would hide friction for ever, although the DCS has dropped it.
fn end_terms(history: &History, now: f64, is_written: impl Fn(&LoopId) -> bool) {
    for own in history.loops().iter().filter(|own| !is_written(&own.id)) {
        let tag = history.tag_index(&own.id, &TagKind::Role(Role::Term));
        if let Some(ring) = tag.and_then(|tag| history.ring(tag))
            && ring.latest().is_some_and(|last| last.value != 0.0)
        {
            ring.push(Sample::good(now, 0.0));
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
