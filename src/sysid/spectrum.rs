//! Power spectra, and the part of a signal in a band of frequencies.

use nalgebra::Complex;
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

/// Plans of Fourier transforms: each length is planned once.
#[derive(Default)]
pub struct Transforms(RealFftPlanner<f64>);

/// A signal in the frequency domain, padded with zeros so that nothing wraps around.
///
/// ```text
/// X[j] = sum over k of x[k] exp(-2 pi i j k / m)     m: the least length from 2 n on that is 2^a or 3 2^a
/// ```
#[derive(Clone, Debug)]
pub struct Spectrum {
    /// `X[0]` … `X[m/2]`, in the unit of x.
    pub bins: Vec<Complex<f64>>,
    /// Samples of the signal, n.
    pub n: usize,
    /// Length of the transform, m.
    pub m: usize,
}

impl Transforms {
    /// Without a plan yet.
    pub fn new() -> Self {
        Self(RealFftPlanner::new())
    }

    /// The spectrum of `x`.
    pub fn spectrum(&mut self, x: &[f64]) -> Spectrum {
        let n = x.len();
        let m = padded(2 * n.max(1));
        let mut padded = x.to_vec();
        padded.resize(m, 0.0);
        let forward = self.0.plan_fft_forward(m);
        let mut bins = forward.make_output_vec();
        let done = forward.process(&mut padded, &mut bins);
        debug_assert!(done.is_ok());
        Spectrum { bins, n, m }
    }

    /// The autocovariance `a(l) = sum over k of x[k] x[k + l]`, l = 0 … n - 1, of a band of x.
    ///
    /// * `weight`: share of the power (0..1) that passes at a frequency (cycles per sample).
    pub fn autocovariance(&mut self, of: &Spectrum, weight: impl Fn(f64) -> f64) -> Vec<f64> {
        let at = |j: usize| j as f64 / of.m as f64;
        let power = of.bins.iter().enumerate().map(|(j, x)| Complex::new(weight(at(j)) * x.norm_sqr(), 0.0));
        self.back(power.collect(), of)
    }

    /// A band of x, n samples, without a shift in time (zero phase).
    ///
    /// * `weight`: share of the amplitude (0..1) that passes at a frequency (cycles per sample).
    pub fn filtered(&mut self, of: &Spectrum, weight: impl Fn(f64) -> f64) -> Vec<f64> {
        let at = |j: usize| j as f64 / of.m as f64;
        let passed = of.bins.iter().enumerate().map(|(j, x)| x * weight(at(j)));
        self.back(passed.collect(), of)
    }

    /// The inverse transform, cut to the n samples of the signal.
    fn back(&mut self, mut bins: Vec<Complex<f64>>, of: &Spectrum) -> Vec<f64> {
        let inverse = self.0.plan_fft_inverse(of.m);
        // The first and the last bin of a real signal are real; the transform refuses the imaginary part that rounding leaves.
        let last = bins.len() - 1;
        (bins[0].im, bins[last].im) = (0.0, 0.0);
        let mut out = inverse.make_output_vec();
        let done = inverse.process(&mut bins, &mut out);
        debug_assert!(done.is_ok());
        out.truncate(of.n);
        out.iter_mut().for_each(|x| *x /= of.m as f64);
        out
    }
}

/// The least even `2^a` or `3 2^a` from `least` on.
fn padded(least: usize) -> usize {
    let two = least.max(2).next_power_of_two();
    if two >= 4 && 3 * (two / 4) >= least { 3 * (two / 4) } else { two }
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

    #[test]
    fn the_whole_spectrum_gives_the_plain_autocovariance_and_the_signal_back() {
        for n in [1, 2, 5, 48, 100] {
            let x: Vec<f64> = (0..n).map(|k| ((k * k) as f64).cos() - 0.1).collect();
            let mut transforms = Transforms::new();
            let spectrum = transforms.spectrum(&x);
            assert!(spectrum.m >= 2 * n && spectrum.m.is_multiple_of(2));
            let a = transforms.autocovariance(&spectrum, |_| 1.0);
            let plain = |lag: usize| -> f64 { x[..n - lag].iter().zip(&x[lag..]).map(|(a, b)| a * b).sum() };
            assert!(a.iter().enumerate().all(|(lag, a)| (a - plain(lag)).abs() < 1e-9 * n as f64), "{n}");
            let back = transforms.filtered(&spectrum, |_| 1.0);
            assert!(back.iter().zip(&x).all(|(a, b)| (a - b).abs() < 1e-12), "{n}");
        }
    }

    #[test]
    fn a_band_lets_its_own_wave_pass() {
        let wave = |k: usize, period: f64| (TAU * k as f64 / period).sin();
        let x: Vec<f64> = (0..600).map(|k| wave(k, 50.0) + wave(k, 6.0)).collect();
        let mut transforms = Transforms::new();
        let spectrum = transforms.spectrum(&x);
        let slow = transforms.filtered(&spectrum, |f| if f < 0.05 { 1.0 } else { 0.0 });
        // The edges of the record leak; inside, less than a twentieth of the fast wave is left.
        assert!((60..540).all(|k| (slow[k] - wave(k, 50.0)).abs() < 0.05));
    }
}
