//! The effects, one file each: how it is recognised, and what it adds to the model.

mod asymmetric_friction;
mod bands;
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

#[cfg(test)]
pub use oscillating_load::OscillatingLoad;
pub use oscillating_load::wave;

use super::Settings;
use super::evidence::Judge;
use super::growing::Left;
use super::model::{Data, Element, Spec, Stage, Term};
use super::regress::Quick;
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
    left: OnceCell<Left<'a>>,
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
    /// Whether it acts on the band that the stem has to cross: it takes long to look for.
    fn on_the_band(&self) -> bool {
        false
    }
    /// Whether the signals alone show it: then it comes before all others and needs no gain in likelihood.
    fn direct(&self) -> bool {
        false
    }
}

/// Every effect but the slip jump, which is part of every friction estimate.
pub const ALL: &[&dyn Recognise] = &[
    // A coarse PV stands still by itself: where both are there, its steps are named first.
    &quantised_pv::QuantisedPv,
    &frozen_pv::FrozenPv,
    // What PV's own past says of a sample means nothing where OP's is of another time.
    &clock_skew::ClockSkew,
    &outliers::Outliers,
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

impl<'a> Context<'a> {
    /// Of a model, its signals `stage` and its errors `e`.
    pub fn new(
        data: &'a Data,
        (spec, likely): (&'a Spec, Element),
        (stage, e): (&'a Stage, &'a [f64]),
        quick: &'a Quick,
        settings: &'a Settings,
    ) -> Self {
        Self { data, spec, stage, e, quick, likely, settings, judge: OnceCell::new(), left: OnceCell::new() }
    }

    /// What judges the evidence of other stems and shapes.
    pub fn judge(&self) -> &Judge {
        self.judge.get_or_init(|| Judge::new(self.data, self.stage, self.spec.orders.nk))
    }

    /// What the long ARX leaves, for columns that grow.
    pub fn left(&self) -> &Left<'a> {
        self.left.get_or_init(|| Left::new(self.quick))
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

    /// What a stem of this shape would add through the long ARX's own B.
    pub fn through_b(&self, shape: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; shape.len()];
        for (lag, b) in self.quick.z_lags.iter().zip(self.quick.b()) {
            for k in *lag..shape.len() {
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
