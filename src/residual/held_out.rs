//! Validation on the held-out samples: the last fifth of the window, to which no coefficient was fitted.
//!
//! ```text
//! z = sum d_k / sqrt(sum d_k^2),   d_k = ln p(y[k] | with) - ln p(y[k] | without)      over the held-out samples k
//! ```
//!
//! The held-out samples are the latest ones: a change that lasts must still be there, and a load that goes on must go on.
//!
//! They also reject effects ([`super::rejection`]) and can keep the verdict of the diagnosis ([`super::report`]). So the errors on
//! them are those of a model that they helped to choose. [`super::continuation`] has the errors on samples that chose nothing.

use super::fit::{Fitted, fit_anew};
use super::hypothesis::OnData;
use crate::diagnosis::Residual;
use crate::sysid::armax::{Errors, Input, ORDER};
use crate::sysid::iddata::IdData;
use crate::sysid::simulate::simulate;
use crate::sysid::student;
use crate::sysid::whiteness::is_white;
use std::ops::Range;

/// Free runs into which the held-out samples are cut: over one run, one slow error would decide for an integrating process.
const STRETCHES: usize = 4;

/// A model on the whole record: its errors and its free run.
pub struct Validation {
    /// Whiteness, and the errors on the held-out samples (PV unit).
    pub residual: Residual,
    /// Log-likelihood of each held-out sample (-).
    log_likelihoods: Vec<f64>,
    /// One-step errors of every sample (standard deviations of PV). An error in the rows after missing samples is divided by the
    /// factor by which its own standard deviation is larger.
    pub e: Vec<f64>,
    /// One-step errors without that division: measured PV less its prediction (standard deviations of PV).
    pub one_step: Vec<f64>,
    /// Free run (standard deviations of PV).
    pub free: Vec<f64>,
}

/// Validates a model on the held-out samples. Only the samples that count in the record `counted` count in the errors.
pub fn validate(data: &IdData, fitted: &Fitted, counted: &IdData) -> Validation {
    let Errors { e, gains, .. } = errors(data, fitted);
    let held = data.split..data.len();
    let stretch = held.len().div_ceil(STRETCHES).max(1);
    // Without missing samples there are no gains: the likeliest value of an error is the error, and its standard deviation is 1.
    let past = if gains.likeliest.is_empty() { &e } else { &gains.likeliest };
    let free = free_run(data, fitted, past, data.split, stretch);
    let root = |k: usize| gains.root.get(k).copied().unwrap_or(1.0);
    let one_step: Vec<f64> = e.iter().enumerate().map(|(k, e)| e * root(k)).collect();
    let rms = |error: &dyn Fn(usize) -> f64| rms(counted, held.clone(), error) * data.units.y;
    let kept: Vec<f64> = (data.first..data.len()).filter(|&k| data.weight[k] > 0.0).map(|k| e[k]).collect();
    let residual = Residual {
        white: is_white(&kept, 2 * ORDER),
        one_step_rmse: rms(&|k| one_step[k]),
        free_run_rmse: rms(&|k| free[k] - data.y[k]),
    };
    let model = &fitted.model;
    let each = |k: usize| {
        let lost = counted.weight[k] * root(k).ln();
        student::log_likelihood(&e[k..=k], &counted.weight[k..=k], model.scale, model.nu) - lost
    };
    let log_likelihoods = held.map(each).collect();
    Validation {
        residual,
        log_likelihoods,
        e,
        one_step,
        free: free_run(data, fitted, &vec![0.0; data.len()], data.first, stretch),
    }
}

/// The errors of the one-step prediction of every sample (standard deviations of PV).
fn errors(data: &IdData, fitted: &Fitted) -> Errors {
    let signals = OnData::new(&fitted.hypothesis, data).signals(&fitted.model.theta);
    fitted.model.errors(data, &data.y, &signals, data.len())
}

/// Root mean square of an error over the rows that count, in the unit of the error.
fn rms(counted: &IdData, rows: Range<usize>, error: &dyn Fn(usize) -> f64) -> f64 {
    let sum: f64 = rows.clone().map(|k| counted.weight[k] * error(k).powi(2)).sum();
    let count: f64 = counted.weight[rows].iter().sum();
    (sum / count.max(1.0)).sqrt()
}

