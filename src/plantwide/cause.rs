//! The cause why a loop is not at rest: one for each loop, with a probability and the sentence that operators read.
//!
//! ```text
//! P(cause | x) = exp(w_cause · (x, 1)) / sum over the causes and "at rest" of exp(w · (x, 1))
//! ```
//!
//! x: the features of the loop ([`super::signs`]); w: weights of a multinomial logit, fitted on simulated loops (`causes fit`).
//!
//! - A loop in no group has the likeliest cause; none where "at rest" is the likeliest. Where that cause has a probability below 1/2, the
//!   cause is `unknown`, which has no probability.
//! - A loop in a group has the cause `neighbour` where another member is likelier the source, with the probability that it is not the
//!   source itself. The likeliest source has its own cause where it is the source with a probability of 1/2 or more, and `unknown`
//!   otherwise. The probability of its own cause is multiplied by that of being the source, so that it is at least 1/4.
//! - A diagnosis of the valve comes before the features. A valve that sticks is the cause, unless another member is likelier the source
//!   of the group; a sound valve is never the cause.
//! - A loop that cannot be judged ([`is_judged`]) has no cause.
//! - The sentence of `unknown` says why a diagnosis of the valve had no result, where there was one.

use super::groups::Group;
use super::signs::{SIGNS, Signs};
use super::{LoopFound, sensor, tuning};
use crate::signal::share;

/// A cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Cause {
    /// The valve sticks or has a dead band.
    Valve,
    /// The controller is tuned too tightly or too slowly.
    Tuning,
    /// A load from outside.
    Load,
    /// The measurement of PV.
    Sensor,
    /// Another loop.
    Neighbour,
    /// OP is at a limit.
    Saturation,
    /// The cause is not known.
    Unknown,
}

impl Cause {
    /// Every cause.
    pub const ALL: [Cause; 7] = [
        Cause::Valve,
        Cause::Tuning,
        Cause::Load,
        Cause::Sensor,
        Cause::Neighbour,
        Cause::Saturation,
        Cause::Unknown,
    ];

    /// As reports write it.
    pub fn as_str(self) -> &'static str {
        match self {
            Cause::Valve => "valve",
            Cause::Tuning => "tuning",
            Cause::Load => "load",
            Cause::Sensor => "sensor",
            Cause::Neighbour => "neighbour",
            Cause::Saturation => "saturation",
            Cause::Unknown => "unknown",
        }
    }
}

/// The cause of one loop, with its probability and its sentence.
#[derive(Clone, Debug, PartialEq)]
pub struct Reason {
    /// The cause.
    pub cause: Cause,
    /// Probability of the cause (0..1); none for `unknown`.
    pub probability: Option<f64>,
    /// Probability that the neighbour, or without one this loop, is the source of the group (0..1); 1 for a loop in no group.
    pub source: f64,
    /// The sentence that operators read.
    pub why: String,
    /// The likeliest source of the group, for the cause `neighbour`.
    pub neighbour: Option<usize>,
}

/// The classes that the signs of a loop distinguish; the last one is "at rest".
pub const CLASSES: [Option<Cause>; 6] = [
    Some(Cause::Valve),
    Some(Cause::Tuning),
    Some(Cause::Load),
    Some(Cause::Sensor),
    Some(Cause::Saturation),
    None,
];
/// Position of the valve among them.
pub(super) const VALVE: usize = 0;
/// Weights of the signs and of 1, for each of [`CLASSES`].
#[rustfmt::skip]
const WEIGHTS: [[f64; SIGNS + 1]; CLASSES.len()] = [
    [-16.726, -0.002, -0.740, -2.631, -0.398, 11.348, 0.252, 0.012, -3.920, 2.018, -0.871, -3.225, -4.178, -0.900, -4.278], // valve
    [-7.227, -0.001, 3.754, -18.814, 6.036, -12.059, -0.087, 0.164, -2.531, -0.651, -3.012, -3.667, 6.303, 1.041, 9.933], // tuning
    [-15.857, -0.225, 0.463, -7.533, -1.554, 20.334, -0.570, -1.198, 2.504, -0.244, 2.763, 0.743, -4.874, -0.274, -25.105], // load
    [20.550, 0.669, 5.053, 67.417, 0.326, 7.524, 0.065, 0.713, 25.799, -0.047, 1.759, 4.550, -0.506, -0.504, -1.992], // sensor
    [47.145, -0.001, -6.760, -15.008, -0.914, -13.523, -0.196, 0.344, 0.142, -0.333, -2.604, -1.792, 4.009, 0.456, 10.589], // saturation
    [-27.885, -0.440, -1.770, -23.431, -3.496, -13.624, 0.536, -0.035, -21.995, -0.742, 1.966, 3.390, -0.754, 0.181, 10.854], // at rest
];

