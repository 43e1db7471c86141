//! How much of a signal is measurement noise, and how coarse it was kept.
//!
//! ```text
//! noise share  = sigma² / variance        sigma = min(d, sqrt(e / 0.625))
//! bend[k]      = v[k] - (v[k-1] + v[k+1]) / 2
//! quantisation = quantum / sd             the least step that nearly all distinct values are whole multiples of
//! compression  = samples / samples that a straight line between their neighbours does not replace
//! ```
//!
//! d: standard deviation of the noise by the finest wavelet details (Donoho 1995), to which a cycle of fewer than six samples is
//! noise; e: what the two bends before each leave of the variance of the bends, by Levinson's recursion: 0.625 of the variance of
//! white noise, and nothing of a sine of any period.
//!
//! Source: Thornhill, Choudhury & Shah, J. Process Control 2004, 14, 389 (compression as the number of kept values; above 3 the
//! data are not fit for statistics).

use crate::diagnosis::denoise::noise_sd;
use crate::residual::data_quality::quantised::quantum;
use crate::sysid::least_squares::dot;
use crate::sysid::stats::sd;

/// Distance from a line, as a part of the standard deviation, that is on it.
const ON_LINE: f64 = 1e-6;
/// What the two bends before it leave of a bend of white noise, in the noise's variance (-): bends have 1.5 of it and
/// autocorrelations of -2/3 and 1/6, of which 7/12 are foretold.
const LEFT_OF_NOISE: f64 = 0.625;

/// How a signal spreads, and what of that is noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Standard deviation (its unit).
    pub sd: f64,
    /// Standard deviation of its white noise, [`sigma`] (its unit).
    pub noise: f64,
    /// Standard deviation of its noise by the finest details alone, d (its unit).
    pub finest: f64,
}

impl Spread {
    /// Of a signal as it was sampled.
    pub fn of(v: &[f64]) -> Self {
        let finest = noise_sd(v);
        Self { sd: sd(v), noise: white(v, finest), finest }
    }
}

/// How a signal was measured and kept.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Kept {
    /// Share of the variance that is noise (0..1).
    pub noise_share: f64,
    /// Quantum in standard deviations; 0 where none is found (-).
    pub quantisation: f64,
    /// Compression factor, 1 for none (-).
    pub compression: f64,
}

/// The step of a signal (its unit); 0 where none is found.
pub fn step(v: &[f64]) -> f64 {
    let spread = sd(v);
    if !(spread.is_finite() && spread > 0.0) {
        return 0.0;
    }
    let normal: Vec<f64> = v.iter().map(|x| x / spread).collect();
    quantum(&normal).map_or(0.0, |quantum| spread * quantum.size)
}

/// Standard deviation of the white noise in `v` (its unit); 0 where it is too short to judge.
pub fn sigma(v: &[f64]) -> f64 {
    white(v, noise_sd(v))
}

/// The same, of which the finest details have so much.
fn white(v: &[f64], finest: f64) -> f64 {
    let bends: Vec<f64> = v.windows(3).map(|w| w[1] - 0.5 * (w[0] + w[2])).collect();
    let covariance = |lag: usize| {
        let pairs = bends.len().saturating_sub(lag);
        dot(&bends[..pairs], &bends[bends.len() - pairs..]) / pairs.max(1) as f64
    };
    let [whole, one, two] = [0, 1, 2].map(covariance);
    if whole <= 0.0 {
        return 0.0;
    }
    let first = one / whole;
    let after_one = whole * (1.0 - first * first);
    let second = if after_one > 0.0 { (two - first * one) / after_one } else { 0.0 };
    let left = after_one.max(0.0) * (1.0 - second * second).max(0.0);
    finest.min((left / LEFT_OF_NOISE).sqrt())
}

