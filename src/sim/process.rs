//! Linear processes, discretised exactly under a held input, with a dead time of any length.

/// The dynamics of a process from valve flow `u` [%] to `y` [%].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ProcessKind {
    /// `K / (τ s + 1)`.
    FirstOrder {
        /// Gain K (%/%).
        gain: f64,
        /// Time constant τ (s).
        tau_s: f64,
    },
    /// `K / (τ² s² + 2 ζ τ s + 1)`; ζ < 1 oscillates, ζ >= 1 has two real poles.
    SecondOrder {
        /// Gain K (%/%).
        gain: f64,
        /// Natural period over 2 π, τ (s).
        tau_s: f64,
        /// Damping ratio ζ (-).
        zeta: f64,
    },
    /// `K / s`.
    Integrating {
        /// Rate K (%/s per %).
        rate: f64,
    },
    /// `K / (s (τ s + 1))`.
    IntegratingLag {
        /// Rate K (%/s per %).
        rate: f64,
        /// Lag τ (s).
        tau_s: f64,
    },
}

impl ProcessKind {
    /// Two real poles: `K / ((τ1 s + 1)(τ2 s + 1))`.
    pub fn two_lags(gain: f64, tau1_s: f64, tau2_s: f64) -> Self {
        let tau_s = (tau1_s * tau2_s).sqrt();
        Self::SecondOrder { gain, tau_s, zeta: (tau1_s + tau2_s) / (2.0 * tau_s) }
    }

    /// True when the process holds its level instead of returning to one.
    pub fn is_integrating(&self) -> bool {
        matches!(self, Self::Integrating { .. } | Self::IntegratingLag { .. })
    }
}

/// A process: dynamics and dead time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProcessSpec {
    /// The dynamics.
    pub kind: ProcessKind,
    /// Dead time (s); need not be a multiple of the sample period.
    pub dead_time_s: f64,
}

/// `x(t + h) = Φ x(t) + Γ u` for a held input u; x = (y, its rate or lag).
#[derive(Clone, Copy, Debug)]
struct Advance {
    phi: [[f64; 2]; 2],
    gamma: [f64; 2],
}

impl Advance {
    fn over(kind: ProcessKind, h: f64) -> Self {
        match kind {
            ProcessKind::FirstOrder { gain, tau_s } => {
                let a = (-h / tau_s).exp();
                Self { phi: [[a, 0.0], [0.0, 0.0]], gamma: [-gain * (-h / tau_s).exp_m1(), 0.0] }
            }
            ProcessKind::SecondOrder { gain, tau_s, zeta } => second_order(gain, tau_s, zeta, h),
            ProcessKind::Integrating { rate } => {
                Self { phi: [[1.0, 0.0], [0.0, 0.0]], gamma: [rate * h, 0.0] }
            }
            ProcessKind::IntegratingLag { rate, tau_s } => {
                let e = (-h / tau_s).exp();
                let rise = -(-h / tau_s).exp_m1();
                Self { phi: [[1.0, tau_s * rise], [0.0, e]], gamma: [rate * (h - tau_s * rise), rate * rise] }
            }
        }
    }

    fn apply(&self, x: [f64; 2], u: f64) -> [f64; 2] {
        [
            self.phi[0][0] * x[0] + self.phi[0][1] * x[1] + self.gamma[0] * u,
            self.phi[1][0] * x[0] + self.phi[1][1] * x[1] + self.gamma[1] * u,
        ]
    }
}

/// The free response of `τ² y'' + 2 ζ τ y' + y = K u` about its rest point `(K u, 0)`:
/// `Φ = e^(-αh) [[c + α s, s], [-s/τ², c - α s]]`, c and s the (hyperbolic) cosine and sine over δ.
fn second_order(gain: f64, tau: f64, zeta: f64, h: f64) -> Advance {
    let alpha = zeta / tau;
    let disc = (zeta * zeta - 1.0) / (tau * tau);
    let delta = disc.abs().sqrt();
    // Near a double pole the sine over δ is its limit h; the quotient itself would lose all digits.
    let (c, s) = if delta * h < 1e-7 {
        let e = (-alpha * h).exp();
        (e, h * e)
    } else if disc < 0.0 {
        let e = (-alpha * h).exp();
        (e * (delta * h).cos(), e * (delta * h).sin() / delta)
    } else {
        // e^(-αh) is multiplied into the exponentials: cosh alone would overflow for stiff pairs.
        let slow = ((delta - alpha) * h).exp();
        let fast = ((-delta - alpha) * h).exp();
        (0.5 * (slow + fast), 0.5 * (slow - fast) / delta)
    };
    let phi = [[c + alpha * s, s], [-s / (tau * tau), c - alpha * s]];
    Advance { phi, gamma: [gain * (1.0 - phi[0][0]), -gain * phi[1][0]] }
}

/// A process at work: its state and the inputs still on their way through the dead time.
#[derive(Clone, Debug)]
pub struct Process {
    early: Option<Advance>,
    late: Advance,
    state: [f64; 2],
    /// The last d + 1 inputs, `u[k]` at `head`.
    line: Vec<f64>,
    head: usize,
}

