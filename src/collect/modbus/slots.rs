//! Which request is asked when, so that one that never answers cannot starve the others. Pure.
//!
//! ```text
//!            answered                      unanswered, others answered
//!   +-----> healthy ---------------------------------> suspect(1)
//!   |          ^  refused: asked last from now on         |  | unanswered again, others answered
//!   |          |                                          |  v
//!   |          +------------------ answered --------------+ suspect(n): rests 2^(n-1) - 1 polls, 31 at most
//! ```
//! A poll that no request answers says nothing about any one of them (the device is gone): no suspicion,
//! but the next poll begins behind the last request asked, so that a bad one at the head blocks nobody.
//!
//! A request that the device refuses is divided. When all parts are answered in the very poll in which the whole was
//! refused, the refusal was of the whole (a hole between its tags, or more than the device gives at once), and it is
//! never asked so again. When they are answered only later, and for a while, the requests are tried undivided again,
//! later and later: a device that refused everything while it was started must not be asked for every tag by itself
//! from then on.

use super::plan::{Request, Tag};
use crate::signal::BadReason;
use std::collections::VecDeque;

const LONGEST_REST: u64 = 31;
/// Polls answered in full after which divided requests are tried whole again; doubled each time, up to the second.
const PATIENCE: u64 = 60;
const LONGEST_PATIENCE: u64 = 1 << 14;

/// The requests of a device with what is known of each; a slot's number changes between polls only.
#[derive(Debug)]
pub(super) struct Slots {
    slots: Vec<Slot>,
    first: usize,
    planned: Vec<Request>,
    /// Polls in a row that every part of what was divided has answered.
    answered_in_full: u64,
    patience: u64,
    /// Whether a request has been divided in this poll.
    divided_now: bool,
}

#[derive(Debug)]
struct Slot {
    request: Request,
    failures: u32,
    rest_until: u64,
    reason: BadReason,
    /// Whether it has been answered with values in this poll.
    heard: bool,
}

impl Slot {
    fn new(request: Request) -> Self {
        Self { request, failures: 0, rest_until: 0, reason: BadReason::Timeout, heard: false }
    }
}

/// What to do in one poll.
#[derive(Debug, PartialEq)]
pub(super) struct Order {
    /// Slots to ask, in this order.
    pub(super) due: VecDeque<usize>,
    /// Slots to leave alone this time, with the reason their tags are bad.
    pub(super) resting: Vec<(usize, BadReason)>,
}

impl Slots {
    pub(super) fn new(requests: Vec<Request>) -> Self {
        let slots = requests.iter().cloned().map(Slot::new).collect();
        Self {
            slots,
            first: 0,
            planned: requests,
            answered_in_full: 0,
            patience: PATIENCE,
            divided_now: false,
        }
    }

    pub(super) fn request(&self, slot: usize) -> &Request {
        &self.slots[slot].request
    }

    /// The healthy ones first, then those that failed and are due again.
    pub(super) fn order(&self, poll: u64) -> Order {
        let count = self.slots.len();
        let rotated = || (0..count).map(|k| (self.first + k) % count);
        let resting = |slot: usize| poll < self.slots[slot].rest_until;
        let healthy = |slot: usize| self.slots[slot].failures == 0;
        let due = rotated().filter(|&slot| healthy(slot) && !resting(slot));
        let suspect = rotated().filter(|&slot| !healthy(slot) && !resting(slot));
        Order {
            due: due.chain(suspect).collect(),
            resting: rotated()
                .filter(|&slot| resting(slot))
                .map(|slot| (slot, self.slots[slot].reason))
                .collect(),
        }
    }

    /// The slot's request was answered with values.
    pub(super) fn answered(&mut self, slot: usize) {
        self.slots[slot].heard = true;
        self.slots[slot].failures = 0;
        self.slots[slot].rest_until = 0;
    }

    /// The device refused the request: it is asked last from now on. True when that is news.
    pub(super) fn refused(&mut self, slot: usize) -> bool {
        let news = self.slots[slot].failures == 0;
        self.slots[slot].failures = 1;
        self.slots[slot].rest_until = 0;
        news
    }

