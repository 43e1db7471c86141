//! What the API may know of the plant as a whole, and what people may do to its work list.

use super::super::report::GroupPictures;
use crate::indicators::series::Values;
use crate::signal::LoopId;
use crate::work::{Act, Order, Refusal};
use std::sync::Arc;

/// What the latest look at the plant found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Overview {
    /// When it was (s).
    pub at: f64,
    /// How long it took (s on the wall clock).
    pub took_s: f64,
    /// Loops that were looked at.
    pub looked_at: usize,
    /// Loops whose record could not be used, and why.
    pub skipped: Vec<(LoopId, String)>,
    /// Groups, the largest first.
    pub groups: Vec<GroupSeen>,
}

/// Loops that swing together.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupSeen {
    /// Period (s).
    pub period_s: f64,
    /// Its loops, the strongest first.
    pub members: Vec<LoopId>,
    /// Who may have started it, the likeliest first: probability (0..1) and evidence. None where no member can be judged.
    pub suspects: Vec<(LoopId, f64, Vec<String>)>,
    /// What is drawn of it; none of the smallest of very many.
    pub pictures: Option<GroupPictures>,
}

/// An order and what its loop's swing costs.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkLine {
    /// The order.
    pub order: Order,
    /// Price and its unit, of the loop and of those that may calm down with it; `None` where nobody gave prices.
    pub cost: Option<(f64, String)>,
}

impl WorkLine {
    /// What lines are sorted by, the greatest first: standing before watched before over, then price, then how many loops are
    /// expected to be calmer, then how sure the cause is, an unknown one last.
    pub fn rank(&self) -> (u8, [f64; 3]) {
        let standing = match self.order.state {
            state if state.is_standing() => 2,
            state if state.is_over() => 0,
            _ => 1,
        };
        let sure = self.order.cause().and_then(|(_, probability)| probability);
        let cost = self.cost.as_ref().map_or(0.0, |(cost, _)| *cost);
        (standing, [cost, self.order.worth(), sure.unwrap_or(-1.0)])
    }
}

/// The indicators of one loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Health {
    /// The looks of the latest week, oldest first: when (s), and what.
    pub looks: Vec<(f64, Values)>,
    /// Days before that, oldest first: when one ended (s), and its mean.
    pub days: Vec<(f64, Values)>,
}

/// Where the plant as a whole is asked for.
pub trait PlantwidePort: Send + Sync {
    /// What the latest look found; `None` before the first.
    fn overview(&self) -> Option<Arc<Overview>>;

    /// Asks for a look now; false where one is under way or none is wanted.
    fn look(&self) -> bool;

    /// Every order, in no order.
    fn work(&self) -> Vec<WorkLine>;

    /// Somebody acts on the order of a loop; `None` where there is none.
    ///
    /// # Errors
    /// [`Refusal`].
    fn act(
        &self,
        id: &LoopId,
        act: Act,
        by: Option<String>,
        note: Option<String>,
    ) -> Option<Result<WorkLine, Refusal>>;

    /// The indicators of a loop by the latest look; `None` before the first look at it.
    fn latest(&self, id: &LoopId) -> Option<Values>;

    /// The indicators of a loop over time; `None` before the first look at it.
    fn health(&self, id: &LoopId) -> Option<Health>;
}
