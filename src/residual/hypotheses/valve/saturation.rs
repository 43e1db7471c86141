//! The stem runs into a stop: `x -> min(x, level)` or `x -> max(x, level)`.
//!
//! Parameter: level (OP unit), rate 1/2, because nothing jumps at a kink. Alternatives: above or below; the stem itself is held, so
//! that it leaves the stop only once the force has turned, or x is limited behind the stem.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind, Lasting};
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::Screen;
use crate::signal::told;
use crate::sysid::armax::{Armax, Smooth};
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::quantile;
use crate::sysid::valve::ValveModel;

/// Levels that are screened on each side: the stem is beyond them for these shares of the time.
const SHARES: [f64; 8] = [0.01, 0.03, 0.06, 0.1, 0.16, 0.24, 0.34, 0.45];
/// Levels proposed.
const LEVELS: usize = 2;

/// The stops.
pub struct Saturations;

#[derive(Clone, Debug)]
struct Stop {
    /// Level of the stop (deviation from the mean of OP, in its standard deviations).
    level: f64,
    /// Whether it is the upper stop.
    above: bool,
    /// Whether the stem itself is held.
    held: bool,
    /// Least and largest level.
    bounds: (f64, f64),
}

impl EffectModel for Stop {
    fn kind(&self) -> Kind {
        Kind::ValveSaturation
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR
    }
    fn alternatives(&self) -> f64 {
        4.0
    }
    fn smooth(&self) -> Vec<Smooth> {
        vec![Smooth { value: self.level, step: 1e-3, bounds: self.bounds }]
    }
    fn set_smooth(&mut self, theta: &[f64]) {
        self.level = theta[0];
    }
    fn maps_stem(&self) -> bool {
        !self.held
    }
    fn change_valve(&self, valve: &mut ValveModel) {
        if self.held {
            let (low, high) = valve.stops.unwrap_or((f64::NEG_INFINITY, f64::INFINITY));
            valve.stops =
                Some(if self.above { (low, high.min(self.level)) } else { (low.max(self.level), high) });
        }
    }
    fn map_stem(&self, _data: &IdData, _k: usize, x: &mut [f64]) {
        for x in x {
            *x = if self.above { x.min(self.level) } else { x.max(self.level) };
        }
    }
    fn neighbours(&self, _data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        let by = 0.1 * step;
        [-by, by].map(|by| Stop { level: self.level + by, ..self.clone() }.boxed()).into()
    }
    fn lasting(&self, data: &IdData) -> Option<Lasting> {
        let level = self.level * data.units.u + data.units.u0;
        Some(Lasting::ValveSaturation { level, above: self.above, held: self.held })
    }
    fn describe(&self, data: &IdData, _model: &Armax, _gamma: &[f64]) -> Described {
        let level = self.level * data.units.u + data.units.u0;
        let side = if self.above { "above" } else { "below" };
        let name = if self.above { "high" } else { "low" };
        let percent = if data.units.span == Some(100.0) { " %" } else { "" };
        Described::new(format!("the valve does not go {side} OP {}{percent} however OP moves", told(level)))
            .with(name, level, "OP")
    }
}

/// The stop at this level (OP unit); `None` where OP does not reach it.
pub fn restored(data: &IdData, level: f64, above: bool, held: bool) -> Option<Box<dyn EffectModel>> {
    let level = (level - data.units.u0) / data.units.u;
    let bounds = reached(&data.u[data.rows()]);
    (bounds.0..=bounds.1).contains(&level).then(|| Stop { level, above, held, bounds }.boxed())
}

/// The range of levels that a signal reaches, without its extreme 0.2 % on each side.
fn reached(x: &[f64]) -> (f64, f64) {
    (quantile(x, 0.002), quantile(x, 0.998))
}

impl Propose for Saturations {
    fn kind(&self) -> Kind {
        Kind::ValveSaturation
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        if screen.hypothesis().has(Kind::ValveSaturation) {
            return Vec::new();
        }
        let data = screen.data;
        let stem = &screen.signals.x;
        let own = &stem[data.rows()];
        let bounds = reached(own);
        let mut out = Vec::new();
        for above in [false, true] {
            for share in SHARES {
                let level = quantile(own, if above { 1.0 - share } else { share });
                let stop = Stop { level, above, held: false, bounds };
                let mut x = stem.clone();
                stop.map_stem(data, 0, &mut x);
                // The part of the stem that the stop keeps back.
                let lost: Vec<f64> = x.iter().zip(stem).map(|(x, stem)| x - stem).collect();
                let gain = screen.armax.single_gain(screen.stem_regressor(&lost)).0;
                out.push((stop, gain));
            }
        }
        out.sort_by(|a: &(Stop, f64), b| b.1.total_cmp(&a.1));
        out.truncate(screen.limit(LEVELS));
        if screen.hypothesis().valve.is_some() {
            let held = out.iter().map(|(stop, gain)| (Stop { held: true, ..stop.clone() }, *gain));
            out.extend(held.collect::<Vec<_>>());
        }
        out.into_iter().map(|(stop, gain)| Proposal::new(stop, gain)).collect()
    }
}
