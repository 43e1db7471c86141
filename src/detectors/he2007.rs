//! He, Wang, Pottmann & Qin 2007: curves fitted to half cycles.
//!
//! A valve that sticks moves in steps, and the first integrator after it makes triangles of them: that of the controller
//! where the process is self-regulating (OP), that of the process where it integrates (PV). Anything else leaves sines.
//!
//! ```text
//! SI = MSE_sin / (MSE_sin + MSE_tri)      MSE: mean over the half cycles of the mean squared error of the best fit
//! sin: A sin(pi s)    tri: A s/p for s < p, A (1 - s)/(1 - p) after      s in 0..1 from crossing to crossing, p free
//! ```
//!
//! SI: stiction index (-); A: height (unit of the signal). Sound up to 0.4, sticks above 0.6, between them undetermined.
//!
//! Source: Ind. Eng. Chem. Res. 2007, 46, 4549; thresholds are the authors'.
//! Limits: noise adds to both errors and draws SI to 0.5; a process that is slow beside the cycle bends the triangle of OP
//! into a parabola, which looks like a sine; a triangular load looks like a valve.

use super::half_cycles::{LEAST_SAMPLES, fit, sine, triangle};
use super::{Band, Facts, Integrates, Method, Opinion};

const ME: Method = Method::He2007;
/// The authors' thresholds (-).
pub const BAND: Band = Band { sound: 0.4, sticks: 0.6 };
/// Peaks tried for a triangle.
const PEAKS: usize = 19;
/// Fewest half cycles.
const LEAST_HALVES: usize = 6;

/// What the method says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    if let Err(why) = facts.oscillates() {
        return Opinion::cannot_tell(ME, why);
    }
    let (name, cycles) = match facts.integration.answer {
        Integrates::No => ("OP", &facts.op),
        Integrates::Yes => ("PV", &facts.pv),
        Integrates::Unknown => return Opinion::cannot_tell(ME, facts.integration.why()),
    };
    let (mut sin, mut tri, mut count) = (0.0, 0.0, 0);
    for half in &cycles.halves {
        let samples = cycles.samples(half);
        let n = samples.clone().count();
        if n < LEAST_SAMPLES {
            continue;
        }
        sin += fit(samples.clone(), sine).0 / n as f64;
        tri += (1..=PEAKS)
            .map(|p| p as f64 / (PEAKS + 1) as f64)
            .map(|p| fit(samples.clone(), |s| triangle(s, p)).0)
            .fold(f64::INFINITY, f64::min)
            / n as f64;
        count += 1;
    }
    if count < LEAST_HALVES {
        return Opinion::cannot_tell(
            ME,
            format!("{name} has {count} half cycles, {LEAST_HALVES} are needed"),
        );
    }
    let index = sin / (sin + tri);
    Opinion::of(ME, index, BAND, format!("{count} half cycles of {name}: SI {index:.2}"))
}
