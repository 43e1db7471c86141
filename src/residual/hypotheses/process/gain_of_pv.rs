//! A process gain that depends on PV: `x[k] -> (1 + r (y[k] - mean y)) x[k]`.
//!
//! Parameter: r (1/PV unit), rate 1/2. Alternatives: in the process or in the valve's characteristic. x is a deviation from its
//! mean: the product of the mean stem and y is a part of A already.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind, Lasting};
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::Screen;
use crate::signal::told;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;

/// Largest relative change of the gain over one standard deviation of PV (-).
const MOST: f64 = 0.8;

/// The gains that depend on PV.
pub struct GainsOfPv;

#[derive(Clone, Debug)]
struct GainOfPv {
    r: f64,
}

impl EffectModel for GainOfPv {
    fn kind(&self) -> Kind {
        Kind::StaticNonlinearity
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR
    }
    fn alternatives(&self) -> f64 {
        2.0
    }
    fn smooth(&self) -> Vec<Smooth> {
        vec![Smooth { value: self.r, step: 1e-4, bounds: (-MOST, MOST) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.r = theta[0];
    }
    fn maps_stem(&self) -> bool {
        true
    }
    fn map_stem(&self, data: &IdData, k: usize, x: &mut [f64]) {
        let gain = 1.0 + self.r * data.y[k];
        x.iter_mut().for_each(|x| *x *= gain);
    }
    fn lasting(&self, data: &IdData) -> Option<Lasting> {
        Some(Lasting::GainOfPv { gain_per_pv: self.r / data.units.y })
    }
    fn describe(&self, data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let r = self.r / data.units.y;
        let how = if r > 0.0 { "rises" } else { "falls" };
        let by = told(100.0 * r.abs());
        Described::new(format!("the process gain {how} by {by} % per PV unit as PV rises"))
            .with("gain_per_pv", r, "1/PV")
            .at("process")
    }
}

/// The gain with this relative slope (1/PV unit).
pub fn restored(data: &IdData, gain_per_pv: f64) -> Option<Box<dyn EffectModel>> {
    let r = gain_per_pv * data.units.y;
    r.is_finite().then(|| GainOfPv { r: r.clamp(-MOST, MOST) }.boxed())
}

impl Propose for GainsOfPv {
    fn kind(&self) -> Kind {
        Kind::StaticNonlinearity
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        // A second one would make a curve of higher order, and the two sentences could contradict each other.
        if screen.hypothesis().has_lasting(screen.data, |own| matches!(own, Lasting::GainOfPv { .. })) {
            return Vec::new();
        }
        let product: Vec<f64> = screen.signals.x.iter().zip(&screen.data.y).map(|(x, y)| x * y).collect();
        let (gain, r) = screen.armax.single_gain(screen.stem_regressor(&product));
        vec![Proposal::new(GainOfPv { r: r.clamp(-0.5 * MOST, 0.5 * MOST) }, gain)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::fit::fit_anew;
    use crate::residual::hypotheses::valve::characteristic::{self, Characteristics};
    use crate::residual::hypothesis::Hypothesis;
    use crate::signal::Window;
    use crate::sysid::valve::Start;

    #[test]
    fn one_gain_of_pv_and_one_characteristic_are_enough() {
        let op: Vec<f64> = (0..600).map(|k| (0.11 * k as f64).sin() + (0.043 * k as f64).cos()).collect();
        let mut pv = vec![0.0; op.len()];
        for k in 1..op.len() {
            pv[k] = 0.8 * pv[k - 1] + 0.2 * (1.0 + 0.3 * pv[k - 1]) * op[k - 1];
        }
        let window = Window { ts: 1.0, op, pv, ..Window::default() };
        let data = IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough");
        let proposed = |effects: [Option<Box<dyn EffectModel>>; 2]| {
            let hypothesis =
                effects.into_iter().flatten().fold(Hypothesis::default(), |all, own| all.with(own));
            let fitted = fit_anew(&data, hypothesis, None);
            let screen = Screen::new(&data, &fitted);
            [GainsOfPv.propose(&screen).len(), Characteristics.propose(&screen).len()]
        };
        let (gain, curve) = (|| restored(&data, 0.1), || characteristic::restored(&data, 0.1));
        assert_eq!(proposed([None, None]), [1, 1]);
        assert_eq!(proposed([gain(), None]), [0, 1]);
        assert_eq!(proposed([None, curve()]), [1, 0]);
        assert_eq!(proposed([gain(), curve()]), [0, 0]);
    }
}