    /// Divides a request that the device refused, until all is answered for a while. The slot keeps the lower part; the new
    /// slot with the upper part is returned.
    pub(super) fn split(&mut self, slot: usize, tags: &[Tag]) -> Option<usize> {
        let (lower, upper) = self.slots[slot].request.split(tags)?;
        self.slots[slot] = Slot::new(lower);
        self.slots.push(Slot::new(upper));
        self.divided_now = true;
        Some(self.slots.len() - 1)
    }

    /// Ends a poll: `unanswered` are the slots that got no answer at all, in the order asked, each with the
    /// reason; `any_answer` tells whether some other did.
    pub(super) fn poll_ended(&mut self, poll: u64, unanswered: &[(usize, BadReason)], any_answer: bool) {
        if any_answer {
            for &(slot, reason) in unanswered {
                let slot = &mut self.slots[slot];
                slot.failures = slot.failures.saturating_add(1);
                let rest = (1u64 << (slot.failures - 1).min(5)) - 1;
                slot.rest_until = poll + 1 + rest.min(LONGEST_REST);
                slot.reason = reason;
            }
        } else if let Some((last, _)) = unanswered.last() {
            self.first = (last + 1) % self.slots.len();
        }
        // Every slot is asked, for each forgets what it heard.
        let silent =
            self.slots.iter_mut().filter_map(|slot| (!std::mem::take(&mut slot.heard)).then_some(())).count();
        let heard_all = silent == 0;
        if std::mem::take(&mut self.divided_now) && heard_all {
            self.planned = self.slots.iter().map(|slot| slot.request.clone()).collect();
        }
        let divided = self.slots.len() > self.planned.len();
        let full = any_answer && unanswered.is_empty() && self.slots.iter().all(|slot| slot.failures == 0);
        self.answered_in_full = if divided && full { self.answered_in_full + 1 } else { 0 };
        if self.answered_in_full >= self.patience {
            self.slots = self.planned.iter().cloned().map(Slot::new).collect();
            (self.first, self.answered_in_full) = (0, 0);
            self.patience = (2 * self.patience).min(LONGEST_PATIENCE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::modbus::{Limits, Plan, Register, Span, TagSpec, group};
    use proptest::prelude::*;

    fn slots(count: u16) -> Slots {
        let spans: Vec<Span> =
            (0..count).map(|k| Span { register: Register::Holding, start: 100 * k, count: 1 }).collect();
        Slots::new(group(&spans, &Limits { registers: 125, bits: 2000, gap: 0 }))
    }

    /// Polls as the device loop does: at most two requests without an answer, then the poll is given up.
    fn poll(slots: &mut Slots, number: u64, answers: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut order = slots.order(number);
        let (mut read, mut failed) = (Vec::new(), Vec::new());
        while let Some(slot) = order.due.pop_front() {
            if answers(slot) {
                slots.answered(slot);
                read.push(slot);
            } else {
                failed.push((slot, BadReason::Timeout));
                if failed.len() == 2 {
                    break;
                }
            }
        }
        slots.poll_ended(number, &failed, !read.is_empty());
        read
    }

    #[test]
    fn a_request_that_never_answers_moves_last_and_rests_longer_and_longer() {
        let mut slots = slots(3);
        let mut asked = Vec::new();
        for number in 0..80 {
            if slots.order(number).due.contains(&0) {
                asked.push(number);
            }
            assert_eq!(poll(&mut slots, number, |slot| slot != 0), [1, 2]);
        }
        assert_eq!(asked, [0, 1, 3, 7, 15, 31, 63]);
        assert_eq!(slots.order(63).resting, [(0, BadReason::Timeout)]);
    }

    #[test]
    fn one_answer_makes_it_healthy_again() {
        let mut slots = slots(2);
        for number in 0..10 {
            poll(&mut slots, number, |slot| slot != 0);
        }
        poll(&mut slots, 15, |_| true);
        assert_eq!(slots.order(16).due, [0, 1]);
    }

    #[test]
    fn a_dead_device_makes_no_request_suspect() {
        let mut slots = slots(3);
        for number in 0..20 {
            poll(&mut slots, number, |_| false);
        }
        let mut read = poll(&mut slots, 20, |_| true);
        read.sort_unstable();
        assert_eq!(read, [0, 1, 2]);
    }

    #[test]
    fn a_refused_request_is_asked_last_but_every_time() {
        let mut slots = slots(3);
        assert!(slots.refused(0));
        assert!(!slots.refused(0));
        assert_eq!(slots.order(5).due, [1, 2, 0]);
    }

    /// One request of four neighbouring registers.
    fn of_four() -> (Slots, Vec<Tag>) {
        let config = toml::from_str("name = 'd'\naddress = 'd:502'\naddress_base = 0").unwrap();
        let spec = |address: usize| TagSpec {
            index: address,
            name: String::new(),
            role: None,
            config: toml::from_str(&format!(
                "device = 'd'\nregister = 'holding'\naddress = {address}\ntype = 'u16'"
            ))
            .unwrap(),
            frozen_after_s: None,
        };
        let plan = Plan::new(0, &config, (0..4).map(spec).collect()).unwrap();
        (Slots::new(plan.requests), plan.tags)
    }

    #[test]
    fn what_was_divided_is_tried_whole_again_later_and_later() {
        let (mut slots, tags) = of_four();
        let mut number = 0;
        let mut polls = |slots: &mut Slots, count: u64, answers: bool| {
            for _ in 0..count {
                poll(slots, number, |slot| answers || slot > 0);
                number += 1;
            }
        };
        for patience in [PATIENCE, 2 * PATIENCE] {
            assert_eq!(slots.split(0, &tags), Some(1));
            // The device refuses the parts too at first.
            polls(&mut slots, 1, false);
            polls(&mut slots, patience - 1, true);
            // One poll that is not answered in full, and the counting begins anew.
            polls(&mut slots, 1, false);
            polls(&mut slots, patience, true);
            assert_eq!(slots.order(u64::MAX).due, [0], "whole again after {patience} polls");
        }
    }

    #[test]
    fn a_hole_that_is_proven_is_never_read_across_again() {
        let (mut slots, tags) = of_four();
        assert_eq!(slots.split(0, &tags), Some(1));
        // Both parts are answered in the poll in which the whole was refused.
        for number in 0..100_000 {
            assert_eq!(poll(&mut slots, number, |_| true).len(), 2, "poll {number}");
        }
    }

    proptest! {
        /// Whatever requests never answer, after a few polls every other one is read in every poll.
        #[test]
        fn the_good_are_never_starved(bad in prop::collection::vec(any::<bool>(), 1..20)) {
            let mut slots = slots(bad.len() as u16);
            let good = bad.iter().filter(|b| !**b).count();
            // Two bad ones are found out per poll, so n polls find them all wherever they stand.
            for number in 0..bad.len() as u64 {
                poll(&mut slots, number, |slot| !bad[slot]);
            }
            for number in 0..100 {
                let read = poll(&mut slots, bad.len() as u64 + number, |slot| !bad[slot]);
                prop_assert_eq!(read.len(), good);
            }
        }

        /// Every slot is either due or resting, once.
        #[test]
        fn every_slot_is_accounted_for(outcomes in prop::collection::vec(any::<u8>(), 1..60)) {
            let mut slots = slots(6);
            for (number, mask) in outcomes.iter().enumerate() {
                let order = slots.order(number as u64);
                let mut all: Vec<usize> = order.due.iter().copied().collect();
                all.extend(order.resting.iter().map(|(slot, _)| *slot));
                all.sort_unstable();
                prop_assert_eq!(all, (0..6).collect::<Vec<_>>());
                poll(&mut slots, number as u64, |slot| mask >> slot & 1 == 1);
            }
        }
    }
}
