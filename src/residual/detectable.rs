//! The least detectable friction: the least f that would have shown in a record, by the power of the likelihood-ratio test. It says
//! what a verdict of no stiction is worth.
//!
//! ```text
//! v_f    = B(q)/C(q) (x_f - x)                             what friction f adds to the one-step prediction of PV
//! lambda = min over theta |v_f - Phi theta|^2 I / s^2      noncentrality: the part that no linear model explains
//! LR     ~ N(lambda/2, lambda)                             log-likelihood ratio for f against no friction
//! shown  : tau (lambda/2 - z sqrt lambda) - penalty of the valve >= evidence/2,   z = 1.28: in nine records of ten
//! ```
//!
//! | symbol | what it is | unit |
//! |---|---|---|
//! | `x_f`, `x` | stem with friction f under the recorded OP; stem of the fitted model | OP |
//! | `Phi` | regressors without friction: lags of OP, lags of `y + B/A (x_f - x)`, a constant, shapes of loads | - |
//! | `s`, `nu` | scale and degrees of freedom of the errors | PV, - |
//! | `I` | Fisher information of the location of an error, in `1/s^2`: `(nu + 1)/(nu + 3)` | - |
//! | `Q` | `lambda = b' Q b / s^2` as a quadratic form of the coefficients b of B | - |
//!
//! The estimate b is noisy, and its noise adds to lambda: the mean of that, `tr(cov(b) Q)`, and 1.64 standard deviations of it are
//! subtracted. Where PV moves in steps, only the samples at which it moves count, because the rounding errors between two moves are
//! one and the same error.
//!
//! Source: Kay, Fundamentals of Statistical Signal Processing II, 1998, section 6.5 (power of a likelihood-ratio test);
//! Lange, Little & Taylor, JASA 1989, 84, 881 (information of a Student-t sample).

use super::fit::Fitted;
use super::hypothesis::Hypothesis;
use super::interval::unseen_step;
use super::valve_search::cost;
use crate::sysid::armax::{Armax, ORDER};
use crate::sysid::arx::Arx;
use crate::sysid::criterion::{REGULAR, TEMPERING, penalty};
use crate::sysid::gram::{lower, products};
use crate::sysid::iddata::IdData;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute};
use crate::sysid::valve::{StopRule, ValveModel};
use nalgebra::{SMatrix, SVector};

/// Normal quantile that nine of ten records exceed (-).
const NINE_OF_TEN: f64 = 1.2816;
/// Normal quantile for what the noise of B adds to lambda, exceeded by 5 of 100 (-).
const CHANCE: f64 = 1.6449;
/// Ratio of the values of f that are tried, from the least up.
const STEP: f64 = 1.25;
/// Factor by which `f_detectable` is larger than the theory says: a real stem is none of the models, and errors are not quite
/// independent. The aim is that no more than one in twenty sticking valves told none is above it. The factor was chosen on the
/// seeds from 8800 and 9100:
/// `cargo run --release -p stictiond-numerics --example detectable -- --records 100 --first-seed 8800`.
const MARGIN: f64 = 1.25;
/// Share of a step that an integrating process keeps after one sample: PV must not run away in the simulation (-).
const LEAK: f64 = 0.999;
/// The least f that is tried, as a share of the largest at which a stem reverses.
const LEAST: f64 = 0.01;
/// Stop rules and J/S that one f may have. Of those that show at all, the one that shows least counts.
const VALVES: [(StopRule, f64); 3] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Reversal, 0.1)];

/// The least f whose evidence would reach `evidence` on nine of ten records such as this (standard deviations of OP). `None` where
/// no friction would show, whatever its size: also where PV hardly answers OP, so that B is not worth its own penalty.
///
/// * `fitted`: the model of the record, with friction or without.
/// * `evidence`: twice the log odds that a verdict asks for (-).
/// * `fast`: where the controller scanned between the samples, the quantile (0..1) of the steps of OP of which one is added: the
///   stem turned at values of OP that the power knows nothing of ([`unseen_step`]). Elsewhere nothing is added, as in the
///   calibration of `MARGIN`.
pub fn detectable(data: &IdData, fitted: &Fitted, evidence: f64, fast: Option<f64>) -> Option<f64> {
    let Fitted { hypothesis, model, .. } = fitted;
    let stem = hypothesis.to_process(data, hypothesis.stem(data).0);
    let none = WithoutFriction::new(data, hypothesis);
    let information =
        informative_share(data) * (model.nu + 1.0) / (model.nu + 3.0) / (model.scale * model.scale);
    let (information_of_b, b) = (information_of_b(data, fitted, &stem), SVector::<f64, ORDER>::from(model.b));
    let penalty_of_b = penalty(REGULAR * ORDER as f64, data.counted());
    if 0.5 * TEMPERING * b.dot(&(information_of_b * b)) * information < penalty_of_b {
        return None;
    }
    let covariance_of_b = information_of_b.try_inverse().unwrap_or_else(OverB::zeros);
    let least = |(rule, ratio): (StopRule, f64)| {
        let shown = |f: &f64| {
            let valve = ValveModel { s: 2.0 * f, j: 2.0 * f * ratio, rule, ..ValveModel::default() };
            let other = hypothesis.with_valve(Some(valve));
            let x = other.to_process(data, other.stem(data).0);
            let left = none.unexplained(data, &responses(data, model, &x, &stem));
            // The noise of b adds to lambda, too.
            let by_chance = covariance_of_b * left;
            let chance = by_chance.trace() + CHANCE * (2.0 * (by_chance * by_chance).trace().max(0.0)).sqrt();
            let lambda = (b.dot(&(left * b)) * information - chance).max(0.0);
            let cost = penalty(cost(Some(&valve)).0, data.counted());
            TEMPERING * (0.5 * lambda - NINE_OF_TEN * lambda.sqrt()) - cost >= 0.5 * evidence
        };
        values(data).find(shown)
    };
    VALVES.into_iter().filter_map(least).reduce(f64::max).map(|f| MARGIN * f + unseen_step(data, fast))
}

