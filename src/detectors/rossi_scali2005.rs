//! Rossi & Scali 2005: the response to a relay fitted to half cycles of PV.
//!
//! A valve that sticks acts like a relay: PV is the response of a first-order process with dead time to a square wave.
//! In the steady cycle, the shape of a half cycle depends on one number alone, `T = P/tau`:
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
//! Limits: noise moves S_I towards 0; a self-regulating process that is slow compared with the cycle, and one of higher order, make a
//! sine of PV; a square or triangular load looks like a valve.

use super::facts::Facts;
use super::half_cycles::{HalfCycle, LEAST_SAMPLES, fit, sine, triangle};
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, curve};

const METHOD: Method = Method::RossiScali2005;
/// The authors' zone of uncertainty (-).
pub const BAND: Band = Band { sound: -0.21, sticks: 0.21 };
/// Values of T tried (-).
const RATIOS: [f64; 8] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// Fewest half cycles.
const LEAST_HALVES: usize = 6;

/// The response to a relay at `s` (0..1) for `T = ratio`, but for its height.
pub fn relay(s: f64, ratio: f64) -> f64 {
    let theta = ((1.0 + ratio.exp()) / 2.0).ln() / ratio;
    if s < theta {
        1.0 - (-ratio * s).exp()
    } else {
        (2.0 - (-ratio * theta).exp()) * (-ratio * (s - theta)).exp() - 1.0
    }
}

/// The shapes that a relay can make, but for their height: number 0 is a triangle, the others are the responses for each ratio.
fn response(shape: usize, s: f64) -> f64 {
    match shape.checked_sub(1).and_then(|at| RATIOS.get(at)) {
        Some(ratio) => relay(s, *ratio),
        None => triangle(s, 0.5),
    }
}

/// What the method evaluates: the half cycles, each with the height of its sine, and the mean squared errors.
struct Evaluated {
    halves: Vec<(HalfCycle, f64)>,
    /// Mean squared error of the sine, summed over the half cycles.
    sine: f64,
    /// The same of the best shape of a relay, and its number.
    relay: (f64, usize),
}

impl Evaluated {
    /// The index S_I (-).
    fn index(&self) -> f64 {
        (self.sine - self.relay.0) / (self.sine + self.relay.0)
    }
}

fn evaluate(facts: &Facts<'_>) -> Result<Evaluated, String> {
    facts.oscillates()?;
    let (mut sum, mut errors, mut halves) = (0.0, [0.0; RATIOS.len() + 1], Vec::new());
    for half in &facts.pv.halves {
        let samples = facts.pv.samples(half);
        let n = samples.clone().count() as f64;
        if n < LEAST_SAMPLES as f64 {
            continue;
        }
        let (sse, height) = fit(samples.clone(), sine);
        sum += sse / n;
        // The process has one time constant: its shape is the same in all half cycles.
        for (shape, error) in errors.iter_mut().enumerate() {
            *error += fit(samples.clone(), |s| response(shape, s)).0 / n;
        }
        halves.push((*half, height));
    }
    let count = halves.len();
    if count < LEAST_HALVES {
        return Err(format!("PV has {count} half cycles, {LEAST_HALVES} are needed"));
    }
    let best = errors.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1));
    let relay = best.map_or((f64::INFINITY, 0), |(shape, error)| (*error, shape));
    Ok(Evaluated { halves, sine: sum, relay })
}

/// The half cycles of PV laid over each other, each divided by the height of its sine, with the sine and the relay's response.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(found) = evaluate(facts) else { return Vec::new() };
    let raised = found.halves.iter().filter(|(_, height)| *height > 0.0);
    let dots: Vec<(f64, f64)> = raised
        .flat_map(|(half, height)| facts.pv.samples(half).map(|(s, v)| (s, v / height)).collect::<Vec<_>>())
        .collect();
    let shape = found.relay.1;
    let (_, height) = fit(dots.iter().copied(), |s| response(shape, s));
    let layers = vec![
        Layer::dots("half cycles of PV", Tone::Data, dots),
        Layer::line("sine", Tone::Sound, curve(sine)),
        Layer::line("response to a relay", Tone::Sticks, curve(|s| height * response(shape, s))),
    ];
    let title = format!(
        "{} half cycles of PV over each other: a relay's response where the valve sticks",
        found.halves.len()
    );
    vec![Picture::new(title, "from crossing to crossing (-)", "height (of the fitted sine)", layers)]
}

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    match evaluate(facts) {
        Ok(found) => {
            let index = found.index();
            let why = format!("{} half cycles of PV: S_I {}", found.halves.len(), BAND.told(index, 2));
            Opinion::of(METHOD, index, BAND, why)
        }
        Err(why) => Opinion::cannot_tell(METHOD, why),
    }
}