/// Looks at a signal; a signal that does not move has neither noise nor steps. `known` is its step and its spread where `v` is not
/// as it was measured.
pub fn kept(v: &[f64], known: Option<(f64, Spread)>) -> Kept {
    let Spread { sd: spread, noise, .. } = known.map_or_else(|| Spread::of(v), |known| known.1);
    if v.len() < 3 || !(spread.is_finite() && spread > 0.0) {
        return Kept { compression: 1.0, ..Kept::default() };
    }
    let share = (noise / spread).powi(2).min(1.0);
    let quantisation = known.map_or_else(|| step(v), |known| known.0) / spread;
    // A value that is held is on the line, too, but so it is behind a coarse sensor: that is no compression.
    let on_line = v.windows(3).filter(|w| {
        let (a, b) = (w[1] - w[0], w[2] - w[1]);
        (a - b).abs() <= ON_LINE * spread && a.abs() > ON_LINE * spread
    });
    let lines = if quantisation > 0.03 { 0 } else { on_line.count() };
    Kept { noise_share: share, quantisation, compression: v.len() as f64 / (v.len() - lines) as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    #[test]
    fn noise_steps_and_lines_are_measured() {
        let noise: Vec<f64> =
            StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(3)).take(2000).collect();
        let wave = |k: usize| (0.05 * k as f64).sin();
        let noisy: Vec<f64> = noise.iter().enumerate().map(|(k, e)| wave(k) + 0.5 * e).collect();
        // 0.25 of 0.75; the estimate's standard error is 5 % at 1,000 details.
        assert!((kept(&noisy, None).noise_share - 1.0 / 3.0).abs() < 0.05, "{:?}", kept(&noisy, None));
        let coarse: Vec<f64> = (0..2000).map(|k| (wave(k) / 0.25).round() * 0.25).collect();
        assert!((kept(&coarse, None).quantisation - 0.25 / sd(&coarse)).abs() < 1e-9);
        assert!((step(&coarse) - 0.25).abs() < 1e-9 && step(&noisy) == 0.0 && step(&[]) == 0.0);
        let smooth: Vec<f64> = (0..2000).map(wave).collect();
        // What was measured before goes before what is seen.
        let before = (0.25, Spread { sd: 2.0, noise: 1.0, finest: 1.0 });
        let known = kept(&smooth, Some(before));
        assert_eq!((known.quantisation, known.noise_share), (0.125, 0.25));
        assert_eq!(Spread::of(&noisy).noise, sigma(&noisy));
        // Every fourth sample kept: of four, three lie on a line but the kept one and its line's start.
        let lines: Vec<f64> = (0..2000)
            .map(|k| {
                let (from, part) = (k / 4, (k % 4) as f64 / 4.0);
                noise[from] + part * (noise[from + 1] - noise[from])
            })
            .collect();
        assert!((kept(&lines, None).compression - 4.0).abs() < 0.1, "{:?}", kept(&lines, None));
        assert_eq!(kept(&[], None).compression, 1.0);
    }

    #[test]
    fn a_fast_cycle_is_no_noise_and_noise_stays_noise() {
        let noise: Vec<f64> =
            StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(4)).take(720).collect();
        // On a slow swing of ten times its size.
        let wave = |k: usize| (0.01 * k as f64).sin();
        let cycle = |period: f64, k: usize| 5.0 * (TAU * k as f64 / period + 0.3).sin() + 50.0 * wave(k);
        for period in [2.0, 2.5, 3.0, 3.7, 4.0, 4.5, 5.0, 5.5, 6.0, 8.0] {
            let pure: Vec<f64> = (0..720).map(|k| cycle(period, k)).collect();
            assert!(sigma(&pure) < 0.25, "{period}: {}", sigma(&pure));
            assert!(kept(&pure, None).noise_share < 0.01);
        }
        // Noise alone, of which 720 samples tell the size to 5 %.
        assert!((sigma(&noise) - 1.0).abs() < 0.15, "{}", sigma(&noise));
        // Of a coin's, which is 0 or 1, a turn of four standard deviations is more than its range.
        let coin: Vec<f64> = noise.iter().map(|e| f64::from(u8::from(*e > 0.0))).collect();
        assert!(sigma(&coin) > 0.25, "{}", sigma(&coin));
        let slow: Vec<f64> = noise.iter().enumerate().map(|(k, e)| 50.0 * wave(k) + e).collect();
        assert!((sigma(&slow) - 1.0).abs() < 0.15, "{}", sigma(&slow));
        assert_eq!((sigma(&[]), sigma(&[1.0; 100]), sigma(&[1.0, 2.0])), (0.0, 0.0, 0.0));
    }
}
