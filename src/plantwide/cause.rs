//! Why a loop is not at rest: one cause each, with a probability and a sentence.
//!
//! ```text
//! P(cause | x) = exp(w_cause · (x, 1)) / sum over the causes and "at rest" of exp(w · (x, 1))
//! ```
//!
//! x are the loop's own [`super::signs`]; the weights are a multinomial logit fitted on simulated loops (`causes fit`), so that
//! the probability is what such loops say. A loop that is likelier at rest than anything else has no cause. Below 1/2 the cause is
//! `unknown`. A member of a group is its `neighbour`'s victim by the probability that another member is the source, and what is
//! said of the source is weighted by the probability that it is. What a diagnosis said of the valve is one of the signs.

use super::groups::Group;
use super::signs::{SIGNS, Signs};
use super::{Friction, LoopFound, PlantLoop};

/// A cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Cause {
    /// The valve sticks or has a dead band.
    Valve,
    /// The controller is too tight or too slow.
    Tuning,
    /// A load from outside.
    Load,
    /// The measurement.
    Sensor,
    /// Another loop.
    Neighbour,
    /// OP is at a limit.
    Saturation,
    /// It is not known.
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

/// A cause, how likely it is, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Reason {
    /// Which.
    pub cause: Cause,
    /// Probability (0..1).
    pub probability: f64,
    /// One sentence.
    pub why: String,
    /// The loop that is meant by `neighbour`.
    pub neighbour: Option<usize>,
}

/// What a loop's own signs can say; the last is that nothing is wrong with it.
pub const CLASSES: [Option<Cause>; 6] = [
    Some(Cause::Valve),
    Some(Cause::Tuning),
    Some(Cause::Load),
    Some(Cause::Sensor),
    Some(Cause::Saturation),
    None,
];
/// Weights of the signs and of 1, for each of [`CLASSES`].
#[rustfmt::skip]
const WEIGHTS: [[f64; SIGNS + 1]; CLASSES.len()] = [
    [-3.162, -0.004, -1.239, -3.336, -0.902, 9.972, 0.239, -0.010, -2.786, 2.500, -1.156, -3.160, -4.614, -0.818, -2.732], // valve
    [-1.758, -0.001, 6.510, -11.879, 6.202, -13.572, 0.078, 0.069, -1.326, 1.209, -0.781, -5.522, 7.960, 1.880, 7.643], // tuning
    [-11.506, -0.216, 0.378, -11.750, -1.734, 19.813, -0.665, -1.226, 3.352, -0.079, 2.350, -0.538, -3.636, -0.026, -24.657], // load
    [20.330, 0.674, 2.121, 80.797, 0.114, 6.897, 0.366, 0.494, 20.861, -0.013, 0.260, 5.500, -1.853, -2.249, -0.431], // sensor
    [30.896, -0.003, -3.500, -21.258, -0.532, -11.140, -0.218, 0.559, 0.963, -3.045, -1.605, -1.067, 2.802, 0.529, 10.299], // saturation
    [-34.800, -0.449, -4.269, -32.574, -3.149, -11.969, 0.201, 0.113, -21.063, -0.572, 0.932, 4.788, -0.660, 0.684, 9.877], // at rest
];

/// Probability of each of [`CLASSES`], by the signs of a loop.
pub fn probabilities(signs: &Signs) -> [f64; CLASSES.len()] {
    let scores = WEIGHTS.map(|w| w.iter().zip(signs.iter().chain([&1.0])).map(|(w, x)| w * x).sum::<f64>());
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = scores.iter().map(|s| (s - most).exp()).sum();
    scores.map(|s| (s - most).exp() / sum)
}

