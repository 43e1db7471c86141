//! A hypothesis: a valve with friction or without, and the effects beside it; the signals that drive its linear part.

use super::effect::EffectModel;
use super::findings::{Kind, Lasting};
use crate::sysid::armax::{Input, Signals, Smooth};
use crate::sysid::criterion::REGULAR;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel};
use std::borrow::Cow;

/// Lags of OP that act beside the stem: a level, a change, and two more for a delay of either. OP may answer a load before PV
/// shows it.
const DIRECT_LAGS: usize = 4;
/// Step of the difference quotient in J, as a share of S.
const STEP_OF_J: f64 = 1e-3;

/// Number of lags of OP that act beside the stem: they are the first shapes of every hypothesis.
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

    /// Whether it has an effect that lasts in this form.
    pub fn has_lasting(&self, data: &IdData, form: impl Fn(&Lasting) -> bool) -> bool {
        self.effects.iter().filter_map(|effect| effect.lasting(data)).any(|own| form(&own))
    }

    /// Whether it has an effect of this kind.
    pub fn has(&self, kind: Kind) -> bool {
        self.effects.iter().any(|effect| effect.kind() == kind)
    }

    /// Whether friction or an effect acts between OP and PV: on the valve, or on how the process answers the valve. Such a hypothesis
    /// is wrong where its model has positive feedback, because that loop would run away.
    pub fn is_between_op_and_pv(&self) -> bool {
        self.valve.is_some() || self.effects.iter().any(|effect| effect.kind().is_between_op_and_pv())
    }

    /// The valve as the effects change it.
    pub fn full_valve(&self) -> Option<ValveModel> {
        let mut valve = self.valve?;
        self.effects.iter().for_each(|effect| effect.change_valve(&mut valve));
        Some(valve)
    }

    /// The stem x as the valve moves it (standard deviations of OP), and the direction of its last move (+1, -1, 0 without
    /// friction).
    pub fn stem(&self, data: &IdData) -> (Vec<f64>, Vec<f64>) {
        let (mut x, mut dir) = (Vec::new(), Vec::new());
        match self.full_valve() {
            Some(valve) => valve.run(&data.u, data.start, data.split, &mut x, &mut dir),
            None => (x, dir) = (data.u.clone(), vec![0.0; data.len()]),
        }
        (x, dir)
    }

    /// The stem `x` as the process sees it: mapped by the effects, then delayed by them.
    pub fn to_process(&self, data: &IdData, mut x: Vec<f64>) -> Vec<f64> {
        for effect in self.effects.iter().filter(|effect| effect.maps_stem()) {
            (0..x.len()).for_each(|k| effect.map_stem(data, k, &mut x[k..=k]));
        }
        for effect in &self.effects {
            if (effect.delay(0), effect.delay(usize::MAX)) != (0, 0) {
                x = (0..x.len()).map(|k| x[k.saturating_sub(effect.delay(k))]).collect();
            }
        }
        x
    }

    /// The signals of the linear part: the stem as the process sees it, the shapes of loads, and the offset of PV.
    pub fn signals(&self, data: &IdData) -> Signals {
        self.signals_of_stem(data, self.stem(data).0)
    }

    /// [`Hypothesis::signals`] where the stem `x` is known.
    fn signals_of_stem(&self, data: &IdData, x: Vec<f64>) -> Signals {
        Signals { x: self.to_process(data, x), shapes: self.shapes(data), offset: self.offset(data) }
    }

    /// The offset that PV shows beside the process output (standard deviations of PV); empty where there is none.
    pub fn offset(&self, data: &IdData) -> Vec<f64> {
        if !self.effects.iter().any(|effect| effect.has_pv_offset()) {
            return Vec::new();
        }
        let mut offset = vec![0.0; data.len()];
        self.effects.iter().for_each(|effect| effect.add_pv_offset(data, &mut offset));
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

    /// The shapes of all loads: first the lags of OP where OP acts beside the stem ([`IdData::direct`]), then what OP tells of
    /// PV beyond its samples ([`IdData::unrecorded`]), then those of each effect.
    pub fn shapes(&self, data: &IdData) -> Vec<Vec<f64>> {
        let late = |lag: usize| (0..data.len()).map(|k| data.u[k.saturating_sub(lag)]).collect();
        let mut shapes: Vec<Vec<f64>> = (1..=direct_lags(data)).map(late).collect();
        shapes.extend_from_slice(&data.unrecorded);
        self.effects.iter().for_each(|effect| effect.shapes(data, &mut shapes));
        shapes
    }

    /// Sum of the rates of OP's coefficients beside the stem (-). Without friction it is 0: the stem is OP, these lags are further
    /// lags of it, and the model without friction may answer OP as freely as the model with friction.
    pub fn direct_rate(&self, data: &IdData) -> f64 {
        if self.valve.is_some() { REGULAR * direct_lags(data) as f64 } else { 0.0 }
    }

    /// The valve, where J is a smooth parameter: a stem that rests at reversals only has J in its lag alone, and in no threshold.
    fn smooth_j(&self) -> Option<ValveModel> {
        self.valve.filter(|valve| valve.rule == StopRule::Reversal && valve.j != valve.s)
    }

    /// The smooth parameters: those of the valve, then those of each effect.
    pub fn smooth(&self) -> Vec<Smooth> {
        let of_valve = self.smooth_j().map(|valve| Smooth {
            value: valve.j,
            step: STEP_OF_J * valve.s,
            bounds: (0.0, 2.0 * valve.s),
        });
        of_valve.into_iter().chain(self.effects.iter().flat_map(|effect| effect.smooth())).collect()
    }

    /// Sets the smooth parameters, in the order of [`Hypothesis::smooth`].
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

/// A hypothesis with the record it is fitted to: the input of an ARMAX fit.
pub struct OnData<'a> {
    hypothesis: &'a Hypothesis,
    data: &'a IdData,
    /// The valve as the effects change it, and its stem. Most smooth parameters leave the valve as it is: the stem is run once for
    /// all their values.
    valve: Option<ValveModel>,
    stem: Vec<f64>,
}

