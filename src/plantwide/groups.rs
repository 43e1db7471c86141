//! Groups of loops that oscillate together.
//!
//! ```text
//! leader    : the strongest oscillation that is not in a group yet
//! followers : oscillations of nearly the same period, with coherence gamma² >= g with the leader in its band
//! U[f]      = sum over leader and followers of X_i[f] e^(-i phi_i) / |X_i|              their common wave
//! members   : loops with gamma² >= g with U, and 10 % of their variance in the band;
//!             where the leader has no followers, loops with gamma² times that share >= 25 %
//! ```
//!
//! Where no other oscillation follows the leader, loops whose valve sticks are its followers: those with gamma² >= g with it and 10 %
//! of their variance in the band. A limit cycle may be too uneven to be an oscillation by itself, and swings other loops all the same.
//!
//! X_i: spectrum of loop i in the band; phi_i: its phase against the leader; g: the larger of 0.6 and of `1 - 0.0001^(1/(M - 1))`,
//! which independent waves in M bins exceed in one of ten thousand pairs (-). U is the first principal component after one step of the
//! power method. It is compared with every loop, so that a loop which oscillates too little to be noticed alone is found with the
//! others. A group has two members or more, and three or more where the leader has no followers and its oscillation has a probability
//! below 0.9. The leader is a member: otherwise it swings in another way than the loops that it led to, and one of these leads them.
//! Of two groups of nearly the same period with nearly the same loops the larger one is kept.
//!
//! A group on a grid of a shorter time counts only where one member has no place on a longer grid that compares its period. Such a
//! group replaces one with the same period, and mostly the same loops, that was found on a longer grid, and takes in its members.
//!
//! Source: Thornhill, Shah, Huang & Vishnubhotla, Control Eng. Practice 2002, 10, 833 (spectral principal components); Jiang,
//! Choudhury & Shah, J. Process Control 2007, 17, 159 (spectral envelope: loops that share a frequency).

use super::lag::Lag;
use super::rank::Suspect;
use super::spectra::{Spectra, coherence, power};
use crate::indicators::oscillation::Oscillation;
use nalgebra::Complex;

/// Coherence gamma² from which two loops oscillate together (-).
const TOGETHER: f64 = 0.6;
/// Probability that two independent waves pass the least coherence: a plant has a thousand pairs of loops and more.
const CHANCE: f64 = 1e-4;
/// Largest ratio of two periods that are nearly the same.
const NEAR: f64 = 1.15;
/// Least share of a member's variance in the band.
const SHARE: f64 = 0.1;
/// Least share of a member's variance that a leader without followers explains: on simulated plants it is 8 % for an unrelated loop and
/// 30 % for a victim.
const EXPLAINED: f64 = 0.25;
/// Least probability of the oscillation of a leader without followers, in a group of two: a plant without oscillations has many that
/// might be one.
const SURE: f64 = 0.9;
/// Fewest members where the leader has no followers and is not sure: two loops beside it that its wave explains. One is not enough,
/// because a slave is coherent with its master whatever both do.
const WITNESSED: usize = 3;
/// Share of a group's loops from which they are those of another group.
const SAME: f64 = 0.8;

/// A group of loops that oscillate together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// Period (s).
    pub period_s: f64,
    /// Number of the grid on which it was found.
    pub grid: usize,
    /// Numbers of its loops, the one with the largest share of its variance first.
    pub members: Vec<usize>,
    /// Coherence gamma² of each member with the common wave (-).
    pub with_common: Vec<f64>,
    /// Share of each member's variance in the band (0..1).
    pub shares: Vec<f64>,
    /// Coherence gamma² of every two of the first members, row by row (-).
    pub coherence: Vec<f64>,
    /// Lag of every two of these members, row by row: of the loop of the column against that of the row.
    pub lags: Vec<Lag>,
    /// Which member may be the source, the likeliest first.
    pub suspects: Vec<Suspect>,
}

/// One member of a group.
#[derive(Clone, Copy)]
struct Member {
    /// The loop.
    at: usize,
    /// Coherence gamma² with the common wave (-).
    gamma: f64,
    /// Share of its variance in the band (0..1).
    share: f64,
}

