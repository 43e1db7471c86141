//! Messages of one subject are taken in the order of their stream, also where one of them had to be put off: rings and the
//! history of an alarm go forward only.

use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

/// A message that was put off and has not come again for this long was deleted from its stream: it comes every few seconds.
/// Nothing waits for it any more.
const GONE: Duration = Duration::from_secs(60);
/// A message of a loop that is still not known after this time is dropped: its edge has it no more.
const GIVEN_UP: Duration = Duration::from_secs(600);
/// While more messages than this are put off none waits long for its loop: a server gives 4,096 to a reader that does not
/// acknowledge them, and then nothing more of any site.
const MANY: usize = 1000;
/// What an edge says of itself has been in force for so long: a loop that it has would be known.
const IN_FORCE: Duration = Duration::from_secs(10);

/// How long a message waits for its loop to be known while so many are put off; `in_force`: for how long what the edges of its
/// site say has been in force.
pub(super) fn patience(put_off: usize, in_force: Option<Duration>) -> Duration {
    let would_be_known = in_force.is_some_and(|since| since >= IN_FORCE);
    if put_off > MANY && would_be_known { IN_FORCE } else { GIVEN_UP }
}

/// How long samples of a tag wait for what their edge says of it: longer while a list of its site is still to be taken, but not
/// where many messages are put off.
pub(super) fn announcement_patience(put_off: usize, in_force: Option<Duration>) -> Duration {
    if put_off <= MANY && in_force.is_none() { GIVEN_UP } else { ANNOUNCEMENT_WAIT }
}

/// The messages that were put off: by subject, their numbers in the stream, and when that was last, on a steady clock.
#[derive(Default)]
pub(super) struct Order {
    put_off: HashMap<String, BTreeMap<u64, Duration>>,
    /// Subjects whose loop is not known, since when, and when that was seen last.
    unknown: HashMap<String, (Duration, Duration)>,
    /// Sites of which nothing is known, since when, and when that was seen last.
    unknown_sites: HashMap<String, (Duration, Duration)>,
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

    /// Nothing of `subject` is waited for any more: what comes next is taken.
    pub(super) fn forget(&mut self, subject: &str) {
        self.put_off.remove(subject);
    }

    /// How many messages are put off.
    pub(super) fn waiting(&self) -> usize {
        self.put_off.values().map(BTreeMap::len).sum()
    }

