//! What to do, source before victims: one task for each loop that has a cause of its own.

use super::{Analysis, Cause};

/// One thing to do, and whose trouble it is expected to end.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// The loop to look at.
    pub at: usize,
    /// Why it is not at rest.
    pub cause: Cause,
    /// Probability of the cause (0..1).
    pub probability: f64,
    /// One sentence.
    pub why: String,
    /// Loops that are expected to calm down with it.
    pub victims: Vec<usize>,
}

impl Task {
    /// How sure it is, for people; of an unknown cause there is nothing to be sure of.
    pub fn sure(&self) -> Option<f64> {
        (self.cause != Cause::Unknown).then_some(self.probability)
    }

    /// Loops that are expected to be calmer when it is done, in the mean: what tasks are sorted by.
    pub fn worth(&self) -> f64 {
        self.probability * (1 + self.victims.len()) as f64
    }
}

/// The tasks of a plant, those of the greatest [`Task::worth`] first.
pub fn tasks(found: &Analysis) -> Vec<Task> {
    let mut tasks: Vec<Task> = Vec::new();
    for (at, of) in found.loops.iter().enumerate() {
        let victims = victims(found, at);
        match &of.reason {
            Some(reason) if reason.cause != Cause::Neighbour => {
                let (cause, probability, why) = (reason.cause, reason.probability, reason.why.clone());
                tasks.push(Task { at, cause, probability, why, victims });
            }
            // A suspect whose members are less sure of themselves than of it is a task of its own all the same.
            _ if !victims.is_empty() => {
                let why = "it is the likeliest source of its group, but not by enough to be sure".to_string();
                tasks.push(Task { at, cause: Cause::Unknown, probability: 0.5, why, victims });
            }
            _ => {}
        }
    }
    tasks.sort_by(|a, b| b.worth().total_cmp(&a.worth()));
    tasks
}

fn victims(found: &Analysis, of: usize) -> Vec<usize> {
    let is_victim =
        |at: &usize| found.loops[*at].reason.as_ref().is_some_and(|reason| reason.neighbour == Some(of));
    (0..found.loops.len()).filter(is_victim).collect()
}
