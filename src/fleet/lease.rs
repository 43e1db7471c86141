//! Who of several centres acts: the one that holds the lease. Pure: who asks says what it saw and when.
//!
//! The lease is one message in a stream, which its holder writes anew every few seconds, on the condition that its own is
//! still the last. Who sees the same message for longer than a lease lasts writes one of its own, on the same condition; so
//! of several only one succeeds. The number of the first message of a holder is its *epoch*: it only grows, and an edge that
//! has seen a newer one takes no orders of an older.

use std::time::Duration;

/// The lease as the stream has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Number of the message.
    pub sequence: u64,
    /// Who wrote it.
    pub holder: String,
    /// Number of the first message of this holder in a row; 0 in that message itself.
    pub epoch: u64,
}

impl Seen {
    /// The message's text.
    pub fn text(holder: &str, epoch: u64) -> String {
        format!("{epoch} {holder}")
    }

    /// The message with this number; `None` for a text that is no lease.
    pub fn read(sequence: u64, text: &str) -> Option<Self> {
        let (epoch, holder) = text.split_once(' ')?;
        Some(Self { sequence, holder: holder.to_string(), epoch: epoch.parse().ok()? })
    }

    /// The epoch of its holder.
    pub fn epoch(&self) -> u64 {
        if self.epoch == 0 { self.sequence } else { self.epoch }
    }

    /// Whether this, which was seen after `before`, is in another stream than that: in one stream no number ever falls. The
    /// server made it anew, after it had lost its disk.
    pub fn is_of_another_stream(&self, before: &Self) -> bool {
        self.sequence < before.sequence || self.epoch() < before.epoch()
    }
}

/// What is to be done now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Nothing: somebody else holds it.
    Wait,
    /// Write a message, if the last still has the number `after` (0: there is none).
    Write {
        /// Number of the last message.
        after: u64,
        /// The epoch to write.
        epoch: u64,
    },
}

/// One centre's view of the lease.
#[derive(Clone, Debug)]
pub struct Lease {
    name: String,
    lasts: Duration,
    /// The last message, and when it was first seen.
    seen: Option<(Seen, Duration)>,
    /// Until when our own last message holds, counted from before it was sent.
    holds_until: Duration,
}

impl Lease {
    /// The view of the centre called `name`, before it has seen anything. A lease lasts for `lasts`.
    pub fn new(name: &str, lasts: Duration) -> Self {
        Self { name: name.to_string(), lasts, seen: None, holds_until: Duration::ZERO }
    }

    /// Takes the last message of the stream as it is at `now` (a steady clock), and says what to do.
    pub fn look(&mut self, last: Option<Seen>, now: Duration) -> Step {
        let Some(last) = last else {
            self.seen = None;
            return Step::Write { after: 0, epoch: 0 };
        };
        if self.seen.as_ref().is_none_or(|(seen, _)| *seen != last) {
            self.seen = Some((last.clone(), now));
        }
        let since = self.seen.as_ref().map_or(now, |(_, since)| *since);
        if last.holder == self.name && now < self.holds_until {
            return Step::Write { after: last.sequence, epoch: last.epoch() };
        }
        // Also after our own, which we have let run out: somebody may have seen that.
        if now.saturating_sub(since) >= self.lasts {
            return Step::Write { after: last.sequence, epoch: 0 };
        }
        Step::Wait
    }

    /// Our message, which was begun to be sent at `sent`, is the last and has this number.
    pub fn wrote(&mut self, sequence: u64, epoch: u64, sent: Duration) {
        let seen = Seen { sequence, holder: self.name.clone(), epoch };
        self.seen = Some((seen, sent));
        // Half a lease less than others wait: two never hold it at once, though their clocks run unevenly.
        self.holds_until = sent + self.lasts / 2;
    }

    /// Until when our last message holds, on the clock that was given.
    pub fn holds_until(&self) -> Duration {
        self.holds_until
    }

