//! Which of two loops swings later, and by how much, by the slope of the phase of their cross spectrum over a band.
//!
//! ```text
//! delay = sum w (f - mean f)(phase - mean phase) / (2 pi sum w (f - mean f)²)
//! error = sd(phase) / (2 pi sd(f))          sd(phase) = sqrt((1 - gamma²) / (2 n gamma²))
//! ```
//!
//! w: magnitude of the cross spectrum in a bin; f: frequency (Hz), sd(f) weighted by w; phase: that of the cross spectrum, relative to
//! S_ab (rad); gamma²: coherence in the band (-, [`super::spectra`]); n: independent bins less the two numbers that are fitted to their
//! phases.
//!
//! The delay of two steady sines is known up to whole periods only: their band has one frequency, and its phase no slope. So a delay is
//! measured by how an oscillation comes and goes and changes its period.
//!
//! Source: Bendat & Piersol, Random Data, 2010, chapter 9 (standard deviation of a phase).

use super::spectra::{coherence, wide};
use nalgebra::Complex;
use std::f64::consts::PI;

/// How much later one loop swings than another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// Its delay against the other loop (s); below 0 where it swings earlier.
    pub delay_s: f64,
    /// Standard error of the delay (s); infinite where the delay cannot be measured.
    pub error_s: f64,
}

impl Lag {
    /// A delay that cannot be measured.
    pub const UNKNOWN: Self = Self { delay_s: 0.0, error_s: f64::INFINITY };

    /// Whether it is known which of the two loops comes first: the delay exceeds twice its standard error.
    pub fn is_known(&self) -> bool {
        self.delay_s.abs() > 2.0 * self.error_s
    }

    /// The lag of the other loop against this one.
    pub fn reversed(self) -> Self {
        Self { delay_s: -self.delay_s, ..self }
    }

    /// The lag of b against a, as [`delay`] with the number of `independent` bins given; not known where the slope and the level of the
    /// phase take all of them.
    pub fn of(a: &[Complex<f32>], b: &[Complex<f32>], step_hz: f64, independent: f64) -> Self {
        let free = independent - 2.0;
        let slope = PhaseSlope::of(a, b, step_hz).filter(|_| free > 0.0);
        slope.map_or(Self::UNKNOWN, |own| Self { delay_s: own.delay_s, error_s: own.error_s(free) })
    }
}

/// The delay of b against a (s), by the slope of the phase over the band, and its standard error (s).
///
/// `a`, `b`: their bins in a band; `step_hz`: distance of two bins (Hz).
pub fn delay(a: &[Complex<f32>], b: &[Complex<f32>], step_hz: f64) -> (f64, f64) {
    let Some(slope) = PhaseSlope::of(a, b, step_hz) else { return (0.0, f64::INFINITY) };
    // Half of the bins are independent, because the signals are padded to twice their length.
    let free = (0.5 * a.len() as f64 - 2.0).max(1.0);
    (slope.delay_s, slope.error_s(free))
}

/// The slope of the phase of two loops over a band.
struct PhaseSlope {
    /// The delay that it stands for (s).
    delay_s: f64,
    /// Coherence gamma² (-).
    gamma: f64,
    /// Standard deviation of the frequency, weighted by the magnitude of the cross spectrum (Hz).
    sd_hz: f64,
}

impl PhaseSlope {
    /// None where the band has no width.
    fn of(a: &[Complex<f32>], b: &[Complex<f32>], step_hz: f64) -> Option<Self> {
        let (gamma, cross) = coherence(a, b);
        let turn = cross.conj() / cross.norm().max(f64::MIN_POSITIVE);
        let (mut w0, mut w1, mut w2, mut p0, mut p1) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (k, (a, b)) in a.iter().zip(b).enumerate() {
            let cross = wide(*a) * wide(*b).conj() * turn;
            let (w, phase, f) = (cross.norm(), cross.arg(), k as f64 * step_hz);
            (w0, w1, w2, p0, p1) = (w0 + w, w1 + w * f, w2 + w * f * f, p0 + w * phase, p1 + w * phase * f);
        }
        let spread = w2 - w1 * w1 / w0.max(f64::MIN_POSITIVE);
        if spread.is_nan() || spread <= 0.0 {
            return None;
        }
        let delay_s = (p1 - p0 * w1 / w0) / spread / (2.0 * PI);
        Some(Self { delay_s, gamma, sd_hz: (spread / w0).sqrt() })
    }

    /// Standard error of the delay (s), by n bins ([`delay`]).
    fn error_s(&self, n: f64) -> f64 {
        let phase = ((1.0 - self.gamma).max(1e-6) / (2.0 * self.gamma.max(1e-6) * n)).sqrt();
        phase / (2.0 * PI * self.sd_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn which_loop_comes_first_is_known_where_the_delay_exceeds_twice_its_error() {
        let step_hz = 1e-3;
        // Sixteen bins: b is late, and the phase of each bin is off by the same angle, to either side in turn so that no slope comes of it.
        let late = |delay_s: f64, off: f64| -> Vec<Complex<f32>> {
            let bin = |k: usize| {
                let sign = [1.0, -1.0, -1.0, 1.0][k % 4];
                let turn = Complex::from_polar(1.0, -TAU * k as f64 * step_hz * delay_s);
                let bin = turn * Complex::new(1.0, off * sign);
                Complex::new(bin.re as f32, bin.im as f32)
            };
            (0..16).map(bin).collect()
        };
        let a = late(0.0, 0.0);
        // sd(f) is sqrt((16² - 1) / 12) = 4.6098 bins, and n is 8 - 2. By 45 degrees gamma² is 1/2: sd(phase) is sqrt(1 / 12) = 0.28868
        // rad, and the error 0.28868 / (2 pi 4.6098e-3). A delay of 10 s leaves 0.91887 of gamma² alone, and 0.45943 beside the angle.
        for (delay_s, off, error_s, is_known) in
            [(0.0, 1.0, 9.9667, false), (10.0, 1.0, 10.811, false), (10.0, 0.0, 2.9615, true)]
        {
            let b = late(delay_s, off);
            for (sign, lag) in [
                (1.0, Lag::of(&a, &b, step_hz, 8.0)),
                (-1.0, Lag::of(&b, &a, step_hz, 8.0)),
                (-1.0, Lag::of(&a, &b, step_hz, 8.0).reversed()),
            ] {
                assert!((lag.delay_s - sign * delay_s).abs() < 1e-3, "{lag:?}");
                assert!((lag.error_s / error_s - 1.0).abs() < 1e-3, "{lag:?} {error_s}");
                assert_eq!(lag.is_known(), is_known, "{lag:?}");
            }
        }
        // The slope and the level of two independent phases always fit.
        assert_eq!(Lag::of(&a, &late(10.0, 0.0), step_hz, 2.0), Lag::UNKNOWN);
        assert_eq!(Lag::of(&a[..1], &a[..1], step_hz, 8.0), Lag::UNKNOWN);
        assert!(!Lag::UNKNOWN.is_known());
    }
}