/// Root mean square of the one-step error over some rows (PV unit), as [`validate`] publishes it of the held-out ones.
pub fn one_step_rmse(data: &IdData, fitted: &Fitted, rows: Range<usize>) -> f64 {
    let Errors { e, gains, .. } = errors(data, fitted);
    let root = |k: usize| gains.root.get(k).copied().unwrap_or(1.0);
    rms(data, rows, &|k| e[k] * root(k)) * data.units.y
}

/// Most free runs with an effect that depends on PV: each run is right for at least one dead time more than the run before.
const RUNS: usize = 50;
/// Change of PV below which a run repeats the one before (standard deviations of PV).
const SAME: f64 = 1e-6;

/// The free run of a model from sample `from` on: it predicts PV from the stem and its own predictions, and starts again from
/// measured PV every `stretch` samples. `e`: the errors before a start.
fn free_run(data: &IdData, fitted: &Fitted, e: &[f64], from: usize, stretch: usize) -> Vec<f64> {
    let Fitted { model, hypothesis, .. } = fitted;
    let run = |data: &IdData, of: &IdData| {
        let signals = OnData::new(hypothesis, of).signals(&model.theta);
        simulate(model, data, &signals, e, from, stretch)
    };
    let mut free = run(data, data);
    if !hypothesis.effects.iter().any(|effect| effect.maps_stem()) {
        return free;
    }
    // An effect may depend on PV: in a free run that is the PV of the run, and not the measured one.
    let mut of = data.clone();
    for _ in 0..RUNS {
        let differs = |(own, other): (&f64, &f64)| (own - other).abs() > SAME;
        if !of.y.iter().zip(&free).any(differs) {
            break;
        }
        of.y.clone_from(&free);
        free = run(data, &of);
    }
    free
}

/// By how many standard deviations the held-out samples are likelier with the second model than with the first: z (-).
pub fn held_out_gain(before: &Validation, after: &Validation) -> f64 {
    let pairs = before.log_likelihoods.iter().zip(&after.log_likelihoods);
    let by: Vec<f64> = pairs.map(|(before, after)| after - before).collect();
    by.iter().sum::<f64>() / (by.iter().map(|by| by * by).sum::<f64>().sqrt().max(f64::MIN_POSITIVE))
}

/// The model without the effect at `at`, fitted, and by how many standard deviations the held-out samples are likelier with the
/// effect (-). `with`: the model that has the effect, validated.
pub fn without_effect(data: &IdData, best: &Fitted, with: &Validation, at: usize) -> (Fitted, f64) {
    let without = fit_anew(data, best.hypothesis.without(at), None);
    let held_out = held_out_gain(&validate(data, &without, data), with);
    (without, held_out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::hypotheses::process::gain_of_pv::restored;
    use crate::residual::hypothesis::Hypothesis;
    use crate::signal::Window;
    use crate::sysid::valve::Start;

    #[test]
    fn a_free_run_does_not_know_what_is_measured_later() {
        let op: Vec<f64> =
            (0..900).map(|k| 3.0 * (0.11 * f64::from(k)).sin() + (0.43 * f64::from(k)).cos()).collect();
        let mut pv = vec![0.0; op.len()];
        for k in 1..pv.len() {
            pv[k] =
                0.8 * pv[k - 1] + 0.2 * (1.0 + 0.1 * pv[k - 1]) * op[k - 1] + 0.01 * (1.7 * k as f64).sin();
        }
        let window = Window { t0: 0.0, ts: 1.0, op, pv, ..Window::default() };
        let mut data = IdData::new(&window, Start { index: 0, is_max: true }).expect("long enough");
        let bent = Hypothesis::default().with(restored(&data, 0.1).expect("a gain"));
        let fitted = fit_anew(&data, bent, None);
        let run = |data: &IdData| free_run(data, &fitted, &vec![0.0; data.len()], data.split, data.len());
        let before = run(&data);
        let from = data.split + 1;
        data.y[from..].iter_mut().for_each(|y| *y += 2.0);
        let off = before.iter().zip(run(&data)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-4, "{off}");
    }
}
