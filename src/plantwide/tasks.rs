//! The tasks of a plant: one for each loop that has a cause of its own, the source of a group before its victims. They are a list in
//! three parts: what to do first, what to do perhaps, and which loops are not at rest for a cause that is not known.

use super::cause::{STANDS_OUT, with_untold};
use super::{Analysis, Cause, LoopFound, sensor};

/// A part of the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The cause is likely enough to order work by it.
    First,
    /// The cause is less likely, or nothing is gained by removing it.
    Perhaps,
    /// The cause is not known, so that there is nothing to do yet.
    Unknown,
}

/// Probability from which work may be ordered by a cause: below it 3 of 4 causes were right, from it on 9 of 10
/// (`docs/plantwide.md`).
pub const LIKELY: f64 = 0.8;

impl Part {
    /// Every part, in the order of the list.
    pub const ALL: [Part; 3] = [Part::First, Part::Perhaps, Part::Unknown];

    /// The part of a cause with its probability (0..1), which is compared as it is told, in whole per cent. `gains_nothing`: whether nothing is gained by removing it.
    pub fn of(cause: Cause, probability: Option<f64>, gains_nothing: bool) -> Self {
        match cause {
            Cause::Unknown => Part::Unknown,
            _ if !gains_nothing && probability.is_some_and(|p| (100.0 * p).round() >= 100.0 * LIKELY) => {
                Part::First
            }
            _ => Part::Perhaps,
        }
    }

    /// As reports write it.
    pub fn as_str(self) -> &'static str {
        match self {
            Part::First => "first",
            Part::Perhaps => "perhaps",
            Part::Unknown => "unknown",
        }
    }

    /// Its heading.
    pub fn heading(self) -> &'static str {
        match self {
            Part::First => "What to do first",
            Part::Perhaps => "Perhaps",
            Part::Unknown => "Not at rest, cause unknown",
        }
    }

    /// What its loops have in common, below the heading; nothing for the first part.
    pub fn note(self) -> Option<&'static str> {
        match self {
            Part::First => None,
            Part::Perhaps => Some("less likely than 80 %, or nothing to gain: look before you order work"),
            Part::Unknown => Some("nothing to order yet"),
        }
    }
}

/// One task, with the loops that may be calmer when it is done.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    /// Number of the loop to inspect.
    pub at: usize,
    /// Its cause.
    pub cause: Cause,
    /// Probability of the cause (0..1); none for `unknown`.
    pub probability: Option<f64>,
    /// Expected number of loops that are calmer when it is done: the sum of the probabilities that the loop is the source, over itself
    /// and the loops of which it is the likeliest source.
    pub worth: f64,
    /// The sentence that operators read.
    pub why: String,
    /// Whether nothing is gained by removing the cause.
    pub gains_nothing: bool,
    /// The loops that are expected to calm down with it: those of which it is the source with a probability of [`STANDS_OUT`] or more.
    pub victims: Vec<usize>,
}

impl Task {
    /// The part of the list that it belongs to.
    pub fn part(&self) -> Part {
        Part::of(self.cause, self.probability, self.gains_nothing)
    }
}

/// The tasks of a plant, part by part, and in each part the one with the largest worth first; of equals the one with the most probable
/// cause.
pub fn tasks(found: &Analysis) -> Vec<Task> {
    let mut tasks: Vec<Task> = Vec::new();
    for ((at, of), follow) in found.loops.iter().enumerate().zip(followers(found)) {
        let others: f64 = follow.iter().map(|own| own.1).sum();
        let stands_out = |own: &&(usize, f64)| own.1 >= STANDS_OUT;
        let victims: Vec<usize> = follow.iter().filter(stands_out).map(|own| own.0).collect();
        match &of.reason {
            Some(reason) if reason.cause != Cause::Neighbour => {
                let (cause, probability, why) = (reason.cause, reason.probability, reason.why.clone());
                let (worth, gains_nothing) = (reason.source + others, gains_nothing(cause, of));
                tasks.push(Task { at, cause, probability, worth, why, gains_nothing, victims });
            }
            // The likeliest source of one group may have its largest oscillation in another group, with the cause `neighbour` there.
            reason if !follow.is_empty() => {
                let first = reason.as_ref().and_then(|reason| reason.neighbour);
                let why =
                    why_in_another_group(follow.len(), first.map(|first| found.loops[first].name.as_str()));
                let why = with_untold(why, of);
                tasks.push(Task {
                    at,
                    cause: Cause::Unknown,
                    probability: None,
                    worth: others,
                    why,
                    gains_nothing: false,
                    victims,
                });
            }
            _ => {}
        }
    }
    let sure = |task: &Task| task.probability.unwrap_or(-1.0);
    let by_worth = |a: &Task, b: &Task| b.worth.total_cmp(&a.worth).then(sure(b).total_cmp(&sure(a)));
    tasks.sort_by(|a, b| a.part().cmp(&b.part()).then_with(|| by_worth(a, b)));
    tasks
}

/// Whether nothing is gained by removing a loop's cause: PV's noise and steps that the valve does not follow, and the tuning of a loop
/// whose error is as small as any tuning makes it.
fn gains_nothing(cause: Cause, of: &LoopFound) -> bool {
    match cause {
        Cause::Sensor => sensor::costs_nothing(of),
        Cause::Tuning => of.indicators.is_at_minimum(),
        _ => false,
    }
}

/// The sentence for a loop that is the likeliest source of `many` others, and whose own largest oscillation is another one. `first`: the
/// likeliest source of that other oscillation.
fn why_in_another_group(many: usize, first: Option<&str>) -> String {
    let swing = match many {
        1 => "1 loop that swings".to_string(),
        many => format!("{many} loops that swing"),
    };
    let own = first.map_or_else(
        || "why it swings itself is not known".to_string(),
        |first| format!("its own largest swing is another one, of which {first} is the likeliest source"),
    );
    format!("it is the likeliest source of {swing} with it; {own}")
}

