//! The dead time changes at some time: `z[k - d]` from t on (or until t, where it becomes shorter), time and change [s].

use super::load_step::MARGIN;
use super::{Context, Proposal, Recognise, best};
use crate::residual::model::{Data, Knob, Term};
use crate::residual::{Kind, Parameter};

/// Times tried, and the longest change (samples).
const TIMES: usize = 14;
const LONGEST: i32 = 8;
/// Least change that counts (samples).
const LEAST: f64 = 1.5;

pub struct DeadTimeChange;

#[derive(Clone, Debug)]
struct Change {
    at: f64,
    /// Samples more from `at` on; negative: less.
    more: f64,
    bounds: (f64, f64),
}

impl Term for Change {
    fn kind(&self) -> Kind {
        Kind::DeadTimeChange
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![
            Knob { value: self.at, step: 12.0, smooth: false, bounds: self.bounds },
            Knob { value: self.more, step: 1.0, smooth: false, bounds: (-20.0, 20.0) },
        ]
    }
    fn set(&mut self, at: usize, value: f64) {
        if at == 0 {
            self.at = value.round();
        } else {
            self.more = value;
        }
    }
    fn changes_stem(&self) -> bool {
        true
    }
    fn stem(&self, _data: &Data, z: &mut [f64]) {
        let at = (self.at as usize).min(z.len());
        // The shorter of the two delays is the linear part's own: a longer one can be added, not taken away.
        let (range, by) = if self.more >= 0.0 { (at..z.len(), self.more) } else { (0..at, -self.more) };
        let (whole, part) = (by.floor() as usize, by.fract());
        let old = z.to_vec();
        for k in range {
            let (a, b) = (old[k.saturating_sub(whole)], old[k.saturating_sub(whole + 1)]);
            z[k] = a + part * (b - a);
        }
    }
    fn describe(&self, data: &Data, _gamma: &[f64], _gain: f64) -> (Vec<Parameter>, String) {
        let time = data.scale.t0 + self.at * data.scale.ts;
        let change = self.more * data.scale.ts;
        let parameters = vec![
            Parameter { name: "time_s", value: time, unit: "s" },
            Parameter { name: "change_s", value: change, unit: "s" },
        ];
        (parameters, format!("from {time:.1} s on the dead time is {change:.4} s longer"))
    }
}

impl Recognise for DeadTimeChange {
    fn plausible(&self, term: &dyn Term) -> bool {
        // A change of about one sample is what any error in the dynamics looks like.
        term.kind() != Kind::DeadTimeChange || term.knobs()[1].value.abs() >= LEAST
    }
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let margin = MARGIN.max((c.data.split - c.data.first) / 12);
        let (from, to) = (c.data.first + margin, c.data.split.saturating_sub(margin));
        let n = c.data.len();
        let z = &c.stage.z;
        let tried = f64::from(2 * LONGEST) * (to - from) as f64 / 4.0;
        // When anything about the response changes: its lags twice, the second time from `at` on.
        let mut times: Vec<(f64, usize)> = (from..to)
            .step_by(((to - from) / TIMES).max(1))
            .map(|at| {
                let late = |lag: usize| -> Vec<f64> {
                    (0..n).map(|k| if k >= at { z[k.saturating_sub(lag)] } else { 0.0 }).collect()
                };
                let later = c.quick.z_lags.last().map_or(1, |last| last + 2);
                let columns: Vec<Vec<f64>> =
                    c.quick.z_lags.iter().copied().step_by(2).chain([later]).map(late).collect();
                (c.quick.with(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>()).0, at)
            })
            .collect();
        times.sort_by(|a, b| a.0.total_cmp(&b.0));
        let bounds = (from as f64, to as f64);
        let mut proposals = Vec::new();
        for &(_, at) in times.iter().take(2) {
            for more in (-LONGEST..=LONGEST).filter(|d| *d != 0) {
                let term = Change { at: at as f64, more: f64::from(more), bounds };
                // The model's delay lies anywhere between the two there are.
                let nk = c.spec.orders.nk;
                let least = nk.saturating_sub(more.unsigned_abs() as usize).max(1);
                let loss = c.rebuilt_at(&term, nk).min(c.rebuilt_at(&term, least));
                proposals.push(Proposal {
                    term: Box::new(term),
                    loss,
                    parameters: 2.0,
                    tried,
                    element: None,
                });
            }
        }
        best(proposals, 2)
    }
}
