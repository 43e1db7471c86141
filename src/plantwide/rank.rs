//! The source of a group: the probability of each member that it started the oscillation, by a conditional logit.
//!
//! ```text
//! P(i) = exp(w · x_i) / sum over suspects j of exp(w · x_j)
//! ```
//!
//! w: weights; x_i: the features of member i, called signs:
//!
//! | sign | what it is | why |
//! |---|---|---|
//! | share | ln of the share of PV's variance in the band over the largest in the group | an oscillation is strongest at its source |
//! | shape of PV | ln of (power of the harmonics over that of the fundamental, + 0.003) | a limit cycle has corners; every process rounds them off |
//! | shape of OP | the same of OP | behind a sticking valve PV has more harmonics than OP |
//! | stuck | share of the time in which PV stands still while OP moves | friction |
//! | lead | mean lead over each other member (periods), weighted by its certainty | a cause comes first |
//! | master | 1 where its output is another member's set point | it has no valve of its own |
//! | upstream | share of the members downstream of it less that upstream, by the configured streams | streams carry the oscillation |
//! | sticks | how well the friction of a diagnosis explains the swing (`friction.rs`), times its evidence over that of the member where both together are largest, at most 1; in the group of the loop's largest oscillation alone, and 0 for a master | the valve limits the cycle |
//!
//! Suspects are the members that can be judged: good samples over half of the time, and in manual for at most half of it. A loop in
//! manual has no limit cycle of its own, and a suspicion of it leads to no order. So P is the probability of a source among the
//! suspects; a load that enters at a loop in manual is none of them.
//!
//! The weights are a conditional logit (McFadden 1974) fitted on simulated plants (`calibrate rank`, on seeds of its own). Suspects with
//! the same signs have the same probability.
//!
//! Source of the signs: Thornhill & Horch, Control Eng. Practice 2007, 15, 1196 (distortion and share); Bauer et al., IEEE Trans.
//! Control Syst. Technol. 2007, 15, 12 (direction by what comes first); Thornhill, J. Process Control 2005, 15, 403 (non-linearity
//! is largest at the source).

use super::cause::is_judged;
use super::friction::swing;
use super::groups::Group;
use super::lag::delay;
use super::signs::{PURE, whole};
use super::spectra::{Spectra, power};
use super::{LoopFound, Plant};
use crate::signal::share;
use crate::sysid::spectrum::Transforms;
use crate::sysid::stats::mean;
use nalgebra::Complex;

/// Number of signs.
pub const SIGNS: usize = 8;
/// Weights of the signs.
const WEIGHTS: [f64; SIGNS] = [2.766, 0.019, -1.324, 0.069, 3.639, -0.888, 2.0, STICKS];
/// Position of the sign *sticks*.
const STICKING: usize = 7;
/// Weight of a diagnosis that the valve sticks: ln of the ratio of two rates, that of this diagnosis for valves that start an
/// oscillation (22 of 26) and for other loops (2 of 589), in `causes rows --first 20000 --plants 235`.
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
/// Most members that are ranked: those with the largest shares.
const MOST: usize = 64;
/// Longest lead (periods).
const LONGEST: f64 = 1.0;
/// Least lead that a sentence gives (periods): a smaller one would be written as 0.00.
const TOLD: f64 = 0.005;

/// A member of a group, as a suspect.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Suspect {
    /// Number of the loop.
    pub at: usize,
    /// Probability that it is the source, given that a suspect is (0..1).
    pub probability: f64,
    /// The signs, in the order of [`NAMES`].
    pub signs: [f64; SIGNS],
    /// The evidence for it as sentences, the strongest first.
    pub evidence: Vec<String>,
}

