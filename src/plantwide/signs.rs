//! What the causes of a loop are told by: one number a sign, none of which depends on units.
//!
//! | sign | what |
//! |---|---|
//! | limits | share of the time with OP at a limit, or at the largest or least value that it has where it stops there again and again |
//! | steps | ln of (PV's step over its standard deviation + 0.01) |
//! | noise | share of PV's variance that is noise, times that of OP: noise of a loop at rest moves nothing |
//! | held | longest stretch in which PV does not change at all, as a share of the record |
//! | swing | share of the variance in the largest oscillation; 0 without one |
//! | steady | its steadiness: 1 for a sine, 0.67 for noise in a band |
//! | corners of PV, of OP | ln of (power of its harmonics over its own + 0.003) |
//! | stuck | share of the time in which PV stands still while OP moves; 0 where OP does not move |
//! | sticks | ln of the odds of friction by a diagnosis that says so, at most 3; else 0 |
//! | sound | 1 where a diagnosis says that the valve is sound |
//! | Harris | the index, 0.5 where it is not known |
//! | slow | share of the error's variance that is slower than a twentieth of the record |
//! | effort | ln of OP's standard deviation over PV's, both in their noise |

use super::rank::harmonics;
use super::{LoopFound, PlantLoop};
use crate::indicators::error::known_errors;
use crate::indicators::noise::Spread;
use crate::sysid::spectrum::{Spectrum, Transforms};
use crate::sysid::stats::{mean, range};

/// How many.
pub const SIGNS: usize = 14;
/// Where the one of a diagnosis that says that the valve sticks stands.
pub const STICKS: usize = 9;
/// The signs of one loop.
pub type Signs = [f64; SIGNS];
/// What is added to a share of harmonics: no measured wave is purer.
pub const PURE: f64 = 0.003;
/// What is added to a step: finer ones are none.
const FINE: f64 = 0.01;
/// The most that a diagnosis of friction counts (log odds): its model may be wrong.
pub const SURE: f64 = 3.0;
/// Part of the record that is slow.
const SLOW: f64 = 20.0;
/// Fewest values of an OP that moves freely: of fewer each is often the largest or the least.
const VALUES: usize = 40;
/// Distance from a value that is at it, as a part of OP's range.
const AT: f64 = 1e-3;
/// How many times as often as at the value beside it OP is at a stop: in simulated loops 11 times and more.
const OFTEN: usize = 4;
/// Samples of a stay at a stop, and fewest stays.
const STAY: usize = 3;
const AGAIN: usize = 3;

/// The signs of a loop.
pub fn signs(of: &PlantLoop, found: &LoopFound, transforms: &mut Transforms) -> Signs {
    let (w, i) = (&of.window, &found.indicators);
    let swing = found.oscillations.first();
    let corners = |x: &[f64], transforms: &mut Transforms| {
        let power =
            swing.zip(whole(x, transforms)).map(|(own, s)| harmonics(&s.bins, s.m, own.period_s / w.ts));
        (power.unwrap_or(0.0) + PURE).ln()
    };
    let friction = of.friction.as_ref();
    let odds = |p: f64| (p / (1.0 - p).max(1e-9)).max(1.0).ln().min(SURE);
    // Rows between samples have less noise than these, and none that is white.
    let (pv, op) = of.raw.map_or_else(|| (Spread::of(&w.pv), Spread::of(&w.op)), |raw| (raw.pv, raw.op));
    [
        // A controller may be stopped long before the limits that somebody knows of.
        i.at_limits.unwrap_or(0.0).max(at_extremes(&w.op)),
        (i.kept.quantisation + FINE).ln(),
        i.kept.noise_share * noise_share(&op),
        of.raw.map_or_else(|| held(&w.pv), |raw| raw.held),
        swing.map_or(0.0, |own| own.share),
        swing.map_or(0.67, |own| own.steadiness),
        corners(&w.pv, transforms),
        corners(&w.op, transforms),
        i.stuck.unwrap_or(0.0),
        friction.filter(|own| own.sticks).map_or(0.0, |own| odds(own.probability)),
        f64::from(u8::from(friction.is_some_and(|own| !own.sticks))),
        i.harris.map_or(0.5, |own| own.index),
        slow(&known_errors(&w.pv, w.sp.as_deref(), of.sp_known.as_deref()), transforms),
        effort(&op, &pv),
    ]
}

