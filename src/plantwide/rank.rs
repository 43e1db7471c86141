//! Who started it: the members of a group by how likely each is the source.
//!
//! ```text
//! P(i) = exp(w · x_i) / sum over members j of exp(w · x_j)
//! ```
//!
//! | x | sign | why |
//! |---|---|---|
//! | share | ln of the share of PV's variance in the band over the group's largest | a wave is strongest where it begins |
//! | shape of PV | ln of (harmonics' power over the fundamental's, + 0.003) | a limit cycle has corners; every process rounds them off |
//! | shape of OP | the same of OP | behind a sticking valve PV has more of them than OP |
//! | stuck | share of the time in which PV stands still while OP moves | friction |
//! | lead | mean of how much earlier than each other member, in periods, weighted by certainty | a cause comes first |
//! | master | 1 where it sets another member's set point | it has no valve of its own |
//! | sticks | ln of the odds of friction by a diagnosis that says so, over its most; in the loop's own group alone | what limits the cycle is the valve |
//! | upstream | share of the members that lie downstream by what the user said, less that upstream | streams carry it |
//!
//! The weights are a conditional logit (McFadden 1974) fitted on simulated plants (`calibrate rank`, seeds of its own); the
//! probability is what such plants say, so that two suspects who cannot be told apart share it.
//!
//! Source of the signs: Thornhill & Horch, Control Eng. Practice 2007, 15, 1196 (distortion and share); Bauer et al., IEEE Trans.
//! Control Syst. Technol. 2007, 15, 12 (direction by what comes first); Thornhill, J. Process Control 2005, 15, 403 (non-linearity
//! is largest at the source).

use super::groups::Group;
use super::signs::{PURE, whole};
use super::spectra::{Spectra, delay, power};
use super::{LoopFound, Plant};
use crate::sysid::spectrum::Transforms;
use crate::sysid::stats::mean;
use nalgebra::Complex;

/// Signs.
pub const SIGNS: usize = 8;
/// Weights of the signs.
const WEIGHTS: [f64; SIGNS] = [2.766, 0.019, -1.324, 0.069, 3.639, -0.888, 2.0, STICKS];
/// Weight of a diagnosis that says that the valve sticks: ln of the ratio at which it says so of valves that start a swing (22
/// of 26) and of other loops (2 of 589), in `causes rows --first 20000 --plants 235`.
const STICKS: f64 = 5.0;
/// Names of the signs.
pub const NAMES: [&str; SIGNS] = [
    "share",
    "shape of PV",
    "shape of OP",
    "stands still",
    "comes first",
    "is a master",
    "lies upstream",
    "sticks",
];
/// Most members that are ranked: the strongest.
const MOST: usize = 64;
/// Longest lead (periods).
const LONGEST: f64 = 1.0;

/// A member of a group, as a suspect.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Suspect {
    /// Which loop.
    pub at: usize,
    /// Probability that it is the source, given that a member is (0..1).
    pub probability: f64,
    /// The signs, as [`NAMES`] has them.
    pub signs: [f64; SIGNS],
    /// What speaks for it, the strongest first.
    pub evidence: Vec<String>,
}

/// Ranks the members of a group, by the group that `found` has each loop in: `number` is its place among them.
pub fn rank(
    number: usize,
    group: &Group,
    plant: &dyn Plant,
    found: &[LoopFound],
    spectra: &Spectra,
    transforms: &mut Transforms,
) -> Vec<Suspect> {
    let members = &group.members[..group.members.len().min(MOST)];
    let signs = signs(members, (number, group), plant, found, spectra, transforms);
    let scores: Vec<f64> =
        signs.iter().map(|x| x.iter().zip(&WEIGHTS).map(|(x, w)| x * w).sum::<f64>()).collect();
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = scores.iter().map(|s| (s - most).exp()).sum();
    let average: Vec<f64> =
        (0..SIGNS).map(|k| mean(&signs.iter().map(|x| x[k]).collect::<Vec<_>>())).collect();
    let says = |at: usize| found[at].friction.as_ref().map_or("", |own| own.says.as_str());
    let mut suspects: Vec<Suspect> = (0..members.len())
        .map(|i| Suspect {
            at: members[i],
            probability: (scores[i] - most).exp() / sum,
            signs: signs[i],
            evidence: evidence(&signs[i], &average, says(members[i])),
        })
        .collect();
    suspects.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    suspects
}

