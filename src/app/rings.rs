//! Where one device's samples go.

use crate::collect::{self, Poll};
use crate::history::Ring;
use crate::schedule::Clock;
use crate::signal::Sample;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::watch;

/// Where one device's samples go. It holds that device's rings only, so that a device that outlives a reload keeps no
/// memory of loops that are gone.
pub(super) struct Rings {
    pub(super) by_tag: HashMap<usize, Arc<Ring>>,
    /// Polls that have ended; tells write-back that there is news.
    pub(super) polled: watch::Sender<u64>,
    pub(super) clock: Clock,
    /// Whether the device tells every change while it is there, so that its silence says that nothing has changed.
    pub(super) tells_changes: bool,
}

impl Rings {
    /// Time since the daemon's start (s).
    fn now_s(&self) -> f64 {
        self.clock.elapsed().as_secs_f64()
    }
}

impl collect::Sink for Rings {
    fn sample(&self, tag: usize, sample: Sample) {
        if let Some(ring) = self.by_tag.get(&tag) {
            ring.push(sample);
            if sample.quality.is_good() {
                ring.heard().sample(sample.t, self.now_s());
            }
        }
    }

    fn again(&self, tag: usize) {
        if let Some(ring) = self.by_tag.get(&tag) {
            ring.heard().seen(self.now_s());
        }
    }

    fn poll(&self, _device: usize, poll: Poll) {
        // While nobody answers every tag counts as bad.
        if self.tells_changes && (poll.good > 0 || poll.bad == 0) {
            let now_s = self.now_s();
            self.by_tag.values().for_each(|ring| ring.heard().seen(now_s));
        }
        self.polled.send_modify(|polls| *polls = polls.wrapping_add(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::Sink;
    use crate::signal::{BadReason, Quality};
    use std::time::Duration;

    /// By a clock that begins at 0 and shows so much (s).
    fn rings(clock: Clock, tells_changes: bool) -> (Rings, Arc<Ring>) {
        let ring = Arc::new(Ring::new(8));
        let by_tag = HashMap::from([(3, ring.clone())]);
        (Rings { by_tag, polled: watch::Sender::new(0), clock, tells_changes }, ring)
    }

    fn poll(good: usize, bad: usize) -> Poll {
        Poll { t: 0.0, good, bad, took: Duration::ZERO }
    }

    #[test]
    fn when_a_good_sample_came_is_known_whatever_its_stamp_says() {
        let clock = Clock::by_hand(0.0);
        let (rings, ring) = rings(clock, false);
        clock.set(100.0);
        rings.sample(3, Sample::good(7000.0, 1.0));
        clock.set(130.0);
        let bad = Sample { t: 9000.0, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) };
        rings.sample(3, bad);
        rings.poll(0, poll(5, 0));
        assert_eq!(ring.heard().shows(130.0), Some(7030.0));
        assert!(!ring.heard().was_there(130.0, 1e9), "what is polled says so by its samples");
        assert_eq!(ring.snapshot().len(), 2);
    }

    #[test]
    fn what_is_told_again_by_a_broker_is_there() {
        let clock = Clock::by_hand(0.0);
        let (rings, ring) = rings(clock, false);
        clock.set(100.0);
        rings.again(3);
        rings.again(4);
        clock.set(160.0);
        rings.poll(0, poll(5, 0));
        assert!(ring.heard().was_there(160.0, 60.0) && !ring.heard().was_there(160.0, 59.0));
        assert!(ring.snapshot().is_empty());
    }

    #[test]
    fn what_tells_changes_is_there_while_somebody_answers() {
        let clock = Clock::by_hand(0.0);
        let (rings, ring) = rings(clock, true);
        // In a session without news, in one with a bad tag, and without one.
        for (at, told, since) in
            [(100.0, poll(0, 0), 0.0), (200.0, poll(2, 1), 0.0), (300.0, poll(0, 3), 100.0)]
        {
            clock.set(at);
            rings.poll(0, told);
            assert!(ring.heard().was_there(at, since), "{at}");
            assert!(since == 0.0 || !ring.heard().was_there(at, 0.9 * since), "{at}");
        }
    }
}
