//! A work list in which every loop has an order, for how fast the page is.

use std::sync::Arc;
use stictiond::indicators::series::Values;
use stictiond::plantwide::Cause;
use stictiond::serve::{Health, Overview, PlantwidePort, WorkLine};
use stictiond::signal::LoopId;
use stictiond::work::{Act, Order, Refusal, State};

/// An order for each of these loops, five victims each.
pub struct Orders(pub Vec<LoopId>);

impl PlantwidePort for Orders {
    fn overview(&self) -> Option<Arc<Overview>> {
        None
    }

    fn look(&self) -> bool {
        false
    }

    fn work(&self) -> Vec<WorkLine> {
        let line = |(at, id): (usize, &LoopId)| {
            let victims = self.0.iter().cycle().skip(at + 1).take(5).cloned().collect();
            let why = "it swings with five others at 41 s, and its valve sticks".to_string();
            let why = Some((Cause::Valve, why));
            let order = Order { state: State::Open, why, victims, ..Order::new(id.clone(), 0.0) };
            WorkLine { order, cost: Some((at as f64, "EUR/day".into())) }
        };
        self.0.iter().enumerate().map(line).collect()
    }

    fn act(
        &self,
        _: &LoopId,
        _: Act,
        _: Option<String>,
        _: Option<String>,
    ) -> Option<Result<WorkLine, Refusal>> {
        None
    }

    fn latest(&self, _: &LoopId) -> Option<Values> {
        None
    }

    fn health(&self, _: &LoopId) -> Option<Health> {
        None
    }
}
