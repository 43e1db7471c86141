//! The Harris index: how near the error's variance is to the least that any controller could leave.
//!
//! ```text
//! e[k] = c + sum_{i=1}^{m} a_i e[k - d + 1 - i] + r[k]       by least squares
//! eta  = (sum r² / (n - m - 1)) / (sum (e - mean)² / (n - 1))
//! ```
//!
//! * `e` error of the loop (PV), `d` dead time in samples (one more than the process's own, since a sample passes before OP acts);
//! * `eta` 1: minimum variance; near 0: what is left could be foretold from before the dead time, and be controlled.
//!
//! Its confidence: the record is cut into blocks, and the blocks' own indices give the standard error of their mean (batch
//! means). What is least depends on the dead time alone, so that a wrong one gives a wrong index.
//!
//! Source: Harris, Can. J. Chem. Eng. 1989, 67, 856; Desborough & Harris, Can. J. Chem. Eng. 1992, 70, 1186 (regression).

use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::stats::{mean, sd, variance};

/// Lags of the error, m.
const LAGS: usize = 15;
/// Blocks that the confidence is taken from.
const BLOCKS: usize = 8;
/// Fewest rows of a regression, a lag.
const ROWS_A_LAG: usize = 6;
/// 97.5 % point of Student's t with seven degrees of freedom.
const T_975: f64 = 2.365;
/// Lower end of the interval from which a loop is at its minimum variance (-): a tenth of the variance, a twentieth of the standard
/// deviation, is all that tuning could gain.
const LEAST: f64 = 0.9;

/// The index and its interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Harris {
    /// eta (0..1).
    pub index: f64,
    /// 95 % interval; none where the record is too short for blocks.
    pub interval: Option<(f64, f64)>,
}

impl Harris {
    /// Whether the error is as small as a controller can make it, by the whole interval: then tuning gains nothing. An index for one
    /// sample is enough for that, because that for a longer dead time is larger.
    pub fn is_at_minimum(&self) -> bool {
        self.interval.is_some_and(|(low, _)| low >= LEAST)
    }
}

/// The dead time of the index (samples) at a sample period of `ts` (s), where the process's own is `own_s` (s): one sample more than
/// the whole number that is nearest to it, and one sample where its own is not known.
pub fn samples(own_s: Option<f64>, ts: f64) -> usize {
    // No record is so long that more would make a difference.
    1 + own_s.map_or(0.0, |own_s| (own_s / ts).round()).clamp(0.0, f64::from(u16::MAX)) as usize
}

/// The index of the errors `e` with a dead time of `dead` samples (at least 1); none where the record is too short or does not move.
pub fn harris(e: &[f64], dead: usize) -> Option<Harris> {
    let index = index(e, dead.max(1))?;
    let blocks: Vec<f64> =
        e.chunks_exact(e.len() / BLOCKS).filter_map(|e| self::index(e, dead.max(1))).collect();
    let interval = (blocks.len() >= BLOCKS).then(|| {
        let half = T_975 * sd(&blocks) / ((blocks.len() - 1) as f64).sqrt();
        ((index - half).max(0.0), (index + half).min(1.0))
    });
    Some(Harris { index, interval })
}

fn index(e: &[f64], dead: usize) -> Option<f64> {
    let first = dead + LAGS - 1;
    let rows = e.len().checked_sub(first).filter(|rows| *rows >= ROWS_A_LAG * LAGS)?;
    let level = mean(e);
    let e: Vec<f64> = e.iter().map(|e| e - level).collect();
    let whole = variance(&e);
    if !(whole.is_finite() && whole > 1e-20 * level * level && whole > 0.0) {
        return None;
    }
    let ones = vec![1.0; rows];
    let column = |i: usize| if i < LAGS { &e[first - dead - i..][..rows] } else { &ones[..] };
    let size = LAGS + 1;
    let target = &e[first..];
    let (mut gram, mut right) = (vec![0.0; size * size], vec![0.0; size]);
    for i in 0..size {
        right[i] = dot(column(i), target);
        for j in 0..=i {
            gram[i * size + j] = dot(column(i), column(j));
        }
    }
    let mut live = [true; MOST_COLUMNS];
    factor(&mut gram, size, size, &mut live);
    let mut theta = right.clone();
    substitute(&gram, size, &live, &mut theta);
    let left = (dot(target, target) - dot(&theta, &right)).max(0.0) / (rows - size) as f64;
    Some((left / variance(target)).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn noise(n: usize) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(5)).take(n).collect()
    }

    #[test]
    fn minimum_variance_is_one_and_first_order_noise_is_what_theory_says() {
        let white = noise(8000);
        // Moving average of two: nothing of it is known two samples before.
        let least: Vec<f64> = white.windows(2).map(|w| w[1] + 0.7 * w[0]).collect();
        let found = harris(&least, 2).expect("long enough");
        assert!(found.index > 0.98, "{found:?}");
        // One sample before, 0.7 of the last one is known: 1 of 1.49 is left.
        let found = harris(&least, 1).expect("long enough");
        assert!((found.index - 1.0 / 1.49).abs() < 0.04, "{found:?}");
        let mut x = 0.0;
        let coloured: Vec<f64> = white
            .iter()
            .map(|e| {
                x = 0.9 * x + e;
                x
            })
            .collect();
        for dead in [1, 3, 6] {
            // 1 - phi^(2 d) of the variance is younger than d samples.
            let theory = 1.0 - 0.9f64.powi(2 * dead);
            let found = harris(&coloured, dead as usize).expect("long enough");
            let (low, high) = found.interval.expect("blocks");
            // 8,000 samples with a correlation time of ten: two standard errors are 5 %.
            assert!((found.index - theory).abs() < 0.05, "{dead}: {found:?} {theory}");
            assert!(low < theory && theory < high, "{dead}: {found:?} {theory}");
        }
    }

    #[test]
    fn a_loop_is_at_its_minimum_where_the_whole_interval_is_near_one() {
        let of = |interval| Harris { index: 0.95, interval };
        assert!(of(Some((0.92, 1.0))).is_at_minimum());
        assert!(!of(Some((0.8, 1.0))).is_at_minimum(), "a fifth of the variance may be left to gain");
        assert!(!of(None).is_at_minimum(), "too short to say");
        assert!(harris(&noise(8000), 1).is_some_and(|own| own.is_at_minimum()));
    }

    #[test]
    fn a_dead_time_is_as_many_samples_as_come_in_it_and_one_more() {
        assert_eq!([Some(0.0), Some(3.0), Some(3.1), None].map(|own_s| samples(own_s, 1.0)), [1, 4, 4, 1]);
        // As a model at 10 s has it, and at other sample periods.
        assert_eq!([5.0, 10.0, 10.02, 60.0].map(|ts| samples(Some(20.0), ts)), [5, 3, 3, 1]);
        assert_eq!([f64::NAN, -5.0].map(|own_s| samples(Some(own_s), 1.0)), [1; 2]);
        assert_eq!(harris(&noise(500), samples(Some(f64::INFINITY), 1.0)), None);
    }

    #[test]
    fn a_wave_could_be_controlled_and_nothing_is_nothing() {
        let wave: Vec<f64> =
            noise(2000).iter().enumerate().map(|(k, e)| (0.1 * k as f64).sin() + 0.05 * e).collect();
        assert!(harris(&wave, 5).expect("long enough").index < 0.05);
        assert_eq!(harris(&[], 1), None);
        assert_eq!(harris(&[2.0; 500], 1), None);
        assert_eq!(harris(&noise(50), 1), None);
    }
}
