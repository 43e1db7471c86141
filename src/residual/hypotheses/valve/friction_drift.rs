//! Friction that changes over the record: S and J grow from `1 - d` to `1 + d` times themselves.
//!
//! Parameter: d (-), rate 1. It is proposed by beam searches at some values of d.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::Screen;
use crate::residual::valve_search::{MOST_UNEQUAL, propose_bands};
use crate::sysid::armax::Armax;
use crate::sysid::criterion::THRESHOLD;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Values of d that are tried.
const VALUES: [f64; 6] = [-0.7, -0.45, -0.2, 0.2, 0.45, 0.7];

/// The drifts of friction.
pub struct Drifts;

#[derive(Clone, Debug)]
struct Drift {
    d: f64,
}

impl EffectModel for Drift {
    fn kind(&self) -> Kind {
        Kind::FrictionDrift
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        THRESHOLD
    }
    fn change_valve(&self, valve: &mut ValveModel) {
        valve.drift += self.d;
    }
    fn neighbours(&self, _data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        let inside = |d: &f64| d.abs() < MOST_UNEQUAL;
        let sides = [self.d - 0.12 * step, self.d + 0.12 * step];
        sides.into_iter().filter(inside).map(|d| Drift { d }.boxed()).collect()
    }
    fn describe(&self, data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let end = ValveModel { drift: self.d, ..ValveModel::default() }.growth(data.len(), data.split);
        let ratio = end / (1.0 - self.d);
        Described::new(format!("friction at the end is {ratio:.2} times that at the start")).with(
            "end_to_start",
            ratio,
            "-",
        )
    }
}

impl Propose for Drifts {
    fn kind(&self) -> Kind {
        Kind::FrictionDrift
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        if screen.hypothesis().has(Kind::FrictionDrift) {
            return Vec::new();
        }
        propose_bands(screen, &VALUES, |valve, d| valve.drift += d, |d| Box::new(Drift { d }))
    }
}
