//! Single PV samples far off both neighbours: they do not count, and are bridged.
//!
//! ```text
//! min(|y[k] - y[k-1]|, |y[k] - y[k+1]|) > 4 scale,   both on the same side; scale is the robust sd of PV's changes
//! (sum p_i e[k+i])^2 / (s^2 sum p_i^2) > 25,         p = 1, -a_1, -a_2 .. of the long model, e and s its errors and their sd
//! ```
//!
//! One or the other: where the valve swings PV, its changes hide what the long model's errors show (Chang, Tiao and Chen,
//! Technometrics 1988, 30, 193).

use super::frozen_pv::bridge;
use super::quantised_pv::quantum;
use super::{Context, Proposal, Recognise};
use crate::diagnosis::stats::{mean, median};
use crate::residual::evidence::Innovations;
use crate::residual::model::{Data, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Threshold in robust standard deviations of PV's changes.
const FAR: f64 = 4.0;
/// The same of the size that the errors of the long model say, in its own standard deviations.
const ALONE: f64 = 5.0;
/// Least share of the gain of likelihood that the sample's own error has.
const AT_ONCE: f64 = 0.4;
/// Largest share of samples that can be called outliers.
const SHARE: f64 = 0.1;
/// Fewest: a single one may be anything, and so may two that only the long model shows.
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
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
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
        let y = &c.stage.y;
        let changes: Vec<f64> = y.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        // Quantised PVs mostly do not change at all: the mean keeps the scale above 0.
        let step = quantum(y).map_or(0.0, |(size, _)| size);
        let scale = (median(&changes) / 0.6745).max(0.5 * mean(&changes)).max(0.4 * step);
        let errors: Vec<f64> = c.e[c.data.first..].iter().map(|e| e.abs()).collect();
        let spread = median(&errors) / 0.6745;
        let long = Innovations::new(c.data, c.stage, c.spec.orders.nk);
        let mut at = Vec::new();
        let mut sizes = Vec::new();
        let mut plain = 0;
        for k in c.data.start.index + 8..y.len().saturating_sub(1) {
            let (before, after) = (y[k] - y[k - 1], y[k] - y[k + 1]);
            let least = before.abs().min(after.abs());
            if before * after <= 0.0 {
                continue;
            }
            let far = least > FAR * scale && c.e[k].abs() > FAR * spread;
            let wrong = || k.checked_sub(c.data.first).and_then(|row| alone(&long, row));
            let fits = |size: f64| size * before > 0.0 && least > 0.5 * size.abs() && least > 1.5 * step;
            if far || wrong().is_some_and(fits) {
                plain += usize::from(far);
                at.push(k);
                sizes.push(least);
            }
        }
        let fewest = if plain < FEWEST { FEWEST + 1 } else { FEWEST };
        if at.len() < fewest || at.len() as f64 > SHARE * y.len() as f64 {
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

/// By how much PV is wrong at a sample, if it alone is: then the next errors say so as well as its own does. What a stem that turns
/// leaves shows later only, and a shock at that sample only.
fn alone(long: &Innovations, row: usize) -> Option<f64> {
    let pairs = || long.print.iter().zip(&long.e[row..]);
    let power: f64 = pairs().map(|(print, _)| print * print).sum();
    let size = pairs().map(|(print, e)| print * e).sum::<f64>() / power;
    let variance = long.scale * long.scale;
    let (gain, at_once) = (size * size * power / variance, long.e[row] * long.e[row] / variance);
    (gain > ALONE * ALONE && gain > at_once && at_once > AT_ONCE * gain).then_some(size)
}
