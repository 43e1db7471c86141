//! The effects, one file each: how it is recognised, and what it adds to the model.

mod asymmetric_friction;
mod clock_skew;
mod dead_time_change;
mod drift;
mod friction_drift;
mod frozen_pv;
mod gain_change;
mod load_step;
mod measured_disturbance;
mod oscillating_load;
mod outliers;
mod quantised_pv;
mod static_nonlinearity;
mod valve_saturation;

use super::Settings;
use super::evidence::Judge;
use super::model::{Data, Element, Spec, Stage, Term};
use super::regress::{LONG_Y, Quick};
use super::scan::Scan;
use super::search::{Reach, growing, settle};
use std::cell::OnceCell;

/// The present model and what screening reads of it.
pub struct Context<'a> {
    /// The window.
    pub data: &'a Data,
    /// The present model.
    pub spec: &'a Spec,
    /// Its signals.
    pub stage: &'a Stage,
    /// Its prediction errors over the whole window.
    pub e: &'a [f64],
    /// The long ARX on the same signals.
    pub quick: &'a Quick,
    /// The most likely friction element, whether adopted or not.
    pub likely: Element,
    /// Settings.
    pub settings: &'a Settings,
    judge: OnceCell<Judge>,
}

/// A term on trial.
#[derive(Debug)]
pub struct Proposal {
    /// The term.
    pub term: Box<dyn Term>,
    /// Loss of the long ARX with it; of what the signals alone show, the share of them by which it may be doubted.
    pub loss: f64,
    /// Numbers it adds, beside the columns counted from its stage.
    pub parameters: f64,
    /// The friction element it was rated with, where not the present one.
    pub element: Option<Element>,
    /// How many alternatives it was chosen from.
    pub tried: f64,
}

