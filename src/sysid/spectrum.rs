//! The power spectrum.

use realfft::RealFftPlanner;

/// `|sum over k of x[k] exp(-2 pi i j k / n)|²` for j = 0 … n/2, in the square of x's unit; takes x as scratch.
pub fn power(x: &mut [f64]) -> Vec<f64> {
    let forward = RealFftPlanner::<f64>::new().plan_fft_forward(x.len());
    let mut bins = forward.make_output_vec();
    // Its only error is a length that the plan does not have.
    let done = forward.process(x, &mut bins);
    debug_assert!(done.is_ok());
    bins.iter().map(|bin| bin.norm_sqr()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn it_is_the_sum_it_stands_for() {
        for n in [1, 2, 7, 12, 64] {
            let x: Vec<f64> = (0..n).map(|k| ((k * k) as f64).sin() + 0.3).collect();
            let found = power(&mut x.clone());
            assert_eq!(found.len(), n / 2 + 1);
            for (j, found) in found.into_iter().enumerate() {
                let turn = |k: usize| TAU * (j * k) as f64 / n as f64;
                let re: f64 = x.iter().enumerate().map(|(k, x)| x * turn(k).cos()).sum();
                let im: f64 = x.iter().enumerate().map(|(k, x)| x * turn(k).sin()).sum();
                assert!((found - re * re - im * im).abs() < 1e-9 * n as f64, "{n} {j}");
            }
        }
    }
}
