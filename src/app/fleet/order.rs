//! Messages of one subject are taken in the order of their stream, also where one of them had to be put off: rings and the
//! history of an alarm go forward only.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

/// A message that was put off and has not come again for this long was deleted from its stream: it comes every few seconds.
/// Nothing waits for it any more.
const GONE: Duration = Duration::from_secs(60);

/// When a message was put off for the first time, and the last time.
struct PutOff {
    first: Duration,
    last: Duration,
}

/// The messages that were put off: by subject, their numbers in the stream, and when that was, on a steady clock.
#[derive(Default)]
pub(super) struct Order(HashMap<String, BTreeMap<u64, PutOff>>);

impl Order {
    /// Whether no earlier message of `subject` is still to come.
    pub(super) fn is_next(&mut self, subject: &str, sequence: u64, now: Duration) -> bool {
        let Some(waiting) = self.0.get_mut(subject) else { return true };
        waiting.retain(|_, put_off| now.saturating_sub(put_off.last) < GONE);
        waiting.keys().next().is_none_or(|first| sequence <= *first)
    }

    /// The message comes again.
    pub(super) fn put_off(&mut self, subject: &str, sequence: u64, now: Duration) {
        let waiting = self.0.entry(subject.to_string()).or_default();
        waiting.entry(sequence).or_insert(PutOff { first: now, last: now }).last = now;
    }

    /// For how long the message has been put off.
    pub(super) fn waits(&self, subject: &str, sequence: u64, now: Duration) -> Duration {
        let waiting = self.0.get(subject).and_then(|waiting| waiting.get(&sequence));
        waiting.map_or(Duration::ZERO, |put_off| now.saturating_sub(put_off.first))
    }

    /// The message does not come again.
    pub(super) fn end(&mut self, subject: &str, sequence: u64) {
        if let Some(waiting) = self.0.get_mut(subject) {
            waiting.remove(&sequence);
            if waiting.is_empty() {
                self.0.remove(subject);
            }
        }
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
        assert!(order.0.is_empty(), "nothing is remembered of what is done");
    }

    #[test]
    fn a_message_that_was_deleted_holds_nobody_up_for_ever() {
        let mut order = Order::default();
        order.put_off("a", 1, SECOND);
        assert!(!order.is_next("a", 2, GONE));
        assert!(order.is_next("a", 2, SECOND + GONE));
        assert_eq!(order.waits("b", 7, SECOND), Duration::ZERO);
        (1..9).for_each(|at| order.put_off("b", 7, at * GONE / 2));
        assert_eq!(order.waits("b", 7, 5 * GONE), 9 * GONE / 2, "since the first time");
        assert!(!order.is_next("b", 8, 5 * GONE - SECOND), "it still comes");
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
