//! How much of a signal is measurement noise, and how coarse it was kept.
//!
//! ```text
//! noise share  = sigma² / variance        sigma: from the finest wavelet details (Donoho 1995)
//! quantisation = quantum / sd             the least step that nearly all distinct values are whole multiples of
//! compression  = samples / samples that a straight line between their neighbours does not replace
//! ```
//!
//! Source: Thornhill, Choudhury & Shah, J. Process Control 2004, 14, 389 (compression as the number of kept values; above 3 the
//! data are not fit for statistics).

use crate::diagnosis::denoise::noise_sd;
use crate::residual::data_quality::quantised::quantum;
use crate::sysid::stats::sd;

/// Distance from a line, as a part of the standard deviation, that is on it.
const ON_LINE: f64 = 1e-6;

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

/// Looks at a signal; a signal that does not move has neither noise nor steps. `known` is its step where `v` is not as it was
/// measured.
pub fn kept(v: &[f64], known: Option<f64>) -> Kept {
    let spread = sd(v);
    if v.len() < 3 || !(spread.is_finite() && spread > 0.0) {
        return Kept { compression: 1.0, ..Kept::default() };
    }
    let share = (noise_sd(v) / spread).powi(2).min(1.0);
    let quantisation = known.unwrap_or_else(|| step(v)) / spread;
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
        assert!((kept(&smooth, Some(0.25)).quantisation - 0.25 / sd(&smooth)).abs() < 1e-9);
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
}
