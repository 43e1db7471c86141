//! Friction differs between opening and closing: the band to cross is `2f (1 + s)` turning down and `2f (1 - s)` turning up.

use super::bands::{Bands, plausible};
use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Element, Knob, Linear, Term};
use crate::residual::{Kind, Parameter};

const SKEWS: [f64; 6] = [-0.7, -0.45, -0.2, 0.2, 0.45, 0.7];

pub struct AsymmetricFriction;

#[derive(Clone, Debug)]
struct Skew {
    skew: f64,
}

impl Term for Skew {
    fn kind(&self) -> Kind {
        Kind::AsymmetricFriction
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![Knob { value: self.skew, step: 0.1, smooth: false, bounds: (-0.95, 0.95) }]
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.skew = value;
    }
    fn element(&self, element: &mut Element) {
        element.skew += self.skew;
    }
    fn describe(&self, _data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let ratio = (1.0 + self.skew) / (1.0 - self.skew);
        let parameters = vec![Parameter { name: "down_to_up", value: ratio, unit: "-" }];
        (parameters, format!("turning down takes {ratio:.2} times the force of turning up"))
    }
}

impl Recognise for AsymmetricFriction {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        if c.likely.f <= 0.0 || c.spec.full_element().skew != 0.0 {
            return Vec::new();
        }
        let term = &Skew { skew: 0.0 };
        Bands { term, values: &SKEWS, grow: false }.propose(c)
    }
    fn on_the_band(&self) -> bool {
        true
    }
    fn plausible(&self, term: &dyn Term) -> bool {
        plausible(term, Kind::AsymmetricFriction)
    }
}