impl<'a> OnData<'a> {
    /// A hypothesis on a record.
    pub fn new(hypothesis: &'a Hypothesis, data: &'a IdData) -> Self {
        Self { hypothesis, data, valve: hypothesis.full_valve(), stem: hypothesis.stem(data).0 }
    }

    /// The signals of a hypothesis that differs from this one by little, as by the values of its smooth parameters.
    pub fn signals_of(&self, other: &Hypothesis) -> Signals {
        let same = other.full_valve() == self.valve;
        other.signals_of_stem(self.data, if same { self.stem.clone() } else { other.stem(self.data).0 })
    }
}

impl Input for OnData<'_> {
    fn smooth(&self) -> Vec<Smooth> {
        self.hypothesis.smooth()
    }

    fn signals(&self, theta: &[f64]) -> Signals {
        if theta.is_empty() {
            return self.signals_of(self.hypothesis);
        }
        let mut other = self.hypothesis.clone();
        other.set_smooth(theta);
        self.signals_of(&other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::hypotheses::load::load_step::at_input;
    use crate::residual::hypotheses::valve::saturation;
    use crate::signal::Window;
    use crate::sysid::valve::Start;

    #[test]
    fn the_stem_that_is_kept_is_the_stem_of_the_same_valve_only() {
        let wave = |k: usize| 3.0 * (0.11 * k as f64).sin() + (0.043 * k as f64).cos();
        let op: Vec<f64> = (0..400).map(wave).collect();
        let window = Window { ts: 1.0, pv: op.clone(), op, ..Window::default() };
        let data = IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough");
        let tied = ValveModel { s: 0.8, j: 0.8, ..ValveModel::default() };
        let stop = |held: bool| saturation::restored(&data, 1.0, true, held).expect("it is reached");
        let with = |valve: Option<ValveModel>| Hypothesis { valve, effects: vec![at_input(200, 0.5)] };
        // J is smooth where it differs from S; a stop is part of the valve where the stem is held by it.
        let free = with(Some(ValveModel { j: 0.3, ..tied }));
        let all = [
            with(None),
            with(Some(tied)),
            free,
            with(Some(tied)).with(stop(true)),
            with(Some(tied)).with(stop(false)),
        ];
        let mut kept = 0;
        for hypothesis in &all {
            let input = OnData::new(hypothesis, &data);
            let theta: Vec<f64> = hypothesis.smooth().iter().map(|smooth| smooth.value + 0.1).collect();
            let mut other = hypothesis.clone();
            other.set_smooth(&theta);
            kept += usize::from(other.full_valve() == hypothesis.full_valve());
            for (found, plain) in [
                (input.signals(&theta), other.signals(&data)),
                (input.signals(&[]), hypothesis.signals(&data)),
            ] {
                assert!(found.x == plain.x && found.offset == plain.offset, "{hypothesis:?}");
                assert_eq!(found.shapes, plain.shapes);
            }
            assert_ne!(input.signals(&theta).x, input.signals(&[]).x);
        }
        assert_eq!(kept, 3);
    }
}
