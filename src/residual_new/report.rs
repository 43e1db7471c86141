//! What was found, in the plant's units.

use super::Parameter;
use crate::sysid::armax::Armax;
use crate::sysid::iddata::IdData;

/// An effect in numbers and in one sentence.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// Its numbers.
    pub parameters: Vec<Parameter>,
    /// Where it acts, for kinds that have more than one place.
    pub place: Option<&'static str>,
    /// One sentence.
    pub explanation: String,
}

impl Described {
    /// With no numbers yet.
    pub fn new(explanation: String) -> Self {
        Self { parameters: Vec::new(), place: None, explanation }
    }

    /// With one number more.
    pub fn with(mut self, name: &'static str, value: f64, unit: &'static str) -> Self {
        self.parameters.push(Parameter { name, value, unit });
        self
    }

    /// With its place.
    pub fn at(mut self, place: &'static str) -> Self {
        self.place = Some(place);
        self
    }
}

/// Least `|A|` and `|B|` that a load is divided by: where PV integrates, or does not answer at all, its size has no end.
const LEAST: [f64; 2] = [1e-3, 1e-6];

fn settled(left: f64, least: f64) -> f64 {
    1.0 / if left.abs() < least { least.copysign(left) } else { left }
}

/// What a load of 1 in the equation is worth at the valve once it has settled, `1/B(1)` (OP unit).
pub fn in_op(data: &IdData, model: &Armax) -> f64 {
    settled(model.b.iter().sum(), LEAST[1]) * data.units.u
}

/// What it does to PV if nothing controls it, `1/A(1)` (PV unit); of an integrating process in its first thousand samples.
pub fn in_pv(data: &IdData, model: &Armax) -> f64 {
    settled(1.0 + model.a.iter().sum::<f64>(), LEAST[0]) * data.units.y
}

/// What a wave of amplitude 1 in the equation does to PV, and is worth at the valve (PV unit, OP unit).
pub fn of_wave(data: &IdData, model: &Armax, w: f64) -> [f64; 2] {
    let of = |numbers: &mut dyn Iterator<Item = f64>, least: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (lag, number) in numbers.enumerate() {
            let (s, c) = (w * lag as f64).sin_cos();
            (re, im) = (re + number * c, im - number * s);
        }
        settled(re.hypot(im), least)
    };
    let a = of(&mut [1.0].into_iter().chain(model.a), LEAST[0]);
    let b = of(&mut model.b.into_iter(), LEAST[1]);
    [a * data.units.y, b * data.units.u]
}
