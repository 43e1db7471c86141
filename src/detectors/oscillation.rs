//! Whether OP oscillates regularly, and how fast: by the zero crossings of its autocovariance, in which noise stands at lag 0
//! alone. `diagnosis::region` asks the same of the zero crossings of OP itself, which needs fewer periods; the larger r counts.
//!
//! ```text
//! a(l) = sum c[k] c[k + l]           c: OP less its mean over two typical periods around each sample
//! r = mean(T) / (3 sd(T))            T: the first ten intervals between zero crossings of a (samples); r > 1 is regular
//! period = 2 mean(T)
//! ```
//!
//! Source: Thornhill, Huang & Zhang, J. Process Control 2003, 13, 91; the threshold is theirs. Chosen here: six
//! intervals are enough where the record has no ten, and the lags end at half the record.

use super::half_cycles::centre;
use crate::sysid::least_squares::dot;
use crate::sysid::stats::{mean, sd};

/// r from which an oscillation is regular (-).
pub const REGULAR: f64 = 1.0;
/// Intervals between zero crossings that are judged, and fewest of them.
const INTERVALS: usize = 10;
const LEAST_INTERVALS: usize = 6;

/// A regular oscillation, or none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle {
    /// Period (samples).
    pub period: f64,
    /// r (-).
    pub regularity: f64,
}

/// The oscillation of `u`, whose typical period is about so many samples; none with too few zero crossings.
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
    // A perfectly regular record stays a number.
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
