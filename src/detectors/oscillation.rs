//! The oscillation of OP, its period and its regularity r, by the zero crossings of its autocovariance: white noise enters that at lag 0
//! alone. `diagnosis::region` computes the same from the zero crossings of OP itself, which needs fewer periods; [`super::Facts`] takes
//! the one with the larger r.
//!
//! ```text
//! a(l) = sum c[k] c[k + l]           c: OP less its mean over two typical periods around each sample
//! r = mean(T) / (3 sd(T))            T: the first ten intervals between zero crossings of a (samples); r > 1 is regular
//! period = 2 mean(T)
//! ```
//!
//! Source: Thornhill, Huang & Zhang, J. Process Control 2003, 13, 91, with their threshold. Chosen here: six intervals are enough where
//! the record has no ten, and the lags end at half the record.

use super::half_cycles::centre;
use crate::sysid::least_squares::dot;
use crate::sysid::stats::{mean, sd};

/// r from which an oscillation is regular (-).
pub const REGULAR: f64 = 1.0;
/// Most intervals between zero crossings that are used.
const INTERVALS: usize = 10;
/// Fewest of them.
const LEAST_INTERVALS: usize = 6;

/// An oscillation, regular or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle {
    /// Period (samples).
    pub period: f64,
    /// Regularity r (-): above [`REGULAR`] it is regular.
    pub regularity: f64,
}

/// The oscillation of `u`; none with too few zero crossings. `typical`: its period, roughly (samples).
pub fn cycle(u: &[f64], typical: f64) -> Option<Cycle> {
    let c = centre(u, 2.0 * typical);
    let n = c.len();
    let mut crossings = Vec::new();
    let mut before = dot(&c, &c);
    for lag in 1..n / 2 {
        let now = dot(&c[..n - lag], &c[lag..]);
        if (now > 0.0) != (before > 0.0) {
            crossings.push((lag - 1) as f64 + before / (before - now));
        }
        if crossings.len() > INTERVALS {
            break;
        }
        before = now;
    }
    let intervals: Vec<f64> = crossings.windows(2).map(|w| w[1] - w[0]).collect();
    if intervals.len() < LEAST_INTERVALS {
        return None;
    }
    let m = mean(&intervals);
    // The spread of equal intervals is 0: r stays finite.
    Some(Cycle { period: 2.0 * m, regularity: m / (3.0 * sd(&intervals)).max(1e-3 * m) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn noise_does_not_hide_a_sine_and_is_none() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(2));
        let noise: Vec<f64> = (0..1000).map(|_| draw.next().unwrap_or(0.0)).collect();
        let wave: Vec<f64> =
            noise.iter().enumerate().map(|(k, e)| (TAU * k as f64 / 47.0).sin() + 0.3 * e).collect();
        let found = cycle(&wave, 45.0).expect("oscillates");
        assert!((found.period - 47.0).abs() < 0.5 && found.regularity > 3.0, "{found:?}");
        assert!(cycle(&noise, 45.0).is_none_or(|found| found.regularity < REGULAR));
        assert_eq!(cycle(&[], 10.0), None);
    }
}