/// The cause of one loop; none where it is at rest.
pub fn reason(at: usize, plant: &[PlantLoop], found: &[LoopFound], groups: &[Group]) -> Option<Reason> {
    let of = &found[at];
    let group = of.group.map(|g| &groups[g]);
    let is_source = group.and_then(|g| Some(g.suspects.iter().find(|s| s.at == at)?.probability));
    if let (Some(group), Some(own)) = (group, is_source.filter(|own| *own < 0.5)) {
        return Some(shared(at, plant, group, own));
    }
    let own = probabilities(&of.signs);
    let (which, p) = own.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let probability = p * is_source.unwrap_or(1.0);
    match CLASSES[which] {
        None if group.is_none() => None,
        Some(cause) if p >= 0.5 => {
            Some(Reason { cause, probability, why: why(cause, of, &plant[at]), neighbour: None })
        }
        _ => {
            let why = match group {
                Some(_) => {
                    "it is the likeliest source of its group, but its own signals do not say why it swings"
                }
                None => "its own signals do not say why it is not at rest",
            };
            Some(Reason { cause: Cause::Unknown, probability, why: why.into(), neighbour: None })
        }
    }
}

/// What is said of a member of a group that is likelier not its source.
fn shared(at: usize, plant: &[PlantLoop], group: &Group, own: f64) -> Reason {
    let first = group.suspects.first().filter(|s| s.at != at);
    let many = group.members.len();
    let swing = period(group.period_s);
    match first {
        Some(first) => Reason {
            cause: Cause::Neighbour,
            probability: 1.0 - own,
            why: format!(
                "it swings with {} others at {swing} and is expected to calm down when {} does",
                many - 1,
                plant[first.at].name
            ),
            neighbour: Some(first.at),
        },
        None => Reason {
            cause: Cause::Unknown,
            probability: own,
            why: format!(
                "{many} loops swing together at {swing}; no source stands out among them, and this one is the likeliest"
            ),
            neighbour: None,
        },
    }
}

/// A period for people.
pub fn period(s: f64) -> String {
    if s < 120.0 {
        format!("{s:.0} s")
    } else if s < 7200.0 {
        format!("{:.1} min", s / 60.0)
    } else {
        format!("{:.1} h", s / 3600.0)
    }
}

/// In one sentence what speaks for a cause.
fn why(cause: Cause, of: &LoopFound, loop_: &PlantLoop) -> String {
    let (i, signs) = (&of.indicators, &of.signs);
    let swing = of.oscillations.first();
    let at = swing.map_or_else(String::new, |own| format!(" at {}", period(own.period_s)));
    let percent = |x: f64| format!("{:.0} %", 100.0 * x);
    match cause {
        Cause::Valve => match loop_.friction.as_ref().filter(|own: &&Friction| own.sticks) {
            Some(friction) => friction.says.clone(),
            None if i.stuck > 0.05 => {
                format!("PV stands still for {} of the time while OP moves", percent(i.stuck))
            }
            None => format!("it swings{at} as the limit cycle of a valve that sticks does"),
        },
        Cause::Tuning if swing.is_some() => {
            format!(
                "it rings{at} with a height that comes and goes, as a loop does that its controller hardly damps"
            )
        }
        Cause::Tuning => "its error comes and goes slowly, and the controller hardly acts on it".into(),
        Cause::Load if swing.is_some() => {
            format!(
                "it swings{at} steadily, as under a load that swings, and neither the valve nor the tuning explains it"
            )
        }
        Cause::Load => "a load from outside moves it faster than it can follow".into(),
        Cause::Sensor if signs[HELD] > 0.05 => {
            format!("PV does not change at all for {} of the time in one piece", percent(signs[HELD]))
        }
        Cause::Sensor if i.kept.quantisation > 0.1 => {
            format!("PV moves in steps of {:.1} standard deviations", i.kept.quantisation)
        }
        Cause::Sensor => format!("{} of PV's variance is noise", percent(i.kept.noise_share)),
        Cause::Saturation => format!("OP is at a limit for {} of the time", percent(signs[LIMITS])),
        Cause::Neighbour | Cause::Unknown => String::new(),
    }
}

/// Where two of the signs stand.
const LIMITS: usize = 0;
const HELD: usize = 3;