/// Share of the fitted samples that are informative: those at which PV moves, where it moves in steps; otherwise 1. Values that
/// take the place of missing samples do not count.
fn informative_share(data: &IdData) -> f64 {
    let measured: Vec<usize> =
        data.rows().filter(|k| data.weight[*k] > 0.0 && data.weight[k - 1] > 0.0).collect();
    let moves = measured.iter().filter(|k| data.y[**k] != data.y[**k - 1]).count();
    if data.least_scale > 0.0 { moves as f64 / measured.len().max(1) as f64 } else { 1.0 }
}

/// The values of f that are tried.
fn values(data: &IdData) -> impl Iterator<Item = f64> + use<> {
    let most = data.f_max;
    std::iter::successors(Some(LEAST * most), |f| Some(f * STEP)).take_while(move |f| *f < most)
}

/// A matrix over the coefficients b1, b2, b3 of B.
type OverB = SMatrix<f64, ORDER, ORDER>;

/// Responses of PV to a change of the stem.
struct Responses {
    /// Of the one-step prediction on the fitted rows, to each term of B with a coefficient of 1.
    ahead: [Vec<f64>; ORDER],
    /// Of PV itself, from the first sample to the last fitted row.
    free: Vec<f64>,
}

/// The signal `v / C(q)` from the beginning of the model on, at the fitted rows.
fn filtered(data: &IdData, model: &Armax, v: &dyn Fn(usize) -> f64) -> Vec<f64> {
    let mut out = vec![0.0; data.split];
    for k in model.begin(data)..data.split {
        let past: f64 = model.c.iter().enumerate().map(|(i, c)| c * out[k - 1 - i]).sum();
        out[k] = v(k) - past;
    }
    out.split_off(data.first)
}

/// The responses of PV to the stem `x` in place of the stem `before`.
fn responses(data: &IdData, model: &Armax, x: &[f64], before: &[f64]) -> Responses {
    // The mean is left out: the controller removes a constant difference.
    let mean = data.rows().map(|k| x[k] - before[k]).sum::<f64>() / data.rows().len() as f64;
    let by = |k: usize| x[k] - before[k] - mean;
    let ahead = std::array::from_fn(|j| filtered(data, model, &|k| by(k - model.nk - j)));
    let mut free = vec![0.0; data.split];
    for k in model.begin(data)..data.split {
        let driven: f64 = model.b.iter().enumerate().map(|(j, b)| b * by(k - model.nk - j)).sum();
        let past: f64 = (0..ORDER).map(|i| model.a[i] * LEAK.powi(i as i32 + 1) * free[k - 1 - i]).sum();
        free[k] = driven - past;
    }
    Responses { ahead, free }
}

/// Information of the fitted rows on b1, b2, b3: the inverse of their covariance, in units of the squared scale of the errors.
fn information_of_b(data: &IdData, fitted: &Fitted, stem: &[f64]) -> OverB {
    let model = &fitted.model;
    let x: [Vec<f64>; ORDER] = std::array::from_fn(|j| filtered(data, model, &|k| stem[k - model.nk - j]));
    let y = fitted.hypothesis.pv(data);
    let mut others: Vec<Vec<f64>> = (1..=ORDER).map(|lag| filtered(data, model, &|k| y[k - lag])).collect();
    others.extend(data.unrecorded.iter().map(|input| filtered(data, model, &|k| input[k])));
    others.push(vec![1.0; data.rows().len()]);
    let weight = &data.weight[data.rows()];
    residual_products(&x, others, weight)
}

/// The signals of the model without friction.
struct WithoutFriction {
    /// OP as the process sees it.
    x: Vec<f64>,
    /// PV less the offset of the effects.
    y: Vec<f64>,
    /// Shapes of the effects' loads.
    shapes: Vec<Vec<f64>>,
}

impl WithoutFriction {
    fn new(data: &IdData, fitted: &Hypothesis) -> Self {
        let none = fitted.with_valve(None);
        let signals = none.signals(data);
        Self { x: signals.x, y: none.pv(data).into_owned(), shapes: signals.shapes }
    }