/// The suspects of a group, the likeliest first.
///
/// * `number`: number of the group, as [`LoopFound::group`] has it.
/// * `found`: the results of all loops so far.
/// * `spectra`: the spectra on the grid of the group.
pub fn rank(
    number: usize,
    group: &Group,
    plant: &dyn Plant,
    found: &[LoopFound],
    spectra: &Spectra,
    transforms: &mut Transforms,
) -> Vec<Suspect> {
    let judged = group.members.iter().copied().filter(|at| is_judged(&found[*at]));
    let members: Vec<usize> = judged.take(MOST).collect();
    let signs = signs(&members, (number, group), plant, found, spectra, transforms);
    let scores: Vec<f64> =
        signs.iter().map(|x| x.iter().zip(&WEIGHTS).map(|(x, w)| x * w).sum::<f64>()).collect();
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let sum: f64 = scores.iter().map(|s| (s - most).exp()).sum();
    let average: Vec<f64> =
        (0..SIGNS).map(|k| mean(&signs.iter().map(|x| x[k]).collect::<Vec<_>>())).collect();
    let mut suspects: Vec<Suspect> = (0..members.len())
        .map(|i| Suspect {
            at: members[i],
            probability: (scores[i] - most).exp() / sum,
            signs: signs[i],
            evidence: evidence(&signs[i], &average, members[i], found),
        })
        .collect();
    suspects.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    suspects
}

/// The evidence for a suspect: a sentence for each sign that raises its score above the average. A sign may be above the average and
/// still mean nothing, as a small lead does: then it has no sentence.
fn evidence(signs: &[f64; SIGNS], average: &[f64], at: usize, found: &[LoopFound]) -> Vec<String> {
    let mut for_it: Vec<(f64, usize)> =
        (0..SIGNS).map(|k| (WEIGHTS[k] * (signs[k] - average[k]), k)).filter(|e| e.0 > 0.1).collect();
    for_it.sort_by(|a, b| b.0.total_cmp(&a.0));
    let harmonics = |sign: f64| share((sign.exp() - PURE).max(0.0), 1);
    let is_master = || found.iter().any(|of| of.master == Some(at));
    let say = |k: usize| {
        Some(match k {
            0 if signs[0] > -0.01 => "no other loop has as large a share of its PV in this swing".to_string(),
            0 => format!(
                "it swings {} as much as the loop with the largest share of its PV in this swing",
                share(signs[0].exp(), 0)
            ),
            1 => format!(
                "PV's swing is less like a sine than the others': its harmonics have {} of its power",
                harmonics(signs[1])
            ),
            2 => format!(
                "OP's swing is more like a sine than the others': its harmonics have {} of its power",
                harmonics(signs[2])
            ),
            3 => format!("PV stands still for {} of the time while OP moves", share(signs[3], 0)),
            4 if signs[4] < TOLD => return None,
            4 => format!("it swings {:.2} periods before the others", signs[4]),
            5 if is_master() => return None,
            5 => "it sets no other loop's set point, and another member does".to_string(),
            6 => "more of the others lie downstream than upstream".to_string(),
            _ => found[at].friction.as_ref()?.says.clone(),
        })
    };
    for_it.into_iter().filter_map(|(_, k)| say(k)).collect()
}

/// The signs of each of `members`.
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
    let most = group.members.iter().map(|i| share(*i)).fold(1e-9, f64::max);
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
    let downstream = downstream(members, &group.members, found);
    let mut signs: Vec<[f64; SIGNS]> = members
        .iter()
        .zip(downstream)
        .map(|(&i, downstream)| {
            let own = plant.get(i);
            let of = &own.window;
            let op = whole(&of.op, transforms);
            let pv = spectra.spectrum(i);
            let is_master = group.members.iter().any(|j| found[*j].master == Some(i));
            // A valve has one limit cycle: it can be the source of the loop's largest oscillation only. A master has no valve: what
            // sticks between its OP and its PV is its slave's.
            let friction =
                found[i].friction.as_ref().filter(|_| found[i].group == Some(number) && !is_master);
            let swing = op.as_ref().map(|op| swing(op, group.period_s / of.ts));
            [
                (share(i) / most).ln(),
                (pv.map_or(0.0, |bins| harmonics(bins, spectra.m(), group.period_s / spectra.ts)) + PURE)
                    .ln(),
                (op.map_or(0.0, |s| harmonics(&s.bins, s.m, group.period_s / of.ts)) + PURE).ln(),
                found[i].indicators.stuck.unwrap_or(0.0),
                lead(i),
                f64::from(u8::from(is_master)),
                downstream,
                friction.map_or(0.0, |friction| friction.explains(swing)),
            ]
        })
        .collect();
    compare_evidence(&mut signs, |k| found[members[k]].friction.as_ref().map_or(0.0, |own| own.evidence));
    signs
}

