//! Where an oscillation starts: from loop to loop along the disturbances that the diagnoses found.

use super::{KnownEffect, Results, lock};
use crate::residual::Kind;
use crate::signal::LoopId;

/// Loops on one path at the most.
const LONGEST_PATH: usize = 32;

/// The way a disturbance came to a loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Origin {
    /// From the loop asked for to where it starts, or once around where the loops drive each other.
    pub path: Vec<LoopId>,
    /// The loop it starts in; `None` where the loops drive each other and not exactly one of them sticks.
    pub starts_in: Option<LoopId>,
    /// Whether the valve of that loop sticks.
    pub sticky: bool,
}

impl Results {
    /// Follows what drives a loop to the loop that nothing known drives; `None` when no other loop drives this one.
    ///
    /// Where the path closes upon itself the one loop on it whose valve sticks is the start: friction oscillates by
    /// itself, a driven loop does not.
    pub fn origin(&self, id: &LoopId) -> Option<Origin> {
        let mut path = vec![id.clone()];
        while let Some(next) =
            path.last().and_then(|at| self.driver(at)).filter(|_| path.len() < LONGEST_PATH)
        {
            if let Some(first) = path.iter().position(|seen| *seen == next) {
                let mut sticky = path[first..].iter().filter(|at| self.sticks(at));
                let only = sticky.next().filter(|_| sticky.next().is_none()).cloned();
                return Some(Origin { sticky: only.is_some(), starts_in: only, path });
            }
            path.push(next);
        }
        let last = path.last().filter(|_| path.len() > 1)?.clone();
        Some(Origin { sticky: self.sticks(&last), starts_in: Some(last), path })
    }

    /// The loop whose tag drives this one, the most telling first.
    fn driver(&self, id: &LoopId) -> Option<LoopId> {
        let effects = self.effects(id);
        effects.iter().find_map(|effect| self.owner(effect).filter(|owner| owner != id))
    }

    /// The loop that the tag of a measured disturbance, `loop.tag`, belongs to.
    fn owner(&self, (kind, tag): &KnownEffect) -> Option<LoopId> {
        let tag = tag.as_deref().filter(|_| *kind == Kind::MeasuredDisturbance)?;
        let dots = tag.match_indices('.').map(|(at, _)| LoopId::new(&tag[..at]));
        dots.into_iter().find(|id| self.entry(id).is_some())
    }

    fn sticks(&self, id: &LoopId) -> bool {
        let entry = self.entry(id);
        entry.is_some_and(|entry| lock(&entry).diagnosed.as_ref().is_some_and(|(run, _)| run.sticks()))
    }
}

#[cfg(test)]
mod tests;
