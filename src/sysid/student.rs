//! The distribution of the errors of every model: independent, of Student's t, so that a few huge errors cost little.
//!
//! ```text
//! ln L = sum over k of w_k (c(nu) - ln s - (nu + 1)/2 ln(1 + e_k^2 / (nu s^2)))
//! c(nu) = ln Gamma((nu + 1)/2) - ln Gamma(nu/2) - ln(nu pi)/2
//! omega_k = w_k (nu + 1) / (nu + e_k^2 / s^2)      weights of the equivalent least squares
//! ```
//!
//! | symbol | what it is | unit |
//! |---|---|---|
//! | `e` | prediction errors | normalised PV |
//! | `w` | 1 where a sample counts, else 0 | – |
//! | `s` | scale of the errors, estimated | normalised PV |
//! | `nu` | degrees of freedom, estimated among 1.5, 2.5, 5, 10 and 30 | – |
//!
//! Source: Lange, Little & Taylor, J. Am. Stat. Assoc. 1989, 84, 881.

use super::least_squares::total;

/// Degrees of freedom nu that a fit begins with, and those of data quality, where nu is not estimated (-): heavy enough for slips
/// that come a sample early, 90 % efficient where errors are normal.
pub const FREEDOM: f64 = 5.0;
/// Degrees of freedom nu that are tried (-), each with its c(nu): a stem that is nearly right leaves the heaviest tails.
const FREEDOMS: [(f64, f64); 5] = [
    (1.5, -1.076650285),
    (2.5, -1.016639593),
    (5.0, -0.968619589),
    (10.0, -0.943897352),
    (30.0, -0.927270325),
];
/// Least scale s of errors of a normalised PV: below it rounding decides.
const LEAST_SCALE: f64 = 3e-7;
/// Most passes of the fixed-point iteration for the scale.
const PASSES: usize = 6;
/// Relative change of s^2 below which its estimate is settled: the likelihood is flat there, to 1e-6 of a nat a sample.
const SETTLED: f64 = 1e-3;
/// Factors multiplied before one logarithm is taken.
const FACTORS: usize = 16;
/// Largest factor: sixteen of them are finite.
const MOST_FACTOR: f64 = 1e18;

/// The scale s that maximises the likelihood at a given `nu`, by the fixed point `s^2 = sum omega e^2 / sum w`.
///
/// * `guess`: where the iteration starts.
/// * `least`: lower bound of s, as that from rounding of PV.
pub fn scale(e: &[f64], weight: &[f64], guess: f64, nu: f64, least: f64) -> f64 {
    let count = total(weight);
    let least = least.max(LEAST_SCALE);
    let mut s2 = guess.max(least).powi(2);
    for _ in 0..PASSES {
        let sum = weighted_power(e, weight, 1.0 / s2, nu);
        let next = ((nu + 1.0) * sum / count.max(1.0)).max(least * least);
        let settled = (next / s2 - 1.0).abs() < SETTLED;
        s2 = next;
        if settled {
            break;
        }
    }
    s2.sqrt()
}

/// `sum of w e^2 / (nu + per e^2)`, with `per = 1 / s^2`.
#[multiversion::multiversion(targets("x86_64+avx2"))]
fn weighted_power(e: &[f64], weight: &[f64], per: f64, nu: f64) -> f64 {
    let mut sums = [0.0; 8];
    let (e8, e_rest) = e.as_chunks::<8>();
    let (w8, w_rest) = weight.as_chunks::<8>();
    for (e, w) in e8.iter().zip(w8) {
        for i in 0..8 {
            let square = e[i] * e[i];
            sums[i] += w[i] * square / (nu + per * square);
        }
    }
    let rest = e_rest.iter().zip(w_rest).map(|(e, w)| w * e * e / (nu + per * e * e));
    sums.iter().sum::<f64>() + rest.sum::<f64>()
}

/// A first guess of the scale: the weighted mean of the absolute errors.
pub fn first_scale(e: &[f64], weight: &[f64]) -> f64 {
    let count = total(weight);
    let sum: f64 = e.iter().zip(weight).map(|(e, w)| w * e.abs()).sum();
    (sum / count.max(1.0)).max(LEAST_SCALE)
}

/// c(nu), the logarithm of the density's constant, for a nu of [`FREEDOMS`]; for another nu that of the next one below.
fn log_constant(nu: f64) -> f64 {
    FREEDOMS.iter().rev().find(|(known, _)| *known <= nu).unwrap_or(&FREEDOMS[0]).1
}

/// The maximum-likelihood estimates of the scale s and the degrees of freedom nu, and the log-likelihood: `(s, nu, ln L)`.
///
/// The likelihood has one maximum in nu. From the nu of `near` on its neighbours are tried, while the likelihood rises.
///
/// * `near`: the s and the nu to begin with; nu = 0 where none is known.
/// * `least`: lower bound of s.
pub fn tails(e: &[f64], weight: &[f64], near: (f64, f64), least: f64) -> (f64, f64, f64) {
    let estimated = |at: usize, guess: f64| {
        let nu = FREEDOMS[at].0;
        let s = scale(e, weight, guess, nu, least);
        (s, nu, log_likelihood(e, weight, s, nu))
    };
    let begun = if near.1 > 0.0 { near.1 } else { FREEDOM };
    let from = FREEDOMS.iter().rposition(|(nu, _)| *nu <= begun).unwrap_or(0);
    // From a guess that is far off, one estimate of the scale does not converge, and the next nu would seem better. So it is
    // estimated twice.
    let mut best = estimated(from, scale(e, weight, near.0, begun, least));
    for side in [(from + 1..FREEDOMS.len()).collect::<Vec<_>>(), (0..from).rev().collect()] {
        for at in side {
            let next = estimated(at, best.0);
            if next.2.total_cmp(&best.2).is_le() {
                break;
            }
            best = next;
        }
    }
    best
}