/// Weighs several valves that stick: the sign of each is multiplied by its evidence over that of the valve where the product of both is
/// largest, at most by 1. So the sign of that valve stays as it is, and evidence that is just enough for a verdict counts less beside
/// evidence that is beyond doubt. `evidence`: that of each suspect (-).
fn compare_evidence(signs: &mut [[f64; SIGNS]], evidence: impl Fn(usize) -> f64) {
    let told = |own: &[f64; SIGNS], k: usize| own[STICKING] * evidence(k);
    let best = signs.iter().enumerate().max_by(|a, b| told(a.1, a.0).total_cmp(&told(b.1, b.0)));
    let most = best.map_or(0.0, |best| evidence(best.0));
    if most > 0.0 {
        let scaled = |k: usize| (evidence(k) / most).clamp(0.0, 1.0);
        signs.iter_mut().enumerate().for_each(|(k, own)| own[STICKING] *= scaled(k));
    }
}

/// Power of the second and the third harmonic, less that between the harmonics, over the power of the fundamental (-).
///
/// * `bins`: spectrum, of a transform of length `m`.
/// * `period`: period of the fundamental (samples).
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
    // A harmonic beyond the end of the spectrum counts as 0.
    if own > 0.0 { (above(2.0, 0.5) + above(3.0, 0.5)) / own } else { 0.0 }
}

