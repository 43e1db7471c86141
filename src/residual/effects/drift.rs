//! A load or sensor that runs away at a constant rate from some time on: `g max(k - t, 0)`, rate [OP/s].

use super::{Context, Proposal, Recognise, best};
use crate::residual::model::{Data, Knob, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};

/// Starting times tried.
const STARTS: usize = 12;

pub struct Drift;

#[derive(Clone, Debug)]
struct Ramp {
    /// Sample it begins at; `None`: before the window.
    from: Option<f64>,
    bounds: (f64, f64),
}

impl Ramp {
    fn shape(&self, n: usize) -> Vec<f64> {
        let from = self.from.unwrap_or(0.0);
        (0..n).map(|k| (k as f64 - from).max(0.0) / n as f64).collect()
    }
}

impl Term for Ramp {
    fn kind(&self) -> Kind {
        Kind::Drift
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn knobs(&self) -> Vec<Knob> {
        let knob = |value| Knob { value, step: 10.0, smooth: true, bounds: self.bounds };
        self.from.map(knob).into_iter().collect()
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.from = Some(value);
    }
    fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
        out.push(self.shape(data.len()));
    }
    fn describe(&self, data: &Data, gamma: &[f64], linear: &Linear) -> (Vec<Parameter>, String) {
        let per_sample = gamma.first().copied().unwrap_or(0.0) / data.len() as f64;
        let rate = per_sample * linear.in_op() * data.scale.u / data.scale.ts;
        let mut parameters = vec![Parameter { name: "rate_op_per_s", value: rate, unit: "OP/s" }];
        let since = self.from.map(|from| data.scale.t0 + from * data.scale.ts);
        parameters.extend(since.map(|value| Parameter { name: "from_s", value, unit: "s" }));
        (parameters, format!("a load or the sensor drifts, worth {rate:.3e} OP/s"))
    }
}

impl Recognise for Drift {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let (first, split) = (c.data.first as f64, c.data.split as f64);
        let bounds = (first, split - 0.1 * (split - first));
        let start = |i: usize| first + (split - first) * i as f64 / (STARTS + 2) as f64;
        let ramps = (0..=STARTS).map(|i| Ramp { from: (i > 0).then(|| start(i)), bounds });
        let rated = ramps.map(|ramp| {
            let free = f64::from(u8::from(ramp.from.is_some()));
            let loss = c.quick.with(&[&ramp.shape(c.data.len())]).0 * (2.0 * free / c.rows()).exp();
            let tried = if ramp.from.is_some() { STARTS as f64 } else { 1.0 };
            Proposal { term: Box::new(ramp), loss, parameters: free, tried, element: None }
        });
        // One of each: they go on differently.
        let (always, later): (Vec<_>, Vec<_>) = rated.partition(|p| p.term.knobs().is_empty());
        always.into_iter().chain(best(later, 1)).collect()
    }
}