/// Probability of each of [`CLASSES`], by the signs of a loop.
pub fn probabilities(signs: &Signs) -> [f64; CLASSES.len()] {
    let scores = WEIGHTS.map(|w| w.iter().zip(signs.iter().chain([&1.0])).map(|(w, x)| w * x).sum::<f64>());
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = scores.iter().map(|s| (s - most).exp()).sum();
    scores.map(|s| (s - most).exp() / sum)
}

/// Whether a loop can be judged: good samples over half of the time, and in manual for at most half of it.
///
/// Any other loop is no suspect and has no cause. In manual a loop has no limit cycle and its valve is not tested, and values that are
/// interpolated across gaps were not measured.
pub fn is_judged(of: &LoopFound) -> bool {
    let in_manual = of.indicators.service_factor.is_some_and(|share| share < IN_MANUAL);
    of.indicators.measured && !in_manual
}

/// The cause of one loop; none where the loop is at rest, or cannot be judged. `at`: its number in `found`.
pub fn reason(at: usize, found: &[LoopFound], groups: &[Group]) -> Option<Reason> {
    let of = &found[at];
    if !is_judged(of) {
        return None;
    }
    let group = of.group.map(|g| &groups[g]);
    let is_source = source_of(at, group);
    let shared =
        group.filter(|_| is_source < STANDS_OUT).and_then(|group| shared(at, found, group, is_source));
    match (shared, of.friction.as_ref().filter(|own| own.sticks)) {
        (Some(shared), None) => Some(shared),
        (Some(shared), Some(_)) if shared.cause == Cause::Neighbour => Some(shared),
        (_, Some(friction)) => Some(Reason {
            cause: Cause::Valve,
            probability: Some(friction.probability * is_source),
            source: is_source,
            why: friction.says.clone(),
            neighbour: None,
        }),
        (None, None) => by_signs(of, group.is_some(), is_source),
    }
}

/// Probability that a loop is the source of its group: 1 in no group, 0 for a member that is no suspect.
pub(super) fn source_of(at: usize, group: Option<&Group>) -> f64 {
    let suspect = |group: &Group| group.suspects.iter().find(|s| s.at == at).map_or(0.0, |s| s.probability);
    group.map_or(1.0, suspect)
}

/// The cause by the signs of a loop; none where it is in no group and at rest.
fn by_signs(of: &LoopFound, is_member: bool, is_source: f64) -> Option<Reason> {
    let (which, p) = classes(of).into_iter().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let own = |cause: Cause, probability: Option<f64>, why: String| {
        Some(Reason { cause, probability, source: is_source, why, neighbour: None })
    };
    match CLASSES[which] {
        None if !is_member => None,
        Some(cause) if p >= 0.5 => own(cause, Some(p * is_source), why(cause, of)),
        _ => {
            let why = if is_member {
                "it is the likeliest source of its group, but its own signals do not say why it swings"
            } else {
                "its own signals do not say why it is not at rest"
            };
            own(Cause::Unknown, None, with_untold(why.into(), of))
        }
    }
}

/// A sentence for `unknown`, and behind it what a diagnosis of the valve lacked.
pub(super) fn with_untold(why: String, of: &LoopFound) -> String {
    match &of.untold {
        Some(untold) => format!("{why}; its valve could not be judged: {}", untold.says),
        None => why,
    }
}

/// Probability of each of [`CLASSES`], without the valve where a diagnosis has found it sound.
pub(super) fn classes(of: &LoopFound) -> [f64; CLASSES.len()] {
    let mut all = probabilities(&of.signs);
    if of.friction.as_ref().is_some_and(|own| !own.sticks) {
        all[VALVE] = 0.0;
        let sum: f64 = all.iter().sum();
        all = all.map(|p| p / sum.max(f64::MIN_POSITIVE));
    }
    all
}

/// The cause of a member of a group that is likelier not the source; none where the group has no suspect. `own`: probability that this
/// member is the source.
fn shared(at: usize, found: &[LoopFound], group: &Group, own: f64) -> Option<Reason> {
    let first = group.suspects.first()?;
    let many = group.members.len();
    let swing = period(group.period_s);
    if first.at == at {
        let why = format!(
            "{many} loops swing together with a period of {swing}; no source stands out among them, and this one is the likeliest"
        );
        let why = with_untold(why, &found[at]);
        return Some(Reason { cause: Cause::Unknown, probability: None, source: own, why, neighbour: None });
    }
    let (source, others) = (&found[first.at].name, others(many.saturating_sub(1)));
    let swings = format!("it swings with {others} at a period of {swing}");
    let why = if first.probability >= STANDS_OUT {
        format!("{swings} and is expected to calm down when {source} does")
    } else {
        format!("{swings}; no source stands out among them, and {source} is the likeliest")
    };
    Some(Reason {
        cause: Cause::Neighbour,
        probability: Some(1.0 - own),
        source: first.probability,
        why,
        neighbour: Some(first.at),
    })
}

