//! A drift of a load or a sensor at a constant rate: the shape `gamma max(k - t, 0)`.
//!
//! Parameters: slope gamma (OP unit/s), rate 1/2; the time t of the kink (s), rate 1/2, where the drift does not begin with the
//! record. Nothing jumps at a kink, so that the rate of its time is that of a coefficient. Alternatives: from the start or from a
//! time on.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind};
use crate::residual::hypotheses::change_time::neighbouring_times;
use crate::residual::hypotheses::gains::{in_op, in_pv};
use crate::residual::hypotheses::proposal::{Proposal, Propose};
use crate::residual::screening::Screen;
use crate::signal::moment;
use crate::sysid::armax::Armax;
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;

/// Times of a kink that are screened.
const TIMES: usize = 24;

/// The ramps.
pub struct Ramps;

#[derive(Clone, Debug)]
struct Ramp {
    /// Sample of the kink; `None` for a drift from the start.
    from: Option<usize>,
    /// Length of the record in which it was found (samples): a record that goes on does not change its slope.
    length: usize,
}

impl Ramp {
    /// The ramp, scaled so that it rises by 1 over the length of the record in which it was found.
    fn shape(&self, data: &IdData) -> Vec<f64> {
        let from = self.from.unwrap_or(0);
        (0..data.len()).map(|k| k.saturating_sub(from) as f64 / self.length as f64).collect()
    }
}

impl EffectModel for Ramp {
    fn kind(&self) -> Kind {
        Kind::Drift
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn rate(&self) -> f64 {
        REGULAR + if self.from.is_some() { REGULAR } else { 0.0 }
    }
    fn alternatives(&self) -> f64 {
        2.0
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        out.push(self.shape(data));
    }
    fn neighbours(&self, data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        let spread = (data.split - data.first) as f64 / (4.0 * TIMES as f64);
        self.from
            .into_iter()
            .flat_map(|from| neighbouring_times(from, data, step * spread.max(1.0)))
            .map(|from| Ramp { from: Some(from), ..self.clone() }.boxed())
            .collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        let per_s = gamma.first().copied().unwrap_or(0.0) / (self.length as f64 * data.units.ts);
        let (in_op, in_pv) = (per_s * in_op(data, model), per_s * in_pv(data, model));
        let from = data.time(self.from.unwrap_or(0) as f64);
        let since = if self.from.is_some() { format!(" from {} on", moment(from)) } else { String::new() };
        Described::new(format!(
            "the load or the sensor drifts{since}, as if OP moved by {} an hour",
            data.units.along_op(in_op * 3600.0)
        ))
        .with("from_s", from, "s")
        .with("rate_op_per_s", in_op, "OP/s")
        .with("rate_pv_per_s", in_pv, "PV/s")
    }
}

impl Propose for Ramps {
    fn kind(&self) -> Kind {
        Kind::Drift
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let data = screen.data;
        let length = data.len();
        let rated = |ramp: Ramp| {
            let gain = screen.arx.single_gain(screen.arx_regressor(&ramp.shape(data))).0;
            Proposal::new(ramp, gain)
        };
        let later = screen.change_times(((data.split - data.first) / TIMES).max(1));
        let later = later.map(|from| rated(Ramp { from: Some(from), length }));
        let best = later.max_by(|a, b| a.gain.total_cmp(&b.gain));
        [rated(Ramp { from: None, length })].into_iter().chain(best).collect()
    }
}
