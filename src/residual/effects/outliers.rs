//! Single PV samples far off both neighbours: they do not count, and are bridged.
//!
//! `min(|y[k] - y[k-1]|, |y[k] - y[k+1]|) > 4 scale`, both on the same side; scale is the robust sd of PV's changes.

use super::frozen_pv::bridge;
use super::quantised_pv::quantum;
use super::{Context, Proposal, Recognise};
use crate::diagnosis::stats::{mean, median};
use crate::residual::model::{Data, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Threshold in robust standard deviations of PV's changes.
const FAR: f64 = 4.0;
/// Largest share of samples that can be called outliers.
const SHARE: f64 = 0.1;
/// Fewest: a single one may be anything.
const FEWEST: usize = 2;

pub struct Outliers;

#[derive(Clone, Debug)]
struct Spikes {
    at: Vec<usize>,
    size: f64,
}

impl Term for Spikes {
    fn kind(&self) -> Kind {
        Kind::Outliers
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn data(&self, stage: &mut Stage) {
        for &k in &self.at {
            bridge(&mut stage.y, k, k + 1);
            stage.weight[k] = 0.0;
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _gain: f64) -> (Vec<Parameter>, String) {
        let size = self.size * data.scale.y;
        let parameters = vec![
            Parameter { name: "count", value: self.at.len() as f64, unit: "-" },
            Parameter { name: "share", value: self.at.len() as f64 / data.len() as f64, unit: "-" },
            Parameter { name: "size", value: size, unit: "PV" },
        ];
        (parameters, format!("{} samples of PV are off by {size:.3} on average", self.at.len()))
    }
}

impl Recognise for Outliers {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let y = &c.data.y;
        let changes: Vec<f64> = y.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        // Quantised PVs mostly do not change at all: the mean keeps the scale above 0.
        let step = quantum(y).map_or(0.0, |(size, _)| size);
        let scale = (median(&changes) / 0.6745).max(0.5 * mean(&changes)).max(0.4 * step);
        let errors: Vec<f64> = c.e[c.data.first..].iter().map(|e| e.abs()).collect();
        let spread = median(&errors) / 0.6745;
        let mut at = Vec::new();
        let mut sizes = Vec::new();
        for k in c.data.start.index + 8..y.len().saturating_sub(1) {
            let (before, after) = (y[k] - y[k - 1], y[k] - y[k + 1]);
            let least = before.abs().min(after.abs());
            if before * after > 0.0 && least > FAR * scale && c.e[k].abs() > FAR * spread {
                at.push(k);
                sizes.push(least);
            }
        }
        if at.len() < FEWEST || at.len() as f64 > SHARE * y.len() as f64 {
            return Vec::new();
        }
        let (parameters, size) = (at.len() as f64, mean(&sizes));
        vec![Proposal {
            term: Box::new(Spikes { at, size }),
            loss: 0.0,
            parameters,
            tried: 1.0,
            element: None,
        }]
    }
    fn direct(&self) -> bool {
        true
    }
}
