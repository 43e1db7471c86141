//! Friction that differs by direction: to reverse downwards takes `S (1 + a)`, to reverse upwards `S (1 - a)`. Which of the two
//! closes the valve depends on the actuator, so that the sentence speaks of OP.
//!
//! Parameter: a (-), rate 1. It is proposed by beam searches at some values of a.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind, Lasting};
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::Screen;
use crate::residual::valve_search::{MOST_UNEQUAL, propose_bands};
use crate::sysid::armax::Armax;
use crate::sysid::criterion::THRESHOLD;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Values of a that are tried.
const VALUES: [f64; 6] = [-0.7, -0.45, -0.2, 0.2, 0.45, 0.7];

/// The asymmetries.
pub struct Asymmetries;

#[derive(Clone, Debug)]
struct Asymmetry {
    a: f64,
}

impl EffectModel for Asymmetry {
    fn kind(&self) -> Kind {
        Kind::AsymmetricFriction
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        THRESHOLD
    }
    fn change_valve(&self, valve: &mut ValveModel) {
        valve.asymmetry += self.a;
    }
    fn neighbours(&self, _data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        let inside = |a: &f64| a.abs() < MOST_UNEQUAL;
        let sides = [self.a - 0.12 * step, self.a + 0.12 * step];
        sides.into_iter().filter(inside).map(|a| Asymmetry { a }.boxed()).collect()
    }
    fn lasting(&self, _data: &IdData) -> Option<Lasting> {
        Some(Lasting::AsymmetricFriction { asymmetry: self.a })
    }
    fn describe(&self, _data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let ratio = (1.0 + self.a) / (1.0 - self.a);
        let sentence = format!("friction is {ratio:.2} times as large where OP falls as where it rises");
        Described::new(sentence).with("falling_to_rising", ratio, "-")
    }
}

/// The asymmetric friction with this a (-).
pub fn restored(asymmetry: f64) -> Option<Box<dyn EffectModel>> {
    (asymmetry.abs() < MOST_UNEQUAL).then(|| Asymmetry { a: asymmetry }.boxed())
}

impl Propose for Asymmetries {
    fn kind(&self) -> Kind {
        Kind::AsymmetricFriction
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        if screen.hypothesis().has(Kind::AsymmetricFriction) {
            return Vec::new();
        }
        propose_bands(screen, &VALUES, |valve, a| valve.asymmetry += a, |a| Box::new(Asymmetry { a }))
    }
}
