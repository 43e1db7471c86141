//! What the API may know of the plant as a whole, and what people may do to its work list.

use super::super::report::GroupPictures;
use crate::indicators::distribution::Distribution;
use crate::indicators::harris::Harris;
use crate::indicators::margins::Margins;
use crate::indicators::oscillation::Oscillation;
use crate::indicators::series::Values;
use crate::indicators::settling::Settling;
use crate::plantwide::Part;
use crate::signal::LoopId;
use crate::work::{Act, Order, Refusal};
use std::collections::HashMap;
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
    /// Why loops were not at rest; no entry for a loop that was, or could not be judged.
    pub causes: HashMap<LoopId, CauseSeen>,
}

/// Why a loop was not at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct CauseSeen {
    /// The cause that is named.
    pub name: &'static str,
    /// Its probability (0..1); `None` for one that is not known.
    pub probability: Option<f64>,
    /// The sentence for operators.
    pub why: String,
    /// The likeliest source of its group, where that is the cause.
    pub neighbour: Option<LoopId>,
    /// The probability of every cause and of rest (0..1), the largest first.
    pub causes: Vec<(&'static str, f64)>,
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
    /// What lines are sorted by, the greatest first: the parts of the list before watched before over, then price, then how many loops
    /// are expected to be calmer, then how sure the cause is, an unknown one last.
    pub fn rank(&self) -> (u8, [f64; 3]) {
        let standing = match self.order.part() {
            Some(Part::First) => 4,
            Some(Part::Perhaps) => 3,
            Some(Part::Unknown) => 2,
            None => u8::from(!self.order.state.is_over()),
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
    /// What the latest look found beside them; `None` before the first since the start, and where it is as old as `looks` says.
    pub last: Option<LoopLook>,
}

/// What a look found of one loop beside its indicators: of its whole record, a week at most, and the index of its latest part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoopLook {
    /// When it was (s).
    pub at: f64,
    /// The Harris index.
    pub harris: Option<Harris>,
    /// Dead time of the process that it is for (s); `None` where it is for one sample.
    pub dead_time_s: Option<f64>,
    /// How steps of the set point were followed.
    pub settling: Option<Settling>,
    /// Oscillations of the error, the largest first.
    pub oscillations: Vec<Oscillation>,
    /// Where OP stayed.
    pub distribution: Option<Distribution>,
    /// Its margins, by the controller and the linear model of its latest diagnosis.
    pub margins: Option<Margins>,
}

/// How a loop stands among others, by the latest look.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Standing {
    /// The score (0..100); `None` where it is not known.
    pub score: Option<f64>,
    /// What its swing costs, and the unit; `None` where nobody gave a price.
    pub cost: Option<(f64, String)>,
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

    /// How a loop stands among others.
    fn standing(&self, id: &LoopId) -> Standing;
}
