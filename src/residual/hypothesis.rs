//! A hypothesis: friction or none, and the effects beside it.

use super::Kind;
use super::effect::EffectModel;
use crate::sysid::armax::{Input, Signals, Smooth};
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel};
use std::borrow::Cow;

/// Lags of OP beside the stem: a level, a change, and two more for a delay of either, for a load that is known before PV shows it.
const DIRECT_LAGS: usize = 4;
/// Step of a difference quotient for J, as a share of S.
const STEP_OF_J: f64 = 1e-3;

/// Lags of OP that act beside a stem: the first shapes of every hypothesis.
pub fn direct_lags(data: &IdData) -> usize {
    if data.direct { DIRECT_LAGS } else { 0 }
}

/// Friction or none, with effects.
#[derive(Debug, Default)]
pub struct Hypothesis {
    /// The valve; `None` where the stem follows OP.
    pub valve: Option<ValveModel>,
    /// The effects in the order they were added.
    pub effects: Vec<Box<dyn EffectModel>>,
}

impl Clone for Hypothesis {
    fn clone(&self) -> Self {
        Self { valve: self.valve, effects: self.effects.iter().map(|effect| effect.boxed()).collect() }
    }
}

impl Hypothesis {
    /// The same with another valve.
    pub fn with_valve(&self, valve: Option<ValveModel>) -> Self {
        Self { valve, ..self.clone() }
    }

    /// The same with one effect more.
    pub fn with(&self, effect: Box<dyn EffectModel>) -> Self {
        let mut other = self.clone();
        other.effects.push(effect);
        other
    }

    /// The same without the effect at `at`.
    pub fn without(&self, at: usize) -> Self {
        let mut other = self.clone();
        other.effects.remove(at);
        other
    }

    /// Whether it has an effect of this kind.
    pub fn has(&self, kind: Kind) -> bool {
        self.effects.iter().any(|effect| effect.kind() == kind)
    }

    /// Whether it says something of the valve or of how the process answers to it: a model in which the feedback is positive
    /// cannot be right about that, because the loop would run away.
    pub fn is_of_the_valve(&self) -> bool {
        self.valve.is_some() || self.effects.iter().any(|effect| effect.kind().is_of_the_valve())
    }

    /// The valve with what the effects change about it.
    pub fn full_valve(&self) -> Option<ValveModel> {
        let mut valve = self.valve?;
        self.effects.iter().for_each(|effect| effect.on_valve(&mut valve));
        Some(valve)
    }

    /// The stem as the valve moves it, and the direction of its last move.
    pub fn stem(&self, data: &IdData) -> (Vec<f64>, Vec<f64>) {
        let (mut x, mut dir) = (Vec::new(), Vec::new());
        match self.full_valve() {
            Some(valve) => valve.run(&data.u, data.start, data.split, &mut x, &mut dir),
            None => (x, dir) = (data.u.clone(), vec![0.0; data.len()]),
        }
        (x, dir)
    }

    /// The stem `x` as the process sees it.
    pub fn to_process(&self, data: &IdData, mut x: Vec<f64>) -> Vec<f64> {
        for effect in self.effects.iter().filter(|effect| effect.bends()) {
            (0..x.len()).for_each(|k| effect.bend(data, k, &mut x[k..=k]));
        }
        for effect in &self.effects {
            if (effect.delay(0), effect.delay(usize::MAX)) != (0, 0) {
                x = (0..x.len()).map(|k| x[k.saturating_sub(effect.delay(k))]).collect();
            }
        }
        x
    }

    /// What the linear part is driven by.
    pub fn signals(&self, data: &IdData) -> Signals {
        let x = self.to_process(data, self.stem(data).0);
        Signals { x, shapes: self.shapes(data), offset: self.offset(data) }
    }

    /// What PV shows beside the process' output; empty for nothing.
    pub fn offset(&self, data: &IdData) -> Vec<f64> {
        if !self.effects.iter().any(|effect| effect.shifts_pv()) {
            return Vec::new();
        }
        let mut offset = vec![0.0; data.len()];
        self.effects.iter().for_each(|effect| effect.on_pv(data, &mut offset));
        offset
    }

    /// PV less its offset.
    pub fn pv<'a>(&self, data: &'a IdData) -> Cow<'a, [f64]> {
        let offset = self.offset(data);
        if offset.is_empty() {
            return Cow::Borrowed(&data.y);
        }
        Cow::Owned(data.y.iter().zip(&offset).map(|(y, offset)| y - offset).collect())
    }

    /// OP late by one sample and more, where it acts beside a stem ([`IdData::direct`]), then the shapes of all effects.
    pub fn shapes(&self, data: &IdData) -> Vec<Vec<f64>> {
        let late = |lag: usize| (0..data.len()).map(|k| data.u[k.saturating_sub(lag)]).collect();
        let mut shapes: Vec<Vec<f64>> = (1..=direct_lags(data)).map(late).collect();
        self.effects.iter().for_each(|effect| effect.shapes(data, &mut shapes));
        shapes
    }

    /// Sum of the rates of OP's coefficients beside a stem. Without friction the stem is OP and they are further lags of it, which
    /// are not charged: what friction is compared with may answer OP as freely as what has friction.
    pub fn direct_rate(&self, data: &IdData) -> f64 {
        if self.valve.is_some() { REGULAR * direct_lags(data) as f64 } else { 0.0 }
    }

    /// Whether J is a smooth parameter: it is where it decides nothing but the lag.
    fn smooth_j(&self) -> Option<ValveModel> {
        self.valve.filter(|valve| valve.rule == StopRule::Reversal && valve.j != valve.s)
    }

    /// Values of the smooth parameters: of the valve, then of each effect.
    pub fn smooth(&self) -> Vec<Smooth> {
        let of_valve = self.smooth_j().map(|valve| Smooth {
            value: valve.j,
            step: STEP_OF_J * valve.s,
            bounds: (0.0, 2.0 * valve.s),
        });
        of_valve.into_iter().chain(self.effects.iter().flat_map(|effect| effect.smooth())).collect()
    }

    /// Sets them.
    pub fn set_smooth(&mut self, mut theta: &[f64]) {
        if self.smooth_j().is_some() && !theta.is_empty() {
            if let Some(valve) = &mut self.valve {
                valve.j = theta[0];
            }
            theta = &theta[1..];
        }
        for effect in &mut self.effects {
            let (own, rest) = theta.split_at(effect.smooth().len().min(theta.len()));
            effect.set_smooth(own);
            theta = rest;
        }
    }
}

/// A hypothesis on its data.
pub struct OnData<'a> {
    /// The hypothesis.
    pub hypothesis: &'a Hypothesis,
    /// The data.
    pub data: &'a IdData,
}

impl Input for OnData<'_> {
    fn smooth(&self) -> Vec<Smooth> {
        self.hypothesis.smooth()
    }

    fn signals(&self, theta: &[f64]) -> Signals {
        if theta.is_empty() {
            return self.hypothesis.signals(self.data);
        }
        let mut other = self.hypothesis.clone();
        other.set_smooth(theta);
        other.signals(self.data)
    }
}
