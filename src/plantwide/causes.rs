//! The probability of every cause of a loop, of which [`super::cause`] names one.
//!
//! ```text
//! P(neighbour) = 1 - s
//! P(cause)     = s P(cause | x)          of every other cause, and of "at rest"
//! ```
//!
//! s: probability that the loop is the source of its group, 1 in no group; P(cause | x): by the features of the loop. Where a diagnosis has
//! found that the valve sticks, its probability is P(valve | x), and the others share the rest as the features have it (Jeffrey's rule).
//! The sum is 1.
//!
//! The cause that is named has the probability that it has here. `unknown` has none.

use super::LoopFound;
use super::cause::{CLASSES, Cause, VALVE, classes, is_judged, source_of};
use super::groups::Group;

/// A cause with its probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likely {
    /// The cause; none for "at rest".
    pub cause: Option<Cause>,
    /// Its probability (0..1).
    pub probability: f64,
}

impl Likely {
    /// As reports write it.
    pub fn as_str(&self) -> &'static str {
        self.cause.map_or("at_rest", Cause::as_str)
    }
}

/// The probability of every cause of a loop and of rest, the largest first; empty where the loop cannot be judged or a feature of it is
/// not known. `at`: its number in `found`.
pub fn causes(at: usize, found: &[LoopFound], groups: &[Group]) -> Vec<Likely> {
    let of = &found[at];
    if !is_judged(of) {
        return Vec::new();
    }
    let source = source_of(at, of.group.map(|g| &groups[g]));
    let own = CLASSES.into_iter().zip(by_diagnosis(of));
    let own = own.map(|(cause, p)| Likely { cause, probability: source * p });
    let neighbour = Likely { cause: Some(Cause::Neighbour), probability: 1.0 - source };
    let mut all: Vec<Likely> = own.chain([neighbour]).collect();
    if all.iter().any(|own| own.probability.is_nan()) {
        return Vec::new();
    }
    all.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    all
}

/// Probability of each of [`CLASSES`], by the features and a diagnosis of the valve, where there was one.
fn by_diagnosis(of: &LoopFound) -> [f64; CLASSES.len()] {
    let mut all = classes(of);
    if let Some(friction) = of.friction.as_ref().filter(|own| own.sticks) {
        all[VALVE] = 0.0;
        let others: f64 = all.iter().sum();
        all = all.map(|p| p * (1.0 - friction.probability) / others.max(f64::MIN_POSITIVE));
        all[VALVE] = friction.probability;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::indicators::Indicators;
    use crate::plantwide::cause::{probabilities, reason};
    use crate::plantwide::{Friction, Suspect};

    /// A loop that can be judged.
    fn measured() -> LoopFound {
        let indicators = Indicators { measured: true, ..Indicators::default() };
        LoopFound { indicators, ..LoopFound::default() }
    }

    fn friction(sticks: bool) -> Option<Friction> {
        let says = "The valve sticks by 3 %".into();
        Some(Friction { sticks, probability: 0.9, says, ..Friction::default() })
    }

    /// The first of a group of two, which is its source with this probability.
    fn member(of: &LoopFound, source: f64) -> ([LoopFound; 2], [Group; 1]) {
        let of = LoopFound { group: Some(0), ..of.clone() };
        let mut suspects = vec![
            Suspect { at: 0, probability: source, ..Suspect::default() },
            Suspect { at: 1, probability: 1.0 - source, ..Suspect::default() },
        ];
        suspects.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        ([of.clone(), of], [Group { members: vec![0, 1], suspects, ..Group::default() }])
    }

    fn of(all: &[Likely], cause: Option<Cause>) -> f64 {
        all.iter().find(|own| own.cause == cause).expect("every cause").probability
    }

    #[test]
    fn every_cause_has_a_probability_and_the_one_that_is_named_has_the_same() {
        let mut plants: Vec<(Vec<LoopFound>, Vec<Group>)> = Vec::new();
        for friction in [None, friction(true), friction(false)] {
            let mut alone = LoopFound { friction, ..measured() };
            // A PV that stands still is the sensor's.
            alone.signs[3] = 0.5;
            plants.push((vec![alone.clone()], Vec::new()));
            for source in [0.2, 0.6, 0.95] {
                let (found, groups) = member(&alone, source);
                plants.push((found.to_vec(), groups.to_vec()));
            }
        }
        for (found, groups) in plants {
            let all = causes(0, &found, &groups);
            assert!((all.iter().map(|own| own.probability).sum::<f64>() - 1.0).abs() < 1e-12, "{all:?}");
            assert!(all.windows(2).all(|two| two[0].probability >= two[1].probability), "{all:?}");
            let mut names: Vec<&str> = all.iter().map(Likely::as_str).collect();
            names.sort_unstable();
            assert_eq!(names, ["at_rest", "load", "neighbour", "saturation", "sensor", "tuning", "valve"]);
            let named = reason(0, &found, &groups).expect("a cause");
            let p = named.probability.expect("a known cause");
            assert!((of(&all, Some(named.cause)) - p).abs() < 1e-12, "{named:?} {all:?}");
        }
    }

    #[test]
    fn a_diagnosis_leaves_the_other_causes_their_proportions() {
        let signs = measured().signs;
        let by_signs = probabilities(&signs);
        let ratio = |all: &[Likely]| of(all, Some(Cause::Load)) / of(all, None);
        let expected = by_signs[2] / by_signs[5];
        for (friction, valve) in [(friction(true), 0.9), (friction(false), 0.0)] {
            let all = causes(0, &[LoopFound { friction, ..measured() }], &[]);
            assert!((of(&all, Some(Cause::Valve)) - valve).abs() < 1e-12, "{all:?}");
            assert!((ratio(&all) / expected - 1.0).abs() < 1e-9, "{all:?}");
            assert_eq!(of(&all, Some(Cause::Neighbour)), 0.0);
        }
    }

    #[test]
    fn what_cannot_be_judged_has_no_causes() {
        let mut of = measured();
        of.indicators.service_factor = Some(0.4);
        assert!(causes(0, &[of], &[]).is_empty());
        assert!(causes(0, &[LoopFound::default()], &[]).is_empty());
    }
}
