//! The least friction that a record would have shown: what "no friction needed" is worth.
//!
//! ```text
//! v_f      = B(q)/C(q) (x_f - x)                                 what friction f adds to PV one step ahead
//! lambda   = min over theta |v_f - Phi theta|^2 I / s^2          what no linear model takes for its own
//! LR       ~ N(lambda/2, lambda)                                 log-likelihood ratio for f against none
//! shown    : tau (lambda/2 - z sqrt lambda) - cost of the valve >= evidence/2,   z = 1.28: nine times of ten
//! ```
//!
//! `x_f`: the stem with friction f under the recorded OP, `x`: the stem of the fitted model, `B/C` its answer one step ahead;
//! `Phi`: the lags of PV and OP, 1 and the effects' shapes, which the model without friction fits; `s`, `nu`: scale and degrees
//! of freedom of the errors (PV unit, -), `I = (nu + 1)/(nu + 3)` a sample's information of their location (-).
//!
//! Source: Kay, Fundamentals of Statistical Signal Processing II, 1998, section 6.5 (power of a likelihood-ratio test);
//! Lange, Little & Taylor, JASA 1989, 84, 881 (information of a Student-t sample).

use super::decide::Decided;
use super::hypothesis::Hypothesis;
use super::valve_search::cost;
use crate::sysid::armax::Armax;
use crate::sysid::arx::Arx;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute, total};
use crate::sysid::valve::{StopRule, ValveModel};

/// Nine of ten records show more: normal quantile (-).
const NINE_OF_TEN: f64 = 1.2816;
/// Values of f, from the least up, each so much larger than the one before.
const STEP: f64 = 1.1;
/// The least, as a share of the largest at which a stem turns.
const LEAST: f64 = 0.01;
/// Rules and J/S of the valves of one f; the one that shows least counts.
const VALVES: [(StopRule, f64); 3] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Slip, 0.5)];

/// The least f whose evidence would be `evidence` or more on nine of ten records such as this (normalised OP); `None` where
/// the record shows no friction at all, whatever f.
///
/// * `fitted`: the model of the record, with friction or without.
/// * `evidence`: twice the log odds that a verdict asks for (-).
pub fn detectable(data: &IdData, fitted: &Decided, evidence: f64) -> Option<f64> {
    let Decided { hypothesis, model, .. } = fitted;
    let linear = Linear::new(data, hypothesis);
    let stem = hypothesis.to_process(data, hypothesis.stem(data).0);
    let information = (model.nu + 1.0) / (model.nu + 3.0) / (model.scale * model.scale);
    let least = |(rule, ratio): (StopRule, f64)| {
        let shown = |f: &f64| {
            let valve = ValveModel { s: 2.0 * f, j: 2.0 * f * ratio, rule, ..ValveModel::default() };
            let other = hypothesis.with_valve(Some(valve));
            let answer = answer(data, model, &other.to_process(data, other.stem(data).0), &stem);
            let lambda = linear.left(&answer) * information;
            let cost = cost(Some(&valve)).0 * data.counted().ln();
            TEMPERING * (0.5 * lambda - NINE_OF_TEN * lambda.sqrt()) - cost >= 0.5 * evidence
        };
        values(data).find(shown)
    };
    VALVES.into_iter().map(least).try_fold(0.0, |most: f64, least| Some(most.max(least?)))
}

/// The values of f that are tried.
fn values(data: &IdData) -> impl Iterator<Item = f64> + use<> {
    let most = data.f_max;
    std::iter::successors(Some(LEAST * most), |f| Some(f * STEP)).take_while(move |f| *f < most)
}

/// What the stem `x` adds to PV one step ahead over the stem `before`, on the fitted rows.
fn answer(data: &IdData, model: &Armax, x: &[f64], before: &[f64]) -> Vec<f64> {
    let mut v = vec![0.0; data.split];
    for k in model.begin(data)..data.split {
        let by = |j: usize| x[k - model.nk - j] - before[k - model.nk - j];
        let driven: f64 = model.b.iter().enumerate().map(|(j, b)| b * by(j)).sum();
        let filtered: f64 = model.c.iter().enumerate().map(|(j, c)| c * v[k - 1 - j]).sum();
        v[k] = driven - filtered;
    }
    v.split_off(data.first)
}

/// The regression of the model without friction, factored.
struct Linear {
    columns: Vec<Vec<f64>>,
    factored: Vec<f64>,
    live: [bool; MOST_COLUMNS],
    weight: Vec<f64>,
}

impl Linear {
    fn new(data: &IdData, fitted: &Hypothesis) -> Self {
        let none = fitted.with_valve(None);
        let (signals, y) = (none.signals(data), none.pv(data));
        let weight = data.weight[data.rows()].to_vec();
        let regression = Arx::new(data, &y, &signals.shapes);
        let weighted = |column: &[f64]| column.iter().zip(&weight).map(|(c, w)| c * w).collect();
        let columns: Vec<Vec<f64>> = regression.columns(&signals.x).into_iter().map(weighted).collect();
        let size = columns.len();
        let (mut factored, mut live) = (vec![0.0; size * size], [true; MOST_COLUMNS]);
        lower(&columns.iter().map(Vec::as_slice).collect::<Vec<_>>(), &mut factored, size);
        factor(&mut factored, size, size, &mut live);
        Self { columns, factored, live, weight }
    }

    /// The part of `v` squared that it does not explain.
    fn left(&self, v: &[f64]) -> f64 {
        let mean = dot(v, &self.weight) / total(&self.weight).max(1.0);
        let v: Vec<f64> = v.iter().zip(&self.weight).map(|(v, w)| (v - mean) * w).collect();
        let columns: Vec<&[f64]> = self.columns.iter().map(Vec::as_slice).collect();
        let mut right = vec![0.0; columns.len()];
        products(&[&v], &columns, |_, i, sum| right[i] = sum);
        let mut theta = right.clone();
        substitute(&self.factored, columns.len(), &self.live, &mut theta);
        (dot(&v, &v) - dot(&right, &theta)).max(0.0)
    }
}