/// The signs that speak for a member more than for the average one.
fn evidence(signs: &[f64; SIGNS], average: &[f64], says: &str) -> Vec<String> {
    let mut for_it: Vec<(f64, usize)> =
        (0..SIGNS).map(|k| (WEIGHTS[k] * (signs[k] - average[k]), k)).filter(|e| e.0 > 0.1).collect();
    for_it.sort_by(|a, b| b.0.total_cmp(&a.0));
    let harmonics = |sign: f64| 100.0 * (sign.exp() - PURE).max(0.0);
    let say = |k: usize| match k {
        0 if signs[0] > -0.01 => "no other loop has as large a share of its PV in this swing".to_string(),
        0 => format!(
            "it swings {:.0} % as much as the loop with the largest share of its PV in this swing",
            100.0 * signs[0].exp()
        ),
        1 => format!(
            "PV's swing has more corners than the others': its harmonics have {:.1} % of its power",
            harmonics(signs[1])
        ),
        2 => format!(
            "OP's swing is nearer to a sine than the others': its harmonics have {:.1} % of its power",
            harmonics(signs[2])
        ),
        3 => format!("PV stands still for {:.0} % of the time while OP moves", 100.0 * signs[3]),
        4 if signs[4] <= 0.0 => "hardly any other loop swings before it".to_string(),
        4 => format!("it swings {:.2} periods before the others", signs[4]),
        5 => "it moves a valve of its own".to_string(),
        6 => "more of the others lie downstream than upstream".to_string(),
        _ => says.to_string(),
    };
    for_it.into_iter().map(|(_, k)| say(k)).collect()
}

fn signs(
    members: &[usize],
    (number, group): (usize, &Group),
    plant: &dyn Plant,
    found: &[LoopFound],
    spectra: &Spectra,
    transforms: &mut Transforms,
) -> Vec<[f64; SIGNS]> {
    let band = spectra.band(group.period_s);
    let share = |i: usize| spectra.share(i, &band).max(1e-9);
    let most = members.iter().map(|i| share(*i)).fold(1e-9, f64::max);
    let hz = 1.0 / (spectra.ts * spectra.m() as f64);
    let lead = |i: usize| {
        let (mut sum, mut weights) = (0.0, 0.0);
        for j in members.iter().filter(|j| **j != i) {
            let (Some(a), Some(b)) = (spectra.inside(i, &band), spectra.inside(*j, &band)) else { continue };
            let (late, error) = delay(a, b, hz);
            let (late, error) = (late / group.period_s, error / group.period_s + 0.05);
            let weight = 1.0 / (error * error);
            (sum, weights) = (sum + weight * late.clamp(-LONGEST, LONGEST), weights + weight);
        }
        if weights > 0.0 { sum / weights } else { 0.0 }
    };
    let downstream = downstream(members, found);
    members
        .iter()
        .zip(downstream)
        .map(|(&i, downstream)| {
            let own = plant.get(i);
            let of = &own.window;
            let op = whole(&of.op, transforms);
            let pv = spectra.spectrum(i);
            let is_master = members.iter().any(|j| found[*j].master == Some(i));
            // One valve has one limit cycle: it starts the loop's largest oscillation and no other.
            let sticks =
                if found[i].group == Some(number) { found[i].signs[super::signs::STICKS] } else { 0.0 };
            [
                (share(i) / most).ln(),
                (pv.map_or(0.0, |bins| harmonics(bins, spectra.m(), group.period_s / spectra.ts)) + PURE)
                    .ln(),
                (op.map_or(0.0, |s| harmonics(&s.bins, s.m, group.period_s / of.ts)) + PURE).ln(),
                found[i].indicators.stuck.unwrap_or(0.0),
                lead(i),
                f64::from(u8::from(is_master)),
                downstream,
                sticks / super::signs::SURE,
            ]
        })
        .collect()
}

/// Power around two and three times the frequency, less that between them, over that around the frequency itself; `bins` of a
/// transform of length `m`, the period in samples.
pub fn harmonics<T: Copy + Into<f64>>(bins: &[Complex<T>], m: usize, period: f64) -> f64 {
    /// Half width of a harmonic, in fundamental frequencies.
    const HALF: f64 = 0.15;
    let f = m as f64 / period;
    let around = |times: f64| -> f64 {
        let (from, to) = (((times - HALF) * f) as usize, ((times + HALF) * f) as usize);
        power(bins.get(from..=to.min(bins.len() - 1)).unwrap_or_default())
    };
    let above = |times: f64, beside: f64| {
        let between = around(times - 0.5).min(around(times + beside));
        (around(times) - between).max(0.0)
    };
    let own = around(1.0);
    // A multiple beyond the end of the spectrum is not there.
    if own > 0.0 { (above(2.0, 0.5) + above(3.0, 0.5)) / own } else { 0.0 }
}

/// Share of the other members that lie downstream, less that upstream, by what the user said.
fn downstream(members: &[usize], found: &[LoopFound]) -> Vec<f64> {
    let feeds = |a: usize, b: usize| found[b].upstream.contains(&found[a].name);
    let reached = |from: usize| {
        let mut reached = vec![from];
        let mut at = 0;
        while at < reached.len() {
            for j in members {
                if feeds(reached[at], *j) && !reached.contains(j) {
                    reached.push(*j);
                }
            }
            at += 1;
        }
        reached
    };
    if members.iter().all(|i| found[*i].upstream.is_empty()) {
        return vec![0.0; members.len()];
    }
    let from: Vec<Vec<usize>> = members.iter().map(|i| reached(*i)).collect();
    let others = (members.len() - 1).max(1) as f64;
    members
        .iter()
        .enumerate()
        .map(|(k, i)| {
            let up = from.iter().enumerate().filter(|(j, reached)| *j != k && reached.contains(i)).count();
            ((from[k].len() - 1) as f64 - up as f64) / others
        })
        .collect()
}
