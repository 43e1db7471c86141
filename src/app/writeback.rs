//! Write-back under one name for the rest of `app`, whether or not this binary can write.

#[cfg(not(feature = "writeback"))]
mod absent;
#[cfg(feature = "writeback")]
mod enabled;

#[cfg(not(feature = "writeback"))]
pub(super) use absent::WritebackControl;
#[cfg(feature = "writeback")]
pub(super) use enabled::WritebackControl;

use crate::config::Config;
use crate::history::{History, TagKind};
use crate::signal::{LoopId, Role, Sample};

/// Ends every term, before one is written at `now` (s). A daemon that was killed left its last one in the store, and it came back
/// with the ring. It would hide friction for ever, and would be added to an OP that is filled in later, although the DCS dropped
/// it soon after.
fn end_terms(history: &History, config: &Config, now: f64) {
    for own in &config.loops {
        let Some(writeback) = &own.writeback else { continue };
        let tag = history.tag_index(&LoopId::new(own.id.as_str()), &TagKind::Role(Role::Term));
        let Some(ring) = tag.and_then(|tag| history.ring(tag)) else { continue };
        if let Some(last) = ring.latest().filter(|last| last.value != 0.0) {
            ring.push(Sample::good(now.min(last.t + writeback.term_lasts_s()), 0.0));
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
