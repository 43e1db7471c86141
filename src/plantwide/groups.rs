//! Loops that swing together.
//!
//! ```text
//! the strongest oscillation left leads; who has gamma² >= g with it in its band follows
//! U[f] = sum over members of X_i[f] e^(-i phi_i) / |X_i|        their common wave
//! members: every loop with gamma² >= g with U, and 10 % of its variance in the band; where the leader has no followers, every
//!          loop of whose variance U explains 25 %, gamma² times that share
//! ```
//!
//! g is the larger of 0.6 and of `1 - 0.0001^(1/(M - 1))`, which independent waves in M bins pass once in ten thousand pairs: of few
//! periods nothing is known. U is the first principal component of the members
//! after one step of the power method; it is compared with every loop, so that who swings too little to be noticed alone is found
//! with the others. Two and more make a group.
//!
//! On a grid of a shorter time only those count that have a member without a place on a longer one on which their period is
//! compared. Such a group takes in one that was found on a longer grid with the same period and mostly the same loops.
//!
//! Source: Thornhill, Shah, Huang & Vishnubhotla, Control Eng. Practice 2002, 10, 833 (spectral principal components); Jiang,
//! Choudhury & Shah, J. Process Control 2007, 17, 159 (spectral envelope: loops that share a frequency).

use super::rank::Suspect;
use super::spectra::{Spectra, coherence, power};
use crate::indicators::oscillation::Oscillation;
use nalgebra::Complex;

/// gamma² from which two swing together.
const TOGETHER: f64 = 0.6;
/// Probability that two that have nothing in common are found together: a plant has a thousand pairs and more.
const CHANCE: f64 = 1e-4;
/// How far periods may be apart, as a factor.
const NEAR: f64 = 1.15;
/// Least share of a loop's variance in the band.
const SHARE: f64 = 0.1;

/// Least share of a loop's variance that a leader without followers explains: between what counts for nothing and for a victim on
/// simulated plants, 8 and 30 %.
const EXPLAINED: f64 = 0.25;
/// Least probability of the oscillation of a leader without followers: a plant where nothing swings has many that might be one.
const SURE: f64 = 0.9;

/// Loops that swing together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Group {
    /// Period (s).
    pub period_s: f64,
    /// On which of the grids it was found.
    pub grid: usize,
    /// Loops, the strongest first.
    pub members: Vec<usize>,
    /// gamma² of each member with the common wave.
    pub with_common: Vec<f64>,
    /// Share of each member's variance in the band.
    pub shares: Vec<f64>,
    /// gamma² of every two members, row by row.
    pub coherence: Vec<f64>,
    /// Who started it, the likeliest first.
    pub suspects: Vec<Suspect>,
}

