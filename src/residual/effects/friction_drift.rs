//! Friction changes over the window: f grows from `1 - g` to `1 + g` times its mean.

use super::bands::{Bands, plausible};
use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Element, Knob, Linear, Term};
use crate::residual::{Kind, Parameter};

const GROWTHS: [f64; 6] = [-0.7, -0.45, -0.2, 0.2, 0.45, 0.7];

pub struct FrictionDrift;

#[derive(Clone, Debug)]
struct Growth {
    growth: f64,
}

impl Term for Growth {
    fn kind(&self) -> Kind {
        Kind::FrictionDrift
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![Knob { value: self.growth, step: 0.1, smooth: false, bounds: (-0.98, 0.98) }]
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.growth = value;
    }
    fn element(&self, element: &mut Element) {
        element.growth += self.growth;
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let end = 2.0 * data.len() as f64 / data.split as f64 - 1.0;
        let ratio = (1.0 + self.growth * end) / (1.0 - self.growth);
        let parameters = vec![Parameter { name: "end_to_start", value: ratio, unit: "-" }];
        (parameters, format!("friction at the end is {ratio:.2} times that at the start"))
    }
}

impl Recognise for FrictionDrift {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        if c.likely.f <= 0.0 || c.spec.full_element().growth != 0.0 {
            return Vec::new();
        }
        let term = &Growth { growth: 0.0 };
        Bands { term, values: &GROWTHS, grow: true }.propose(c)
    }
    fn on_the_band(&self) -> bool {
        true
    }
    fn plausible(&self, term: &dyn Term) -> bool {
        plausible(term, Kind::FrictionDrift)
    }
}
