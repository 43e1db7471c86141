//! What the store gives back: at the start, for loops that are configured again, and once a store works that could not be read
//! at the start. What was made meanwhile without it is joined with it, and takes the place of nothing.

use super::health::{FRESH, ToKeep, kept_fresh_s};
use super::rows::KeptPlant;
use super::swings::swings;
use super::{AT_ONCE, Plantwide, lock, rows};
use crate::signal::LoopId;
use crate::work::{Measure, Order, State, WorkList};
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::Arc;

/// Looks of an order that is joined of two, as many as any order remembers.
const LOOKS: usize = 240;

impl Plantwide {
    /// Takes back orders, days and the latest measures of the loops that are watched. What is joined is kept anew: a row that
    /// waits to be written was made without it.
    pub(super) fn take_back(&self, kept: KeptPlant) {
        let watched = lock(&self.watched).clone();
        let ids: BTreeSet<LoopId> = watched.loops.iter().map(|own| own.id.clone()).collect();
        let now = self.clock.now();
        // A look of long ago, or the last one, does not say how the plant swings now.
        let (is_enabled, period_s) = (watched.config.enabled, watched.config.period_s);
        let is_within = |at: f64, age_s: f64| is_enabled && at >= now - age_s;
        // An order is kept at every look.
        let is_fresh = |at: f64| is_within(at, FRESH * period_s);
        let wanted = |order: &Order| ids.contains(&order.id) && !order.is_forgotten(now);
        let mut list = lock(&self.list);
        let orders = kept.orders.into_iter().filter(wanted).collect();
        for order in put_back(&mut list, orders, is_fresh) {
            self.persistence.note_rows(rows::order_rows(&order, None));
        }
        self.results.swing(swings(&list));
        drop(list);
        let mut health = lock(&self.health);
        for (id, days) in kept.days.into_iter().filter(|(id, _)| ids.contains(id)) {
            if let Some(all) = health.restore(&id, &days) {
                self.persistence.note_rows(vec![rows::health_row(&id, &all)]);
            }
        }
        let mut measures = lock(&self.measures);
        for own in kept.todays.into_iter().filter(|own| ids.contains(&own.id)) {
            if is_within(own.part.until, kept_fresh_s(period_s)) {
                measures.entry(own.id.clone()).or_insert(own.measure);
            }
            if let Some(part) = health.restore_part(&own.id, own.part) {
                let measure = measures.get(&own.id).copied().unwrap_or_default();
                self.persistence.note_rows(vec![rows::today_row(&own.id, &part, &measure)]);
            }
        }
    }

    /// The clock was set by so much (s) to `now` (s), so long after the start (s): orders and looks are no older by that.
    pub(in crate::app) fn clock_was_set(&self, by: f64, now: f64, elapsed_s: f64) {
        let until = now - by;
        let since_start = [until - elapsed_s, until];
        let set = |t: &mut f64| {
            if (since_start[0]..=until).contains(&*t) {
                *t += by;
            }
        };
        let mut health = lock(&self.health);
        health.clock_was_set(since_start, by);
        // Both are of one look.
        lock(&self.last).values_mut().for_each(|own| set(&mut own.at));
        drop(health);
        if let Some(own) = &mut *lock(&self.overview) {
            set(&mut Arc::make_mut(own).at);
        }
        let mut list = lock(&self.list);
        let changed = list.clock_was_set(since_start, by);
        let kept = changed.iter().flat_map(|order| rows::order_rows(order, None));
        self.persistence.note_rows(kept.collect());
        self.results.swing(swings(&list));
    }

    /// Has orders and indicators kept again, all of them.
    pub(super) fn keep_again(&self) {
        let list = lock(&self.list);
        let orders = list.orders().flat_map(|order| rows::order_rows(order, None));
        self.persistence.note_rows(orders.collect());
        drop(list);
        let ids = lock(&self.health).ids();
        for some in ids.chunks(AT_ONCE) {
            let health = lock(&self.health);
            self.note_health(&health.all(some), &lock(&self.measures));
        }
    }

    /// Keeps days, and the day so far with how the loops were by the latest look.
    pub(super) fn note_health(&self, keep: &ToKeep, measures: &HashMap<LoopId, Measure>) {
        let today = |(id, part): &(LoopId, rows::Part)| {
            rows::today_row(id, part, &measures.get(id).copied().unwrap_or_default())
        };
        let days = keep.days.iter().map(|(id, days)| rows::health_row(id, days));
        self.persistence.note_rows(days.chain(keep.parts.iter().map(today)).collect());
    }
}