/// How an effect comes into the model.
pub trait Recognise: Sync {
    /// The terms worth a full fit, at most a few, best first.
    fn propose(&self, context: &Context<'_>) -> Vec<Proposal>;
    /// Whether what a fit made of the term is still this effect and no other.
    fn plausible(&self, _term: &dyn Term) -> bool {
        true
    }
    /// Whether it acts on the stem's way to the process: friction may have been taken for it, and it for friction.
    fn on_the_stem(&self) -> bool {
        false
    }
    /// Whether the signals alone show it: then it comes before all others and needs no gain in likelihood.
    fn direct(&self) -> bool {
        false
    }
}

/// Every effect but the slip jump, which is part of every friction estimate.
pub const ALL: &[&dyn Recognise] = &[
    &frozen_pv::FrozenPv,
    &outliers::Outliers,
    &clock_skew::ClockSkew,
    &quantised_pv::QuantisedPv,
    &oscillating_load::OscillatingLoad,
    &measured_disturbance::MeasuredDisturbance,
    &load_step::LoadStep,
    &drift::Drift,
    &gain_change::GainChange,
    &dead_time_change::DeadTimeChange,
    &valve_saturation::ValveSaturation,
    &static_nonlinearity::StaticNonlinearity,
    &asymmetric_friction::AsymmetricFriction,
    &friction_drift::FrictionDrift,
];

/// Ways a stem may go with one band, of those that matter to its errors.
const PATHS: f64 = 300.0;
/// Values of f in a scan together with another number of the element.
const SCAN: u32 = 7;
/// Kinds of valve in such a scan beside the likely one: lag, resume threshold, slips; and how many of them are sought closely.
const KINDS: [(f64, f64, bool); 4] =
    [(0.0, 0.0, false), (0.0, 1.0, false), (0.5, 0.5, false), (0.0, 0.5, true)];
const OTHERS: usize = 2;

impl<'a> Context<'a> {
    /// Of a model, its signals `stage` and its errors `e`.
    pub fn new(
        data: &'a Data,
        (spec, likely): (&'a Spec, Element),
        (stage, e): (&'a Stage, &'a [f64]),
        quick: &'a Quick,
        settings: &'a Settings,
    ) -> Self {
        Self { data, spec, stage, e, quick, likely, settings, judge: OnceCell::new() }
    }

    /// What judges the evidence of other stems and shapes.
    pub fn judge(&self) -> &Judge {
        self.judge.get_or_init(|| Judge::new(self.data, self.stage, self.spec.orders.nk))
    }

    /// Samples that are fitted.
    pub fn rows(&self) -> f64 {
        (self.data.split - self.data.first) as f64
    }

    /// Loss of the long ARX when `term` is added: for terms that change the stem or the element.
    pub fn rebuilt(&self, term: &dyn Term, element: Option<Element>) -> f64 {
        let mut trial = self.spec.clone();
        trial.element = element.unwrap_or(trial.element);
        trial.terms.push(term.boxed());
        let (stage, _) = trial.stage(self.data);
        Quick::long_arx(self.data, &stage, self.spec.orders.nk).loss
    }

    /// Elements like the likely one of which f grows so, sought closely.
    pub fn growing(&self, growths: &[f64]) -> Vec<Element> {
        growing(self.data, &Spec { element: self.likely, ..self.spec.clone() }, growths)
    }

    /// Friction and the first knob of `term` rated together, with `grown` elements beside: the f that suits one constant band
    /// may be anywhere between the bands there are, and its lag makes up for what the model lacks.
    pub fn with_friction(
        &self,
        term: &dyn Term,
        values: &[f64],
        grown: &[Element],
        (settled, most): (usize, usize),
    ) -> Vec<Proposal> {
        let mut trial = self.spec.clone();
        trial.terms.push(term.boxed());
        let last = trial.terms.len() - 1;
        let mut scan = Scan::new(self.data, &trial);
        let mut rate = |elements: &[Element], value: f64| -> Vec<f64> {
            scan.trial.terms[last].set(0, value);
            scan.rate(elements).into_iter().map(|loss| loss.unwrap_or(f64::INFINITY)).collect()
        };
        let mut rated: Vec<(f64, Element, f64)> = Vec::new();
        let own = (self.likely.resume, self.likely.slips);
        let [first, second] = [0.0, 0.5].map(|lag| (lag, own.0, own.1));
        let [plain, sticks, sticks_half, slips] = KINDS;
        let kinds = [first, second, plain, sticks, sticks_half, slips];
        for &value in values {
            let about = [1.0, 1.0 / (1.0 + value.abs()), 1.0 / (1.0 - 0.5 * value.abs())];
            let about = about.into_iter().map(|share| share * self.likely.f);
            let grid = (1..=SCAN).map(|i| self.data.f_top * (f64::from(i) / f64::from(SCAN)).powf(1.5));
            let elements = about.chain(grid).flat_map(|f| {
                kinds.map(|(lag, resume, slips)| Element { f, lag, resume, slips, ..self.likely })
            });
            let elements: Vec<Element> = elements.collect();
            let losses = rate(&elements, value);
            rated.extend(losses.into_iter().zip(elements).map(|(loss, element)| (loss, element, value)));
        }
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        // The best of each value, of the likely kind and of others: a turn missed by one costs more squares than a wrong value does.
        let mut seen: Vec<(bool, f64)> = Vec::new();
        rated.retain(|&(loss, element, value)| {
            let key = ((element.resume, element.slips) == own, value);
            let most = if key.0 { settled } else { OTHERS };
            let new = loss.is_finite()
                && !seen.contains(&key)
                && seen.iter().filter(|other| other.0 == key.0).count() < most;
            if new {
                seen.push(key);
            }
            new
        });
        let mut rated: Vec<_> = rated.into_iter().map(|r| (r.1, r.2, Reach::Near)).collect();
        rated.extend(grown.iter().map(|&element| {
            let value = element.growth - self.likely.growth;
            (Element { growth: self.likely.growth, ..element }, value, Reach::Close)
        }));
        let mut rated: Vec<(f64, Element, f64)> = rated
            .into_iter()
            .map(|(element, value, reach)| {
                let (element, settled) = settle(self.data, &trial, element, Some(value), reach);
                let value = settled.unwrap_or(value);
                trial.element = element;
                trial.terms[last].set(0, value);
                let gain = self.judge().gain(self.data, &trial.stage(self.data).0, self.spec.orders.nk);
                (self.quick.loss * (-gain / self.rows()).exp(), element, value)
            })
            .collect();
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        rated.truncate(most);
        let ways = if grown.is_empty() { kinds.len() as f64 * f64::from(SCAN) } else { PATHS };
        let tried = ways * values.len() as f64;
        rated
            .into_iter()
            .filter(|r| r.0.is_finite())
            .map(|(loss, element, value)| {
                let mut term = term.boxed();
                term.set(0, value);
                Proposal { term, loss, parameters: 1.0, tried, element: Some(element) }
            })
            .collect()
    }

    /// What the stem, changed to `z`, would add through the long ARX's own B.
    pub fn through_b(&self, change: &dyn Fn(usize) -> f64) -> Vec<f64> {
        let n = self.data.len();
        let b = &self.quick.theta[LONG_Y..LONG_Y + self.quick.z_lags.len()];
        let shape: Vec<f64> = (0..n).map(change).collect();
        let mut out = vec![0.0; n];
        for (lag, b) in self.quick.z_lags.iter().zip(b) {
            for k in *lag..n {
                out[k] += b * shape[k - lag];
            }
        }
        out
    }
}

/// The best `most` by loss.
pub fn best(mut proposals: Vec<Proposal>, most: usize) -> Vec<Proposal> {
    proposals.sort_by(|a, b| a.loss.total_cmp(&b.loss));
    proposals.truncate(most);
    proposals
}
