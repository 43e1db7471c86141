//! A measured disturbance: a recorded tag d drives PV, `gamma_1 d[k-l] + gamma_2 d[k-l-1]`.
//!
//! Parameters: two coefficients (OP unit per standard deviation of the tag), rate 1/2 each. Alternatives: tags times delays l. Only
//! the past of a tag is used: a tag that follows PV is correlated with PV as well, but at negative lags.

use crate::residual::effect::EffectModel;
use crate::residual::findings::{Described, Kind, Lasting};
use crate::residual::hypotheses::gains::{in_op, in_pv};
use crate::residual::hypotheses::proposal::{Proposal, Propose, best};
use crate::residual::screening::Screen;
use crate::signal::figures;
use crate::sysid::armax::Armax;
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::dot_long;

/// Longest delay of a tag (samples).
const LONGEST: usize = 30;
/// Coefficients at neighbouring lags: the delay may lie between two samples.
const TAPS: usize = 2;
/// Correlation with PV from which a tag is taken for PV measured a second time, and left out (-).
const SAME: f64 = 0.98;
/// Delays of a tag for which the score test is made.
const CLOSE: usize = 3;
/// Tags proposed.
const TAGS: usize = 2;

/// The recorded tags.
pub struct Measured;

#[derive(Clone, Debug)]
struct Tag {
    /// Its number among the tags of the record.
    index: usize,
    name: String,
    /// Delay l (samples).
    lag: usize,
    /// Tags times delays (-).
    alternatives: f64,
}

/// A signal, `lag` samples later.
fn delayed(v: &[f64], lag: usize) -> Vec<f64> {
    (0..v.len()).map(|k| v[k.saturating_sub(lag)]).collect()
}

impl EffectModel for Tag {
    fn kind(&self) -> Kind {
        Kind::MeasuredDisturbance
    }
    fn boxed(&self) -> Box<dyn EffectModel> {
        Box::new(self.clone())
    }
    fn tag(&self) -> Option<&str> {
        Some(&self.name)
    }
    fn rate(&self) -> f64 {
        TAPS as f64 * REGULAR
    }
    fn alternatives(&self) -> f64 {
        self.alternatives
    }
    fn shapes(&self, data: &IdData, out: &mut Vec<Vec<f64>>) {
        if let Some((_, v)) = data.tags.get(self.index) {
            out.extend((0..TAPS).map(|more| delayed(v, self.lag + more)));
        }
    }
    fn lasting(&self, data: &IdData) -> Option<Lasting> {
        let delay_s = self.lag as f64 * data.units.ts;
        Some(Lasting::MeasuredDisturbance { tag: self.name.clone(), delay_s })
    }
    fn neighbours(&self, _data: &IdData, step: f64) -> Vec<Box<dyn EffectModel>> {
        if step < 0.5 {
            return Vec::new();
        }
        let lags = [self.lag.wrapping_sub(1), self.lag + 1];
        let inside = lags.into_iter().filter(|lag| (1..=LONGEST).contains(lag));
        inside.map(|lag| Tag { lag, ..self.clone() }.boxed()).collect()
    }
    fn describe(&self, data: &IdData, model: &Armax, gamma: &[f64]) -> Described {
        let total: f64 = gamma.iter().sum();
        let (op, pv) = (total * in_op(data, model), total * in_pv(data, model));
        let delay = self.lag as f64 * data.units.ts;
        Described::new(format!(
            "{} drives PV {} s later: one standard deviation of it acts as if OP had moved by {}",
            self.name,
            figures(delay),
            data.units.along_op(op)
        ))
        .with("delay_s", delay, "s")
        .with("gain_per_sd", pv, "PV")
        .with("op_per_sd", op, "OP")
    }
}

/// The tag of this name with this delay (s); `None` where it is not recorded, or the delay is too long.
pub fn restored(data: &IdData, name: &str, delay_s: f64) -> Option<Box<dyn EffectModel>> {
    let index = data.tags.iter().position(|tag| tag.0 == name)?;
    let (lag, longest) = ((delay_s / data.units.ts).round(), longest(data));
    let inside = lag >= 1.0 && lag <= longest as f64;
    let alternatives = (data.tags.len() * longest) as f64;
    inside.then(|| Tag { index, name: name.to_string(), lag: lag as usize, alternatives }.boxed())
}

/// Longest delay that the fitted rows allow (samples).
fn longest(data: &IdData) -> usize {
    LONGEST.min(data.first - 1)
}

impl Propose for Measured {
    fn kind(&self) -> Kind {
        Kind::MeasuredDisturbance
    }
    fn propose(&self, screen: &Screen<'_>) -> Vec<Proposal> {
        let data = screen.data;
        let rows = data.rows();
        let taken: Vec<&str> = screen.hypothesis().effects.iter().filter_map(|effect| effect.tag()).collect();
        let longest = longest(data);
        let alternatives = (data.tags.len() * longest) as f64;
        let y = &data.y[rows.clone()];
        let n = y.len() as f64;
        let mut out = Vec::new();
        for (index, (name, v)) in data.tags.iter().enumerate() {
            let same = (dot_long(&v[rows.clone()], y) / n).abs() > SAME;
            if same || taken.contains(&name.as_str()) {
                continue;
            }
            // The delays with the largest correlation with the errors are tested.
            let mut lags: Vec<(f64, usize)> = (1..=longest)
                .map(|lag| (dot_long(&screen.arx.errors, &v[rows.start - lag..rows.end - lag]).abs(), lag))
                .collect();
            lags.sort_by(|a, b| b.0.total_cmp(&a.0));
            let mut few: Vec<usize> =
                lags.iter().take(CLOSE).flat_map(|(_, lag)| [(lag - 1).max(1), *lag]).collect();
            few.sort_unstable();
            few.dedup();
            let rated = few.into_iter().map(|lag| {
                let columns: Vec<Vec<f64>> =
                    (0..TAPS).map(|more| screen.arx_regressor(&delayed(v, lag + more))).collect();
                let tag = Tag { index, name: name.clone(), lag, alternatives };
                Proposal::new(tag, screen.arx.joint_gain(&columns).0)
            });
            out.extend(rated.max_by(|a, b| a.gain.total_cmp(&b.gain)));
        }
        best(out, screen.limit(TAGS))
    }
}
