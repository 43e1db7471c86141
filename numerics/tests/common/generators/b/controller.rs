//! PI and PID controllers, and how they are tuned.

use std::f64::consts::PI;

use super::draw::{Draw, Range};
use super::process::{Class, Complex, Process, Stage};

/// Settings of a controller (times in scans).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Proportional gain (OP per PV), of the process gain's sign.
    pub gain: f64,
    /// Integral time.
    pub integral: f64,
    /// Derivative time, 0 for PI; the derivative acts on PV.
    pub derivative: f64,
}

/// Lag of the derivative as a share of the derivative time.
const DERIVATIVE_FILTER: f64 = 0.2;
/// Share of the slower loops with a PID controller.
const PID_SHARE: f64 = 0.35;
/// Share of loops tuned by lambda; the others follow Ziegler and Nichols.
const LAMBDA_SHARE: f64 = 0.6;
/// Lambda in multiples of the larger of dead time and a share of the lag: tight to sluggish.
const LAMBDA: Range = (0.8, 4.0);
/// That share of the lag.
const LAMBDA_OF_LAG: f64 = 0.25;
/// Share of the lag in lambda for an integrating process, whose lag is its filling time.
const LAMBDA_OF_TANK: f64 = 0.08;
/// Share of the Ziegler-Nichols gain that is used.
const DETUNED: Range = (0.35, 0.9);
/// Largest proportional gain that is set (OP per PV).
const MOST_GAIN: Range = (4.0, 9.0);
/// Peak of the sensitivity that the tuning may have.
const PEAK: f64 = 2.2;
/// Peak of the sensitivity that the loop may have once the process has changed.
const PEAK_CHANGED: f64 = 3.0;
/// Gain margin that the loop has in any case.
const MARGIN: f64 = 1.6;
/// Frequencies at which margins are looked at.
const FREQUENCIES: usize = 160;
/// Lowest of them (rad per scan).
const LOWEST: f64 = 0.002;

impl Settings {
    /// A tuning for the process that stays stable for its changed forms too.
    pub fn draw(draw: &mut Draw, class: Class, process: &Process, changed: &[Process]) -> Self {
        let pid = !matches!(class, Class::Flow | Class::Level) && draw.chance(PID_SHARE);
        let mut settings = if draw.chance(LAMBDA_SHARE) {
            Self::lambda(draw, process, pid)
        } else {
            Self::ziegler_nichols(draw, process, pid)
        };
        let excess = settings.gain.abs() / draw.uniform(MOST_GAIN);
        if excess > 1.0 {
            settings.gain /= excess;
            settings.integral *= if process.integrates() { excess } else { 1.0 };
        }
        for _ in 0..80 {
            let sound = settings.peak(process) <= PEAK
                && changed.iter().all(|other| settings.peak(other) <= PEAK_CHANGED);
            if sound {
                break;
            }
            settings.gain *= 0.88;
            settings.integral *= if process.integrates() { 1.2 } else { 1.03 };
        }
        settings
    }

    /// Lambda tuning on the first-order model.
    fn lambda(draw: &mut Draw, process: &Process, pid: bool) -> Self {
        let (lag, dead) = process.first_order();
        let factor = draw.log_uniform(LAMBDA);
        let derivative = if pid { 0.4 * dead } else { 0.0 };
        if let Stage::Tank { time, .. } = process.stage {
            let lambda = factor * dead.max(LAMBDA_OF_TANK * time);
            let integral = 2.0 * lambda + dead;
            let gain = integral * time / (process.gain * (lambda + dead).powi(2));
            return Self { gain, integral, derivative };
        }
        let lambda = factor * dead.max(LAMBDA_OF_LAG * lag);
        let integral = if draw.chance(0.5) { lag } else { lag.min(4.0 * (lambda + dead)) };
        Self { gain: lag / (process.gain * (lambda + dead)), integral, derivative }
    }

    /// Ziegler and Nichols from the ultimate gain and period, with less gain.
    fn ziegler_nichols(draw: &mut Draw, process: &Process, pid: bool) -> Self {
        let crossing = frequencies().find(|&omega| {
            let g = process.response(omega);
            g.im >= 0.0 && g.re < 0.0
        });
        let omega = crossing.unwrap_or(PI);
        let ultimate = draw.uniform(DETUNED) * process.gain.signum() / process.response(omega).size();
        let period = 2.0 * PI / omega;
        if pid {
            Self { gain: 0.6 * ultimate, integral: period / 2.0, derivative: period / 8.0 }
        } else {
            Self { gain: 0.45 * ultimate, integral: period / 1.2, derivative: 0.0 }
        }
    }

    /// Frequency response of the controller, for a gain taken as positive.
    pub fn response(&self, omega: f64) -> Complex {
        let filter = Complex::new(1.0, omega * self.derivative * DERIVATIVE_FILTER).inverse();
        let proportional = Complex::new(1.0, -1.0 / (omega * self.integral));
        (proportional + Complex::new(0.0, omega * self.derivative) * filter)
            * Complex::new(self.gain.abs(), 0.0)
    }

    /// Largest sensitivity of the loop; infinite where the gain margin is too small.
    fn peak(&self, process: &Process) -> f64 {
        let mut peak: f64 = 0.0;
        let mut last: Option<Complex> = None;
        for omega in frequencies() {
            let open = process.response(omega) * self.response(omega);
            let crosses = last.is_some_and(|l| l.im < 0.0 && open.im >= 0.0 && open.re < 0.0);
            if crosses && open.re < -1.0 / MARGIN {
                return f64::INFINITY;
            }
            peak = peak.max((open + Complex::new(1.0, 0.0)).inverse().size());
            last = Some(open);
        }
        peak
    }

    /// How much of PV's noise comes through to OP at once.
    pub fn noise_gain(&self) -> f64 {
        self.gain.abs() * if self.derivative > 0.0 { 1.0 + 0.5 / DERIVATIVE_FILTER } else { 1.0 }
    }
}

/// Frequencies up to half the scan rate (rad per scan), evenly in the logarithm.
fn frequencies() -> impl Iterator<Item = f64> {
    (0..FREQUENCIES).map(|i| LOWEST * (PI / LOWEST).powf(i as f64 / (FREQUENCIES - 1) as f64))
}

/// A positional controller in operation.
pub struct Controller {
    settings: Settings,
    bias: f64,
    sum: f64,
    /// PV behind the lag of the derivative.
    slow_pv: f64,
}

impl Controller {
    /// A controller at rest at `op` and `pv`.
    pub fn new(settings: Settings, op: f64, pv: f64) -> Self {
        Self { settings, bias: op, sum: 0.0, slow_pv: pv }
    }

    /// OP at this scan; the integral stops where OP is at a limit.
    pub fn step(&mut self, sp: f64, pv: f64) -> f64 {
        let s = &self.settings;
        let error = sp - pv;
        let mut rate = 0.0;
        if s.derivative > 0.0 {
            let lag = s.derivative * DERIVATIVE_FILTER;
            self.slow_pv += (pv - self.slow_pv) / (1.0 + lag);
            rate = s.derivative * (pv - self.slow_pv) / lag;
        }
        let sum = self.sum + s.gain * error / s.integral;
        let free = self.bias + s.gain * (error - rate) + sum;
        let op = free.clamp(0.0, 100.0);
        if op == free || (free - op) * s.gain * error < 0.0 {
            self.sum = sum;
        }
        op
    }
}