/// Groups of loops, on all grids, the one with the most members first.
///
/// * `swings`: the oscillations of each loop.
/// * `sticks`: whether a diagnosis has found that the valve of each loop sticks.
/// * `grids`: the spectra of all loops, on the grid of the longest time first.
pub fn groups(swings: &[&[Oscillation]], sticks: &[bool], grids: &[Spectra]) -> Vec<Group> {
    let mut found: Vec<Group> = Vec::new();
    for (number, spectra) in grids.iter().enumerate() {
        for group in on_grid(swings, sticks, spectra) {
            let is_on = |longer: &Spectra, member: usize| {
                longer.compares(group.period_s) && longer.spectrum(member).is_some()
            };
            let is_new = |member: &usize| !grids[..number].iter().any(|longer| is_on(longer, *member));
            if group.members.iter().any(is_new) {
                let group = with_longer(Group { grid: number, ..group }, &mut found, spectra);
                found.push(group);
            }
        }
    }
    drop_doubles(&mut found);
    drop_harmonics(&mut found);
    found.sort_by_key(|group| std::cmp::Reverse(group.members.len()));
    found
}

/// The group together with the members of the same group on a longer grid, which is removed from `found`.
fn with_longer(group: Group, found: &mut Vec<Group>, spectra: &Spectra) -> Group {
    let common = |longer: &Group| longer.members.iter().filter(|m| group.members.contains(m)).count();
    let is_same = |longer: &Group| {
        longer.grid < group.grid
            && is_near(longer.period_s, group.period_s)
            && 2 * common(longer) > longer.members.len().min(group.members.len())
    };
    // The longer records may have told several groups apart: only the one with the most common loops is the same.
    let near = (0..found.len()).filter(|at| is_same(&found[*at])).max_by_key(|at| common(&found[*at]));
    let Some(same) = near.map(|at| found.remove(at)) else { return group };
    let band = spectra.band(group.period_s);
    let mut members: Vec<Member> = Vec::new();
    for (at, gamma) in [&group, &same].into_iter().flat_map(|of| of.members.iter().zip(&of.with_common)) {
        if !members.iter().any(|m| m.at == *at) && spectra.inside(*at, &band).is_some() {
            members.push(Member { at: *at, gamma: *gamma, share: spectra.share(*at, &band) });
        }
    }
    members.sort_by(|a, b| b.share.total_cmp(&a.share));
    Group { grid: group.grid, ..self::group(group.period_s, &members, spectra) }
}

/// Whether two periods (s) are nearly the same.
fn is_near(a: f64, b: f64) -> bool {
    (1.0 / NEAR..=NEAR).contains(&(a / b))
}

/// Groups of loops with these oscillations on one grid. `sticks`: the loops whose valve sticks.
fn on_grid(swings: &[&[Oscillation]], sticks: &[bool], spectra: &Spectra) -> Vec<Group> {
    let nodes = nodes(swings, spectra);
    let mut order: Vec<usize> = (0..nodes.len()).collect();
    order.sort_by(|a, b| nodes[*b].share.total_cmp(&nodes[*a].share));
    let is_sure = |of: usize, period_s: f64| {
        swings[of].iter().any(|own| own.period_s == period_s && own.probability() >= SURE)
    };
    let sticking: Vec<usize> = (0..swings.len()).filter(|at| sticks[*at]).collect();
    let mut taken = vec![false; nodes.len()];
    let mut found: Vec<Group> = Vec::new();
    for leader in order {
        if taken[leader] {
            continue;
        }
        taken[leader] = true;
        let Node { of, period_s, .. } = nodes[leader];
        let band = spectra.band(period_s);
        let Some(own) = spectra.inside(of, &band) else { continue };
        let least = least_coherence(own.len(), spectra);
        let near = nodes.partition_point(|n| n.period_s < period_s / NEAR)
            ..nodes.partition_point(|n| n.period_s <= period_s * NEAR);
        let follows = |at: &usize| {
            let other = spectra.inside(*at, &band);
            *at != of && other.is_some_and(|other| coherence(own, other).0 >= least)
        };
        let free = near.clone().filter(|k| !taken[*k]).map(|k| nodes[k].of);
        let mut followers: Vec<usize> = free.filter(follows).collect();
        if followers.is_empty() {
            let swings = |at: &usize| spectra.share(*at, &band) >= SHARE;
            followers = sticking.iter().copied().filter(swings).filter(follows).collect();
        }
        let loops = std::iter::once(of).chain(followers.iter().copied());
        let wave = common_wave(own, loops.filter_map(|i| spectra.inside(i, &band)));
        let mut members: Vec<Member> = (0..swings.len())
            .filter_map(|at| {
                let gamma = coherence(spectra.inside(at, &band)?, &wave).0;
                let share = spectra.share(at, &band);
                let swings = if followers.is_empty() { gamma * share >= EXPLAINED } else { share >= SHARE };
                (gamma >= least && swings).then_some(Member { at, gamma, share })
            })
            .collect();
        let fewest = if followers.is_empty() && !is_sure(of, period_s) { WITNESSED } else { 2 };
        if members.len() < fewest || members.iter().all(|m| m.at != of) {
            continue;
        }
        for k in near {
            taken[k] |= members.iter().any(|m| m.at == nodes[k].of);
        }
        members.sort_by(|a, b| b.share.total_cmp(&a.share));
        found.push(group(period_s, &members, spectra));
    }
    found
}