    /// For how long the loop of a subject has not been known. All its messages count as one, and so do all loops of the `site`
    /// where nothing is known of that: a server gives only so many that nobody acknowledges.
    pub(super) fn unknown_for(&mut self, subject: &str, site: Option<&str>, now: Duration) -> Duration {
        if !self.unknown.contains_key(subject) {
            // Nothing else ends those that no edge ever has.
            self.unknown.retain(|_, (_, last)| now.saturating_sub(*last) < GIVEN_UP);
        }
        let (first, last) = self.unknown.entry(subject.to_string()).or_insert((now, now));
        if now.saturating_sub(*last) >= GIVEN_UP {
            // What comes now is of a loop that may have been added meanwhile.
            *first = now;
        }
        *last = now;
        let mut since = *first;
        if let Some(site) = site {
            let (first, last) = self.unknown_sites.entry(site.to_string()).or_insert((now, now));
            if now.saturating_sub(*last) >= GONE {
                // It was known in between.
                *first = now;
            }
            *last = now;
            since = since.min(*first);
        }
        now.saturating_sub(since)
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

/// Subjects of which a message came before an earlier one: since when one waits for it, and when one did last, on a steady clock.
/// All messages of a subject wait as one. A full stream deletes each of them before it has waited for long, so that none would
/// ever be taken if each waited for itself.
#[derive(Default)]
pub(super) struct Early(HashMap<String, (Duration, Duration)>);

impl Early {
    /// Whether no earlier message of `subject` is still to come. What was put off is waited for once more as long as the earlier
    /// message was; then it counts as deleted, and whatever comes is next.
    pub(super) fn is_next(&self, order: &mut Order, (subject, sequence): (&str, u64), now: Duration) -> bool {
        if self.0.get(subject).is_some_and(|(since, _)| now.saturating_sub(*since) >= 2 * EARLY) {
            order.forget(subject);
        }
        order.is_next(subject, sequence, now)
    }

    /// Whether a message that came early still waits for the earlier one, which may be lost.
    pub(super) fn waits(&mut self, subject: &str, now: Duration) -> bool {
        let (since, last) = self.0.entry(subject.to_string()).or_insert((now, now));
        if now.saturating_sub(*last) >= GIVEN_UP {
            // That was another gap: nothing has come since.
            *since = now;
        }
        *last = now;
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

    /// Nothing was read for so long, so nothing earlier could come.
    pub(super) fn stood_still(&mut self, blocked: Duration) {
        for (since, last) in self.0.values_mut() {
            *since += blocked;
            *last += blocked;
        }
    }
}

/// Samples from another source than their edge has announced wait for so long for the announcement.
const ANNOUNCEMENT_WAIT: Duration = Duration::from_secs(10);

/// Whether samples are from where their edge says that it reads their tag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Origin {
    /// They are from there.
    Own,
    /// They are from elsewhere, and an announcement that says so may be on its way.
    Waits,
    /// They are from elsewhere, and from now on no announcement is waited for.
    GivenUp,
    /// They are from elsewhere, and no announcement is waited for any more.
    Foreign,
}

/// Samples from elsewhere that have not come for so long are waited for again.
const QUIET: Duration = Duration::from_secs(60);

/// Samples of a tag that are from elsewhere than its edge says.
struct Elsewhere {
    source: String,
    /// Since when they wait, on a steady clock; none where they wait no more.
    since: Option<Duration>,
    /// When they came last.
    last: Duration,
}

/// Tags that are remembered so: an edge may make up any number of them.
const MOST_STRANGE: usize = 100_000;

/// Tags whose samples are from elsewhere, by subject and tag.
#[derive(Default)]
pub(super) struct Strange(HashMap<(String, String), Elsewhere>);

impl Strange {
    /// What samples are of a tag that were read at `source`, by an edge that says it reads the tag at `own`; `None` where it has
    /// not said that it has such a tag. They wait for so long for what it says.
    pub(super) fn origin(
        &mut self,
        (subject, tag): (&str, &str),
        (source, own): (&str, Option<&str>),
        (patience, now): (Duration, Duration),
    ) -> Origin {
        let is_own = own == Some(source);
        if is_own && self.0.is_empty() {
            return Origin::Own;
        }
        let place = (subject.to_string(), tag.to_string());
        if is_own {
            // Only what was waited for ends the waiting: another edge may send under the same name.
            if self.0.get(&place).is_some_and(|known| known.source == source) {
                self.0.remove(&place);
            }
            return Origin::Own;
        }
        if self.0.len() >= MOST_STRANGE && !self.0.contains_key(&place) {
            self.0.retain(|_, known| now.saturating_sub(known.last) < QUIET);
            if self.0.len() >= MOST_STRANGE {
                return Origin::GivenUp;
            }
        }
        let new = || Elsewhere { source: source.to_string(), since: Some(now), last: now };
        let known = self.0.entry(place).or_insert_with(new);
        if known.source != source || now.saturating_sub(known.last) >= QUIET {
            *known = new();
        }
        known.last = now;
        match known.since {
            None => Origin::Foreign,
            Some(since) if now.saturating_sub(since) < patience => Origin::Waits,
            Some(_) => {
                known.since = None;
                Origin::GivenUp
            }
        }
    }
}

/// When the stream was made whose messages are remembered by their numbers. A stream that is made anew, after its server lost its
/// disk, counts from 1 again.
#[derive(Default)]
pub(super) struct Making(Option<i128>);

impl Making {
    /// The stream was made then (ns since the Unix epoch); whether it is another than before.
    pub(super) fn is_another(&mut self, made: i128) -> bool {
        self.0.replace(made).is_some_and(|before| before != made)
    }

    /// When it was made.
    pub(super) fn made(&self) -> i128 {
        self.0.unwrap_or_default()
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
        assert_eq!(order.unknown_for("a", None, SECOND), Duration::ZERO);
        order.end("a", 1);
        assert_eq!(order.unknown_for("a", None, GONE), GONE - SECOND, "its next message has waited as long");
        assert_eq!(order.unknown_for("b", None, GONE), Duration::ZERO);
        order.taken("a", 2);
        assert_eq!(order.unknown_for("a", None, GONE), Duration::ZERO, "it was known in between");
    }

    #[test]
    fn a_loop_that_was_given_up_is_waited_for_again_and_forgotten_in_the_end() {
        let mut order = Order::default();
        for at in 0..=600 {
            assert_eq!(order.unknown_for("a", None, at * SECOND), at * SECOND, "it comes again and again");
        }
        order.end("a", 1);
        assert_eq!(order.unknown_for("a", None, GIVEN_UP + SECOND), GIVEN_UP + SECOND, "it is given up");
        assert_eq!(order.unknown_for("a", None, 3 * GIVEN_UP), Duration::ZERO, "after a long silence");
        order.unknown_for("b", None, 5 * GIVEN_UP);
        assert_eq!(order.unknown.len(), 1);
    }

    #[test]
    fn all_loops_of_an_unknown_site_wait_as_one_until_it_is_known() {
        let (mut order, north) = (Order::default(), Some("north"));
        assert_eq!(order.unknown_for("a", north, SECOND), Duration::ZERO);
        assert_eq!(order.unknown_for("b", north, GONE), GONE - SECOND, "as long as the first");
        assert_eq!(order.unknown_for("c", Some("east"), GONE), Duration::ZERO);
        assert_eq!(order.unknown_for("d", None, GONE), Duration::ZERO, "its site is known");
        assert_eq!(order.unknown_for("e", north, 2 * GONE), Duration::ZERO, "it was not unknown for a while");
    }

    #[test]
    fn where_many_wait_a_loop_that_would_be_known_is_not_waited_for() {
        let mut order = Order::default();
        (0..=MANY as u64).for_each(|at| order.put_off(&format!("a{}", at % 7), at, SECOND));
        assert_eq!(order.waiting(), MANY + 1);
        assert_eq!(patience(order.waiting(), Some(IN_FORCE)), IN_FORCE);
        assert_eq!(patience(order.waiting(), Some(IN_FORCE - SECOND)), GIVEN_UP, "it may be taken just now");
        assert_eq!(patience(order.waiting(), None), GIVEN_UP, "its edge has not said what it has");
        order.end("a0", 0);
        assert_eq!(patience(order.waiting(), Some(IN_FORCE)), GIVEN_UP, "there is room");
    }

    #[test]
    fn samples_from_elsewhere_wait_for_what_their_edge_says_and_then_are_left_out() {
        let mut strange = Strange::default();
        let mut look =
            |source, own, now| strange.origin(("a", "pv"), (source, Some(own)), (ANNOUNCEMENT_WAIT, now));
        assert_eq!(look("one", "one", SECOND), Origin::Own);
        assert_eq!(look("two", "one", 2 * SECOND), Origin::Waits);
        assert_eq!(look("two", "two", 3 * SECOND), Origin::Own, "the edge has said so");
        assert_eq!(look("one", "two", 4 * SECOND), Origin::Waits);
        assert_eq!(look("one", "two", 4 * SECOND + ANNOUNCEMENT_WAIT), Origin::GivenUp, "told once");
        assert_eq!(
            look("one", "two", 4 * SECOND + ANNOUNCEMENT_WAIT),
            Origin::Foreign,
            "the next does not wait again"
        );
        // Two edges may send under one name: the one that is known stays so, and the other does not wait again.
        assert_eq!(look("two", "two", 5 * SECOND + ANNOUNCEMENT_WAIT), Origin::Own);
        assert_eq!(look("one", "two", 5 * SECOND + ANNOUNCEMENT_WAIT), Origin::Foreign);
        assert_eq!(look("three", "two", 5 * SECOND + ANNOUNCEMENT_WAIT), Origin::Waits);
        assert_eq!(look("three", "two", 6 * SECOND + 2 * ANNOUNCEMENT_WAIT), Origin::GivenUp);
        assert_eq!(
            look("three", "two", 6 * SECOND + 2 * ANNOUNCEMENT_WAIT + QUIET),
            Origin::Waits,
            "after a long silence"
        );
    }

    #[test]
    fn a_stream_that_is_made_anew_is_another() {
        let mut making = Making::default();
        assert!(!making.is_another(7) && !making.is_another(7));
        assert!(making.is_another(8) && !making.is_another(8));
        assert_eq!(making.made(), 8);
    }

    #[test]
    fn samples_of_a_tag_that_is_not_announced_wait_for_that() {
        let mut strange = Strange::default();
        let mut look = |own, patience, now| strange.origin(("a", "cv"), ("one", own), (patience, now));
        assert_eq!(look(None, ANNOUNCEMENT_WAIT, SECOND), Origin::Waits);
        assert_eq!(look(Some("one"), ANNOUNCEMENT_WAIT, 2 * SECOND), Origin::Own);
        assert_eq!(look(None, GIVEN_UP, 3 * SECOND), Origin::Waits, "another configuration is in force");
        let later = 4 * SECOND + ANNOUNCEMENT_WAIT;
        assert_eq!(look(None, GIVEN_UP, later), Origin::Waits, "a list is still to be taken");
        assert_eq!(look(None, ANNOUNCEMENT_WAIT, later), Origin::GivenUp, "told once");
        assert_eq!(look(None, ANNOUNCEMENT_WAIT, later), Origin::Foreign);
        assert_eq!(announcement_patience(0, None), GIVEN_UP);
        assert_eq!(announcement_patience(0, Some(SECOND)), ANNOUNCEMENT_WAIT);
        assert_eq!(announcement_patience(MANY + 1, None), ANNOUNCEMENT_WAIT, "nobody else is held up");
    }

    #[test]
    fn tags_that_an_edge_makes_up_take_a_bounded_room() {
        let mut strange = Strange::default();
        let mut look = |at: usize, now| {
            let tag = at.to_string();
            let seen = strange.origin(("a", tag.as_str()), ("one", None), (ANNOUNCEMENT_WAIT, now));
            (seen, strange.0.len())
        };
        (0..MOST_STRANGE).for_each(|at| assert_eq!(look(at, SECOND).0, Origin::Waits));
        assert_eq!(look(MOST_STRANGE, SECOND), (Origin::GivenUp, MOST_STRANGE), "it is told all the same");
        assert_eq!(look(MOST_STRANGE, SECOND + QUIET), (Origin::Waits, 1), "the others are gone");
    }

    #[test]
    fn a_message_waits_for_an_earlier_one_for_a_bounded_time() {
        let mut early = Early::default();
        assert!(early.waits("a", SECOND) && early.waits("a", EARLY));
        assert!(!early.waits("a", SECOND + EARLY));
        assert!(early.waits("a", SECOND + EARLY), "another gap, another wait");
        early.end("a");
        assert!(early.waits("a", 3 * EARLY) && early.0.len() == 1);
        early.stood_still(SECOND);
        assert!(early.waits("a", 4 * EARLY), "nothing was read meanwhile");
        assert!(early.waits("a", 4 * EARLY + GIVEN_UP), "that was another gap");
        assert!(!early.waits("a", 5 * EARLY + GIVEN_UP));
    }

    #[test]
    fn what_was_put_off_comes_first_unless_it_was_deleted() {
        let (mut order, mut early) = (Order::default(), Early::default());
        let put_off = |order: &mut Order, early: &mut Early, sequence, now| {
            assert!(early.waits("a", now));
            order.put_off("a", sequence, now);
        };
        put_off(&mut order, &mut early, 7, SECOND);
        let is_next = |order: &mut Order, early: &Early, now| early.is_next(order, ("a", 9), now);
        assert!(!is_next(&mut order, &early, 2 * EARLY), "7 came first");
        assert!(is_next(&mut order, &early, SECOND + 2 * EARLY));
        assert!(order.put_off.is_empty());
        // Without a gap it is waited for as long as its server may take.
        early.end("a");
        order.put_off("a", 7, SECOND);
        assert!(!is_next(&mut order, &early, 2 * SECOND + 2 * EARLY));
    }

    proptest! {
        /// A centre was away for longer than a full stream lasts. The first message that is left is early, and the stream deletes
        /// each a while after it can be read. Those that are there come again and again.
        #[test]
        fn a_loop_whose_messages_are_deleted_before_their_turn_is_taken_again(
            period in 1u32..60,
            lasts in 2u32..60,
            phase in 0u32..2,
        ) {
            let (mut order, mut early, mut taken) = (Order::default(), Early::default(), None);
            // It is looked at again each 2 s, for a message of each period that lasts so long.
            for at in (phase..600).step_by(2) {
                let now = at * SECOND;
                let there = (0..=at / period).filter(|k| at < k * period + lasts);
                for sequence in there.map(u64::from) {
                    if !early.is_next(&mut order, ("a", sequence), now) || early.waits("a", now) {
                        order.put_off("a", sequence, now);
                    } else if taken.is_none() {
                        taken = Some(now);
                        break;
                    }
                }
                if taken.is_some() {
                    break;
                }
            }
            // The wait, the next message and the next look.
            let most = 2 * EARLY + (period + 2) * SECOND;
            prop_assert!(taken.is_some_and(|at| at <= most), "{taken:?}");
        }

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
