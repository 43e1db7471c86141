//! The features of one loop, called signs, by which its cause is found ([`super::cause`]). They do not depend on units.
//!
//! | sign | what it is |
//! |---|---|
//! | limits | share of the time with OP at a limit, or at its own largest or least value where it stops there again and again |
//! | steps | ln of (quantum of PV over its standard deviation, + 0.01) |
//! | noise | share of PV's variance that is noise, times that of OP: the noise of a loop at rest moves nothing |
//! | held | longest stretch in which PV does not change at all, as a share of the record |
//! | swing | share of the variance in the largest oscillation; 0 without one |
//! | steady | steadiness of that oscillation: 1 for a sine, 0.67 for band-limited noise |
//! | corners of PV, of OP | ln of (power of the harmonics over that of the fundamental, + 0.003) |
//! | stuck | share of the time in which PV stands still while OP moves; 0 where OP does not move |
//! | sticks | ln of the odds of friction, at most 3, where a diagnosis has found friction; otherwise 0 |
//! | sound | 1 where a diagnosis has found that the valve is sound; otherwise 0 |
//! | Harris | Harris index for a dead time of one sample; 0.5 where it is not known |
//! | slow | share of the error's variance at periods longer than a twentieth of the record |
//! | effort | ln of OP's standard deviation over PV's, each in units of its noise |

use super::rank::harmonics;
use super::{LoopFound, PlantLoop};
use crate::indicators::error::known_errors;
use crate::indicators::noise::Spread;
use crate::sysid::spectrum::{Spectrum, Transforms};
use crate::sysid::stats::{mean, range};

/// Number of signs.
pub const SIGNS: usize = 14;
/// Position of the sign *held*.
pub const HELD: usize = 3;
/// The signs of one loop.
pub type Signs = [f64; SIGNS];
/// Added to the share of harmonics (-): no measured sine is purer.
pub const PURE: f64 = 0.003;
/// Added to a quantum in standard deviations (-): finer ones make no difference.
const FINE: f64 = 0.01;
/// Largest log odds of a diagnosis of friction that count (-): its model may be wrong.
pub const SURE: f64 = 3.0;
/// Periods longer than the record divided by this are slow.
const SLOW: f64 = 20.0;
/// Fewest distinct values of an OP that moves freely: with fewer, the largest and the least are frequent by themselves.
const VALUES: usize = 40;
/// Distance up to which OP is at a value, as a share of its range.
const AT: f64 = 1e-3;
/// Least ratio of the samples at a stop to those at the value beside it: in simulated loops it is 11 and more.
const OFTEN: usize = 4;
/// Fewest samples of a stay at a stop.
const STAY: usize = 3;
/// Fewest stays at a stop.
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
    // Thinned rows have less noise than the samples, and not white noise: the spread of the samples is used.
    let (pv, op) = of.raw.map_or_else(|| (Spread::of(&w.pv), Spread::of(&w.op)), |raw| (raw.pv, raw.op));
    [
        // A controller may stop well before the configured limits.
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
        i.harris_of_one.map_or(0.5, |own| own.index),
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

/// The share of a signal's variance that is noise (0..1).
fn noise_share(x: &Spread) -> f64 {
    if x.sd > 0.0 { (x.finest / x.sd).powi(2).min(1.0) } else { 0.0 }
}

/// The share of the samples at the largest or at the least value of OP, where that is a stop; otherwise 0.
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

/// The share of the samples at a value where that is a stop; otherwise 0. `far`: distance of OP from the value, in ranges of OP.
///
/// A stop holds OP again and again, and far more often than OP is at the value beside it. A quantised oscillation turns at its largest
/// value, too, but is there at most two and a half times as often as one step below.
fn at_stop(far: &[f64]) -> f64 {
    let is_at = |x: &f64| *x <= AT;
    let at = far.iter().filter(|x| is_at(x)).count();
    let next = far.iter().copied().filter(|x| !is_at(x)).fold(f64::INFINITY, f64::min);
    let beside = far.iter().filter(|x| !is_at(x) && **x <= next + AT).count();
    let runs = far.chunk_by(|a, b| is_at(a) == is_at(b));
    let stays = runs.filter(|run| is_at(&run[0]) && run.len() >= STAY).count();
    if stays >= AGAIN && at > OFTEN * beside { at as f64 / far.len() as f64 } else { 0.0 }
}

/// The longest stretch of equal values, as a share of all (0..1).
pub fn held(x: &[f64]) -> f64 {
    let (mut longest, mut run) = (0, 0);
    for pair in x.windows(2) {
        run = if pair[0] == pair[1] { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest as f64 / x.len().max(1) as f64
}

/// The share of the error's variance at slow periods (0..1).
fn slow(e: &[f64], transforms: &mut Transforms) -> f64 {
    let Some(spectrum) = whole(e, transforms) else { return 0.0 };
    let power = |bins: &[nalgebra::Complex<f64>]| bins.iter().map(|x| x.norm_sqr()).sum::<f64>();
    let first = ((SLOW * spectrum.m as f64 / e.len() as f64) as usize).clamp(1, spectrum.bins.len() - 1);
    let all = power(&spectrum.bins[1..]);
    if all > 0.0 { power(&spectrum.bins[1..=first]) / all } else { 0.0 }
}

/// ln of OP's standard deviation over PV's, each in units of its noise (-).
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
