//! What the transmitter makes of the process output.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// A time in which the measured value does not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Freeze {
    /// First frozen time (s).
    pub from_s: f64,
    /// End (s), exclusive.
    pub to_s: f64,
}

/// Single wrong values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outliers {
    /// Chance a sample (0..1).
    pub probability: f64,
    /// Size, of either sign (%).
    pub size: f64,
}

/// Band-limited white noise as Simulink defines it: a new normal value of variance `power / sample time`
/// every sample time, held in between.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BandLimited {
    /// Height of the power spectral density (%² s).
    pub power: f64,
    /// Sample time of the noise (s).
    pub sample_time_s: f64,
}

/// A transmitter; the default is perfect.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorSpec {
    /// White noise, standard deviation (%).
    pub noise_sd: f64,
    /// Band-limited white noise.
    pub band_limited: Option<BandLimited>,
    /// Drift (%/s).
    pub drift_per_s: f64,
    /// Wrong values.
    pub outliers: Option<Outliers>,
    /// Resolution (%); 0 for none.
    pub quantum: f64,
    /// Frozen value.
    pub freeze: Option<Freeze>,
}

impl SensorSpec {
    /// White noise of the given standard deviation (%), nothing else.
    pub fn noisy(noise_sd: f64) -> Self {
        Self { noise_sd, ..Self::default() }
    }
}

/// A transmitter at work: noise, drift and outliers are added, then the value is quantised, then frozen.
#[derive(Clone, Debug)]
pub struct Sensor {
    spec: SensorSpec,
    held_sd: f64,
    held: f64,
    next_s: f64,
    last: f64,
}

impl Sensor {
    /// A transmitter; a freeze that begins at once shows `pv0`.
    pub fn new(spec: &SensorSpec, pv0: f64) -> Self {
        Self {
            spec: *spec,
            held_sd: spec.band_limited.map_or(0.0, |b| (b.power / b.sample_time_s).sqrt()),
            held: 0.0,
            next_s: 0.0,
            last: pv0,
        }
    }

    /// The measured value of `y` at time `t` (s).
    pub fn step(&mut self, t: f64, y: f64, rng: &mut Pcg64Mcg) -> f64 {
        let spec = &self.spec;
        let mut pv = y + spec.drift_per_s * t;
        if spec.noise_sd > 0.0 {
            let e: f64 = StandardNormal.sample(rng);
            pv += spec.noise_sd * e;
        }
        if let Some(band) = spec.band_limited {
            // Within rounding of its time a new value is due: k ts and the noise's own grid are summed differently.
            if t >= self.next_s - 1e-9 * band.sample_time_s {
                let e: f64 = StandardNormal.sample(rng);
                self.held = self.held_sd * e;
                self.next_s = ((t / band.sample_time_s + 1e-9).floor() + 1.0) * band.sample_time_s;
            }
            pv += self.held;
        }
        if let Some(outliers) = spec.outliers
            && rng.random::<f64>() < outliers.probability
        {
            pv += if rng.random::<bool>() { outliers.size } else { -outliers.size };
        }
        if spec.quantum > 0.0 {
            pv = (pv / spec.quantum).round() * spec.quantum;
        }
        if spec.freeze.is_none_or(|f| t < f.from_s || t >= f.to_s) {
            self.last = pv;
        }
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(spec: SensorSpec, ts: f64, n: usize, y: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut rng = Pcg64Mcg::new(11);
        let mut sensor = Sensor::new(&spec, 0.0);
        (0..n).map(|k| sensor.step(k as f64 * ts, y(k as f64 * ts), &mut rng)).collect()
    }

    #[test]
    fn quantum_drift_and_freeze_by_hand() {
        let spec = SensorSpec {
            drift_per_s: 0.1,
            quantum: 0.5,
            freeze: Some(Freeze { from_s: 3.0, to_s: 5.0 }),
            ..SensorSpec::default()
        };
        // y = t, with drift 1.1 t, to the nearest half.
        assert_eq!(series(spec, 1.0, 7, |t| t), [0.0, 1.0, 2.0, 2.0, 2.0, 5.5, 6.5]);
    }

    #[test]
    fn band_limited_noise_has_simulinks_variance_and_is_held() {
        let band = BandLimited { power: 2.0, sample_time_s: 5.0 };
        let spec = SensorSpec { band_limited: Some(band), ..SensorSpec::default() };
        let v = series(spec, 1.0, 100_000, |_| 0.0);
        assert!(v.chunks(5).all(|c| c.iter().all(|x| x == &c[0])));
        let var = v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64;
        // 2 / 5 = 0.4; 20,000 values: 5 sd of the estimate is 5 %.
        assert!((var / 0.4 - 1.0).abs() < 0.05, "{var}");
    }

    #[test]
    fn outliers_come_as_often_as_asked() {
        let outliers = Outliers { probability: 0.02, size: 7.0 };
        let spec = SensorSpec { outliers: Some(outliers), ..SensorSpec::default() };
        let v = series(spec, 1.0, 50_000, |_| 0.0);
        let hit = v.iter().filter(|x| x.abs() == 7.0).count();
        // 1,000 expected, sd 31.
        assert!((hit as i64 - 1000).abs() < 160, "{hit}");
        assert!(v.iter().all(|&x| x == 0.0 || x.abs() == 7.0));
    }
}
