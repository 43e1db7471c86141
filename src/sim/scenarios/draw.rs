//! Draws that the random families share: a loop at rest with a PI tuned to it.

use crate::sim::controller::ControllerSpec;
use crate::sim::plant::{LoopSpec, Run};
use crate::sim::process::{ProcessKind, ProcessSpec};
use crate::sim::sensor::SensorSpec;
use crate::sim::valve::{Characteristic, Friction, ValveSpec};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Samples run, and how many of them are the transient.
pub(super) const N: usize = 2000;
pub(super) const WARM_UP: usize = 500;
/// Fewest reversals beyond S in the last [`LAST`] samples, so that any usual window holds four.
pub(super) const REVERSALS: usize = 6;
pub(super) const LAST: usize = 1000;
/// Shortest mean half cycle (samples): a faster one is not seen at that sample period.
pub(super) const HALF_CYCLE: usize = 4;

pub(super) fn generator(seed: u64, stream: u128) -> Pcg64Mcg {
    Pcg64Mcg::new((u128::from(seed) << 8 | stream).wrapping_mul(0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835))
}

pub(super) fn uniform(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

pub(super) fn log_uniform(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    uniform(rng, low.ln(), high.ln()).exp()
}

pub(super) fn chance(rng: &mut Pcg64Mcg, p: f64) -> bool {
    rng.random::<f64>() < p
}

/// A valve that sticks, Choudhury's or Kano's, under its author's name.
pub(super) fn sticking(rng: &mut Pcg64Mcg, s: f64, j: f64) -> (&'static str, Friction) {
    let resolution = uniform(rng, 0.003, 0.01);
    if chance(rng, 0.5) {
        ("Choudhury", Friction::Choudhury { s, j, resolution })
    } else {
        ("Kano", Friction::Kano { s, j, resolution })
    }
}

/// A loop at rest and what later draws need to know of it.
pub(super) struct Base {
    /// Its class: flow, pressure, level or temperature.
    pub(super) name: &'static str,
    /// The loop.
    pub(super) spec: LoopSpec,
    /// A time the closed loop answers in (samples).
    pub(super) pace: f64,
}

/// Process and PI by the SIMC rules, the closed-loop time constant 0.7 (tight) to 4 (sluggish) times the
/// effective dead time, which is up to `max_dead` samples of dead time and what sampling and a second lag add.
pub(super) fn draw_loop(rng: &mut Pcg64Mcg, friction: Friction, max_dead: f64) -> Base {
    let class = rng.random_range(0..4);
    let dead = if chance(rng, 0.3) { 0.0 } else { uniform(rng, 0.0, max_dead) };
    let (name, ts_s, kind, gain, lag) = match class {
        0 => {
            let ts = log_uniform(rng, 0.5, 2.0);
            let (gain, tau) = (log_uniform(rng, 0.5, 2.0), ts * log_uniform(rng, 1.0, 12.0));
            ("flow", ts, ProcessKind::FirstOrder { gain, tau_s: tau }, gain, tau / ts)
        }
        1 => {
            let ts = log_uniform(rng, 1.0, 5.0);
            let (gain, tau) = (log_uniform(rng, 0.4, 2.5), ts * log_uniform(rng, 4.0, 25.0));
            let second = tau * uniform(rng, 0.1, 0.5);
            ("pressure", ts, ProcessKind::two_lags(gain, tau, second), gain, (tau + 0.5 * second) / ts)
        }
        2 => {
            let ts = log_uniform(rng, 5.0, 60.0);
            let rate = log_uniform(rng, 0.01, 0.15) / ts;
            let kind = if chance(rng, 0.5) {
                ProcessKind::Integrating { rate }
            } else {
                let tau_s = ts * log_uniform(rng, 0.5, 4.0);
                ProcessKind::IntegratingLag { rate, tau_s }
            };
            ("level", ts, kind, rate * ts, f64::INFINITY)
        }
        _ => {
            let ts = log_uniform(rng, 5.0, 30.0);
            let (gain, tau) = (log_uniform(rng, 0.5, 2.0), ts * log_uniform(rng, 8.0, 40.0));
            let second = tau * uniform(rng, 0.2, 0.9);
            ("temperature", ts, ProcessKind::two_lags(gain, tau, second), gain, (tau + 0.5 * second) / ts)
        }
    };
    // The held input adds half a sample, a second lag half of itself.
    let extra = match kind {
        ProcessKind::SecondOrder { .. } => 0.25 * lag.min(20.0),
        ProcessKind::IntegratingLag { tau_s, .. } => tau_s / ts_s,
        _ => 0.0,
    };
    let effective = dead + 0.5 + extra;
    let closed = effective * log_uniform(rng, 0.7, 4.0);
    let pace = closed + effective;
    let (kc, ti) = if lag.is_infinite() {
        (1.0 / (gain * pace), 4.0 * pace * uniform(rng, 0.7, 2.0))
    } else {
        (lag / (gain * pace), lag.min(4.0 * pace) * uniform(rng, 0.5, 1.2))
    };
    let op0 = uniform(rng, 35.0, 65.0);
    let pv0 = uniform(rng, 30.0, 70.0);
    let mut valve = ValveSpec::linear(friction);
    if chance(rng, 0.15) {
        valve.characteristic = Characteristic::EqualPercentage { rangeability: uniform(rng, 20.0, 50.0) };
    }
    let spec = LoopSpec {
        process: ProcessSpec { kind, dead_time_s: dead * ts_s },
        controller: ControllerSpec::pi(kc, ti * ts_s),
        valve,
        loads: Vec::new(),
        sensor: SensorSpec::default(),
        sp: pv0,
        sp_schedule: Vec::new(),
        sp_steps: None,
        ts_s,
        op0,
        pv0,
    };
    Base { name, spec, pace }
}

pub(super) fn inside_limits(spec: &LoopSpec, run: &Run) -> bool {
    let (low, high) = spec.controller.op_limits;
    run.op.iter().all(|&u| u > low && u < high)
}

pub(super) fn sd(v: &[f64]) -> f64 {
    let n = v.len().max(1) as f64;
    let mean = v.iter().sum::<f64>() / n;
    (v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n).sqrt()
}
