//! Single PV samples far off both neighbours: they do not count, and are bridged.
//!
//! ```text
//! min(|y[k] - y[k-1]|, |y[k] - y[k+1]|) > 4 scale,   both on the same side; scale is the robust sd of PV's changes
//! (sum p_i e[k+i])^2 / (s^2 sum p_i^2) > 25,         p = 1, -a_1, -a_2 .. of the long model, e and s its errors and their sd
//! ```
//!
//! One or the other, the second where PV is beyond both neighbours by half of that, too, and the next errors come from it:
//! where the valve swings PV, its changes hide what the long model's errors show (Chang, Tiao and Chen, Technometrics 1988, 30, 193).

use super::frozen_pv::bridge;
use super::quantised_pv::quantum;
use super::{Context, Proposal, Recognise};
use crate::residual::evidence::Innovations;
use crate::residual::model::{Data, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};
use crate::sysid::stats::{mean, median};
use std::ops::Range;

/// Threshold in robust standard deviations of PV's changes.
const FAR: f64 = 4.0;
/// The same of the size that the errors of the long model say, in its own standard deviations.
const ALONE: f64 = 5.0;
/// Share of that size by which PV is at least beyond both its neighbours.
const HALF: f64 = 0.5;
/// The sample's own error squared: at least this share of that size's, and at most this share of the gain. A shock has all of the
/// gain, and what a stem leaves that turns shows later.
const AT_ONCE: Range<f64> = 0.4..1.05;
/// The next errors, and the share of their squares that it explains.
const NEXT: usize = 4;
const OF_NEXT: f64 = 0.6;
/// Largest share of samples that can be called outliers.
const SHARE: f64 = 0.1;
/// Fewest far beyond both neighbours: a single one may be anything; or one more of which the long model shows some.
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
        let mut long = Innovations::new(c.data, c.stage, c.spec.orders.nk);
        // Where PV stands still most of the time, half of the errors are none.
        let power = long.e.iter().map(|e| e * e).sum::<f64>() / long.e.len().max(1) as f64;
        long.scale = long.scale.max(HALF * power.sqrt());
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
            // What follows a wrong sample may look like another, the other way.
            let free = c.stage.weight[k] > 0.0 && at.last().is_none_or(|last| last + 1 < k);
            let row = k.checked_sub(c.data.first).filter(|_| free);
            let wrong = || row.and_then(|row| alone(&long, row));
            // Where a stem goes late PV has a corner, where a sample is wrong a peak.
            let fits = |size: f64| before * size > 0.0 && least > HALF * size.abs() && least > 1.5 * step;
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
    let next: f64 = long.e[row..].iter().take(NEXT).map(|e| e * e / variance).sum();
    let own = AT_ONCE.start * gain < at_once * power && at_once < AT_ONCE.end * gain;
    (gain > ALONE * ALONE && gain > OF_NEXT * next && own).then_some(size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::Settings;
    use crate::residual::model::{Element, Spec};
    use crate::residual::pose::declared;
    use crate::residual::pose::tests::behind_valve;
    use crate::residual::regress::{Quick, all_errors};
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn a_wrong_sample_is_told_from_a_shock_and_from_a_late_turn() {
        let long = |e: &[f64]| Innovations { e: e.to_vec(), scale: 1.0, print: vec![1.0, -0.5] };
        // Wrong by 8: its own error and half of it, the other way, at the next sample.
        assert_eq!(alone(&long(&[0.0, 8.0, -4.0, 0.0]), 1), Some(8.0));
        assert_eq!(alone(&long(&[0.0, 8.0, 0.0, 0.0]), 1), None, "a shock");
        // A PV that hardly changes: the next errors are larger than its own.
        let smooth = Innovations { e: vec![8.0, -12.8, 5.12, 0.0], scale: 1.0, print: vec![1.0, -1.6, 0.64] };
        assert!(alone(&smooth, 0).is_some_and(|size| (size - 8.0).abs() < 1e-12));
        assert_eq!(alone(&long(&[0.0, 0.0, -16.0, 0.0]), 1), None, "what shows later only");
        assert_eq!(alone(&long(&[0.0, 4.0, -2.0, 0.0]), 1), None, "no more than noise");
    }

    /// PV behind a valve that sticks and swings it far beyond its noise, with wrong samples where `wrong` says.
    fn proposed(wrong: impl Fn(usize) -> f64) -> Vec<(usize, f64)> {
        let n = 1500;
        let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(2));
        let op: Vec<f64> =
            (0..n).map(|k| 50.0 + 5.0 * (0.03 * f64::from(k)).sin() + (0.031 * f64::from(k)).cos()).collect();
        let valve = Element { f: 2.0, ..Element::default() };
        let error = |k| 0.05 * noise.next().unwrap_or(0.0) + wrong(k);
        let data = behind_valve(&op, valve, 0.7, error);
        let spec: Spec = declared(&data, valve.f / data.scale.u);
        let (stage, e) = all_errors(&data, &spec);
        let quick = Quick::long_arx(&data, &stage, spec.orders.nk);
        let settings = Settings::default();
        let context = Context::new(&data, (&spec, spec.element), (&stage, &e), &quick, &settings);
        let found = Outliers.propose(&context);
        let mut repaired = stage.clone();
        found.iter().for_each(|p| p.term.data(&mut repaired));
        (0..data.len()).filter(|&k| repaired.weight[k] == 0.0).map(|k| (k, wrong(k))).collect()
    }

    #[test]
    fn wrong_samples_are_found_where_the_valve_swings_pv_far_beyond_them() {
        // Eight standard deviations of the noise, a twentieth of PV's swing.
        let found = proposed(|k| if k % 113 == 60 { 0.4 } else { 0.0 });
        assert!(found.iter().all(|(_, wrong)| *wrong > 0.0), "{found:?}");
        assert!(found.len() >= 10, "{found:?} of 13");
        assert_eq!(proposed(|_| 0.0), []);
    }
}
