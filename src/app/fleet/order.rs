//! Messages of one subject are taken in the order of their stream, also where one of them had to be put off: rings and the
//! history of an alarm go forward only.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

/// A message that was put off and has not come again for this long was deleted from its stream: it comes every few seconds.
/// Nothing waits for it any more.
const GONE: Duration = Duration::from_secs(60);

/// The messages that were put off: by subject, their numbers in the stream, and when that was last, on a steady clock.
#[derive(Default)]
pub(super) struct Order {
    put_off: HashMap<String, BTreeMap<u64, Duration>>,
    /// Subjects whose loop is not known, and since when.
    unknown: HashMap<String, Duration>,
}

impl Order {
    /// Whether no earlier message of `subject` is still to come.
    pub(super) fn is_next(&mut self, subject: &str, sequence: u64, now: Duration) -> bool {
        let Some(waiting) = self.put_off.get_mut(subject) else { return true };
        waiting.retain(|_, last| now.saturating_sub(*last) < GONE);
        waiting.keys().next().is_none_or(|first| sequence <= *first)
    }

    /// The message comes again.
    pub(super) fn put_off(&mut self, subject: &str, sequence: u64, now: Duration) {
        self.put_off.entry(subject.to_string()).or_default().insert(sequence, now);
    }

    /// For how long the loop of a subject has not been known. All its messages count as one: a server gives only so many that
    /// nobody acknowledges.
    pub(super) fn unknown_for(&mut self, subject: &str, now: Duration) -> Duration {
        now.saturating_sub(*self.unknown.entry(subject.to_string()).or_insert(now))
    }

    /// The message was taken, and its loop is known.
    pub(super) fn taken(&mut self, subject: &str, sequence: u64) {
        self.unknown.remove(subject);
        self.end(subject, sequence);
    }

    /// The message does not come again.
    pub(super) fn end(&mut self, subject: &str, sequence: u64) {
        if let Some(waiting) = self.put_off.get_mut(subject) {
            waiting.remove(&sequence);
            if waiting.is_empty() {
                self.put_off.remove(subject);
            }
        }
    }

    /// Nothing was read for so long, so nothing that was put off could come again.
    pub(super) fn stood_still(&mut self, blocked: Duration) {
        self.put_off.values_mut().flat_map(BTreeMap::values_mut).for_each(|last| *last += blocked);
    }
}

/// A message waits for so long for an earlier one of its subject: twice as long as a server takes to give that again.
const EARLY: Duration = Duration::from_secs(22);

/// Messages that came before an earlier one: by subject, which, and since when it waits, on a steady clock.
#[derive(Default)]
pub(super) struct Early(HashMap<String, (u64, Duration)>);

impl Early {
    /// Whether this one still waits for the earlier one, which may be lost.
    pub(super) fn waits(&mut self, subject: &str, sequence: u64, now: Duration) -> bool {
        let (own, since) = self.0.entry(subject.to_string()).or_insert((sequence, now));
        if *own != sequence {
            (*own, *since) = (sequence, now);
        }
        if now.saturating_sub(*since) < EARLY {
            return true;
        }
        self.0.remove(subject);
        false
    }

    /// What was to come first has come.
    pub(super) fn end(&mut self, subject: &str) {
        self.0.remove(subject);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn what_comes_after_a_message_that_was_put_off_waits_for_it() {
        let mut order = Order::default();
        assert!(order.is_next("a", 1, SECOND));
        order.put_off("a", 1, SECOND);
        assert!(!order.is_next("a", 2, SECOND), "1 is still to come");
        assert!(order.is_next("b", 3, SECOND), "another loop does not wait");
        order.put_off("a", 2, SECOND);
        assert!(order.is_next("a", 1, 3 * SECOND));
        order.end("a", 1);
        assert!(order.is_next("a", 2, 3 * SECOND));
        assert!(!order.is_next("a", 4, 3 * SECOND));
        order.end("a", 2);
        assert!(order.is_next("a", 4, 3 * SECOND));
        assert!(order.put_off.is_empty(), "nothing is remembered of what is done");
    }

    #[test]
    fn a_message_that_was_deleted_holds_nobody_up_for_ever() {
        let mut order = Order::default();
        order.put_off("a", 1, SECOND);
        assert!(!order.is_next("a", 2, GONE));
        assert!(order.is_next("a", 2, SECOND + GONE));
        (1..9).for_each(|at| order.put_off("b", 7, at * GONE / 2));
        assert!(!order.is_next("b", 8, 5 * GONE - SECOND), "it still comes");
        order.stood_still(GONE);
        assert!(!order.is_next("b", 8, 5 * GONE), "nothing was read meanwhile");
    }

    #[test]
    fn all_messages_of_an_unknown_loop_wait_as_one() {
        let mut order = Order::default();
        assert_eq!(order.unknown_for("a", SECOND), Duration::ZERO);
        order.end("a", 1);
        assert_eq!(order.unknown_for("a", GONE), GONE - SECOND, "its next message has waited as long");
        assert_eq!(order.unknown_for("b", GONE), Duration::ZERO);
        order.taken("a", 2);
        assert_eq!(order.unknown_for("a", GONE), Duration::ZERO, "it was known in between");
    }

    #[test]
    fn a_message_waits_for_an_earlier_one_for_a_bounded_time() {
        let mut early = Early::default();
        assert!(early.waits("a", 7, SECOND) && early.waits("a", 7, EARLY));
        assert!(!early.waits("a", 7, SECOND + EARLY));
        assert!(early.waits("a", 9, SECOND + EARLY), "another message, another wait");
        early.end("a");
        assert!(early.waits("a", 9, 3 * EARLY) && early.0.len() == 1);
    }

    proptest! {
        /// Messages that come again and again, each unknown for a while, are taken in order.
        #[test]
        fn whatever_is_put_off_messages_are_taken_in_order(
            unknown in proptest::collection::vec(0u64..4, 1..30),
            turns in proptest::collection::vec(any::<u16>(), 0..60),
        ) {
            let (mut order, mut taken) = (Order::default(), Vec::new());
            let mut pending: Vec<(u64, u64)> = unknown.iter().enumerate().map(|(at, n)| (at as u64, *n)).collect();
            let mut put_off: Vec<(u64, u64)> = Vec::new();
            let mut turns = turns.into_iter();
            while !(pending.is_empty() && put_off.is_empty()) {
                // New ones come in their order; between them, those that were put off, in any.
                let again = turns.next().map_or(pending.is_empty(), |turn| turn % 2 == 0) && !put_off.is_empty();
                let (sequence, left) = match again || pending.is_empty() {
                    true => put_off.remove(usize::from(turns.next().unwrap_or(0)) % put_off.len()),
                    false => pending.remove(0),
                };
                if order.is_next("a", sequence, SECOND) && left == 0 {
                    order.end("a", sequence);
                    taken.push(sequence);
                } else {
                    order.put_off("a", sequence, SECOND);
                    put_off.push((sequence, left.saturating_sub(1)));
                }
            }
            prop_assert!(taken.is_sorted());
            prop_assert_eq!(taken.len(), unknown.len());
        }
    }
}