/// Puts orders back as they were kept; of a loop that has one which was made without it the two are joined. Those that were.
///
/// What is expected to calm down with an order comes back where its latest look `is_fresh`, and none was made since the start.
fn put_back(list: &mut WorkList, orders: Vec<Order>, is_fresh: impl Fn(f64) -> bool) -> Vec<Order> {
    let (mut back, mut both) = (Vec::new(), Vec::new());
    let none_since = list.orders().next().is_none();
    for mut kept in orders {
        if !(none_since && kept.looks.back().is_some_and(|look| is_fresh(look.at))) {
            kept.victims.clear();
        }
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
    let (suspected, victims) = (own.suspected.max(kept.suspected), own.victims.clone());
    // It belongs to the sentence, so both come from the same order.
    let gains_nothing = if own.why.is_some() { own.gains_nothing } else { kept.gains_nothing };
    let whole = if by_people { own } else { Order { why: own.why.or(kept.why), gains_nothing, ..kept } };
    Order { first, suspected, victims, looks, before, reopened, ..whole }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::persistence::Persistence;
    use crate::history::History;
    use crate::plantwide::Cause;
    use crate::results::Results;
    use crate::schedule::Clock;
    use crate::serve::{LoopLook, Overview, PlantwidePort};
    use crate::store::Driven;
    use crate::work::{Act, Config, Measure, Said, Seen};

    #[test]
    fn the_latest_look_is_as_long_ago_as_before_the_clock_was_set() {
        let config = crate::config::Config::default();
        let (history, clock) = (Arc::new(History::new(&[], &config.history)), Clock::by_hand(3600.0));
        let results = Arc::new(Results::new(&[], 1, &config.alarm));
        let persistence = Persistence::new(&config, clock, Driven::default(), (&history, &results));
        let plantwide = Plantwide::new(&config, clock, &history, &results, &persistence);
        let id = LoopId::new("A");
        *lock(&plantwide.overview) = Some(Arc::new(Overview { at: 3000.0, ..Overview::default() }));
        let look = LoopLook { at: 3000.0, ..LoopLook::default() };
        lock(&plantwide.last).insert(id.clone(), look);
        let at =
            || (plantwide.overview().map(|own| own.at), lock(&plantwide.last).get(&id).map(|own| own.at));
        plantwide.clock_was_set(1e6, 3600.0 + 1e6, 3600.0);
        assert_eq!(at(), (Some(3000.0 + 1e6), Some(3000.0 + 1e6)));
        // What it did not stamp since the start stays.
        plantwide.clock_was_set(7.0, 9e6, 3600.0);
        assert_eq!(at(), (Some(3000.0 + 1e6), Some(3000.0 + 1e6)));
    }

    /// A list that suspected a loop at each of these hours.
    fn list(hours: std::ops::Range<u32>) -> WorkList {
        let mut list = WorkList::default();
        let seen = Seen {
            cause: Cause::Valve,
            probability: Some(0.9),
            worth: 1.8,
            why: "it sticks".into(),
            gains_nothing: false,
            victims: vec![LoopId::new("B")],
        };
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
        let both = put_back(&mut own, vec![kept.clone()], |_| true);
        let found = only(&own);
        assert_eq!(both, std::slice::from_ref(&found), "it is kept anew");
        assert_eq!((found.state, found.by.as_deref()), (State::Ordered, Some("ann")));
        assert_eq!((found.first, found.since, found.looks.len()), (kept.first, kept.since, 13));
        assert!(put_back(&mut own, vec![kept], |_| true).is_empty(), "it goes on from there");
        assert_eq!(only(&own), found);
    }

    #[test]
    fn what_people_did_since_goes_before_it() {
        let mut before = list(0..10);
        act(&mut before, Act::Order, "ann", 11);
        let mut own = list(20..23);
        act(&mut own, Act::Repaired, "bob", 24);
        put_back(&mut own, vec![only(&before)], |_| true);
        let found = only(&own);
        assert_eq!((found.state, found.by.as_deref()), (State::Repaired, Some("bob")));
        assert_eq!((found.first, found.looks.len()), (0.0, 13));
        assert!(found.before.is_some());
    }

    #[test]
    fn of_a_loop_without_one_the_order_is_back() {
        let kept = only(&list(0..10));
        let mut own = WorkList::default();
        assert!(put_back(&mut own, vec![kept.clone()], |_| true).is_empty());
        assert_eq!(only(&own), kept);
    }

    #[test]
    fn what_calms_down_with_an_order_comes_back_from_a_look_that_is_fresh_and_the_last() {
        let mut kept = list(0..60);
        act(&mut kept, Act::Order, "ann", 60);
        let kept = only(&kept);
        assert_eq!(kept.victims, [LoopId::new("B")]);
        let last = 3600.0 * 59.0;
        let back = |mut own: WorkList, since: f64| {
            put_back(&mut own, vec![kept.clone()], |at| at >= since);
            own.sources().len()
        };
        assert_eq!((back(WorkList::default(), last), back(WorkList::default(), last + 1.0)), (1, 0));
        // A look since the start has found another order, and this loop at rest.
        let mut since = WorkList::default();
        let other = Order { id: LoopId::new("C"), ..kept.clone() };
        since.restore(vec![Order { victims: Vec::new(), ..other }]);
        assert_eq!(back(since, last), 0);
    }
}
