//! A curved valve characteristic, that of an equal-percentage valve: `x -> (exp(Q x) - 1) / Q`. As Q goes to 0 it becomes linear.
//!
//! Parameter: Q (1/OP unit), rate 1/2. Alternatives: in the valve or in the process gain.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind, Lasting};
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::Screen;
use crate::signal::told;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;

/// Largest curvature over one standard deviation of OP (-).
const MOST: f64 = 1.2;
/// Largest relative change of a valve's gain over 1 % of OP's span (-). The flow `sqrt x` of a quick-opening valve has
/// `d ln(gain)/dx = 1/(2 x)`, which is 0.1 per % at an opening x of 5 %; an equal-percentage valve of rangeability 100 has 0.046.
const STEEPEST: f64 = 0.1;
/// Farthest stem over which the curve goes on, so that the exponential stays finite (standard deviations of OP).
const FARTHEST: f64 = 8.0;

/// The characteristics.
pub struct Characteristics;

#[derive(Clone, Debug)]
struct Curve {
    /// Curvature Q (1/standard deviation of OP).
    q: f64,
    /// Largest curvature (1/standard deviation of OP).
    most: f64,
}

impl Curve {
    /// The curve of curvature `q` (1/standard deviation of OP), clamped to a `share` of the largest curvature of a valve.
    fn new(data: &IdData, q: f64, share: f64) -> Self {
        let steepest = data.units.span.map_or(f64::INFINITY, |span| STEEPEST * 100.0 * data.units.u / span);
        let most = MOST.min(steepest);
        Self { q: q.clamp(-share * most, share * most), most }
    }
}

impl EffectModel for Curve {
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
        vec![Smooth { value: self.q, step: 1e-3, bounds: (-self.most, self.most) }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.q = theta[0];
    }
    fn maps_stem(&self) -> bool {
        true
    }
    fn map_stem(&self, _data: &IdData, _k: usize, x: &mut [f64]) {
        for x in x {
            let inside = x.clamp(-FARTHEST, FARTHEST);
            let q = self.q * inside;
            // Near 0 the quotient loses its digits: the series takes its place.
            *x = if q.abs() < 1e-4 { inside * (1.0 + 0.5 * q) } else { q.exp_m1() / self.q };
        }
    }
    fn lasting(&self, data: &IdData) -> Option<Lasting> {
        Some(Lasting::Characteristic { curvature_per_op: self.q / data.units.u })
    }
    fn describe(&self, data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let q = self.q / data.units.u;
        let how = if q > 0.0 { "rises" } else { "falls" };
        let per = data.units.span.map_or(1.0, |span| 0.01 * span);
        let unit = if data.units.span.is_some() { "% OP" } else { "OP unit" };
        let by = 100.0 * per * q.abs();
        Described::new(format!("the gain {how} by {} % per {unit} as OP rises", told(by)))
            .with("curvature_per_op", q, "1/OP")
            .at("valve")
    }
}

/// The curve with this curvature (1/OP unit).
pub fn restored(data: &IdData, curvature_per_op: f64) -> Option<Box<dyn EffectModel>> {
    let q = curvature_per_op * data.units.u;
    q.is_finite().then(|| Curve::new(data, q, 1.0).boxed())
}

impl Propose for Characteristics {
    fn kind(&self) -> Kind {
        Kind::StaticNonlinearity
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        // A second one would make a curve of higher order, and the two sentences could contradict each other.
        if screen.hypothesis().has_lasting(screen.data, |own| matches!(own, Lasting::Characteristic { .. })) {
            return Vec::new();
        }
        let square: Vec<f64> = screen.signals.x.iter().map(|x| 0.5 * x * x).collect();
        let (gain, q) = screen.armax.single_gain(screen.stem_regressor(&square));
        // At most half of the largest curvature, so that the fit can go both ways.
        vec![Proposal::new(Curve::new(screen.data, q, 0.5), gain)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_curve_is_steeper_than_a_valve_can_be() {
        let mut data = IdData::default();
        data.units.u = 0.2;
        assert_eq!(Curve::new(&data, 3.0, 1.0).q, MOST, "the span is not known");
        data.units.span = Some(100.0);
        // 10 % per % of OP, of which a standard deviation is 0.2.
        let curve = Curve::new(&data, -3.0, 1.0);
        assert!((curve.q / data.units.u + 0.1).abs() < 1e-12 && curve.smooth()[0].bounds.0 == curve.q);
        data.units.u = 20.0;
        assert_eq!(Curve::new(&data, 3.0, 0.5).q, 0.5 * MOST, "OP moves widely");
    }
}
