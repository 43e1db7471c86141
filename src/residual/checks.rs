//! Tests of the remaining residual: whiteness, spectral lines, changes, dependence on the stem, and distribution.
//!
//! | test | statistic | fails above |
//! |---|---|---|
//! | whiteness | Ljung–Box ([`crate::sysid::whiteness`]) | its own limit |
//! | input, tags | largest of 20 correlations of e with the past of the stem or of a tag, times sqrt N | 3.7, for tags more |
//! | line | Fisher's g of the spectrum | probability below 1 % |
//! | change point | largest `abs sum (e - mean e)`, over `sd e sqrt N` | 1.63 |
//! | drift, direction, travel | correlation of e with time, the stem's direction, the square of its position, times sqrt N | 2.58 |
//! | variance | `ln` of the ratio of the variances of both halves, times `sqrt(N/8)` | 2.58 |
//! | tails | samples beyond 5 robust standard deviations | 2 + N/1000 |
//!
//! Chance fails each test in 1 % of records or less.

use super::findings::Test;
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::dot;
use crate::sysid::spectrum;
use crate::sysid::stats::{mean, median, sd};
use crate::sysid::whiteness::is_white;

/// Two-sided 99 % point of the normal distribution, for one statistic.
const ONE: f64 = 2.58;
/// The same for the largest of forty statistics; chance exceeds it with the twenty lags here in 0.4 % of records.
const MANY: f64 = 3.7;
/// Lags of the cross-correlations (samples).
const LAGS: usize = 20;

/// The tests that a residual fails; none where fewer than 60 samples count.
///
/// * `x`, `dir`: stem of the model, and the direction of its last move.
/// * `e`: the residual.
/// * `fitted`: number of fitted parameters, which the whiteness test takes off its degrees of freedom.
pub fn failed(data: &IdData, (x, dir): (&[f64], &[f64]), e: &[f64], fitted: usize) -> Vec<Test> {
    let from = data.first;
    let kept: Vec<f64> = (from..e.len()).filter(|&k| data.weight[k] > 0.0).map(|k| e[k]).collect();
    let spread = sd(&kept);
    if kept.len() < 60 || spread <= 0.0 {
        return Vec::new();
    }
    let n = kept.len() as f64;
    let mut out = Vec::new();
    let mut check = |test: Test, fails: bool| {
        if fails {
            out.push(test);
        }
    };
    check(Test::Whiteness, !is_white(&kept, fitted));
    check(Test::Input, largest_cross_correlation(e, x, from) > MANY);
    let tags = data.tags.iter().map(|(_, v)| largest_cross_correlation(e, v, from)).fold(0.0, f64::max);
    // The limit grows with the number of tags, because the largest of more statistics is larger by chance.
    check(Test::Tags, tags > MANY + 0.25 * (1.0 + data.tags.len() as f64).ln());
    check(Test::Line, fisher(&kept) < 0.01);
    let total: f64 = mean(&kept);
    let mut sum = 0.0;
    let largest = kept
        .iter()
        .map(|e| {
            sum += e - total;
            sum.abs()
        })
        .fold(0.0, f64::max);
    // 99 % point of the largest excursion of a Brownian bridge.
    check(Test::ChangePoint, largest / (spread * n.sqrt()) > 1.63);
    let time: Vec<f64> = (0..kept.len()).map(|k| k as f64).collect();
    check(Test::Drift, correlation(&kept, &time).abs() * n.sqrt() > ONE);
    let tail = |v: &[f64]| v[from..].to_vec();
    check(Test::Direction, correlation(&tail(e), &tail(dir)).abs() * n.sqrt() > ONE);
    let squares: Vec<f64> = tail(x).iter().map(|z| z * z).collect();
    check(Test::Travel, correlation(&tail(e), &squares).abs() * n.sqrt() > ONE);
    let half = kept.len() / 2;
    let (a, b) = (sd(&kept[..half]).powi(2), sd(&kept[half..]).powi(2));
    check(Test::Variance, (a.max(1e-300) / b.max(1e-300)).ln().abs() * (n / 8.0).sqrt() > ONE);
    let sizes: Vec<f64> = kept.iter().map(|e| e.abs()).collect();
    let far = 5.0 * median(&sizes) / 0.6745;
    check(Test::Tails, kept.iter().filter(|e| e.abs() > far).count() as f64 > 2.0 + 1e-3 * n);
    out
}

/// The largest correlation of e with past values of v, in standard errors.
fn largest_cross_correlation(e: &[f64], v: &[f64], from: usize) -> f64 {
    let n = e.len();
    let rows = (n - from) as f64;
    let centre = mean(&v[from..]);
    let v: Vec<f64> = v.iter().map(|v| v - centre).collect();
    let power = (dot(&e[from..], &e[from..]) * dot(&v[from..], &v[from..])).sqrt();
    let at = |lag: usize| (dot(&e[from..], &v[from - lag..n - lag]) / power.max(1e-300)).abs() * rows.sqrt();
    (1..=LAGS).map(at).fold(0.0, f64::max)
}

/// The correlation of two signals; 0 where one does not move.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (ma, mb) = (mean(a), mean(b));
    let cross: f64 = a.iter().zip(b).map(|(x, y)| (x - ma) * (y - mb)).sum();
    let power = sd(a) * sd(b) * a.len() as f64;
    if power > 0.0 { cross / power } else { 0.0 }
}

/// Fisher's test: the probability that the largest line of white noise has as large a share of the power as that of `v`.
fn fisher(v: &[f64]) -> f64 {
    let power = spectrum::power(&mut v.to_vec());
    let power = &power[1..];
    let share = power.iter().copied().fold(0.0, f64::max) / power.iter().sum::<f64>().max(1e-300);
    // The first term of Fisher's sum: exact in the tail.
    let m = power.len() as f64;
    (m * (1.0 - share).max(0.0).powf(m - 1.0)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn noise(seed: u64, n: usize) -> Vec<f64> {
        let rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        StandardNormal.sample_iter(rng).take(n).collect()
    }

    #[test]
    fn fishers_g_sees_a_line_and_is_calm_without() {
        let alarms = (0..200).filter(|seed| fisher(&noise(*seed, 400)) < 0.01).count();
        // 1 % of 200 is 2; more than six would have a chance below 1 %.
        assert!(alarms <= 6, "{alarms}");
        let line: Vec<f64> =
            noise(1, 400).iter().enumerate().map(|(k, e)| e + (0.4 * k as f64).sin()).collect();
        assert!(fisher(&line) < 1e-3);
    }

    #[test]
    fn only_the_past_of_a_tag_counts() {
        let tag = noise(3, 500);
        let caused: Vec<f64> = (0..500).map(|k: usize| tag[k.saturating_sub(3)]).collect();
        let causing: Vec<f64> = (0..500).map(|k: usize| tag[(k + 3).min(499)]).collect();
        assert!(largest_cross_correlation(&caused, &tag, 40) > 15.0);
        assert!(largest_cross_correlation(&causing, &tag, 40) < MANY);
    }
}
