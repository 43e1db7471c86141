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
//! Limits: noise adds to both errors, and moves SI towards 0.5; a process that is slow compared with the cycle makes a parabola of the
//! triangle of OP, which looks like a sine; a triangular load looks like a valve.

use super::facts::Facts;
use super::half_cycles::{Cycles, HalfCycle, LEAST_SAMPLES, fit, sine, triangle};
use super::integration::Integrates;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, curve};
use crate::sysid::stats::mean;

const METHOD: Method = Method::He2007;
/// The authors' thresholds (-).
pub const BAND: Band = Band { sound: 0.4, sticks: 0.6 };
/// Positions of the triangle's peak that are tried.
const PEAKS: usize = 19;
/// Fewest half cycles.
const LEAST_HALVES: usize = 6;

/// The fits to one half cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Half {
    half: HalfCycle,
    /// Mean squared error and height of the sine.
    sine: (f64, f64),
    /// Mean squared error and height of the best triangle, and its peak (0..1).
    triangle: (f64, f64, f64),
}

/// What the method evaluates: a signal's name, its cycles, and the fits to their half cycles.
struct Evaluated<'a> {
    name: &'static str,
    cycles: &'a Cycles,
    halves: Vec<Half>,
}

impl Evaluated<'_> {
    /// The stiction index SI (-).
    fn index(&self) -> f64 {
        let sum = |of: &dyn Fn(&Half) -> f64| self.halves.iter().map(of).sum::<f64>();
        let (sine, triangle) = (sum(&|half| half.sine.0), sum(&|half| half.triangle.0));
        sine / (sine + triangle)
    }
}

fn evaluate<'a>(facts: &'a Facts<'_>) -> Result<Evaluated<'a>, String> {
    facts.oscillates()?;
    let (name, cycles) = match facts.integration.answer {
        Integrates::No => ("OP", &facts.op),
        Integrates::Yes => ("PV", &facts.pv),
        Integrates::Unknown => return Err(facts.integration.why()),
    };
    let mut halves = Vec::new();
    for half in &cycles.halves {
        let samples = cycles.samples(half);
        let n = samples.clone().count();
        if n < LEAST_SAMPLES {
            continue;
        }
        let (sse, height) = fit(samples.clone(), sine);
        let mut best = (f64::INFINITY, 0.0, 0.5);
        for peak in (1..=PEAKS).map(|p| p as f64 / (PEAKS + 1) as f64) {
            let (sse, height) = fit(samples.clone(), |s| triangle(s, peak));
            if sse / (n as f64) < best.0 {
                best = (sse / n as f64, height, peak);
            }
        }
        halves.push(Half { half: *half, sine: (sse / n as f64, height), triangle: best });
    }
    let count = halves.len();
    if count < LEAST_HALVES {
        return Err(format!("{name} has {count} half cycles, {LEAST_HALVES} are needed"));
    }
    Ok(Evaluated { name, cycles, halves })
}

/// The half cycles laid over each other, each divided by the height of its sine, with the sine and the mean triangle.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok(found) = evaluate(facts) else { return Vec::new() };
    let raised: Vec<&Half> = found.halves.iter().filter(|half| half.sine.1 > 0.0).collect();
    let dots = raised.iter().flat_map(|own| {
        found.cycles.samples(&own.half).map(|(s, v)| (s, v / own.sine.1)).collect::<Vec<_>>()
    });
    let average = |of: &dyn Fn(&Half) -> f64| mean(&raised.iter().map(|own| of(own)).collect::<Vec<_>>());
    let height = average(&|own| own.triangle.1 / own.sine.1);
    let peak = average(&|own| own.triangle.2);
    let layers = vec![
        Layer::dots(format!("half cycles of {}", found.name), Tone::Data, dots.collect()),
        Layer::line("sine", Tone::Sound, curve(sine)),
        Layer::line("triangle", Tone::Sticks, curve(|s| height * triangle(s, peak))),
    ];
    let title = format!(
        "{} half cycles of {} over each other: triangles where the valve sticks",
        found.halves.len(),
        found.name
    );
    vec![Picture::new(title, "from crossing to crossing (-)", "height (of the fitted sine)", layers)]
}

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    match evaluate(facts) {
        Ok(found) => {
            let index = found.index();
            let (count, told) = (found.halves.len(), BAND.told(index, 2));
            let why = format!("{count} half cycles of {}: SI {told}", found.name);
            Opinion::of(METHOD, index, BAND, why)
        }
        Err(why) => Opinion::cannot_tell(METHOD, why),
    }
}
