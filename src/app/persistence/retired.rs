//! Rings that a reload has replaced wait until what they hold is durable. How many of them may.

use super::Tap;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

/// Those of the `old` rings that wait on, and how many samples of the others are lost. The first `latest` of them were filled
/// until now, and all of these wait. Others do as long as those that wait take no more room than the rings that are `filled`: a
/// store that fails while one reload follows the other must not have the memory grow. A store that is damaged drains none, so
/// none waits for it.
pub(super) fn waiting(
    old: Vec<Arc<Tap>>,
    latest: usize,
    filled: &[Arc<Tap>],
    is_damaged: bool,
) -> (Vec<Arc<Tap>>, u64) {
    let mut room: usize = filled.iter().map(|tap| tap.ring.capacity()).sum();
    let (mut waiting, mut lost) = (Vec::new(), 0);
    for (at, tap) in old.into_iter().enumerate().filter(|(_, tap)| tap.retired.load(Relaxed)) {
        let size = tap.ring.capacity();
        if !is_damaged && (at < latest || size <= room) {
            room = room.saturating_sub(size);
            waiting.push(tap);
        } else {
            lost += tap.ring.pushed().saturating_sub(tap.next.load(Relaxed));
        }
    }
    (waiting, lost)
}
