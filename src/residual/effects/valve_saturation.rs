//! The stem runs into a stop: `z` between a lower and an upper level [OP].

use super::{Context, Proposal, Recognise, best};
use crate::residual::model::{Data, Knob, Linear, Term};
use crate::residual::{Kind, Parameter};
use crate::sysid::stats::quantile;

/// Levels tried on each side, as quantiles of the stem; against its stop OP may stay for most of the time.
const LEVELS: [f64; 12] = [0.01, 0.03, 0.06, 0.1, 0.16, 0.23, 0.31, 0.4, 0.5, 0.62, 0.75, 0.88];

pub struct ValveSaturation;

#[derive(Clone, Debug)]
struct Clip {
    low: Option<f64>,
    high: Option<f64>,
}

impl Term for Clip {
    fn kind(&self) -> Kind {
        Kind::ValveSaturation
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        let knob = |value| Knob { value, step: 0.1, smooth: true, bounds: (-10.0, 10.0) };
        self.low.into_iter().chain(self.high).map(knob).collect()
    }
    fn set(&mut self, at: usize, value: f64) {
        match (&mut self.low, &mut self.high) {
            (Some(low), _) if at == 0 => *low = value,
            (_, Some(high)) => *high = value,
            _ => {}
        }
    }
    fn changes_stem(&self) -> bool {
        true
    }
    fn stem(&self, _data: &Data, z: &mut [f64]) {
        for z in z {
            *z = z.max(self.low.unwrap_or(f64::NEG_INFINITY)).min(self.high.unwrap_or(f64::INFINITY));
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let op = |v: f64| v * data.scale.u + data.scale.u0;
        let mut parameters = Vec::new();
        parameters.extend(self.low.map(|v| Parameter { name: "low", value: op(v), unit: "OP" }));
        parameters.extend(self.high.map(|v| Parameter { name: "high", value: op(v), unit: "OP" }));
        let ends: Vec<String> = parameters.iter().map(|p| format!("{:.3}", p.value)).collect();
        (parameters, format!("the stem stops at {} while OP goes on", ends.join(" and ")))
    }
}

impl Recognise for ValveSaturation {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let z = &c.stage.z[c.data.first..c.data.split];
        let mut clips: Vec<Clip> = Vec::new();
        for q in LEVELS {
            clips.push(Clip { low: Some(quantile(z, q)), high: None });
            clips.push(Clip { low: None, high: Some(quantile(z, 1.0 - q)) });
        }
        let rate = |clip: Clip| {
            let (loss, sides) = (c.rebuilt(&clip, None), clip.low.iter().chain(&clip.high).count() as f64);
            let tried = LEVELS.len() as f64 * 2.0;
            Proposal {
                term: Box::new(clip),
                loss: loss * (2.0 * sides / c.rows()).exp(),
                parameters: sides,
                tried,
                element: None,
            }
        };
        let mut single: Vec<(f64, Clip)> =
            clips.into_iter().map(|clip| (c.rebuilt(&clip, None), clip)).collect();
        single.sort_by(|a, b| a.0.total_cmp(&b.0));
        let low = single.iter().find_map(|(_, clip)| clip.low);
        let high = single.iter().find_map(|(_, clip)| clip.high);
        let mut out: Vec<Proposal> = single.into_iter().take(2).map(|(_, clip)| rate(clip)).collect();
        if let (Some(low), Some(high)) = (low, high)
            && low < high
        {
            out.push(rate(Clip { low: Some(low), high: Some(high) }));
            let half = [quantile(z, 0.2), quantile(z, 0.8)];
            out.push(rate(Clip { low: Some(half[0]), high: Some(half[1]) }));
        }
        best(out, 3)
    }
    fn on_the_stem(&self) -> bool {
        true
    }
}