/// For each suspect the share of the other suspects that lie downstream of it, less the share upstream, by the configured streams (-).
/// `through`: the loops that a stream may pass, suspects or not.
fn downstream(suspects: &[usize], through: &[usize], found: &[LoopFound]) -> Vec<f64> {
    let feeds = |a: usize, b: usize| found[b].upstream.contains(&found[a].name);
    let reached = |from: usize| {
        let mut reached = vec![from];
        let mut at = 0;
        while at < reached.len() {
            for j in through {
                if feeds(reached[at], *j) && !reached.contains(j) {
                    reached.push(*j);
                }
            }
            at += 1;
        }
        reached
    };
    if through.iter().all(|i| found[*i].upstream.is_empty()) {
        return vec![0.0; suspects.len()];
    }
    let from: Vec<Vec<usize>> = suspects.iter().map(|i| reached(*i)).collect();
    let others = suspects.len().saturating_sub(1).max(1) as f64;
    suspects
        .iter()
        .enumerate()
        .map(|(k, i)| {
            let down = suspects.iter().filter(|j| *j != i && from[k].contains(*j)).count();
            let up = from.iter().enumerate().filter(|(j, reached)| *j != k && reached.contains(i)).count();
            (down as f64 - up as f64) / others
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::{Cause, Friction, PlantLoop, analyse, tasks};
    use crate::signal::{Row, Window};

    /// Samples of a day at one minute.
    const DAY: usize = 1440;

    /// Loops that swing at 31 min alike, each with little noise of its own; the stream of the first enters all others.
    fn alike(many: usize) -> Vec<PlantLoop> {
        let one = |i: usize| {
            let noise = |k: usize| 0.2 * ((k * k) as f64 * (0.37 + 0.05 * i as f64)).sin();
            let pv: Vec<f64> = (0..DAY).map(|k| (0.2 * k as f64).sin() + noise(k)).collect();
            let window = Window { ts: 60.0, op: pv.clone(), pv, ..Window::default() };
            let upstream = if i == 0 { Vec::new() } else { vec!["FIC0".to_string()] };
            PlantLoop { name: format!("FIC{i}"), window, upstream, ..PlantLoop::default() }
        };
        (0..many).map(one).collect()
    }

    #[test]
    fn who_cannot_be_judged_is_no_suspect_and_the_others_have_an_order() {
        let mut plant = alike(4);
        let found = analyse(&plant);
        let first = &found.groups[0].suspects[0];
        assert!(first.at == 0 && first.probability >= 0.5, "upstream of all others: {first:?}");
        let in_manual = PlantLoop { mode: Some(vec![0.0; DAY]), ..plant[0].clone() };
        let mut with_gaps = plant[0].clone();
        with_gaps.window.rows =
            (0..DAY).map(|k| if 5 * k < 3 * DAY { Row::Missing } else { Row::Counts }).collect();
        for source in [in_manual, with_gaps] {
            plant[0] = source;
            let found = analyse(&plant);
            let group = &found.groups[0];
            assert_eq!(group.members.len(), 4);
            assert_eq!(group.suspects.len(), 3);
            assert!(group.suspects.iter().all(|own| own.at != 0));
            assert!((group.suspects.iter().map(|own| own.probability).sum::<f64>() - 1.0).abs() < 1e-9);
            let first = group.suspects[0].at;
            assert_eq!(tasks(&found).iter().map(|task| task.at).collect::<Vec<_>>(), [first]);
            assert_eq!(found.loops[0].reason, None);
            let told = |at: usize| found.loops[at].reason.as_ref().map(|own| own.cause);
            assert!((1..4).filter(|at| *at != first).all(|at| told(at) == Some(Cause::Neighbour)));
        }
        // Where nobody can be judged nobody is suspected, and nobody has anything to do.
        for of in &mut plant {
            of.mode = Some(vec![0.0; DAY]);
        }
        let found = analyse(&plant);
        assert_eq!((found.groups.len(), found.groups[0].suspects.len(), tasks(&found).len()), (1, 0, 0));
    }

    /// A valve that sticks with this evidence (-) and S (OP unit).
    fn sticking(evidence: f64, band: f64, is_contested: bool) -> Option<Friction> {
        let says = format!("it ignores {band}");
        Some(Friction { band: Some(band), says, ..Friction::of(true, evidence, is_contested) })
    }

    #[test]
    fn of_two_valves_that_stick_the_one_that_sustains_the_swing_is_the_source() {
        // OP of each swings by 2 from peak to peak, and the first is upstream of the others.
        let mut plant = alike(3);
        plant[0].friction = sticking(21.0, 0.15, true);
        plant[1].friction = sticking(700.0, 1.5, false);
        let of_both = analyse(&plant).groups.remove(0).suspects;
        let first = &of_both[0];
        assert!(first.at == 1 && first.probability > 0.6, "{of_both:?}");
        assert_eq!(first.evidence.first().map(String::as_str), Some("it ignores 1.5"));
        let sign = |suspects: &[Suspect], at: usize| {
            suspects.iter().find(|own| own.at == at).map_or(f64::NAN, |own| own.signs[STICKING])
        };
        // 15 % of what sustains the swing, contested, with 21 % of the other's evidence.
        assert!((sign(&of_both, 0) - 0.15 * 0.5 * 0.21).abs() < 1e-3, "{of_both:?}");
        assert_eq!(sign(&of_both, 1), 1.0);
        // Alone, a valve that explains the swing counts as much whatever its evidence is.
        (plant[0].friction, plant[1].friction) = (None, sticking(21.0, 1.5, false));
        assert_eq!(sign(&analyse(&plant).groups.remove(0).suspects, 1), 1.0);
    }

    #[test]
    fn what_sticks_behind_a_master_is_not_its_own() {
        let mut plant = alike(3);
        plant[0].friction = sticking(100.0, 1.5, false);
        plant[2].window.sp = Some(plant[0].window.op.clone());
        let found = analyse(&plant);
        assert_eq!(found.loops[2].master, Some(0));
        assert!(found.groups[0].suspects.iter().all(|own| own.signs[STICKING] == 0.0), "{:?}", found.groups);
    }

    #[test]
    fn evidence_counts_beside_that_of_the_valve_that_explains_the_swing_best() {
        let compared = |explains: [f64; 3], evidence: [f64; 3]| {
            let mut signs = explains.map(|x| {
                let mut own = [0.5; SIGNS];
                own[STICKING] = x;
                own
            });
            compare_evidence(&mut signs, |k| evidence[k]);
            assert!(signs.iter().all(|own| own[0] == 0.5), "no other sign changes: {signs:?}");
            signs.map(|own| own[STICKING])
        };
        assert_eq!(compared([1.0, 1.0, 0.0], [100.0, 25.0, 0.0]), [1.0, 0.25, 0.0]);
        // The most evidence for friction that is too small does not beat it, and is not raised by it.
        assert_eq!(compared([0.125, 1.0, 0.0], [100.0, 50.0, 0.0]), [0.125, 1.0, 0.0]);
        assert_eq!(compared([0.0, 0.0, 0.0], [0.0, 3.0, 0.0]), [0.0; 3]);
        compare_evidence(&mut [], |_| 0.0);
    }

    #[test]
    fn harmonics_that_are_next_to_nothing_are_not_told_as_none() {
        let told = |power: f64| {
            let mut signs = [0.0; SIGNS];
            signs[2] = (PURE + power).ln();
            // OP of the others is far from a sine.
            let mut average = signs;
            average[2] += 10.0;
            evidence(&signs, &average, 0, &[LoopFound::default()])
        };
        let says = |share: &str| {
            vec![format!(
                "OP's swing is more like a sine than the others': its harmonics have {share} of its power"
            )]
        };
        assert_eq!(told(0.0003), says("less than 0.1 %"));
        assert_eq!(told(0.003), says("0.3 %"));
    }

    #[test]
    fn a_stream_goes_through_a_loop_that_is_no_suspect() {
        let of = |name: &str, upstream: &[&str]| LoopFound {
            name: name.into(),
            upstream: upstream.iter().map(|name| (*name).to_string()).collect(),
            ..LoopFound::default()
        };
        let found = [of("A", &[]), of("B", &["A"]), of("C", &["B"])];
        assert_eq!(downstream(&[0, 2], &[0, 1, 2], &found), [1.0, -1.0]);
        assert_eq!(downstream(&[0, 1, 2], &[0, 1, 2], &found), [1.0, 0.0, -1.0]);
        assert_eq!(downstream(&[], &[0, 1, 2], &found), [0.0; 0]);
    }

    #[test]
    fn only_what_holds_is_said() {
        let master = |of: Option<usize>| LoopFound { master: of, ..LoopFound::default() };
        // The first is the master of a loop that is in another group; the second of none.
        let found = [master(None), master(None), master(Some(0))];
        let said = |sign: usize, own: f64, average: f64, at: usize| {
            let (mut signs, mut all) = ([0.0; SIGNS], [0.0; SIGNS]);
            (signs[sign], all[sign]) = (own, average);
            evidence(&signs, &all, at, &found)
        };
        assert_eq!(said(5, 0.0, 0.2, 0), [""; 0], "it has no valve of its own");
        assert_eq!(said(5, 0.0, 0.2, 1), ["it sets no other loop's set point, and another member does"]);
        // It comes later than the others, and less so than they do on the average.
        assert_eq!((said(4, -0.1, -0.3, 1), said(4, 0.001, -0.3, 1)), (vec![], vec![]));
        assert_eq!(said(4, 0.2, 0.0, 1), ["it swings 0.20 periods before the others"]);
    }
}
