//! Loads: what disturbs a loop from outside.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

/// Where a load enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum At {
    /// Added to the flow before the process and its dead time (% of flow).
    ProcessInput,
    /// Added to the process output before the sensor (% of PV).
    ProcessOutput,
}

/// The shape of a load over time t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LoadKind {
    /// `A (1 + g t) sin(2 π t / P + φ)`, the amplitude never below 0.
    Sine {
        /// Amplitude A (%).
        amplitude: f64,
        /// Period P (s).
        period_s: f64,
        /// Phase φ (rad).
        phase: f64,
        /// Growth g of the amplitude (1/s); 0 for a steady sine.
        growth_per_s: f64,
    },
    /// +A for the first half of each period, -A for the second.
    Square {
        /// Amplitude A (%).
        amplitude: f64,
        /// Period P (s).
        period_s: f64,
    },
    /// Straight lines between -A and +A.
    Triangle {
        /// Amplitude A (%).
        amplitude: f64,
        /// Period P (s).
        period_s: f64,
    },
    /// `size` from `at_s` on.
    Step {
        /// Time of the step (s).
        at_s: f64,
        /// Size (%).
        size: f64,
    },
    /// Grows by `rate` from `from_s` to `to_s`, then stays.
    Ramp {
        /// Start (s).
        from_s: f64,
        /// End (s).
        to_s: f64,
        /// Rate (%/s).
        rate_per_s: f64,
    },
    /// First-order coloured noise: stationary sd and correlation time, `w[k] = φ w[k-1] + √(1 - φ²) sd e[k]`.
    Coloured {
        /// Standard deviation (%).
        sd: f64,
        /// Correlation time (s), `φ = exp(-ts / tau)`.
        tau_s: f64,
    },
    /// `w[k] = w[k-1] + sd √ts e[k]`.
    RandomWalk {
        /// Standard deviation after one second (%).
        sd_per_root_s: f64,
    },
}

/// A load: its shape and where it enters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Shape.
    pub kind: LoadKind,
    /// Entry.
    pub at: At,
}

impl Load {
    /// A load at the process input.
    pub fn input(kind: LoadKind) -> Self {
        Self { kind, at: At::ProcessInput }
    }

    /// A load at the process output.
    pub fn output(kind: LoadKind) -> Self {
        Self { kind, at: At::ProcessOutput }
    }
}

/// A load at work: planned factors and, for the random ones, the last value.
#[derive(Clone, Debug)]
pub struct LoadState {
    load: Load,
    keep: f64,
    fresh: f64,
    value: f64,
}

impl LoadState {
    /// Plans the load for a sample period; coloured noise starts from its stationary distribution.
    pub fn new(load: &Load, ts_s: f64, rng: &mut Pcg64Mcg) -> Self {
        let (keep, fresh, value) = match load.kind {
            LoadKind::Coloured { sd, tau_s } => {
                let phi = (-ts_s / tau_s).exp();
                let start: f64 = StandardNormal.sample(rng);
                (phi, sd * (1.0 - phi * phi).sqrt(), sd * start)
            }
            LoadKind::RandomWalk { sd_per_root_s } => (1.0, sd_per_root_s * ts_s.sqrt(), 0.0),
            _ => (0.0, 0.0, 0.0),
        };
        Self { load: *load, keep, fresh, value }
    }

    /// Where it enters.
    pub fn at(&self) -> At {
        self.load.at
    }

    /// The load at time `t` (s); call once a sample.
    pub fn step(&mut self, t: f64, rng: &mut Pcg64Mcg) -> f64 {
        match self.load.kind {
            LoadKind::Sine { amplitude, period_s, phase, growth_per_s } => {
                amplitude * (1.0 + growth_per_s * t).max(0.0) * (TAU * t / period_s + phase).sin()
            }
            LoadKind::Square { amplitude, period_s } => {
                if (t / period_s).rem_euclid(1.0) < 0.5 {
                    amplitude
                } else {
                    -amplitude
                }
            }
            LoadKind::Triangle { amplitude, period_s } => {
                let x = (t / period_s).rem_euclid(1.0);
                amplitude * (1.0 - 4.0 * (x - 0.5).abs())
            }
            LoadKind::Step { at_s, size } => {
                if t >= at_s {
                    size
                } else {
                    0.0
                }
            }
            LoadKind::Ramp { from_s, to_s, rate_per_s } => rate_per_s * (t.min(to_s) - from_s).max(0.0),
            LoadKind::Coloured { .. } | LoadKind::RandomWalk { .. } => {
                let e: f64 = StandardNormal.sample(rng);
                self.value = self.keep * self.value + self.fresh * e;
                self.value
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(kind: LoadKind, ts: f64, n: usize) -> Vec<f64> {
        let mut rng = Pcg64Mcg::new(7);
        let mut load = LoadState::new(&Load::input(kind), ts, &mut rng);
        (0..n).map(|k| load.step(k as f64 * ts, &mut rng)).collect()
    }

    #[test]
    fn deterministic_shapes_by_hand() {
        let square = LoadKind::Square { amplitude: 2.0, period_s: 4.0 };
        assert_eq!(series(square, 1.0, 5), [2.0, 2.0, -2.0, -2.0, 2.0]);
        let triangle = LoadKind::Triangle { amplitude: 2.0, period_s: 4.0 };
        assert_eq!(series(triangle, 1.0, 5), [-2.0, 0.0, 2.0, 0.0, -2.0]);
        let step = LoadKind::Step { at_s: 2.0, size: 3.0 };
        assert_eq!(series(step, 1.0, 4), [0.0, 0.0, 3.0, 3.0]);
        let ramp = LoadKind::Ramp { from_s: 1.0, to_s: 3.0, rate_per_s: 0.5 };
        assert_eq!(series(ramp, 1.0, 5), [0.0, 0.0, 0.5, 1.0, 1.0]);
        let sine = LoadKind::Sine { amplitude: 3.0, period_s: 4.0, phase: 0.0, growth_per_s: 1.0 };
        // sin at quarters of a period: 0, 1, 0, -1; the amplitude is 3 (1 + t).
        for (got, want) in series(sine, 1.0, 4).iter().zip([0.0, 6.0, 0.0, -12.0]) {
            assert!((got - want).abs() < 1e-12);
        }
    }

    #[test]
    fn coloured_noise_has_its_sd_and_correlation() {
        let n = 200_000;
        let w = series(LoadKind::Coloured { sd: 1.5, tau_s: 10.0 }, 1.0, n);
        let var = w.iter().map(|x| x * x).sum::<f64>() / n as f64;
        let lag = w.windows(2).map(|p| p[0] * p[1]).sum::<f64>() / n as f64;
        // 200,000 samples hold about 10,000 independent ones: 5 sd of the variance's estimate is 7 %.
        assert!((var / 2.25 - 1.0).abs() < 0.07, "{var}");
        assert!((lag / var - (-0.1f64).exp()).abs() < 0.01);
    }

    #[test]
    fn a_random_walk_spreads_with_the_root_of_time() {
        let kind = LoadKind::RandomWalk { sd_per_root_s: 0.3 };
        let w = series(kind, 4.0, 100_000);
        let var = w.windows(2).map(|p| (p[1] - p[0]).powi(2)).sum::<f64>() / 99_999.0;
        // (0.3 √4)² = 0.36; 5 sd of the estimate is 2.2 %.
        assert!((var / 0.36 - 1.0).abs() < 0.022, "{var}");
    }
}