    /// The quadratic form Q: sums of products, over b1, b2, b3, of the part of friction's response that this model does not explain.
    fn unexplained(&self, data: &IdData, friction: &Responses) -> OverB {
        let y: Vec<f64> = self.y.iter().zip(&friction.free).map(|(y, free)| y + free).collect();
        if !y.iter().all(|y| y.is_finite()) {
            return OverB::zeros();
        }
        let regression = Arx::new(data, &y, &self.shapes);
        let columns = regression.columns(&self.x).into_iter().map(<[f64]>::to_vec).collect();
        residual_products(&friction.ahead, columns, &data.weight[data.rows()])
    }
}

/// Sums of products of the signals `v` over the rows that count, less the part that a regression on `columns` explains.
fn residual_products(v: &[Vec<f64>; ORDER], columns: Vec<Vec<f64>>, weight: &[f64]) -> OverB {
    let weighted = |v: &Vec<f64>| -> Vec<f64> { v.iter().zip(weight).map(|(v, w)| v * w).collect() };
    let columns: Vec<Vec<f64>> = columns.iter().map(weighted).collect();
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let size = columns.len();
    let (mut factored, mut live) = (vec![0.0; size * size], [true; MOST_COLUMNS]);
    lower(&columns, &mut factored, size);
    factor(&mut factored, size, size, &mut live);
    let v = v.each_ref().map(weighted);
    let mut right: [Vec<f64>; ORDER] = std::array::from_fn(|_| vec![0.0; size]);
    products(&v.each_ref().map(Vec::as_slice), &columns, |i, j, sum| right[i][j] = sum);
    let theta = right.clone().map(|mut theta| {
        substitute(&factored, size, &live, &mut theta);
        theta
    });
    OverB::from_fn(|i, j| dot(&v[i], &v[j]) - dot(&right[i], &theta[j]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::fit::fit_anew;
    use crate::signal::Window;
    use crate::sysid::valve::Start;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// A sound loop whose OP swings by ±5, with this noise on PV, and its model.
    fn sound(noise: f64) -> (IdData, Fitted) {
        let n = 1200;
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(3));
        let mut next = || draw.next().unwrap_or(0.0);
        let swing = |k: usize| 3.0 * (0.11 * k as f64).sin() + 2.0 * (0.043 * k as f64).cos();
        let op: Vec<f64> = (0..n).map(|k| swing(k) + 0.02 * next()).collect();
        let (mut y, mut pv) = (0.0, vec![0.0; n]);
        for k in 1..n {
            y = 0.8 * y + 0.2 * op[k - 1];
            pv[k] = y + noise * next();
        }
        let window = Window { t0: 0.0, ts: 1.0, op, pv, ..Window::default() };
        let data = IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough");
        let none = fit_anew(&data, Hypothesis::default(), None);
        (data, none)
    }

    #[test]
    fn more_noise_hides_more_and_enough_of_it_all() {
        let least = |noise: f64| {
            let (data, none) = sound(noise);
            detectable(&data, &none, 20.0, None).map(|f| f * data.units.u)
        };
        let (quiet, noisy) = (least(0.01), least(0.3));
        assert!(quiet.is_some_and(|f| f < 0.1), "{quiet:?}");
        assert!(noisy > quiet && noisy.is_some_and(|f| f < 4.0), "{quiet:?} {noisy:?}");
        assert_eq!(least(30.0), None);
    }

    #[test]
    fn more_evidence_asks_for_more_friction() {
        let (data, none) = sound(0.1);
        let [little, much] = [20.0, 100.0].map(|evidence| detectable(&data, &none, evidence, None));
        assert!(much > little && little.is_some(), "{little:?} {much:?}");
    }

    #[test]
    fn where_scans_are_not_seen_it_is_larger_by_the_fast_step_of_op() {
        let (data, none) = sound(0.1);
        let of = |fast| detectable(&data, &none, 20.0, fast).expect("little noise");
        let mut steps: Vec<f64> = data.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
        steps.sort_by(f64::total_cmp);
        let more = of(Some(1.0)) - of(None);
        assert!((more - steps[steps.len() - 1]).abs() < 1e-9, "{more}");
    }

    #[test]
    fn friction_just_above_it_is_found() {
        let (data, none) = sound(0.1);
        let f = 1.05 * detectable(&data, &none, 20.0, None).expect("little noise");
        let valve = ValveModel { s: 2.0 * f, j: 2.0 * f, ..ValveModel::default() };
        let stuck = Hypothesis { valve: Some(valve), effects: Vec::new() };
        let mut sticking = data.clone();
        let added = responses(&data, &none.model, &stuck.stem(&data).0, &data.u).free;
        sticking.y.iter_mut().zip(&added).for_each(|(y, added)| *y += added);
        let [free, stuck] = [Hypothesis::default(), stuck].map(|h| fit_anew(&sticking, h, None));
        assert!(2.0 * (stuck.score - free.score) > 20.0, "{} {}", stuck.score, free.score);
    }
}