/// One oscillation of one loop.
#[derive(Clone, Copy)]
struct Node {
    /// The loop.
    of: usize,
    /// Period (s).
    period_s: f64,
    /// Share of the variance of the loop (0..1).
    share: f64,
}

/// The oscillations that are compared on a grid, by ascending period, so that only neighbours need be compared.
fn nodes(swings: &[&[Oscillation]], spectra: &Spectra) -> Vec<Node> {
    let mut nodes: Vec<Node> = swings
        .iter()
        .enumerate()
        .flat_map(|(of, own)| own.iter().map(move |o| Node { of, period_s: o.period_s, share: o.share }))
        .filter(|node| {
            spectra.compares(node.period_s) && spectra.inside(node.of, &spectra.band(node.period_s)).is_some()
        })
        .collect();
    nodes.sort_by(|a, b| a.period_s.total_cmp(&b.period_s));
    nodes
}

/// The common wave U: the sum of the spectra `x` in a band, each of unit power and turned into the phase of the leader's spectrum.
fn common_wave<'a>(
    leader: &[Complex<f32>],
    x: impl Iterator<Item = &'a [Complex<f32>]>,
) -> Vec<Complex<f32>> {
    let mut wave: Vec<Complex<f64>> = vec![Complex::default(); leader.len()];
    for x in x {
        let (_, cross) = coherence(x, leader);
        let turn = cross.conj() / (cross.norm() * power(x).sqrt()).max(f64::MIN_POSITIVE);
        wave.iter_mut().zip(x).for_each(|(w, x)| *w += Complex::new(f64::from(x.re), f64::from(x.im)) * turn);
    }
    wave.iter().map(|w| Complex::new(w.re as f32, w.im as f32)).collect()
}

/// How many of a number of bins are independent: the zeros with which the signals are padded make more bins and no more information.
fn independent(bins: usize, spectra: &Spectra) -> f64 {
    let padding = spectra.m() as f64 / spectra.n.max(1) as f64;
    bins as f64 / padding.max(1.0)
}

/// g: the coherence gamma² that two waves in a number of bins must have to oscillate together (-).
fn least_coherence(bins: usize, spectra: &Spectra) -> f64 {
    let independent = independent(bins, spectra);
    if independent <= 1.5 { 1.0 } else { TOGETHER.max(1.0 - CHANCE.powf(1.0 / (independent - 1.0))) }
}

/// Most members whose coherence with each other is kept: more cannot be told apart in a picture.
const DRAWN: usize = 64;

/// The group of these members.
fn group(period_s: f64, members: &[Member], spectra: &Spectra) -> Group {
    let band = spectra.band(period_s);
    let drawn: Vec<&[Complex<f32>]> =
        members.iter().take(DRAWN).filter_map(|m| spectra.inside(m.at, &band)).collect();
    let matrix = drawn.iter().flat_map(|a| drawn.iter().map(|b| coherence(a, b).0)).collect();
    Group {
        period_s,
        members: members.iter().map(|m| m.at).collect(),
        with_common: members.iter().map(|m| m.gamma).collect(),
        shares: members.iter().map(|m| m.share).collect(),
        coherence: matrix,
        lags: lags(&drawn, spectra),
        ..Group::default()
    }
}

/// Lag of every two of these loops, row by row, by their bins in a band.
fn lags(of: &[&[Complex<f32>]], spectra: &Spectra) -> Vec<Lag> {
    let step_hz = 1.0 / (spectra.ts * spectra.m() as f64);
    let many = of.len();
    let mut lags = vec![Lag::UNKNOWN; many * many];
    for (i, a) in of.iter().enumerate() {
        for (j, b) in of.iter().enumerate().skip(i + 1) {
            let own = Lag::of(a, b, step_hz, independent(a.len(), spectra));
            (lags[i * many + j], lags[j * many + i]) = (own, own.reversed());
        }
    }
    lags
}

