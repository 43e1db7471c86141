//! The process gain changes at some time: `z (1 + g [k >= t])`, time [s], factor (-).
//!
//! The stem's zero is not known, so a step comes with it.

use super::load_step::{ALIKE, MARGIN, heaviside};
use super::{Context, Proposal, Recognise};
use crate::residual::model::{Data, Knob, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Bounds of the change (-): what ends at one is something else.
const REACH: (f64, f64) = (-0.75, 3.0);
/// Least change of gain that counts (-).
const LEAST: f64 = 0.12;

pub struct GainChange;

#[derive(Clone, Debug)]
struct Change {
    at: f64,
    more: f64,
    /// Whether the stem's zero is estimated.
    shifted: bool,
    bounds: (f64, f64),
}

impl Term for Change {
    fn kind(&self) -> Kind {
        Kind::GainChange
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![
            Knob { value: self.at, step: 4.0, smooth: false, bounds: self.bounds },
            Knob { value: self.more, step: 0.2, smooth: true, bounds: REACH },
        ]
    }
    fn set(&mut self, at: usize, value: f64) {
        if at == 0 { self.at = value.round() } else { self.more = value }
    }
    fn changes_stem(&self) -> bool {
        true
    }
    fn stem(&self, _data: &Data, z: &mut [f64]) {
        for z in z.iter_mut().skip(self.at as usize) {
            *z *= 1.0 + self.more;
        }
    }
    fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
        if self.shifted {
            out.push(heaviside(data.len(), self.at as usize));
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _linear: &Linear) -> (Vec<Parameter>, String) {
        let time = data.scale.t0 + self.at * data.scale.ts;
        let factor = 1.0 + self.more;
        let parameters = vec![
            Parameter { name: "time_s", value: time, unit: "s" },
            Parameter { name: "factor", value: factor, unit: "-" },
        ];
        (parameters, format!("from {time:.1} s on the process gain is {factor:.2} times what it was"))
    }
}

impl Recognise for GainChange {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let margin = MARGIN.max((c.data.split - c.data.first) / 12);
        let (from, to) = (c.data.first + margin, c.data.split.saturating_sub(margin));
        let (first, z) = (c.data.first, &c.stage.z);
        let left = c.left();
        let (mut shape, mut step, mut product) = (left.column(), left.column(), 0.0);
        // One of each: with the wrong zero the loss of a good time is high.
        let mut found: [Option<(f64, Change)>; 2] = [None, None];
        for at in (from..c.data.split).rev() {
            product += step.add(at - first, 1.0) * shape.at(at - first);
            for (lag, b) in c.quick.z_lags.iter().zip(c.quick.b()) {
                let k = at + lag - first;
                product += shape.add(k, b * z[at]) * step.at(k);
            }
            if at >= to {
                continue;
            }
            let rated = [(false, shape.alone()), (true, shape.beside(&step, product))];
            for (best, (shifted, (loss, more))) in found.iter_mut().zip(rated) {
                let loss = loss * (2.0 * f64::from(u8::from(shifted)) / c.rows()).exp();
                if best.as_ref().is_none_or(|best| loss < best.0) {
                    let (at, more) = (at as f64, more.clamp(-0.7, 2.5));
                    *best = Some((loss, Change { at, more, shifted, bounds: (from as f64, to as f64) }));
                }
            }
        }
        let tried = to.saturating_sub(from) as f64 / ALIKE;
        let proposal = |(loss, term)| Proposal {
            term: Box::<Change>::new(term),
            loss,
            parameters: 2.0,
            tried,
            element: None,
        };
        found.into_iter().flatten().map(proposal).collect()
    }
    fn plausible(&self, term: &dyn Term) -> bool {
        // A change of gain by a few per cent with a step is a step.
        term.kind() != Kind::GainChange
            || term.knobs().get(1).is_none_or(|knob| {
                knob.value.abs() > LEAST && knob.value > REACH.0 + 0.02 && knob.value < REACH.1 - 0.1
            })
    }
    fn on_the_stem(&self) -> bool {
        true
    }
}
