//! The clock of the NATS server, as the stamps of its messages show it. It is the one clock that all machines hear, so what is
//! compared with a stamp is compared by it and not by a clock of our own, which may be wrong. Pure.

use std::time::Duration;

/// A stamp counts for at least this long, and for less than twice as long. A window waits no longer in its stream, so a worker
/// hears of one meanwhile that did not wait; and where the server's clock is set, that is noticed within this time.
const COUNTS: Duration = Duration::from_secs(300);

/// The server's clock against a steady clock of ours.
#[derive(Debug, Default)]
pub(super) struct ServerClock {
    /// The least that our clock was ahead of a stamp (s): that of the message that was on its way for the shortest time.
    lately: Option<f64>,
    /// The same of the time before that.
    before: Option<f64>,
    /// Since when `lately` counts.
    since: Duration,
}

impl ServerClock {
    /// A message came at `now`, on a steady clock, that the server stamped with `stamp` (s since the Unix epoch).
    pub(super) fn hear(&mut self, stamp: f64, now: Duration) {
        let counted = now.saturating_sub(self.since);
        if counted >= COUNTS {
            let lately = self.lately.take();
            (self.before, self.since) = (lately.filter(|_| counted < 2 * COUNTS), now);
        }
        let ahead = now.as_secs_f64() - stamp;
        self.lately = Some(self.lately.map_or(ahead, |least| least.min(ahead)));
    }

    /// The server's time at `now`, on the same steady clock (s since the Unix epoch). It is late by what the quickest message took.
    /// `None` before the first message.
    pub(super) fn at(&self, now: Duration) -> Option<f64> {
        let least = match (self.lately, self.before) {
            (Some(lately), Some(before)) => Some(lately.min(before)),
            (lately, before) => lately.or(before),
        };
        Some(now.as_secs_f64() - least?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SECOND: Duration = Duration::from_secs(1);
    /// The server's time when our clock began.
    const BEGAN: f64 = 1_767_225_600.0;

    #[test]
    fn a_message_that_did_not_wait_shows_the_server_s_clock_and_one_that_did_hides_nothing() {
        let mut clock = ServerClock::default();
        assert_eq!(clock.at(SECOND), None);
        clock.hear(BEGAN + 1.0, 5 * SECOND);
        assert_eq!(clock.at(5 * SECOND), Some(BEGAN + 1.0), "nothing better is known");
        clock.hear(BEGAN + 6.0, 6 * SECOND);
        clock.hear(BEGAN, 9 * SECOND);
        assert_eq!(clock.at(9 * SECOND), Some(BEGAN + 9.0));
        assert_eq!(clock.at(20 * SECOND), Some(BEGAN + 20.0), "it goes on");
    }

    #[test]
    fn a_server_s_clock_that_was_set_is_followed() {
        let mut clock = ServerClock::default();
        let hear = |clock: &mut ServerClock, at: u32, by: f64| {
            clock.hear(BEGAN + f64::from(at) + by, at * SECOND);
            clock.at(at * SECOND).expect("a message came") - BEGAN - f64::from(at)
        };
        assert_eq!(hear(&mut clock, 1, 0.0), 0.0);
        assert_eq!(hear(&mut clock, 2, 100.0), 100.0, "at once where it was set forward");
        let later = 2 + 2 * COUNTS.as_secs() as u32;
        let all: Vec<f64> = (3..=later).map(|at| hear(&mut clock, at, 0.0)).collect();
        assert_eq!(all.last(), Some(&0.0), "and soon where it was set back");
        // What was heard before a long silence says nothing.
        assert_eq!(hear(&mut clock, 10 * later, -50.0), -50.0);
    }

    proptest! {
        /// However wrong our own clock is, and however long messages wait: while one in each while does not wait, a message is
        /// never taken for older than it is.
        #[test]
        fn no_message_is_taken_for_older_than_it_is(
            began in -1e9f64..3e9,
            waits in proptest::collection::vec((0.0f64..200.0, 1u32..20), 1..200),
        ) {
            let (mut clock, mut now) = (ServerClock::default(), Duration::ZERO);
            for (waited, pause) in waits {
                now += pause * SECOND;
                let stamp = began + now.as_secs_f64() - waited;
                clock.hear(stamp, now);
                let age = clock.at(now).expect("a message came") - stamp;
                prop_assert!((-1e-5..=waited + 1e-5).contains(&age), "{age} and not {waited}");
            }
        }
    }
}
