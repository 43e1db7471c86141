//! Rossi & Scali 2005: the response to a relay fitted to half cycles of PV.
//!
//! A valve that sticks acts like a relay: PV is the response of a first-order process with dead time to a square wave.
//! In a cycle that repeats itself, a half of it depends on one number alone, `T = P/tau`:
//!
//! ```text
//! y(s) = 1 - e^(-T s)                               s < theta      theta = ln((1 + e^T)/2) / T
//! y(s) = -1 + (2 - e^(-T theta)) e^(-T (s - theta)) after          y(0) = y(1) = 0
//! S_I = (E_sin - E_RT) / (E_sin + E_RT)             E_RT = min(E_relay, E_triangle)
//! ```
//!
//! P: half a period, tau: the process's time constant, theta: its dead time as a share of P; `T -> 0` is the triangle.
//! E: mean over the half cycles of the mean squared error (PV unit²); S_I (-). Sticks above 0.21, sound below -0.21.
//!
//! Source: J. Process Control 2005, 15, 505; thresholds are the authors'.
//! Limits: noise draws S_I to 0; a self-regulating process that is slow beside the cycle, and one of higher order, make
//! PV a sine; a square or triangular load looks like a valve.

use super::half_cycles::{LEAST_SAMPLES, fit, sine, triangle};
use super::{Band, Facts, Method, Opinion};

const ME: Method = Method::RossiScali2005;
/// The authors' zone of uncertainty (-).
pub const BAND: Band = Band { sound: -0.21, sticks: 0.21 };
/// Values of T tried (-).
const RATIOS: [f64; 8] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// Fewest half cycles.
const LEAST_HALVES: usize = 6;

/// The response to a relay at `s` (0..1) for `T = ratio`, up to its height.
pub fn relay(s: f64, ratio: f64) -> f64 {
    let theta = ((1.0 + ratio.exp()) / 2.0).ln() / ratio;
    if s < theta {
        1.0 - (-ratio * s).exp()
    } else {
        (2.0 - (-ratio * theta).exp()) * (-ratio * (s - theta)).exp() - 1.0
    }
}

/// What the method says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    if let Err(why) = facts.oscillates() {
        return Opinion::cannot_tell(ME, why);
    }
    let cycles = &facts.pv;
    let (mut sin, mut best, mut count) = (0.0, [0.0; RATIOS.len() + 1], 0);
    for half in &cycles.halves {
        let samples = cycles.samples(half);
        let n = samples.clone().count();
        if n < LEAST_SAMPLES {
            continue;
        }
        sin += fit(samples.clone(), sine).0 / n as f64;
        best[0] += fit(samples.clone(), |s| triangle(s, 0.5)).0 / n as f64;
        // One process has one time constant: it is the same in all half cycles.
        for (sum, ratio) in best[1..].iter_mut().zip(RATIOS) {
            *sum += fit(samples.clone(), |s| relay(s, ratio)).0 / n as f64;
        }
        count += 1;
    }
    if count < LEAST_HALVES {
        return Opinion::cannot_tell(ME, format!("PV has {count} half cycles, {LEAST_HALVES} are needed"));
    }
    let relay = best.into_iter().fold(f64::INFINITY, f64::min);
    let index = (sin - relay) / (sin + relay);
    Opinion::of(ME, index, BAND, format!("{count} half cycles of PV: S_I {index:.2}"))
}