/// Drops every group of nearly the same period and nearly the same loops as another one that is larger, or as large and found before.
fn drop_doubles(groups: &mut Vec<Group>) {
    let is_double = |(at, of): (usize, &Group)| {
        groups.iter().enumerate().any(|(other_at, other)| {
            let common = of.members.iter().filter(|m| other.members.contains(m)).count();
            (of.members.len(), other_at) < (other.members.len(), at)
                && is_near(of.period_s, other.period_s)
                && common as f64 >= SAME * of.members.len() as f64
        })
    };
    let double: Vec<bool> = groups.iter().enumerate().map(is_double).collect();
    retain_others(groups, &double);
}

/// Drops every group that is a harmonic of another one: its period is a half to a fifth of the other's, and most of its members are
/// the other's, too.
fn drop_harmonics(groups: &mut Vec<Group>) {
    /// Distance of a ratio of periods from a whole number.
    const OFF: f64 = 0.03;
    let is_harmonic = |of: &Group, base: &Group| {
        let ratio = base.period_s / of.period_s;
        let whole = ratio.round();
        let common = of.members.iter().filter(|m| base.members.contains(m)).count();
        (2.0..=5.0).contains(&whole) && (ratio / whole - 1.0).abs() < OFF && 2 * common > of.members.len()
    };
    let harmonic: Vec<bool> =
        groups.iter().map(|of| groups.iter().any(|base| is_harmonic(of, base))).collect();
    retain_others(groups, &harmonic);
}

