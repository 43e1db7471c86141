//! A curved characteristic of the valve, or a process gain that depends on the load: `(exp(q z) - 1) / q`, which is an
//! equal-percentage valve; curvature q (-) over one sd of OP.
//!
//! One number on purpose: a polynomial with more would also draw clipped stems and friction.

use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Knob, Linear, Term};
use crate::residual::{Kind, Parameter};

/// Least curvature that counts.
const LEAST: f64 = 0.03;

pub struct StaticNonlinearity;

#[derive(Clone, Debug)]
struct Curve {
    q: f64,
}

impl Term for Curve {
    fn kind(&self) -> Kind {
        Kind::StaticNonlinearity
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![Knob { value: self.q, step: 0.1, smooth: true, bounds: (-1.2, 1.2) }]
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.q = value;
    }
    fn changes_stem(&self) -> bool {
        true
    }
    fn stem(&self, _data: &Data, z: &mut [f64]) {
        // A stem that rests stays where it is.
        let mut last = (f64::NAN, f64::NAN);
        for z in z {
            if *z != last.0 {
                let q = self.q * z.clamp(-8.0, 8.0);
                // The series where the quotient loses its digits.
                last = (*z, if q.abs() < 1e-4 { *z * (1.0 + 0.5 * q) } else { q.exp_m1() / self.q });
            }
            *z = last.1;
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let curvature = self.q / data.scale.u;
        let parameters = vec![Parameter { name: "curvature_per_op", value: curvature, unit: "1/OP" }];
        let steeper = if self.q > 0.0 { "rises" } else { "falls" };
        (
            parameters,
            format!("the gain {steeper} by {:.1} % per OP unit as the valve opens", 100.0 * curvature.abs()),
        )
    }
}

impl Recognise for StaticNonlinearity {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        // A curve of a curve is a curve.
        if c.spec.terms.iter().any(|t| t.kind() == Kind::StaticNonlinearity) {
            return Vec::new();
        }
        let square: Vec<f64> = c.stage.z.iter().map(|z| 0.5 * z * z).collect();
        let square = c.through_b(&square);
        let (loss, q) = c.quick.with(&[&square]);
        let term = Curve { q: q[0].clamp(-0.8, 0.8) };
        vec![Proposal { term: Box::new(term), loss, parameters: 1.0, tried: 2.0, element: None }]
    }
    fn plausible(&self, term: &dyn Term) -> bool {
        term.kind() != Kind::StaticNonlinearity || term.knobs()[0].value.abs() > LEAST
    }
    fn on_the_stem(&self) -> bool {
        true
    }
}