/// Groups of loops with these oscillations, on all grids; those with the most members first.
pub fn groups(swings: &[&[Oscillation]], grids: &[Spectra]) -> Vec<Group> {
    let mut found: Vec<Group> = Vec::new();
    for (number, spectra) in grids.iter().enumerate() {
        for group in on_grid(swings, spectra) {
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
    merge(&mut found);
    found.sort_by_key(|group| std::cmp::Reverse(group.members.len()));
    found
}

/// The group and all members of those that are the same on a longer grid, which are taken from `found`.
fn with_longer(group: Group, found: &mut Vec<Group>, spectra: &Spectra) -> Group {
    let common = |longer: &Group| longer.members.iter().filter(|m| group.members.contains(m)).count();
    let is_same = |longer: &Group| {
        longer.grid < group.grid
            && (1.0 / NEAR..=NEAR).contains(&(longer.period_s / group.period_s))
            && 2 * common(longer) > longer.members.len().min(group.members.len())
    };
    // Of several, which the long records tell apart, only the nearest is the same.
    let near = (0..found.len()).filter(|at| is_same(&found[*at])).max_by_key(|at| common(&found[*at]));
    let Some(same) = near.map(|at| found.remove(at)) else { return group };
    let band = spectra.band(group.period_s);
    let mut members: Vec<(usize, f64, f64)> = Vec::new();
    for (at, gamma) in [&group, &same].into_iter().flat_map(|of| of.members.iter().zip(&of.with_common)) {
        if !members.iter().any(|m| m.0 == *at) && spectra.inside(*at, &band).is_some() {
            members.push((*at, *gamma, spectra.share(*at, &band)));
        }
    }
    members.sort_by(|a, b| b.2.total_cmp(&a.2));
    Group { grid: group.grid, ..self::group(group.period_s, &members, spectra) }
}

/// Groups of loops with these oscillations on one grid.
fn on_grid(swings: &[&[Oscillation]], spectra: &Spectra) -> Vec<Group> {
    let mut nodes: Vec<(usize, f64, f64)> = swings
        .iter()
        .enumerate()
        .flat_map(|(i, of)| of.iter().map(move |o| (i, o.period_s, o.share)))
        .filter(|(i, period, _)| {
            spectra.compares(*period) && spectra.inside(*i, &spectra.band(*period)).is_some()
        })
        .collect();
    // By period, so that only neighbours are compared.
    nodes.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut order: Vec<usize> = (0..nodes.len()).collect();
    order.sort_by(|a, b| nodes[*b].2.total_cmp(&nodes[*a].2));
    let is_sure = |of: usize, period_s: f64| {
        swings[of].iter().any(|own| own.period_s == period_s && own.probability() >= SURE)
    };
    let mut taken = vec![false; nodes.len()];
    let mut found: Vec<Group> = Vec::new();
    for leader in order {
        if taken[leader] {
            continue;
        }
        taken[leader] = true;
        let (of, period_s, _) = nodes[leader];
        let band = spectra.band(period_s);
        let Some(own) = spectra.inside(of, &band) else { continue };
        let least = least(own.len(), spectra);
        let near = nodes.partition_point(|n| n.1 < period_s / NEAR)
            ..nodes.partition_point(|n| n.1 <= period_s * NEAR);
        let follows = |k: &usize| {
            let other = spectra.inside(nodes[*k].0, &band);
            nodes[*k].0 != of && other.is_some_and(|other| coherence(own, other).0 >= least)
        };
        let followers: Vec<usize> = near.clone().filter(|k| !taken[*k]).filter(follows).collect();
        if followers.is_empty() && !is_sure(of, period_s) {
            continue;
        }
        let mut wave: Vec<Complex<f64>> = vec![Complex::default(); own.len()];
        for x in std::iter::once(of)
            .chain(followers.iter().map(|k| nodes[*k].0))
            .filter_map(|i| spectra.inside(i, &band))
        {
            let (_, cross) = coherence(x, own);
            let turn = cross.conj() / (cross.norm() * power(x).sqrt()).max(f64::MIN_POSITIVE);
            wave.iter_mut()
                .zip(x)
                .for_each(|(w, x)| *w += Complex::new(f64::from(x.re), f64::from(x.im)) * turn);
        }
        let wave: Vec<Complex<f32>> = wave.iter().map(|w| Complex::new(w.re as f32, w.im as f32)).collect();
        let mut members: Vec<(usize, f64, f64)> = (0..swings.len())
            .filter_map(|i| {
                let gamma = coherence(spectra.inside(i, &band)?, &wave).0;
                let share = spectra.share(i, &band);
                let swings = if followers.is_empty() { gamma * share >= EXPLAINED } else { share >= SHARE };
                (gamma >= least && swings).then_some((i, gamma, share))
            })
            .collect();
        if members.len() < 2 {
            continue;
        }
        for k in near {
            taken[k] |= members.iter().any(|m| m.0 == nodes[k].0);
        }
        members.sort_by(|a, b| b.2.total_cmp(&a.2));
        found.push(group(period_s, &members, spectra));
    }
    found
}

/// gamma² that waves in so many bins have to pass.
fn least(bins: usize, spectra: &Spectra) -> f64 {
    let padding = spectra.m() as f64 / spectra.n.max(1) as f64;
    let independent = bins as f64 / padding.max(1.0);
    if independent <= 1.5 { 1.0 } else { TOGETHER.max(1.0 - CHANCE.powf(1.0 / (independent - 1.0))) }
}

/// Most members whose coherence with each other is kept: more are not told apart in a picture.
const DRAWN: usize = 64;

fn group(period_s: f64, members: &[(usize, f64, f64)], spectra: &Spectra) -> Group {
    let band = spectra.band(period_s);
    let drawn: Vec<&[Complex<f32>]> =
        members.iter().take(DRAWN).filter_map(|m| spectra.inside(m.0, &band)).collect();
    let matrix = drawn.iter().flat_map(|a| drawn.iter().map(|b| coherence(a, b).0)).collect();
    Group {
        period_s,
        members: members.iter().map(|m| m.0).collect(),
        with_common: members.iter().map(|m| m.1).collect(),
        shares: members.iter().map(|m| m.2).collect(),
        coherence: matrix,
        ..Group::default()
    }
}

/// A group at a half, a third or a quarter of another's period, most of whose members are the other's too, is its harmonic.
fn merge(groups: &mut Vec<Group>) {
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
    let mut each = harmonic.iter();
    groups.retain(|_| !each.next().copied().unwrap_or(false));
}