/// The log-likelihood `ln L` of the errors at scale `s` with `nu` degrees of freedom.
///
/// * `nu`: 1.5, 2.5, 5, 10 or 30, for which c(nu) is known.
pub fn log_likelihood(e: &[f64], weight: &[f64], s: f64, nu: f64) -> f64 {
    let count = total(weight);
    let per = 1.0 / (nu * s * s);
    let mut sum = 0.0;
    for (e, w) in e.chunks(FACTORS).zip(weight.chunks(FACTORS)) {
        let product: f64 = e.iter().zip(w).map(|(e, w)| 1.0 + w * (per * e * e).min(MOST_FACTOR)).product();
        sum += product.ln();
    }
    count * (log_constant(nu) - s.ln()) - 0.5 * (nu + 1.0) * sum
}

/// Computes the weights `omega_k` of the equivalent least squares, divided by `(nu + 1) / (FREEDOM + 1)`.
///
/// The factor is the same for all samples, and no caller depends on it.
///
/// * `omega`: receives the weights.
pub fn reweigh(e: &[f64], weight: &[f64], (s, nu): (f64, f64), omega: &mut [f64]) {
    let per = 1.0 / (s * s);
    for ((omega, e), w) in omega.iter_mut().zip(e).zip(weight) {
        *omega = w * (FREEDOM + 1.0) / (nu + per * e * e);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_distr::{Distribution, StudentT};

    #[test]
    fn the_scale_is_found_and_is_the_best() {
        let t = StudentT::new(FREEDOM).expect("degrees of freedom above 0");
        let e: Vec<f64> =
            t.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(3)).take(20_000).map(|e| 0.3 * e).collect();
        let weight = vec![1.0; e.len()];
        let s = scale(&e, &weight, first_scale(&e, &weight), FREEDOM, 0.0);
        // One standard error of the scale is about 0.0018 here.
        assert!((s - 0.3).abs() < 0.006, "{s}");
        let best = log_likelihood(&e, &weight, s, FREEDOM);
        assert!(
            best > log_likelihood(&e, &weight, 0.98 * s, FREEDOM)
                && best > log_likelihood(&e, &weight, 1.02 * s, FREEDOM)
        );
    }

    #[test]
    fn the_tails_are_those_of_the_errors() {
        for nu in [1.5, 5.0] {
            let t = StudentT::new(nu).expect("degrees of freedom above 0");
            let e: Vec<f64> = t.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(5)).take(20_000).collect();
            let (s, found, _) = tails(&e, &vec![1.0; e.len()], (1.0, 0.0), 0.0);
            assert!(found == nu && (s - 1.0).abs() < 0.05, "{found} {s} for {nu}");
        }
        // Densities integrate to one.
        for (nu, c) in FREEDOMS {
            let density = |e: f64| (c - 0.5 * (nu + 1.0) * (e * e / nu).ln_1p()).exp();
            let sum: f64 = (-2_000_000..2_000_000).map(|i| 1e-3 * density(1e-3 * f64::from(i))).sum();
            // Tails beyond 2,000 hold less than 1e-4 for nu = 1.5.
            assert!((sum - 1.0).abs() < 1e-4, "{nu}: {sum}");
        }
    }

    #[test]
    fn samples_are_counted_to_the_last_bit() {
        for n in [0, 1, 7, 8, 9, 17, 513, 1535] {
            let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(n);
            let e: Vec<f64> = (0..n).map(|_| rng.random::<f64>() - 0.5).collect();
            let weight: Vec<f64> =
                (0..n).map(|_| if rng.random::<f64>() < 0.8 { 1.0 } else { 0.0 }).collect();
            // One by one.
            let count: f64 = weight.iter().fold(0.0, |sum, w| sum + w);
            let absolute: f64 = e.iter().zip(&weight).map(|(e, w)| w * e.abs()).sum();
            let first = (absolute / count.max(1.0)).max(LEAST_SCALE);
            assert_eq!(first_scale(&e, &weight).to_bits(), first.to_bits(), "{n}");
            // Errors of 0 cost nothing, and ln 1 is 0: the count is left.
            let none = vec![0.0; e.len()];
            let found = log_likelihood(&none, &weight, 1.0, FREEDOM);
            assert_eq!(found.to_bits(), (count * log_constant(FREEDOM)).to_bits(), "{n}");
            // Errors of one size have that size for their scale.
            let halves = scale(&vec![0.5; e.len()], &weight, 0.5, FREEDOM, 0.0);
            assert!(count == 0.0 || (halves - 0.5).abs() < 1e-12, "{n}: {halves}");
        }
    }

    #[test]
    fn a_sample_that_does_not_count_changes_nothing() {
        let (e, weight) = ([0.1, -0.2, 50.0, 0.3], [1.0, 1.0, 0.0, 1.0]);
        let plain: f64 = [0.1f64, -0.2, 0.3]
            .iter()
            .map(|e| log_constant(5.0) - (0.2f64).ln() - 3.0 * (e * e / (5.0 * 0.04)).ln_1p())
            .sum();
        assert!((log_likelihood(&e, &weight, 0.2, FREEDOM) - plain).abs() < 1e-12);
    }
}