/// A number of other loops in words.
fn others(many: usize) -> String {
    if many == 1 { "1 other".into() } else { format!("{many} others") }
}

/// A period (s) in words.
pub fn period(s: f64) -> String {
    if s < 120.0 {
        format!("{s:.0} s")
    } else if s < 7200.0 {
        format!("{:.1} min", s / 60.0)
    } else {
        format!("{:.1} h", s / 3600.0)
    }
}

/// The evidence for a cause in one sentence.
fn why(cause: Cause, of: &LoopFound) -> String {
    let (i, signs) = (&of.indicators, &of.signs);
    let swing = of.oscillations.first().map(|own| format!("with a period of {}", period(own.period_s)));
    let percent = |part: f64| share(part, 0);
    let stands = i.stuck.filter(|share| *share > 0.05);
    match (cause, swing) {
        (Cause::Valve, swing) => match (stands, swing) {
            (Some(share), _) => format!(
                "PV stands still for {} of the time while OP moves, as behind a valve that sticks: test the valve with small steps of OP before anything is repaired",
                percent(share)
            ),
            (None, Some(swing)) => format!(
                "it swings {swing}, as a loop does whose valve sticks: test the valve with small steps of OP before anything is repaired"
            ),
            (None, None) => {
                "it moves as a loop does whose valve sticks: test the valve with small steps of OP before anything is repaired".into()
            }
        },
        (Cause::Tuning, _) => tuning::why(of),
        (Cause::Load, Some(swing)) => format!(
            "it swings steadily {swing}, and neither the valve nor the tuning explains it, but a load that swings would: look for a \
             machine or a loop that swings with the same period"
        ),
        (Cause::Load, None) => {
            "PV moves as under a load that is too fast for the loop: look upstream for what disturbs it"
                .into()
        }
        (Cause::Sensor, _) => sensor::why(of),
        (Cause::Saturation, _) if i.at_limits.is_some_and(|share| share >= signs[LIMITS]) => format!(
            "OP is at a limit for {} of the time, and PV is not controlled meanwhile: check whether the set point can be reached, and \
             the limits",
            percent(signs[LIMITS])
        ),
        // The limit is not configured: it is inferred from how OP stops there.
        (Cause::Saturation, _) => format!(
            "OP stops again and again at its largest or least value, {} of the time, as at a limit, and PV is not controlled meanwhile: \
             check the controller's limits",
            percent(signs[LIMITS])
        ),
        (Cause::Neighbour | Cause::Unknown, _) => String::new(),
    }
}