/// For each loop the loops of which it is the likeliest source, each with the probability that it is.
fn followers(found: &Analysis) -> Vec<Vec<(usize, f64)>> {
    let mut followers = vec![Vec::new(); found.loops.len()];
    for (at, of) in found.loops.iter().enumerate() {
        let Some(reason) = &of.reason else { continue };
        if let Some(neighbour) = reason.neighbour {
            followers[neighbour].push((at, reason.source));
        }
    }
    followers
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::indicators::harris::Harris;
    use crate::indicators::noise::Spread;
    use crate::plantwide::Reason;

    /// A loop with a cause of its own, or with a neighbour, and how likely that or the loop itself is the source.
    fn of(cause: Cause, probability: Option<f64>, source: f64, neighbour: Option<usize>) -> LoopFound {
        let reason = Some(Reason { cause, probability, source, why: String::new(), neighbour });
        LoopFound { reason, ..LoopFound::default() }
    }

    fn of_plant(loops: Vec<LoopFound>) -> Vec<Task> {
        tasks(&Analysis { loops, groups: Vec::new() })
    }

    #[test]
    fn a_source_has_its_victims_and_they_have_no_task() {
        let victim = |source| of(Cause::Neighbour, Some(0.9), source, Some(2));
        let found = of_plant(vec![
            victim(0.8),
            LoopFound::default(),
            of(Cause::Valve, Some(0.7), 0.8, None),
            victim(0.8),
        ]);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].at, found[0].victims.as_slice()), (2, &[0, 3][..]));
        // The loop and two others, by how likely it is the source and not by how sure its cause is.
        assert!((found[0].worth - 2.4).abs() < 1e-12, "{}", found[0].worth);
    }

    #[test]
    fn nobody_is_expected_to_calm_down_with_a_source_that_does_not_stand_out() {
        let with = |source| {
            let victim = of(Cause::Neighbour, Some(1.0 - source), source, Some(0));
            let found = of_plant(vec![of(Cause::Unknown, None, source, None), victim]);
            assert_eq!(found.len(), 1);
            assert!((found[0].worth - 2.0 * source).abs() < 1e-12);
            found[0].victims.clone()
        };
        assert_eq!((with(0.2), with(0.49), with(0.5)), (vec![], vec![], vec![1]));
    }

    #[test]
    fn a_source_whose_own_largest_swing_is_another_one_is_a_task_all_the_same() {
        // The first swings most with the second, and is the likeliest source of others.
        let named = |name: &str, own: LoopFound| LoopFound { name: name.into(), ..own };
        let plant = |victims: usize| {
            let mut loops = vec![
                named("A", of(Cause::Neighbour, Some(0.9), 0.9, Some(1))),
                named("B", of(Cause::Valve, Some(0.8), 0.9, None)),
            ];
            loops.extend((0..victims).map(|_| of(Cause::Neighbour, Some(0.7), 0.6, Some(0))));
            of_plant(loops)
        };
        for (victims, swing) in [(1, "1 loop that swings"), (2, "2 loops that swing")] {
            let found = plant(victims);
            let own = found.iter().find(|task| task.at == 0).expect("a task");
            let why = format!(
                "it is the likeliest source of {swing} with it; its own largest swing is another one, of which B is the likeliest source"
            );
            assert_eq!((own.why.as_str(), own.probability, own.victims.len()), (why.as_str(), None, victims));
        }
    }

    #[test]
    fn work_is_for_likely_causes_and_a_cause_that_is_not_known_is_none() {
        let found = of_plant(vec![
            of(Cause::Unknown, None, 3.0, None),
            of(Cause::Valve, Some(0.79), 2.0, None),
            of(Cause::Load, Some(0.8), 1.0, None),
        ]);
        let parts: Vec<(usize, Part)> = found.iter().map(|task| (task.at, task.part())).collect();
        assert_eq!(
            parts,
            [(2, Part::First), (1, Part::Perhaps), (0, Part::Unknown)],
            "whatever they are worth"
        );
    }

    #[test]
    fn what_gains_nothing_is_done_perhaps() {
        let part = |own: LoopFound| of_plant(vec![own]).first().map(Task::part);
        let noisy = |sd: f64| {
            let mut own = of(Cause::Sensor, Some(0.99), 1.0, None);
            own.indicators.kept.noise_share = 1.0;
            LoopFound { op_spread: Some(Spread { sd, noise: sd, finest: sd }), ..own }
        };
        assert_eq!([0.1, 3.0].map(|sd| part(noisy(sd))), [Some(Part::Perhaps), Some(Part::First)]);
        let tuned = |low: f64| {
            let mut own = of(Cause::Tuning, Some(0.99), 1.0, None);
            own.indicators.harris = Some(Harris { index: 0.97, interval: Some((low, 1.0)) });
            own
        };
        assert_eq!([0.95, 0.5].map(|low| part(tuned(low))), [Some(Part::Perhaps), Some(Part::First)]);
    }

    #[test]
    fn an_unknown_cause_is_not_before_a_known_one_of_the_same_worth() {
        let found = of_plant(vec![
            of(Cause::Unknown, None, 1.0, None),
            of(Cause::Valve, Some(0.6), 1.0, None),
            of(Cause::Tuning, Some(0.9), 1.0, None),
        ]);
        assert_eq!(found.iter().map(|task| task.at).collect::<Vec<_>>(), [2, 1, 0]);
    }
}
