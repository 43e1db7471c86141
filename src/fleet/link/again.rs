//! Messages that a server gives again, in the order of their stream. A server gives them in any order, and as many as it likes. So only
//! the first of them are held, and their bytes are bounded. Of the others the numbers are noted. They come once more, because a
//! server gives a message again until it is done, and are handed on in a later round.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

/// Messages that a server gives to a reader that does not acknowledge them; then it waits. No more are waited for, whatever a
/// server says.
pub(super) const UNACKNOWLEDGED: u16 = 4096;
/// Bytes after which no more are asked for before those are taken.
pub(super) const HELD: usize = 1 << 23;
/// A message that its only reader has not done within this time is given to it again.
pub(super) const GIVEN_AGAIN: Duration = Duration::from_secs(10);
/// How late a server may be with that.
pub(super) const MARGIN: Duration = Duration::from_secs(1);
/// What has not come for so long was deleted from the stream.
const GONE: Duration = GIVEN_AGAIN.saturating_add(MARGIN);

/// What is known of a message that came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Came {
    /// Its number in the stream.
    pub(super) sequence: u64,
    /// What it takes.
    pub(super) bytes: usize,
    /// It was given before.
    pub(super) is_again: bool,
}

/// What was given before and was not done. It comes in rounds: each gathers all that is missing, and hands on the first of it.
#[derive(Debug)]
pub(super) struct Again<T> {
    /// The first that came in this round, by their numbers; any of them is before any that was left out.
    held: BTreeMap<u64, (usize, T)>,
    /// Bytes of those.
    bytes: usize,
    /// Numbers of those that came in this round and are not held.
    left_out: BTreeSet<u64>,
    /// What came once more after it was handed on, because it was put off. Nothing waits for it.
    repeated: Vec<T>,
    /// How many are still to come in this round.
    missing: usize,
    /// Number of the last that was handed on.
    passed: u64,
    /// From when on the server gives what is missing.
    due: Instant,
    /// When one of those that are missing came last.
    since: Instant,
    /// When anything came last.
    last: Instant,
}

impl<T> Again<T> {
    /// So many messages are waited for, from `now` on.
    pub(super) fn new(missing: usize, now: Instant) -> Self {
        let (missing, due) = (missing.min(usize::from(UNACKNOWLEDGED)), now + GONE);
        Self {
            held: BTreeMap::new(),
            bytes: 0,
            left_out: BTreeSet::new(),
            repeated: Vec::new(),
            missing,
            passed: 0,
            due,
            since: due,
            last: now,
        }
    }

    /// Whether all of them were handed on.
    pub(super) fn is_over(&self) -> bool {
        self.missing == 0 && self.held.is_empty() && self.left_out.is_empty() && self.repeated.is_empty()
    }

    /// Whether there is something to be handed on, or nothing more is to be waited for.
    pub(super) fn is_ready(&self, now: Instant) -> bool {
        let is_whole = self.missing == 0 || now.saturating_duration_since(self.since) >= GONE;
        is_whole || !self.repeated.is_empty()
    }

    /// How long it takes until the server gives what is missing. Who asks before that gets what is new.
    pub(super) fn wait(&self, now: Instant) -> Duration {
        self.due.saturating_duration_since(now)
    }

    /// A message came.
    pub(super) fn take(&mut self, came: Came, message: T, now: Instant) {
        let Came { sequence, bytes, is_again } = came;
        self.last = now;
        if sequence <= self.passed {
            self.repeated.push(message);
            return;
        }
        let is_new = !self.held.contains_key(&sequence) && !self.left_out.contains(&sequence);
        if is_new && is_again {
            (self.missing, self.since) = (self.missing.saturating_sub(1), now.max(self.due));
        }
        // What comes after one that was left out must not be handed on before it.
        if self.left_out.first().is_some_and(|first| *first <= sequence) {
            self.left_out.insert(sequence);
        } else {
            let before = self.held.insert(sequence, (bytes, message));
            self.bytes += bytes;
            self.bytes -= before.map_or(0, |(bytes, _)| bytes);
        }
        self.bound();
    }

    /// Leaves out the last while more is held than may be; one message is held however large it is.
    fn bound(&mut self) {
        while self.bytes > HELD
            && self.held.len() > 1
            && let Some((sequence, (bytes, _))) = self.held.pop_last()
        {
            self.bytes -= bytes;
            self.left_out.insert(sequence);
        }
        // No server gives as many. What is forgotten here comes after all that is known.
        while self.held.len() + self.left_out.len() > usize::from(UNACKNOWLEDGED) {
            if self.left_out.pop_last().is_none()
                && let Some((_, (bytes, _))) = self.held.pop_last()
            {
                self.bytes -= bytes;
            }
        }
    }