/// Probability from which a source stands out: it is likelier than all other suspects together.
pub const STANDS_OUT: f64 = 0.5;
/// Share of the time in automatic below which a loop cannot be judged.
const IN_MANUAL: f64 = 0.5;
/// Position of the sign *limits*.
const LIMITS: usize = 0;

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::indicators::Indicators;
    use crate::indicators::harris::Harris;
    use crate::indicators::oscillation::Oscillation;
    use crate::plantwide::signs::HELD;
    use crate::plantwide::{Friction, Suspect, Untold};
    use std::slice;

    /// A loop of which there was enough to measure.
    fn measured() -> LoopFound {
        let indicators = Indicators { measured: true, ..Indicators::default() };
        LoopFound { indicators, ..LoopFound::default() }
    }

    fn said(sticks: bool) -> Option<Friction> {
        let says = "The valve sticks by 3 %".into();
        Some(Friction { sticks, probability: 0.9, says, ..Friction::default() })
    }

    /// Signs of which one alone is not zero.
    fn only(sign: usize, x: f64) -> Signs {
        let mut signs = [0.0; SIGNS];
        signs[sign] = x;
        signs
    }

    fn suspect(at: usize, probability: f64) -> Suspect {
        Suspect { at, probability, ..Suspect::default() }
    }

    #[test]
    fn a_diagnosis_goes_before_the_shape_of_pv() {
        // PV that stands still: without a diagnosis it is the sensor.
        let mut of = LoopFound { signs: only(HELD, 0.5), ..measured() };
        assert_eq!(reason(0, &[of.clone()], &[]).map(|own| own.cause), Some(Cause::Sensor));
        of.friction = said(true);
        let valve = reason(0, &[of], &[]).expect("a cause");
        assert_eq!((valve.cause, valve.probability, valve.source), (Cause::Valve, Some(0.9), 1.0));
        assert_eq!(valve.why, "The valve sticks by 3 %");
    }

    #[test]
    fn a_sound_valve_is_not_the_cause() {
        // Where largest oscillation and its steadiness stand.
        const SWING: usize = 4;
        const STEADY: usize = 5;
        let mut of = LoopFound { signs: only(SWING, 1.0), ..measured() };
        of.signs[STEADY] = 1.0;
        of.friction = said(false);
        let all = classes(&of);
        assert!(all[VALVE] == 0.0 && (all.iter().sum::<f64>() - 1.0).abs() < 1e-12, "{all:?}");
        assert!(probabilities(&of.signs)[VALVE] > 0.0);
        assert_ne!(reason(0, &[of], &[]).map(|own| own.cause), Some(Cause::Valve));
    }

    #[test]
    fn a_valve_that_sticks_may_swing_with_a_neighbour() {
        let mut of = LoopFound { group: Some(0), friction: said(true), ..measured() };
        let group = |first, second| Group {
            members: vec![0, 1],
            suspects: vec![suspect(first, 0.6), suspect(second, 0.4)],
            ..Group::default()
        };
        let of_two = |of: &LoopFound, group: Group| reason(0, &[of.clone(), of.clone()], &[group]);
        let source = of_two(&of, group(0, 1)).expect("a cause");
        assert_eq!(source.cause, Cause::Valve);
        assert!(source.probability.is_some_and(|p| (p - 0.54).abs() < 1e-12), "{source:?}");
        assert_eq!(of_two(&of, group(1, 0)).and_then(|own| own.neighbour), Some(1));
        // Who is the likeliest of many, but not likely, has a valve that sticks all the same.
        let unsure = Group { suspects: vec![suspect(0, 0.4), suspect(1, 0.3)], ..group(0, 1) };
        assert_eq!(of_two(&of, unsure.clone()).map(|own| own.cause), Some(Cause::Valve));
        of.friction = None;
        // Of no cause there is nothing to be sure of, but how likely it is the source is known.
        let unknown = of_two(&of, unsure).expect("it swings");
        assert_eq!((unknown.cause, unknown.probability, unknown.source), (Cause::Unknown, None, 0.4));
    }

    #[test]
    fn of_a_loop_that_cannot_be_judged_nothing_is_said() {
        let mut of = LoopFound { signs: only(HELD, 0.5), friction: said(true), ..measured() };
        assert!(is_judged(&of) && reason(0, &[of.clone()], &[]).is_some());
        of.indicators.service_factor = Some(0.4);
        assert!(!is_judged(&of) && reason(0, &[of.clone()], &[]).is_none(), "in manual");
        of.indicators = Indicators { service_factor: Some(1.0), ..Indicators::default() };
        assert!(!is_judged(&of) && reason(0, &[of], &[]).is_none(), "mostly gaps");
    }

    #[test]
    fn what_its_own_signals_do_not_say_has_no_probability() {
        // By its signs it is likelier at rest than anything else, and the likeliest source of a group all the same.
        let of = LoopFound { group: Some(0), ..measured() };
        let group = Group { members: vec![0, 1], suspects: vec![suspect(0, 0.8)], ..Group::default() };
        let all = probabilities(&of.signs);
        assert!(all[..CLASSES.len() - 1].iter().all(|p| *p < all[CLASSES.len() - 1]), "{all:?}");
        let told = reason(0, &[of], &[group]).expect("a member");
        assert_eq!((told.cause, told.probability, told.source), (Cause::Unknown, None, 0.8));
    }

    #[test]
    fn an_unknown_cause_says_what_a_diagnosis_of_the_valve_lacked() {
        let says = "sampled too slowly: 2.2 samples per period".to_string();
        let untold = Some(Untold { code: "undersampled".into(), says });
        let of = LoopFound { group: Some(0), untold, ..measured() };
        let lacked = "; its valve could not be judged: sampled too slowly: 2.2 samples per period";
        for p in [0.8, 0.3] {
            let group = Group { members: vec![0, 1], suspects: vec![suspect(0, p)], ..Group::default() };
            let why = |of: &LoopFound| {
                reason(0, slice::from_ref(of), slice::from_ref(&group)).expect("a member").why
            };
            let without = why(&LoopFound { untold: None, ..of.clone() });
            assert_eq!(why(&of), format!("{without}{lacked}"), "{p}");
        }
        // Another cause stands without the valve.
        let of = LoopFound { signs: only(HELD, 0.5), group: None, ..of };
        assert!(
            reason(0, &[of], &[]).is_some_and(|own| own.cause == Cause::Sensor && !own.why.contains("valve"))
        );
    }

    #[test]
    fn who_is_not_ranked_is_a_neighbour() {
        let of = LoopFound { group: Some(0), signs: only(HELD, 0.5), ..measured() };
        let group = Group { members: vec![1, 0], suspects: vec![suspect(1, 0.9)], ..Group::default() };
        let told = reason(0, &[of.clone(), of], &[group]).expect("a cause");
        assert_eq!((told.cause, told.neighbour), (Cause::Neighbour, Some(1)));
        assert_eq!((told.probability, told.source), (Some(1.0), 0.9));
    }

    #[test]
    fn a_valve_is_said_to_stand_still_where_that_is_known() {
        let mut of = LoopFound::default();
        assert_eq!(
            why(Cause::Valve, &of),
            "it moves as a loop does whose valve sticks: test the valve with small steps of OP before anything is repaired"
        );
        of.indicators.stuck = Some(0.2);
        assert_eq!(
            why(Cause::Valve, &of),
            "PV stands still for 20 % of the time while OP moves, as behind a valve that sticks: test the valve with small steps of OP before anything is repaired"
        );
    }

    /// A swing with a period of a minute.
    pub(in crate::plantwide) fn swing() -> Oscillation {
        Oscillation {
            period_s: 60.0,
            regularity: 2.0,
            lasting: 1.0,
            share: 0.8,
            share_of_fast: 0.8,
            steadiness: 0.9,
            periods: 20.0,
            amplitude: 1.0,
        }
    }

    #[test]
    fn a_swing_is_said_where_there_is_one() {
        let still = LoopFound::default();
        let of = LoopFound { oscillations: vec![swing()], ..LoopFound::default() };
        for (cause, swings, is_still) in [
            (
                Cause::Valve,
                "it swings with a period of 60 s, as a loop does whose valve sticks: test the valve with small steps of OP before anything is repaired",
                "it moves as a loop does whose valve sticks: test the valve with small steps of OP before anything is repaired",
            ),
            (
                Cause::Load,
                "it swings steadily with a period of 60 s, and neither the valve nor the tuning explains it, but a load that swings would: look for a machine or a loop that swings with the same period",
                "PV moves as under a load that is too fast for the loop: look upstream for what disturbs it",
            ),
        ] {
            assert_eq!((why(cause, &of).as_str(), why(cause, &still).as_str()), (swings, is_still));
        }
    }

    #[test]
    fn a_loop_at_its_minimum_variance_is_not_to_be_tuned() {
        let mut of = LoopFound::default();
        let usual = why(Cause::Tuning, &of);
        of.indicators.harris = Some(Harris { index: 0.97, interval: Some((0.95, 1.0)) });
        let said = why(Cause::Tuning, &of);
        assert!(said != usual && said.ends_with("leave the tuning as it is"), "{said}");
    }

    #[test]
    fn a_loop_is_expected_to_calm_down_with_a_source_that_stands_out_alone() {
        let of = |name: &str| LoopFound { name: name.into(), group: Some(0), ..measured() };
        let told = |first: f64, members: Vec<usize>| {
            let suspects = vec![suspect(1, first), suspect(0, 0.3)];
            let group = Group { period_s: 60.0, members, suspects, ..Group::default() };
            reason(0, &[of("A"), of("B"), of("C")], &[group]).expect("a cause").why
        };
        assert_eq!(
            told(0.5, vec![0, 1]),
            "it swings with 1 other at a period of 60 s and is expected to calm down when B does"
        );
        assert_eq!(
            told(0.4, vec![0, 1, 2]),
            "it swings with 2 others at a period of 60 s; no source stands out among them, and B is the likeliest"
        );
    }

    #[test]
    fn a_limit_is_called_one_where_it_is_known() {
        let mut of = LoopFound { signs: only(LIMITS, 0.4), ..LoopFound::default() };
        let stops = "OP stops again and again at its largest or least value, 40 % of the time, as at a limit, and PV is not \
                     controlled meanwhile: check the controller's limits";
        assert_eq!(why(Cause::Saturation, &of), stops);
        of.indicators.at_limits = Some(0.4);
        let at = "OP is at a limit for 40 % of the time, and PV is not controlled meanwhile: check whether the set point can be reached, \
                  and the limits";
        assert_eq!(why(Cause::Saturation, &of), at);
    }
}
