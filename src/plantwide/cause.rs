//! Why a loop is not at rest: one cause each, with a probability and a sentence.
//!
//! A loop whose oscillation is a group's is its `neighbour`'s victim by the probability that another member is the source; for
//! what is left, and for a loop alone, the signs of the loop itself decide:
//!
//! | cause | sign |
//! |---|---|
//! | `saturation` | OP is at a limit of its output for more than a fifth of the time |
//! | `sensor` | PV in steps of more than 0.3 standard deviations, noise of more than half its variance, or standing still while OP moves beyond what friction does |
//! | `valve` | it oscillates, PV's harmonics are larger than OP's or PV stands still while OP moves |
//! | `tuning` | it oscillates as a sine in PV and OP alike; or the error is slow: a Harris index below 0.1 without an oscillation |
//! | `load` | it oscillates, and OP's swing lags so that the valve is sound and the loop well damped |
//! | `unknown` | none of these by enough |
//!
//! The scores are turned into probabilities by a softmax; `unknown` has a score of its own, so that a loop with little evidence
//! is said to be unknown rather than given the best of bad names.

use super::groups::Group;
use super::{LoopFound, PlantLoop};

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
/// Steps of PV in standard deviations, and noise as a share of its variance, that are a cause.
const COARSE: f64 = 0.3;
const NOISY: f64 = 0.5;
/// Share of the variance in the swing below which a loop is at rest.
const AT_REST: f64 = 0.1;
/// Harris index of a loop that is far too slow.
const SLOW: f64 = 0.1;

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
    let mut scores = alone(of);
    if swings.is_none() && group.is_none() && scores.iter().all(|s| s.1 <= 0.0) {
        return None;
    }
    scores.push((Cause::Unknown, 1.0, "nothing speaks for a cause by enough".into()));
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

/// Scores of the causes that the loop itself shows, in log-odds against nothing.
fn alone(of: &LoopFound) -> Vec<(Cause, f64, String)> {
    let i = &of.indicators;
    let mut scores = Vec::new();
    let limits = i.at_limits.unwrap_or(0.0);
    if limits > AT_LIMIT {
        scores.push((
            Cause::Saturation,
            3.0 + 5.0 * limits,
            format!("OP is at a limit for {:.0} % of the time", 100.0 * limits),
        ));
    }
    if i.kept.quantisation > COARSE {
        scores.push((
            Cause::Sensor,
            3.0 + i.kept.quantisation,
            format!("PV moves in steps of {:.1} standard deviations", i.kept.quantisation),
        ));
    } else if i.kept.noise_share > NOISY {
        scores.push((
            Cause::Sensor,
            2.0 + 4.0 * (i.kept.noise_share - NOISY),
            format!("{:.0} % of PV's variance is noise", 100.0 * i.kept.noise_share),
        ));
    }
    let index = i.harris.map_or(1.0, |h| h.index);
    match of.oscillations.first().filter(|o| o.share > AT_REST) {
        Some(swing) => {
            let at = period(swing.period_s);
            if i.stuck > 0.1 {
                scores.push((
                    Cause::Valve,
                    2.0 + 5.0 * i.stuck,
                    format!(
                        "PV stands still for {:.0} % of the time while OP moves, and both swing at {at}",
                        100.0 * i.stuck
                    ),
                ));
            }
            if swing.regularity > 3.0 && swing.steadiness < 0.9 {
                scores.push((Cause::Tuning, 2.5, format!("it rings at {at} with a height that comes and goes, as noise in a loop that hardly damps it")));
            }
            if swing.regularity > 3.0 && swing.steadiness >= 0.9 && i.stuck <= 0.1 {
                scores.push((
                    Cause::Load,
                    2.0,
                    format!("it swings steadily at {at} and neither PV nor OP shows a valve that sticks"),
                ));
            }
        }
        None if index < SLOW => {
            scores.push((Cause::Tuning, 2.0, format!("{:.0} % of the error's variance could be foretold from before the dead time, and nothing swings", 100.0 * (1.0 - index))));
        }
        None => {}
    }
    scores
}