    /// At most so many of those that are ready, in order.
    pub(super) fn hand_on(&mut self, most: usize, now: Instant) -> Vec<T> {
        if !self.repeated.is_empty() {
            return self.repeated.drain(..most.min(self.repeated.len())).collect();
        }
        if !self.is_ready(now) {
            return Vec::new();
        }
        self.missing = 0;
        let mut some = Vec::new();
        while some.len() < most
            && let Some((sequence, (bytes, message))) = self.held.pop_first()
        {
            self.bytes -= bytes;
            self.passed = sequence;
            some.push(message);
        }
        if self.held.is_empty() && !self.left_out.is_empty() {
            self.missing = self.left_out.len();
            self.left_out.clear();
            self.due = self.last + GONE;
            self.since = self.due;
        }
        some
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::{HashMap, HashSet};

    const KIB: usize = 1 << 10;

    /// A server that gives each message again, in an order of its own, until it is done; how often all of them came.
    fn rounds(sizes: &[usize], order: impl Fn(usize) -> Vec<u64>, most: usize) -> (Vec<u64>, usize) {
        let mut now = Instant::now();
        let mut again = Again::new(sizes.len(), now);
        let (mut handed, mut done, mut round) = (Vec::new(), HashSet::new(), 0);
        while !again.is_over() {
            assert!(round < 100, "it does not end");
            now += again.wait(now);
            for sequence in order(round).into_iter().filter(|n| !done.contains(n)) {
                let bytes = sizes[sequence as usize - 1];
                again.take(Came { sequence, bytes, is_again: true }, sequence, now);
                let held: usize = again.held.values().map(|(bytes, _)| bytes).sum();
                assert_eq!(held, again.bytes);
                assert!(held <= HELD || again.held.len() == 1, "{held} bytes are held");
            }
            assert!(again.is_ready(now), "all that is missing came");
            loop {
                let some = again.hand_on(most, now);
                assert!(some.len() <= most);
                if some.is_empty() {
                    break;
                }
                done.extend(some.iter().copied());
                handed.extend(some);
            }
            round += 1;
        }
        (handed, round)
    }

    #[test]
    fn what_fits_comes_in_one_round_and_in_order() {
        let sizes = vec![KIB; 40];
        let turned = |_: usize| -> Vec<u64> { (1..=40).rev().collect() };
        assert_eq!(rounds(&sizes, turned, 7), ((1..=40).collect(), 1));
    }

    #[test]
    fn more_than_may_be_held_comes_in_several_rounds_and_in_order() {
        // 400 MiB, of which 8 are held at once.
        let sizes = vec![100 * KIB; 4096];
        let turned = |_: usize| -> Vec<u64> { (1..=4096).rev().collect() };
        let (handed, round) = rounds(&sizes, turned, 256);
        assert_eq!(handed, (1..=4096).collect::<Vec<_>>());
        // 81 messages fit at once.
        assert_eq!(round, 51);
    }

    #[test]
    fn a_server_that_makes_up_numbers_is_waited_for_no_longer_and_takes_no_more() {
        let now = Instant::now();
        let mut again = Again::new(usize::MAX, now);
        let later = now + again.wait(now);
        for sequence in (1..=20_000u64).rev() {
            again.take(Came { sequence, bytes: KIB, is_again: sequence % 2 == 0 }, (), later);
            assert!(again.held.len() + again.left_out.len() <= 4096 && again.bytes <= HELD);
        }
        assert!(again.is_ready(later), "4,096 of them were given again");
        assert_eq!(again.hand_on(1, later).len(), 1);
        assert_eq!(again.passed, 1, "the first of all");
    }

    #[test]
    fn what_was_deleted_is_not_waited_for_without_end() {
        let now = Instant::now();
        let mut again = Again::new(3, now);
        assert!(!again.is_over() && !again.is_ready(now));
        let due = now + again.wait(now);
        assert_eq!(due, now + GONE);
        again.take(Came { sequence: 9, bytes: KIB, is_again: true }, 9, due);
        assert!(!again.is_ready(due + GONE - MARGIN));
        assert_eq!(again.hand_on(5, due), [0; 0]);
        let then = due + GONE;
        assert!(again.is_ready(then));
        assert_eq!(again.hand_on(5, then), [9]);
        assert!(again.is_over());
    }

    #[test]
    fn what_was_put_off_does_not_keep_the_rest_waiting() {
        let now = Instant::now();
        let mut again = Again::new(2, now);
        let mut then = now + again.wait(now);
        let large = |sequence| Came { sequence, bytes: HELD, is_again: true };
        again.take(large(1), 1, then);
        again.take(large(2), 2, then);
        assert_eq!(again.hand_on(9, then), [1]);
        assert!(!again.is_over() && !again.is_ready(then));
        then += again.wait(then);
        // The first was put off, and comes before the second.
        again.take(large(1), 1, then);
        assert_eq!(again.hand_on(9, then), [1]);
        assert!(!again.is_ready(then), "the second is missing");
        again.take(large(2), 2, then);
        assert_eq!(again.hand_on(9, then), [2]);
        assert!(again.is_over());
    }

    proptest! {
        #[test]
        fn whatever_the_order_each_is_handed_on_once_and_in_order(
            sizes in prop::collection::vec(1usize..3 * HELD / 2, 1..20),
            keys in prop::collection::vec(any::<u64>(), 100),
            most in 1usize..9,
        ) {
            let order = |round: usize| {
                let key: HashMap<u64, u64> =
                    (1..=sizes.len() as u64).map(|n| (n, keys[(round * 7 + n as usize) % 100])).collect();
                let mut numbers: Vec<u64> = key.keys().copied().collect();
                numbers.sort_by_key(|n| (key[n], *n));
                numbers
            };
            let (handed, _) = rounds(&sizes, order, most);
            prop_assert_eq!(handed, (1..=sizes.len() as u64).collect::<Vec<_>>());
        }
    }
}
