//! The work list: one order for each loop that somebody should look at, from the first suspicion to the proof that a repair
//! helped. Pure: no clock, no files; time is an argument.
//!
//! The plant-wide analysis says again and again what it suspects ([`WorkList::take`]). A suspicion that lasts becomes an open
//! order; people order the work and say when it is done; what the analysis says after that verifies the repair or opens the
//! order again. [`order`] has the states.

mod config;
pub mod order;

pub use config::{Config, CostConfig};
pub use order::{Act, Measure, Move, Order, Refusal, Seen, State};

use crate::signal::LoopId;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Most orders; those that are over go first.
const MOST: usize = 10_000;

/// What an analysis said of one loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Said {
    /// The loop.
    pub id: LoopId,
    /// The first of the samples that it was made of (s).
    pub from: f64,
    /// How it is.
    pub measure: Measure,
    /// What should be done; `None` where nothing should.
    pub seen: Option<Seen>,
}

/// All orders.
#[derive(Clone, Debug, Default)]
pub struct WorkList {
    orders: BTreeMap<LoopId, Order>,
}

impl WorkList {
    /// Takes what an analysis said of the loops that it looked at. What it could not look at stays as it is, but nothing is
    /// expected to calm down with it any more: that is said of how the plant swings now.
    ///
    /// Returns the orders that are to be kept, with what happened to their states.
    pub fn take(&mut self, said: &[Said], now: f64, config: &Config) -> Vec<(Order, Option<Move>)> {
        let looked_at: BTreeSet<&LoopId> = said.iter().map(|own| &own.id).collect();
        let mut changed = self.forget_victims(|id| !looked_at.contains(id));
        for own in said {
            let order = match (self.orders.get_mut(&own.id), &own.seen) {
                (Some(order), _) => order,
                (None, Some(_)) => {
                    self.orders.entry(own.id.clone()).or_insert_with(|| Order::new(own.id.clone(), now))
                }
                (None, None) => continue,
            };
            let moved = order.take(own.seen.as_ref(), own.measure, own.from, now, config);
            changed.push((order.clone(), moved));
        }
        self.orders.retain(|_, order| !order.is_forgotten(now));
        self.bound();
        changed
    }

    /// Nothing is expected any more to calm down with these loops; the orders that are to be kept, none of which has moved.
    pub fn forget_victims(&mut self, of: impl Fn(&LoopId) -> bool) -> Vec<(Order, Option<Move>)> {
        let own = self.orders.values_mut().filter(|order| !order.victims.is_empty() && of(&order.id));
        own.map(|order| {
            order.victims.clear();
            (order.clone(), None)
        })
        .collect()
    }

    /// Somebody acts on the order of a loop; `None` where there is none.
    ///
    /// # Errors
    /// [`Refusal`], where its state does not allow it.
    pub fn act(
        &mut self,
        id: &LoopId,
        act: Act,
        by: Option<String>,
        note: Option<String>,
        now: f64,
    ) -> Option<Result<(Order, Move), Refusal>> {
        let order = self.orders.get_mut(id)?;
        Some(order.act(act, by, note, now).map(|moved| (order.clone(), moved)))
    }

    /// Takes back what was kept, where there is no newer.
    pub fn restore(&mut self, kept: Vec<Order>) {
        for order in kept {
            self.orders.entry(order.id.clone()).or_insert(order);
        }
        self.bound();
    }

    /// The clock was set by so much (s): what it stamped between two times (s) is as long ago as before, so that nothing is old
    /// enough to be forgotten by that.
    ///
    /// Returns the orders that are to be kept.
    pub fn clock_was_set(&mut self, between: [f64; 2], by: f64) -> Vec<Order> {
        let own = self.orders.values_mut();
        own.filter_map(|order| order.clock_was_set(between, by).then(|| order.clone())).collect()
    }

    /// Forgets loops that are no longer watched.
    pub fn keep_only(&mut self, loops: &BTreeSet<LoopId>) {
        self.orders.retain(|id, _| loops.contains(id));
    }

    /// The orders of one loop.
    pub fn get(&self, id: &LoopId) -> Option<&Order> {
        self.orders.get(id)
    }

    /// Of each loop that is expected, by the latest look, to calm down with one that has an open or ordered order, or whose own cause is
    /// not known, that one.
    pub fn sources(&self) -> HashMap<LoopId, LoopId> {
        let standing = self
            .orders
            .values()
            .filter(|order| matches!(order.state, State::Unexplained | State::Open | State::Ordered));
        let pairs =
            standing.flat_map(|order| order.victims.iter().map(|victim| (victim.clone(), order.id.clone())));
        pairs.collect()
    }

    /// All orders, by loop.
    pub fn orders(&self) -> impl Iterator<Item = &Order> {
        self.orders.values()
    }

    fn bound(&mut self) {
        while self.orders.len() > MOST {
            let rank = |order: &&Order| (order.state.is_over(), -order.since);
            let last = self
                .orders
                .values()
                .max_by(|a, b| rank(a).0.cmp(&rank(b).0).then(rank(a).1.total_cmp(&rank(b).1)));
            let Some(id) = last.map(|order| order.id.clone()) else { return };
            self.orders.remove(&id);
        }
    }
}

#[cfg(test)]
mod tests;
