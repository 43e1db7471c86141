//! What to do, source before victims: one task for each loop that has a cause of its own.

use super::{Analysis, Cause};

/// One thing to do, and whose trouble it may end.
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
    /// Loops that may calm down with it.
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
    for ((at, of), victims) in found.loops.iter().enumerate().zip(victims(found)) {
        match &of.reason {
            Some(reason) if reason.cause != Cause::Neighbour => {
                let (cause, probability, why) = (reason.cause, reason.probability, reason.why.clone());
                tasks.push(Task { at, cause, probability, why, victims });
            }
            // The likeliest source of a group that has no cause of its own, in manual or with its largest swing in another
            // group, is a task all the same.
            _ if !victims.is_empty() => {
                let swing = match victims.len() {
                    1 => "1 loop that swings".to_string(),
                    many => format!("{many} loops that swing"),
                };
                let why = format!(
                    "it is the likeliest source of {swing} with it; why it swings itself is not known"
                );
                tasks.push(Task { at, cause: Cause::Unknown, probability: 0.5, why, victims });
            }
            _ => {}
        }
    }
    tasks.sort_by(|a, b| b.worth().total_cmp(&a.worth()));
    tasks
}

/// Of each loop those that may calm down with it.
fn victims(found: &Analysis) -> Vec<Vec<usize>> {
    let mut victims = vec![Vec::new(); found.loops.len()];
    for (at, of) in found.loops.iter().enumerate() {
        if let Some(neighbour) = of.reason.as_ref().and_then(|reason| reason.neighbour) {
            victims[neighbour].push(at);
        }
    }
    victims
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::{LoopFound, Reason};

    #[test]
    fn a_source_has_its_victims_and_they_have_no_task() {
        let of = |cause, neighbour| LoopFound {
            reason: Some(Reason { cause, probability: 0.8, why: String::new(), neighbour }),
            ..LoopFound::default()
        };
        let loops = vec![
            of(Cause::Neighbour, Some(2)),
            LoopFound::default(),
            of(Cause::Valve, None),
            of(Cause::Neighbour, Some(2)),
        ];
        let found = tasks(&Analysis { loops, groups: Vec::new() });
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].at, found[0].victims.as_slice()), (2, &[0, 3][..]));
        // One in manual has no cause of its own.
        let victim = || of(Cause::Neighbour, Some(0));
        for (loops, source) in [
            (vec![LoopFound::default(), victim()], "the likeliest source of 1 loop that swings with it"),
            (
                vec![LoopFound::default(), victim(), victim()],
                "the likeliest source of 2 loops that swing with it",
            ),
        ] {
            let found = tasks(&Analysis { loops, groups: Vec::new() });
            let why = format!("it is {source}; why it swings itself is not known");
            assert_eq!(found.iter().map(|own| (own.at, own.why.as_str())).collect::<Vec<_>>(), [(0, &*why)]);
        }
    }
}
