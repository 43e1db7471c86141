//! A recorded tag drives PV: `g1 d[k-l] + g2 d[k-l-1] + g3 d[k-l-2]`, delay [s].
//!
//! Only past values of a tag count: a tag that follows PV is correlated with it as well, but at negative lags.

use super::{Context, Proposal, Recognise, best};
use crate::residual::model::{Data, Knob, Linear, Stage, Term};
use crate::residual::{Kind, Parameter};
use crate::sysid::least_squares::dot;

/// A tag that is PV itself, measured again, explains everything and nothing.
const SAME: f64 = 0.98;

pub struct MeasuredDisturbance;

#[derive(Clone, Debug)]
struct Tag {
    index: usize,
    name: String,
    lag: f64,
}

fn delayed(v: &[f64], lag: usize) -> Vec<f64> {
    (0..v.len()).map(|k| v[k.saturating_sub(lag)]).collect()
}

impl Term for Tag {
    fn kind(&self) -> Kind {
        Kind::MeasuredDisturbance
    }
    fn boxed(&self) -> Box<dyn Term> {
        Box::new(self.clone())
    }
    fn tag(&self) -> Option<&str> {
        Some(&self.name)
    }
    fn knobs(&self) -> Vec<Knob> {
        vec![Knob { value: self.lag, step: 1.0, smooth: false, bounds: (1.0, 60.0) }]
    }
    fn set(&mut self, _at: usize, value: f64) {
        self.lag = value.round();
    }
    fn columns(&self, data: &Data, _stage: &Stage, out: &mut Vec<Vec<f64>>) {
        let Some((_, v)) = data.tags.get(self.index) else { return };
        out.extend([0, 1, 2].map(|more| delayed(v, self.lag as usize + more)));
    }
    fn describe(&self, data: &Data, gamma: &[f64], linear: &Linear) -> (Vec<Parameter>, String) {
        let delay = self.lag * data.scale.ts;
        let total = gamma.iter().sum::<f64>();
        let (in_pv, in_op) = (total * linear.in_pv() * data.scale.y, total * linear.in_op() * data.scale.u);
        let parameters = vec![
            Parameter { name: "delay_s", value: delay, unit: "s" },
            Parameter { name: "gain_per_sd", value: in_pv, unit: "PV" },
            Parameter { name: "op_per_sd", value: in_op, unit: "OP" },
        ];
        (
            parameters,
            format!(
                "{} drives PV {delay:.4} s later: a standard deviation of it does what {in_op:.3} OP would",
                self.name
            ),
        )
    }
}

impl Recognise for MeasuredDisturbance {
    fn propose(&self, c: &Context<'_>) -> Vec<Proposal> {
        let y = &c.data.y[..c.data.split];
        let most = c.settings.most_lag.min(c.data.first.saturating_sub(3)).max(1);
        let tried = (c.data.tags.len() * most) as f64;
        let taken: Vec<&str> = c.spec.terms.iter().filter_map(|t| t.tag()).collect();
        let residual = c.quick.residual();
        let mut out = Vec::new();
        for (index, (name, v)) in c.data.tags.iter().enumerate() {
            let n = y.len() as f64;
            if taken.contains(&name.as_str()) || (dot(&v[..y.len()], y) / n).abs() > SAME {
                continue;
            }
            // The correlation with what the base leaves names the delays worth a fit.
            let mut lags: Vec<(f64, usize)> = (1..=most)
                .map(|lag| (dot(&residual, &v[c.data.first - lag..c.data.split - lag]).abs(), lag))
                .collect();
            lags.sort_by(|a, b| b.0.total_cmp(&a.0));
            let few = lags.iter().take(4).flat_map(|(_, lag)| [lag.saturating_sub(1).max(1), *lag]);
            let mut few: Vec<usize> = few.collect();
            few.sort_unstable();
            few.dedup();
            let mut rated: Vec<(f64, usize)> = few
                .into_iter()
                .map(|lag| (c.quick.with(&[&delayed(v, lag), &delayed(v, lag + 1)]).0, lag))
                .collect();
            rated.sort_by(|a, b| a.0.total_cmp(&b.0));
            if let Some(&(loss, lag)) = rated.first() {
                let term = Tag { index, name: name.clone(), lag: lag as f64 };
                out.push(Proposal { term: Box::new(term), loss, parameters: 1.0, tried, element: None });
            }
        }
        best(out, 2)
    }
}
