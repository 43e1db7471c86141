//! What the store gives back: at the start, for loops that are configured again, and once a store works that could not be read
//! at the start. What was made meanwhile without it is joined with it, and takes the place of nothing.

use super::super::persistence::Days;
use super::{Plantwide, lock, rows};
use crate::signal::LoopId;
use crate::work::{Order, State, WorkList};
use std::collections::{BTreeSet, VecDeque};

/// Looks of an order that is joined of two, as many as any order remembers.
const LOOKS: usize = 240;

impl Plantwide {
    /// Takes back orders and days of the loops that are watched. What is joined is kept anew: a row that waits to be written
    /// was made without it.
    pub(super) fn take_back(&self, orders: Vec<Order>, days: Vec<Days>) {
        let ids: BTreeSet<LoopId> = lock(&self.watched).loops.iter().map(|own| own.id.clone()).collect();
        let now = self.clock.now();
        let wanted = |order: &Order| ids.contains(&order.id) && !order.is_forgotten(now);
        let mut list = lock(&self.list);
        let orders = orders.into_iter().filter(wanted).collect();
        for order in put_back(&mut list, orders) {
            self.persistence.note_rows(rows::order_rows(&order, None));
        }
        self.results.swing(list.sources());
        drop(list);
        let mut health = lock(&self.health);
        for (id, days) in days.into_iter().filter(|(id, _)| ids.contains(id)) {
            if let Some(all) = health.restore(&id, &days) {
                self.persistence.note_rows(vec![rows::health_row(&id, &all)]);
            }
        }
    }
}

/// Puts orders back as they were kept; of a loop that has one which was made without it the two are joined. Those that were.
fn put_back(list: &mut WorkList, orders: Vec<Order>) -> Vec<Order> {
    let (mut back, mut both) = (Vec::new(), Vec::new());
    for kept in orders {
        match list.get(&kept.id) {
            None => back.push(kept),
            Some(own) if own.first > kept.first => both.push(joined(kept, own.clone())),
            // It goes on from the one that was kept.
            Some(_) => {}
        }
    }
    let mut whole = WorkList::default();
    whole.restore(both.clone());
    whole.restore(list.orders().cloned().collect());
    whole.restore(back);
    *list = whole;
    both
}

/// One order of the one that was kept and of one that was begun without it: how people left it, the last of them first.
fn joined(kept: Order, own: Order) -> Order {
    let is_new = |at: f64| kept.looks.back().is_none_or(|last| at > last.at);
    let later = own.looks.iter().filter(|look| is_new(look.at));
    let mut looks: VecDeque<_> = kept.looks.iter().chain(later).copied().collect();
    looks.drain(..looks.len().saturating_sub(LOOKS));
    let by_people =
        own.by.is_some() || matches!(own.state, State::Ordered | State::Repaired | State::Dismissed);
    let before = own.before.or(kept.before);
    let (first, reopened) = (kept.first, kept.reopened + own.reopened);
    let whole = if by_people { own } else { Order { seen: own.seen.or(kept.seen), ..kept } };
    Order { first, looks, before, reopened, ..whole }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::Cause;
    use crate::work::{Act, Config, Measure, Said, Seen};

    /// A list that suspected a loop at each of these hours.
    fn list(hours: std::ops::Range<u32>) -> WorkList {
        let mut list = WorkList::default();
        let seen =
            Seen { cause: Cause::Valve, probability: 0.9, why: "it sticks".into(), victims: Vec::new() };
        for hour in hours {
            let (id, measure) = (LoopId::new("A"), Measure::default());
            let said = [Said { id, from: 0.0, measure, seen: Some(seen.clone()) }];
            list.take(&said, 3600.0 * f64::from(hour), &Config::default());
        }
        list
    }

    fn act(list: &mut WorkList, act: Act, by: &str, hour: u32) {
        let by = Some(by.to_string());
        list.act(&LoopId::new("A"), act, by, None, 3600.0 * f64::from(hour)).expect("there").expect("may be");
    }

    fn only(list: &WorkList) -> Order {
        list.orders().next().expect("one").clone()
    }

    #[test]
    fn what_people_did_before_a_start_that_did_not_know_it_still_holds() {
        let mut before = list(0..10);
        act(&mut before, Act::Order, "ann", 11);
        let kept = only(&before);
        // The store could not be read for three looks.
        let mut own = list(20..23);
        let both = put_back(&mut own, vec![kept.clone()]);
        let found = only(&own);
        assert_eq!(both, std::slice::from_ref(&found), "it is kept anew");
        assert_eq!((found.state, found.by.as_deref()), (State::Ordered, Some("ann")));
        assert_eq!((found.first, found.since, found.looks.len()), (kept.first, kept.since, 13));
        assert!(put_back(&mut own, vec![kept]).is_empty(), "it goes on from there");
        assert_eq!(only(&own), found);
    }

    #[test]
    fn what_people_did_since_goes_before_it() {
        let mut before = list(0..10);
        act(&mut before, Act::Order, "ann", 11);
        let mut own = list(20..23);
        act(&mut own, Act::Repaired, "bob", 24);
        put_back(&mut own, vec![only(&before)]);
        let found = only(&own);
        assert_eq!((found.state, found.by.as_deref()), (State::Repaired, Some("bob")));
        assert_eq!((found.first, found.looks.len()), (0.0, 13));
        assert!(found.before.is_some());
    }

    #[test]
    fn of_a_loop_without_one_the_order_is_back() {
        let kept = only(&list(0..10));
        let mut own = WorkList::default();
        assert!(put_back(&mut own, vec![kept.clone()]).is_empty());
        assert_eq!(only(&own), kept);
    }
}