impl Process {
    /// Plans the steps for the sample period `ts_s`; the process rests at `y = 0` with `u = 0`.
    ///
    /// The dead time is `θ = d ts + φ`: in each period the input of `d + 1` samples ago acts for φ, then that
    /// of `d` samples ago for `ts - φ`, so that the response at the samples is exact.
    pub fn new(spec: &ProcessSpec, ts_s: f64) -> Self {
        let whole = (spec.dead_time_s / ts_s).floor();
        let mut d = whole as usize;
        let mut phi = spec.dead_time_s - whole * ts_s;
        // A dead time of 3 ts may come out as 2.999.. ts: within rounding it is a whole number of samples.
        if phi > ts_s * (1.0 - 1e-9) {
            d += 1;
            phi = 0.0;
        }
        let split = phi > ts_s * 1e-9;
        let phi = if split { phi } else { 0.0 };
        Self {
            early: split.then(|| Advance::over(spec.kind, phi)),
            late: Advance::over(spec.kind, ts_s - phi),
            state: [0.0; 2],
            line: vec![0.0; d + 2],
            head: 0,
        }
    }

    /// The output now.
    pub fn output(&self) -> f64 {
        self.state[0]
    }

    /// Holds `u` over the next sample period; the output afterwards is that of the period's end.
    pub fn step(&mut self, u: f64) {
        // The line holds d + 2 places: after writing u[k], the next place is u[k-d-1] and the one after u[k-d].
        let n = self.line.len();
        self.line[self.head] = u;
        let older = if self.head + 1 == n { 0 } else { self.head + 1 };
        let newer = if older + 1 == n { 0 } else { older + 1 };
        if let Some(early) = &self.early {
            self.state = early.apply(self.state, self.line[older]);
        }
        self.state = self.late.apply(self.state, self.line[newer]);
        self.head = older;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The unit step response at time t since the input reached the process.
    fn closed_form(kind: ProcessKind, t: f64) -> f64 {
        if t <= 0.0 {
            return 0.0;
        }
        match kind {
            ProcessKind::FirstOrder { gain, tau_s } => gain * (1.0 - (-t / tau_s).exp()),
            ProcessKind::SecondOrder { gain, tau_s, zeta } if zeta < 1.0 => {
                let w = (1.0 - zeta * zeta).sqrt();
                let e = (-zeta * t / tau_s).exp();
                gain * (1.0 - e * ((w * t / tau_s).cos() + zeta / w * (w * t / tau_s).sin()))
            }
            ProcessKind::SecondOrder { gain, tau_s, zeta: 1.0 } => {
                gain * (1.0 - (1.0 + t / tau_s) * (-t / tau_s).exp())
            }
            ProcessKind::SecondOrder { gain, tau_s, zeta } => {
                let w = (zeta * zeta - 1.0).sqrt();
                let (t1, t2) = (tau_s / (zeta - w), tau_s / (zeta + w));
                gain * (1.0 - (t1 * (-t / t1).exp() - t2 * (-t / t2).exp()) / (t1 - t2))
            }
            ProcessKind::Integrating { rate } => rate * t,
            ProcessKind::IntegratingLag { rate, tau_s } => rate * (t - tau_s * (1.0 - (-t / tau_s).exp())),
        }
    }

    #[test]
    fn step_responses_are_the_closed_form_at_every_sample() {
        let kinds = [
            ProcessKind::FirstOrder { gain: 1.5, tau_s: 7.0 },
            ProcessKind::SecondOrder { gain: 2.0, tau_s: 5.0, zeta: 0.3 },
            ProcessKind::SecondOrder { gain: 2.0, tau_s: 5.0, zeta: 1.0 },
            ProcessKind::two_lags(0.8, 20.0, 0.5),
            ProcessKind::Integrating { rate: 0.01 },
            ProcessKind::IntegratingLag { rate: 0.01, tau_s: 4.0 },
        ];
        for kind in kinds {
            for dead_time_s in [0.0, 0.7, 2.0, 5.3, 6.0] {
                let ts = 2.0;
                let mut process = Process::new(&ProcessSpec { kind, dead_time_s }, ts);
                for k in 1..200 {
                    process.step(1.0);
                    let want = closed_form(kind, k as f64 * ts - dead_time_s);
                    // 1e-11: 200 roundings of 1e-16 on values of order 1.
                    assert!(
                        (process.output() - want).abs() < 1e-11,
                        "{kind:?} θ={dead_time_s} k={k}: {} instead of {want}",
                        process.output()
                    );
                }
            }
        }
    }

    #[test]
    fn a_fractional_dead_time_splits_a_changing_input_exactly() {
        // A pulse of one period is the step response less the step response one period later.
        let kind = ProcessKind::two_lags(1.0, 3.0, 2.0);
        let mut process = Process::new(&ProcessSpec { kind, dead_time_s: 1.25 }, 1.0);
        for k in 1..50 {
            process.step(if k == 1 { 1.0 } else { 0.0 });
            let t = k as f64 - 1.25;
            let want = closed_form(kind, t) - closed_form(kind, t - 1.0);
            assert!((process.output() - want).abs() < 1e-12);
        }
    }

    #[test]
    fn a_dead_time_of_whole_samples_is_not_split_by_rounding() {
        // 0.3 / 0.1 is 2.9999999999999996: three samples all the same.
        let kind = ProcessKind::Integrating { rate: 1.0 };
        let mut process = Process::new(&ProcessSpec { kind, dead_time_s: 0.3 }, 0.1);
        let mut seen = Vec::new();
        for _ in 0..5 {
            process.step(1.0);
            seen.push(process.output());
        }
        assert_eq!(&seen[..3], &[0.0, 0.0, 0.0]);
        assert!((seen[3] - 0.1).abs() < 1e-15);
    }
}