/// Drops the groups that are marked.
fn retain_others(groups: &mut Vec<Group>, marked: &[bool]) {
    let mut each = marked.iter();
    groups.retain(|_| !each.next().copied().unwrap_or(false));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plantwide::PlantLoop;
    use crate::plantwide::cause::tests::swing;
    use crate::signal::Window;
    use std::f64::consts::TAU;

    /// Period of the common wave (s).
    const PERIOD_S: f64 = 300.0 * TAU;

    /// A wave with this period whose phase changes slowly, at minute `k` of a day; another `by` is another wave.
    fn wave(k: f64, by: f64) -> f64 {
        (0.2 * k + 1.5 * (by * k).sin()).sin()
    }

    /// A loop with this PV at minute `k` of a day, and noise of its own.
    fn of(own: usize, pv: impl Fn(f64) -> f64) -> PlantLoop {
        let noise = |k: f64| 0.2 * (k * k * (0.37 + 0.05 * own as f64)).sin();
        let pv: Vec<f64> = (0..1440).map(|k| pv(f64::from(k)) + noise(f64::from(k))).collect();
        let window = Window { ts: 60.0, op: pv.clone(), pv, ..Window::default() };
        PlantLoop { window, ..PlantLoop::default() }
    }

    /// An oscillation with the period of the wave but for a factor. It is sure where `lasting` is 1, and not where it is 0.73.
    fn oscillation(factor: f64, share: f64, lasting: f64) -> Vec<Oscillation> {
        let own = Oscillation { period_s: factor * PERIOD_S, share, lasting, ..swing() };
        assert!(own.counts() && (own.probability() >= SURE) == (lasting == 1.0), "{}", own.probability());
        vec![own]
    }

    /// Period and sorted members of the groups of these loops.
    fn found(plant: &[PlantLoop], swings: &[Vec<Oscillation>], sticks: &[bool]) -> Vec<(f64, Vec<usize>)> {
        let swings: Vec<&[Oscillation]> = swings.iter().map(Vec::as_slice).collect();
        let sorted = |group: Group| {
            let mut members = group.members;
            members.sort_unstable();
            (group.period_s, members)
        };
        groups(&swings, sticks, &[Spectra::of(plant, PERIOD_S)]).into_iter().map(sorted).collect()
    }

    #[test]
    fn who_leads_a_group_is_in_it() {
        // The third has 5 % of its variance in the common wave, which was noticed with another period.
        let small = |k: f64| 0.23 * wave(k, 0.011) + (0.8 * k).sin();
        let plant = [of(0, |k| wave(k, 0.011)), of(1, |k| wave(k, 0.011)), of(2, small)];
        let usual = || oscillation(1.0, 0.8, 1.0);
        // It may lead before the others do, and after them.
        for share in [0.9, 0.5] {
            let swings = [usual(), usual(), oscillation(0.98, share, 1.0)];
            assert_eq!(found(&plant, &swings, &[false; 3]), [(PERIOD_S, vec![0, 1])], "{share}");
        }
    }

    #[test]
    fn a_swing_that_is_not_sure_is_one_where_two_others_have_it() {
        let common = |k: f64| wave(k, 0.011);
        let plant = [of(0, common), of(1, common), of(4, common)];
        // Nobody else oscillates by itself.
        let led = |lasting: f64, plant: &[PlantLoop]| {
            let mut swings = vec![Vec::new(); plant.len()];
            swings[0] = oscillation(1.0, 0.8, lasting);
            let members = found(plant, &swings, &vec![false; plant.len()]);
            members.into_iter().map(|own| own.1).collect::<Vec<Vec<usize>>>()
        };
        assert_eq!(led(0.73, &plant), [vec![0, 1, 2]]);
        assert!(led(0.73, &plant[..2]).is_empty());
        assert_eq!(led(1.0, &plant[..2]), [vec![0, 1]]);
        // Waves of the same period that have nothing to do with it, and with each other.
        let strange = [of(0, common), of(5, |k| wave(k, 0.017)), of(6, |k| wave(k, 0.023))];
        assert!(led(0.73, &strange).is_empty() && led(1.0, &strange).is_empty());
    }

    #[test]
    fn a_loop_whose_valve_sticks_swings_others_though_it_does_not_oscillate_by_itself() {
        let common = |k: f64| wave(k, 0.011);
        // 14 % of the variance, and 5 %.
        let part = |by: f64| move |k: f64| by * wave(k, 0.011) + (0.8 * k).sin();
        let swings = [oscillation(1.0, 0.8, 0.73), Vec::new()];
        let with = |other: PlantLoop, sticks: bool| found(&[of(0, common), other], &swings, &[false, sticks]);
        assert_eq!(with(of(1, part(0.42)), true), [(PERIOD_S, vec![0, 1])]);
        assert!(with(of(1, part(0.42)), false).is_empty());
        assert!(with(of(1, part(0.23)), true).is_empty(), "it has hardly anything of the swing");
        assert!(with(of(1, |k| wave(k, 0.017)), true).is_empty(), "it swings by itself");
    }

    #[test]
    fn nearly_the_same_group_is_kept_once() {
        let group = |period_s: f64, members: &[usize]| Group {
            period_s,
            members: members.to_vec(),
            ..Group::default()
        };
        let kept = |all: &[Group]| {
            let mut left = all.to_vec();
            drop_doubles(&mut left);
            left.iter().map(|own| own.period_s).collect::<Vec<f64>>()
        };
        let first = group(100.0, &[0, 1, 2, 3, 4]);
        assert_eq!(kept(&[first.clone(), group(110.0, &[4, 3, 2, 1, 0])]), [100.0]);
        // The larger one is kept, wherever it stands.
        assert_eq!(kept(&[group(105.0, &[0, 1, 2, 9, 3]), group(100.0, &[0, 1, 2, 3, 4, 5])]), [100.0]);
        // Another period, and loops of which some are the same.
        let others = [first, group(120.0, &[0, 1, 2, 3, 4]), group(101.0, &[0, 1, 2, 7])];
        assert_eq!(kept(&others), [100.0, 120.0, 101.0]);
        assert_eq!(kept(&[]), [0.0; 0]);
    }

    #[test]
    fn every_two_loops_have_a_lag_and_its_opposite() {
        // The period changes, so that the phase has a slope over the band.
        let phase = |t: f64| t / 600.0 + 0.2 * (TAU * t / 9000.0).sin();
        let late = |by_s: f64| {
            let pv: Vec<f64> =
                (0..1440_u32).map(|k| (TAU * phase(60.0 * f64::from(k) - by_s)).sin()).collect();
            let window = Window { ts: 60.0, op: pv.clone(), pv, ..Window::default() };
            PlantLoop { window, ..PlantLoop::default() }
        };
        let spectra = Spectra::of(&[late(0.0), late(90.0)], 600.0);
        let band = spectra.band(600.0);
        let bins: Vec<&[Complex<f32>]> = (0..2).filter_map(|of| spectra.inside(of, &band)).collect();
        let found = lags(&bins, &spectra);
        assert!((found[1].delay_s - 90.0).abs() < 20.0 && found[1].is_known(), "{found:?}");
        assert_eq!(found, [Lag::UNKNOWN, found[1], found[1].reversed(), Lag::UNKNOWN]);
    }
}