    /// Our epoch while we hold the lease at `now`.
    pub fn epoch(&self, now: Duration) -> Option<u64> {
        let (seen, _) = self.seen.as_ref()?;
        (seen.holder == self.name && now < self.holds_until).then(|| seen.epoch())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LASTS: Duration = Duration::from_secs(10);

    fn at(s: f64) -> Duration {
        Duration::from_secs_f64(s)
    }

    #[test]
    fn the_first_takes_it_and_keeps_it_the_second_waits_until_it_falls_silent() {
        let (mut a, mut b) = (Lease::new("a", LASTS), Lease::new("b", LASTS));
        assert_eq!(a.look(None, at(0.0)), Step::Write { after: 0, epoch: 0 });
        a.wrote(1, 0, at(0.0));
        assert_eq!(a.epoch(at(1.0)), Some(1));
        let first = Seen { sequence: 1, holder: "a".into(), epoch: 0 };
        assert_eq!(b.look(Some(first.clone()), at(0.5)), Step::Wait);
        assert_eq!(a.look(Some(first.clone()), at(3.0)), Step::Write { after: 1, epoch: 1 });
        a.wrote(2, 1, at(3.0));
        let second = Seen { sequence: 2, holder: "a".into(), epoch: 1 };
        assert_eq!(b.look(Some(second.clone()), at(4.0)), Step::Wait);
        assert_eq!(b.look(Some(second.clone()), at(13.9)), Step::Wait);
        assert_eq!(a.epoch(at(8.1)), None);
        assert_eq!(b.look(Some(second), at(14.0)), Step::Write { after: 2, epoch: 0 });
        b.wrote(3, 0, at(14.0));
        assert_eq!(b.epoch(at(14.0)), Some(3));
    }

    #[test]
    fn a_text_that_is_none_is_refused() {
        for text in ["", "7", "x a", "-1 a"] {
            assert_eq!(Seen::read(1, text), None, "{text}");
        }
        assert_eq!(
            Seen::read(5, &Seen::text("a b", 3)),
            Some(Seen { sequence: 5, holder: "a b".into(), epoch: 3 })
        );
    }

    #[test]
    fn a_lease_whose_numbers_fell_is_of_a_stream_that_was_made_anew() {
        let seen = |sequence, epoch| Seen { sequence, holder: "a".into(), epoch };
        let before = seen(90, 40);
        for same in [seen(90, 40), seen(91, 40), seen(95, 0)] {
            assert!(!same.is_of_another_stream(&before), "{same:?}");
        }
        for other in [seen(3, 0), seen(4, 3), seen(500, 3)] {
            assert!(other.is_of_another_stream(&before), "{other:?}");
        }
    }

    proptest! {
        /// Three centres over one stream whose writes are conditional: some look, some sleep, some lose the answer to a write
        /// that was done.
        #[test]
        fn never_two_at_once_and_epochs_only_grow(steps in proptest::collection::vec((0..3usize, 0.0..6.0f64, any::<bool>()), 1..200)) {
            let mut centres = ["a", "b", "c"].map(|name| Lease::new(name, LASTS));
            let (mut last, mut now, mut newest): (Option<Seen>, f64, u64) = (None, 0.0, 0);
            for (who, pause, answered) in steps {
                now += pause;
                if let Step::Write { after, epoch } = centres[who].look(last.clone(), at(now)) {
                    let number = last.as_ref().map_or(0, |seen| seen.sequence);
                    prop_assert_eq!(after, number);
                    last = Some(Seen { sequence: number + 1, holder: centres[who].name.clone(), epoch });
                    if answered {
                        centres[who].wrote(number + 1, epoch, at(now));
                    }
                }
                let holding: Vec<u64> = centres.iter().filter_map(|own| own.epoch(at(now))).collect();
                prop_assert!(holding.len() <= 1, "{:?}", holding);
                for epoch in holding {
                    prop_assert!(epoch >= newest);
                    newest = epoch;
                }
            }
        }
    }
}
