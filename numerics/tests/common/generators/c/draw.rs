//! Random numbers and random signals, all of which follow from the case.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

use super::super::Case;

/// Start value of the hash over a case's fields (FNV-1a, 64 bit).
const HASH_START: u64 = 0xcbf2_9ce4_8422_2325;
/// Multiplier of the hash (FNV-1a, 64 bit).
const HASH_FACTOR: u64 = 0x0000_0100_0000_01b3;
/// Samples that a coloured signal runs before it is used.
const RUN_IN: usize = 300;

/// A source of random numbers.
pub struct Draw(Pcg64Mcg);

impl Draw {
    /// The source for a case; `stream` parts sources that must not depend on each other.
    pub fn new(case: &Case, stream: u64) -> Self {
        let effect = case.effect.map_or(0, |kind| kind as u64 + 1);
        let fields =
            [effect, case.size as u64, case.variant as u64, case.seed, case.tags as u64, stream, 0x0c];
        let bytes = fields.iter().flat_map(|field| field.to_le_bytes());
        let hash = bytes.fold(HASH_START, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(HASH_FACTOR));
        Self(Pcg64Mcg::seed_from_u64(hash))
    }

    /// Even between `low` and `high`.
    pub fn even(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Even on a logarithmic scale between `low` and `high`.
    pub fn log(&mut self, low: f64, high: f64) -> f64 {
        self.even(low.ln(), high.ln()).exp()
    }

    /// True with the probability `p`.
    pub fn chance(&mut self, p: f64) -> bool {
        self.0.random::<f64>() < p
    }

    /// +1 or −1.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// A whole number from `low` to `high`, both included.
    pub fn whole(&mut self, low: usize, high: usize) -> usize {
        self.0.random_range(low..=high)
    }

    /// A normal number of mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// White noise of standard deviation 1.
    pub fn white(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.normal()).collect()
    }

    /// First-order coloured noise of standard deviation 1; `tau` in samples.
    pub fn coloured(&mut self, n: usize, tau: f64) -> Vec<f64> {
        let a = (-1.0 / tau).exp();
        let b = (1.0 - a * a).sqrt();
        let mut y = self.normal();
        (0..n)
            .map(|_| {
                y = a * y + b * self.normal();
                y
            })
            .collect()
    }

    /// Second-order coloured noise of standard deviation 1 in the sample; `period` in samples.
    pub fn resonant(&mut self, n: usize, period: f64, damping: f64) -> Vec<f64> {
        let w = std::f64::consts::TAU / period;
        let r = (-damping * w).exp();
        let (a1, a2) = (2.0 * r * (w * (1.0 - damping * damping).sqrt()).cos(), -r * r);
        let (mut y1, mut y2) = (0.0, 0.0);
        let mut out = Vec::with_capacity(n);
        for k in 0..RUN_IN + n {
            let y = a1 * y1 + a2 * y2 + self.normal();
            (y1, y2) = (y, y1);
            if k >= RUN_IN {
                out.push(y);
            }
        }
        let sd = deviation(&out);
        out.iter_mut().for_each(|y| *y /= sd);
        out
    }

    /// Levels that change at random times, about every `hold` samples; levels are even between −1 and 1.
    pub fn steps(&mut self, n: usize, hold: f64) -> Vec<f64> {
        let mut level = self.even(-1.0, 1.0);
        (0..n)
            .map(|_| {
                if self.chance(1.0 / hold) {
                    level = self.even(-1.0, 1.0);
                }
                level
            })
            .collect()
    }

    /// Levels between −1 and 1, held for about `hold` samples and joined by ramps of `ramp` samples.
    pub fn moves(&mut self, n: usize, hold: f64, ramp: f64) -> Vec<f64> {
        let mut level = 0.0;
        let mut target = 0.0;
        let mut wait = self.even(0.2, 1.0) * hold;
        let mut rate = 1.0;
        (0..n)
            .map(|_| {
                wait -= 1.0;
                if wait < 0.0 {
                    wait = self.even(0.5, 1.5) * hold + ramp;
                    // The next level lies on the other side more often than not.
                    let side = if target > 0.0 { -1.0 } else { 1.0 };
                    target = if self.chance(0.7) { side * self.even(0.4, 1.0) } else { self.even(-1.0, 1.0) };
                    rate = (target - level).abs() / ramp.max(1.0);
                }
                level += (target - level).clamp(-rate, rate);
                level
            })
            .collect()
    }
}

/// First-order lag of `tau` samples.
pub fn lagged(signal: &[f64], tau: f64) -> Vec<f64> {
    let a = 1.0 - (-1.0 / tau.max(1e-3)).exp();
    let mut y = signal.first().copied().unwrap_or(0.0);
    signal
        .iter()
        .map(|&u| {
            y += a * (u - y);
            y
        })
        .collect()
}

/// Root mean square.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Standard deviation.
pub fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Largest absolute value.
pub fn peak(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, v| most.max(v.abs()))
}