/// The spectrum of a signal about its mean; none where it is too short or not finite.
pub fn whole(x: &[f64], transforms: &mut Transforms) -> Option<Spectrum> {
    let level = mean(x);
    let x: Vec<f64> = x.iter().map(|x| x - level).collect();
    (x.len() > 60 && x.iter().all(|x| x.is_finite())).then(|| transforms.spectrum(&x))
}

fn noise_share(x: &Spread) -> f64 {
    if x.sd > 0.0 { (x.finest / x.sd).powi(2).min(1.0) } else { 0.0 }
}

/// Share of the samples at the largest or the least value, whichever is a stop; 0 where neither is.
fn at_extremes(op: &[f64]) -> f64 {
    let (low, high) = range(op);
    let mut values = op.to_vec();
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    if high <= low || values.len() < VALUES {
        return 0.0;
    }
    let over: Vec<f64> = op.iter().map(|u| (u - low) / (high - low)).collect();
    let under: Vec<f64> = over.iter().map(|x| 1.0 - x).collect();
    at_stop(&over).max(at_stop(&under))
}

/// Share of the samples at a value, by how far OP is from it, in ranges.
///
/// A stop holds OP again and again, and far more often than OP is at the value beside it. A swing in steps turns at its largest
/// value, too, but is at most two and a half times as often there as a step below.
fn at_stop(far: &[f64]) -> f64 {
    let is_at = |x: &f64| *x <= AT;
    let at = far.iter().filter(|x| is_at(x)).count();
    let next = far.iter().copied().filter(|x| !is_at(x)).fold(f64::INFINITY, f64::min);
    let beside = far.iter().filter(|x| !is_at(x) && **x <= next + AT).count();
    let runs = far.chunk_by(|a, b| is_at(a) == is_at(b));
    let stays = runs.filter(|run| is_at(&run[0]) && run.len() >= STAY).count();
    if stays >= AGAIN && at > OFTEN * beside { at as f64 / far.len() as f64 } else { 0.0 }
}

/// Longest stretch of equal values, as a share.
pub fn held(x: &[f64]) -> f64 {
    let (mut longest, mut run) = (0, 0);
    for pair in x.windows(2) {
        run = if pair[0] == pair[1] { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest as f64 / x.len().max(1) as f64
}

fn slow(e: &[f64], transforms: &mut Transforms) -> f64 {
    let Some(spectrum) = whole(e, transforms) else { return 0.0 };
    let power = |bins: &[nalgebra::Complex<f64>]| bins.iter().map(|x| x.norm_sqr()).sum::<f64>();
    let first = ((SLOW * spectrum.m as f64 / e.len() as f64) as usize).clamp(1, spectrum.bins.len() - 1);
    let all = power(&spectrum.bins[1..]);
    if all > 0.0 { power(&spectrum.bins[1..=first]) / all } else { 0.0 }
}

fn effort(op: &Spread, pv: &Spread) -> f64 {
    let over = |x: &Spread| x.sd / x.finest.max(1e-3 * x.sd).max(f64::MIN_POSITIVE);
    (over(op).max(1e-3) / over(pv).max(1e-3)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A swing of 97 samples a period that never meets the same value twice.
    fn swing(k: usize) -> f64 {
        50.0 + 10.0 * (TAU * k as f64 / 97.3).sin()
    }

    #[test]
    fn a_coarse_op_and_steps_by_hand_are_no_stop() {
        let coarse: Vec<f64> = (0..1200).map(|k| [46.0, 46.1, 46.2][k / 7 % 3]).collect();
        let by_hand: Vec<f64> = (0..1200).map(|k| if k < 600 { 40.0 } else { 60.0 }).collect();
        let in_steps: Vec<f64> = (0..1200).map(|k| (swing(k) / 0.25).round() * 0.25).collect();
        let free: Vec<f64> = (0..1200).map(swing).collect();
        for op in [coarse, by_hand, in_steps, free, vec![], vec![3.0; 100], vec![f64::NAN; 100]] {
            assert_eq!(at_extremes(&op), 0.0);
        }
    }

    #[test]
    fn a_stop_that_nobody_knows_of_is_found_on_either_side() {
        // Half a swing is above 50.
        let below: Vec<f64> = (0..1200).map(|k| swing(k).min(50.0)).collect();
        let above: Vec<f64> = (0..1200).map(|k| swing(k).max(50.0)).collect();
        for op in [below, above] {
            assert!((at_extremes(&op) - 0.5).abs() < 0.03, "{}", at_extremes(&op));
        }
    }
}
