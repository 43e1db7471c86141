//! Why a loop is not at rest: one cause each, with a probability and a sentence.
//!
//! A loop whose oscillation is a group's is its `neighbour`'s victim by the probability that another member is the source; for
//! what is left, and for a loop alone, the signs of the loop itself decide:
//!
//! | cause | sign |
//! |---|---|
//! | `saturation` | OP is at a limit of its output for more than a fifth of the time |
//! | `sensor` | PV moves in steps of more than 0.3 of its standard deviations |
//! | `valve` | it swings, and a diagnosis says that the valve sticks; without a diagnosis, PV has corners (harmonics of 1.5 % of the swing's power and more) or stands still while OP moves |
//! | `tuning` | it swings with a height that comes and goes, as noise in a loop that hardly damps it |
//! | `load` | it swings steadily and as a sine |
//! | `unknown` | none of these by enough |
//!
//! The scores are turned into probabilities by a softmax; `unknown` has a score of its own, so that a loop with little evidence
//! is said to be unknown rather than given the best of bad names. They are rules: what they are worth is in `docs/plantwide.md`.

use super::groups::Group;
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

/// Share of the time at a limit that is a cause.
const AT_LIMIT: f64 = 0.2;
/// Steps of PV in standard deviations that are a cause.
const COARSE: f64 = 0.3;
/// Harmonics of PV, as a share of the swing's power, of a wave with corners, and of a sine: a triangle has 1.4 %.
const CORNERS: f64 = 0.015;
const SINE: f64 = 0.005;
/// Steadiness of a swing whose height comes and goes: that of a sine is 1, that of noise 0.67.
const STEADY: f64 = 0.9;
/// Share of the time in which PV stands still while OP moves.
const STUCK: f64 = 0.1;
/// The most that a diagnosis of friction counts: its model may be wrong.
const SURE: f64 = 0.95;
/// Share of the variance in the swing below which a loop is at rest.
const AT_REST: f64 = 0.1;
/// The cause of one loop; none where it is at rest.
pub fn reason(at: usize, plant: &[PlantLoop], found: &[LoopFound], groups: &[Group]) -> Option<Reason> {
    let of = &found[at];
    let swings = of.oscillations.first().filter(|o| o.share > AT_REST);
    let group = of.group.map(|g| &groups[g]);
    let is_source = group.and_then(|g| Some(g.suspects.iter().find(|s| s.at == at)?.probability));
    if let (Some(group), Some(own)) = (group, is_source)
        && let Some(first) = group.suspects.first().filter(|s| s.at != at)
        && own < 0.5
    {
        let why = format!(
            "it swings with {} others at {} and is expected to calm down when {} does",
            group.members.len() - 1,
            period(group.period_s),
            plant[first.at].name
        );
        return Some(Reason {
            cause: Cause::Neighbour,
            probability: 1.0 - own,
            why,
            neighbour: Some(first.at),
        });
    }
    let harmonics = group.and_then(|g| Some(g.suspects.iter().find(|s| s.at == at)?.harmonics()));
    let mut scores = alone(of, plant[at].friction.as_ref(), harmonics);
    if swings.is_none() && group.is_none() && scores.iter().all(|s| s.1 <= 0.0) {
        return None;
    }
    let nothing = match group {
        Some(_) => "it is the likeliest source of its group, but its own signals do not say why it swings",
        None => "it swings, and its own signals do not say why",
    };
    scores.push((Cause::Unknown, 1.0, nothing.into()));
    let most = scores.iter().map(|s| s.1).fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = scores.iter().map(|s| (s.1 - most).exp()).sum();
    let (cause, score, why) = scores.into_iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let probability = (score - most).exp() / sum * is_source.unwrap_or(1.0);
    Some(Reason { cause, probability, why, neighbour: None })
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

/// Scores of the causes that the loop itself shows, in log-odds against nothing; `harmonics` of a group's member. What a
/// diagnosis said of the valve goes before the shape of PV.
fn alone(of: &LoopFound, friction: Option<&Friction>, harmonics: Option<f64>) -> Vec<(Cause, f64, String)> {
    let i = &of.indicators;
    let mut scores = Vec::new();
    let limits = i.at_limits.unwrap_or(0.0);
    if limits > AT_LIMIT {
        let why = format!("OP is at a limit for {:.0} % of the time", 100.0 * limits);
        scores.push((Cause::Saturation, 3.0 + 5.0 * limits, why));
    }
    if i.kept.quantisation > COARSE {
        let why = format!("PV moves in steps of {:.1} standard deviations", i.kept.quantisation);
        scores.push((Cause::Sensor, 3.0 + i.kept.quantisation, why));
    }
    let Some(swing) = of.oscillations.first().filter(|o| o.share > AT_REST) else { return scores };
    let at = period(swing.period_s);
    let corners = harmonics.unwrap_or(0.0);
    if let Some(friction) = friction.filter(|friction| friction.sticks) {
        let p = friction.probability.clamp(0.5, SURE);
        scores.push((Cause::Valve, 2.0 + (p / (1.0 - p)).ln(), friction.says.clone()));
        return scores;
    }
    let is_sound = friction.is_some();
    if i.stuck > STUCK && !is_sound {
        let why = format!(
            "PV stands still for {:.0} % of the time while OP moves, and both swing at {at}",
            100.0 * i.stuck
        );
        scores.push((Cause::Valve, 2.0 + 5.0 * i.stuck, why));
    } else if corners > CORNERS && !is_sound {
        let why = format!(
            "PV swings at {at} with corners, harmonics of {:.1} %, as a limit cycle does",
            100.0 * corners
        );
        scores.push((Cause::Valve, 2.0, why));
    } else if swing.steadiness < STEADY {
        let why = format!(
            "it rings at {at} with a height that comes and goes, as noise in a loop that hardly damps it"
        );
        scores.push((Cause::Tuning, 2.0, why));
    } else if harmonics.is_some_and(|h| h < SINE) {
        let why = format!("it swings steadily at {at} and as a sine, which neither friction nor tuning does");
        scores.push((Cause::Load, 2.0, why));
    }
    scores
}
