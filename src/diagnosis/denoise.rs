//! Wavelet denoising of OP by a soft threshold (db4, periodised on a mirrored record), and the estimate of its noise.
//!
//! ```text
//! sigma = median |d1| / 0.6745          d1: finest detail coefficients
//! d <- sign(d) max(|d| - sigma sqrt(2 ln N), 0)
//! ```
//!
//! Source: Donoho, IEEE Trans. Inf. Theory 1995, 41, 613. db4 is orthonormal with four vanishing moments.

use crate::sysid::stats::median;

/// Low-pass filter of the db4 wavelet: orthonormal, and with four vanishing moments, so that a smooth OP leaves no details.
const LOW: [f64; 8] = [
    -0.010_597_401_785_069_032,
    0.032_883_011_666_885_2,
    0.030_841_381_835_560_764,
    -0.187_034_811_719_093_1,
    -0.027_983_769_416_859_854,
    0.630_880_767_929_858_9,
    0.714_846_570_552_915_6,
    0.230_377_813_308_896_5,
];

/// Number of levels that are thresholded: they hold periods up to 32 samples; slower ones are the oscillation.
const LEVELS: usize = 4;

/// Standard deviation of the white noise in `v`, from its finest detail coefficients (unit of v).
pub fn noise_sd(v: &[f64]) -> f64 {
    if v.len() < 16 {
        return 0.0;
    }
    let even = &v[..v.len() & !1];
    let (_, detail) = analyse(even);
    // The wrap-around of the periodised transform touches the last coefficients only.
    let inner: Vec<f64> = detail[..detail.len() - LOW.len() / 2].iter().map(|d| d.abs()).collect();
    median(&inner) / 0.6745
}

/// `v` without its white noise, by a soft threshold; `v` itself where it is too short.
pub fn denoise(v: &[f64]) -> Vec<f64> {
    let n = v.len();
    if n < 1 << (LEVELS + 1) {
        return v.to_vec();
    }
    let threshold = noise_sd(v) * (2.0 * (n as f64).ln()).sqrt();
    let block = 1 << LEVELS;
    // The mirror image removes the jump between the record's end and its start.
    let mut approximation: Vec<f64> = v.iter().chain(v.iter().rev()).copied().collect();
    while !approximation.len().is_multiple_of(block) {
        approximation.push(v[0]);
    }
    let mut details = Vec::with_capacity(LEVELS);
    for _ in 0..LEVELS {
        let (low, mut high) = analyse(&approximation);
        for d in &mut high {
            *d = d.signum() * (d.abs() - threshold).max(0.0);
        }
        details.push(high);
        approximation = low;
    }
    for high in details.iter().rev() {
        approximation = synthesise(&approximation, high);
    }
    approximation.truncate(n);
    approximation
}

/// One level of the periodised transform: (approximation, detail), each half as long. Even length only.
fn analyse(v: &[f64]) -> (Vec<f64>, Vec<f64>) {
    let n = v.len();
    let half = n / 2;
    let (mut low, mut high) = (vec![0.0; half], vec![0.0; half]);
    for (k, (low, high)) in low.iter_mut().zip(&mut high).enumerate() {
        for (j, tap) in LOW.iter().enumerate() {
            let x = v[(2 * k + j) % n];
            *low += tap * x;
            *high += high_pass(j) * x;
        }
    }
    (low, high)
}

/// The inverse of [`analyse`]: its transpose, the transform being orthonormal.
fn synthesise(low: &[f64], high: &[f64]) -> Vec<f64> {
    let n = 2 * low.len();
    let mut v = vec![0.0; n];
    for (k, (low, high)) in low.iter().zip(high).enumerate() {
        for (j, tap) in LOW.iter().enumerate() {
            v[(2 * k + j) % n] += tap * low + high_pass(j) * high;
        }
    }
    v
}

/// The quadrature mirror of [`LOW`].
fn high_pass(j: usize) -> f64 {
    let sign = if j.is_multiple_of(2) { 1.0 } else { -1.0 };
    sign * LOW[LOW.len() - 1 - j]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::stats::{sd, variance};
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn noise(n: usize, seed: u64) -> Vec<f64> {
        let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
        StandardNormal.sample_iter(&mut rng).take(n).collect()
    }

    #[test]
    fn filters_are_orthonormal() {
        for shift in 0..4 {
            let low: f64 = (2 * shift..8).map(|j| LOW[j] * LOW[j - 2 * shift]).sum();
            let cross: f64 = (2 * shift..8).map(|j| LOW[j] * high_pass(j - 2 * shift)).sum();
            // Published taps carry 16 digits.
            assert!((low - if shift == 0 { 1.0 } else { 0.0 }).abs() < 1e-11, "{shift}: {low}");
            assert!(cross.abs() < 1e-11);
        }
    }

    proptest! {
        #[test]
        fn synthesis_undoes_analysis(v in prop::collection::vec(-10.0..10.0f64, 16)) {
            let (low, high) = analyse(&v);
            for (a, b) in synthesise(&low, &high).iter().zip(&v) {
                prop_assert!((a - b).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_cubic_has_no_detail() {
        let v: Vec<f64> = (0..64)
            .map(|k| {
                let t = f64::from(k) / 64.0;
                1.0 + t - t * t + t * t * t
            })
            .collect();
        let (_, high) = analyse(&v);
        // Four vanishing moments annihilate a cubic, away from the wrap-around.
        assert!(high[..28].iter().all(|d| d.abs() < 1e-10));
    }

    #[test]
    fn estimates_the_noise_and_removes_most_of_it() {
        let n = 1000;
        let clean: Vec<f64> = (0..n).map(|k| (k as f64 * 0.1).sin()).collect();
        let noisy: Vec<f64> = clean.iter().zip(noise(n, 1)).map(|(c, e)| c + 0.2 * e).collect();
        // The median of 500 coefficients has a relative sd of about 5 %.
        assert!((noise_sd(&noisy) / 0.2 - 1.0).abs() < 0.15);
        assert!(noise_sd(&clean) < 0.01 * sd(&clean));
        let error: Vec<f64> = denoise(&noisy).iter().zip(&clean).map(|(a, b)| a - b).collect();
        assert!(variance(&error) < 0.3 * 0.04, "{}", variance(&error));
    }
}
