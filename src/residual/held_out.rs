//! A model on the samples that nothing was fitted to: they are the last of the window, so what changed must stay changed there,
//! and what goes on must go on.

use super::fit::{Fitted, fit_anew};
use super::hypothesis::OnData;
use crate::diagnosis::Residual;
use crate::sysid::armax::{Errors, Input, ORDER};
use crate::sysid::iddata::IdData;
use crate::sysid::simulate::simulate;
use crate::sysid::student;
use crate::sysid::whiteness::is_white;

/// Free runs, one after the other, over the held-out samples.
const STRETCHES: usize = 4;

/// A model judged: over all samples its errors and its free run.
pub struct Judged {
    /// Its errors on the held-out samples.
    pub residual: Residual,
    /// Log-likelihood of each held-out sample.
    log_likelihoods: Vec<f64>,
    /// Its errors one step ahead, behind a hole in their own standard deviation.
    pub e: Vec<f64>,
    /// The same as differences of PV.
    pub one_step: Vec<f64>,
    /// Its free run.
    pub free: Vec<f64>,
}

/// Judges a model on the held-out samples that count in `counted`.
pub fn judge(data: &IdData, fitted: &Fitted, counted: &IdData) -> Judged {
    let input = OnData { hypothesis: &fitted.hypothesis, data };
    let signals = input.signals(&fitted.model.theta);
    let Errors { e, gains, .. } = fitted.model.errors(data, &data.y, &signals, data.len());
    let held = data.split..data.len();
    let stretch = held.len().div_ceil(STRETCHES).max(1);
    // Without holes there are no gains: an error is its own likeliest value, and its standard deviation 1.
    let past = if gains.likeliest.is_empty() { &e } else { &gains.likeliest };
    let free = free_run(data, fitted, past, data.split, stretch);
    let root = |k: usize| gains.root.get(k).copied().unwrap_or(1.0);
    let one_step: Vec<f64> = e.iter().enumerate().map(|(k, e)| e * root(k)).collect();
    let rms = |error: &dyn Fn(usize) -> f64| {
        let sum: f64 = held.clone().map(|k| counted.weight[k] * error(k).powi(2)).sum();
        let count: f64 = counted.weight[held.clone()].iter().sum();
        (sum / count.max(1.0)).sqrt() * data.units.y
    };
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
    Judged {
        residual,
        log_likelihoods,
        e,
        one_step,
        free: free_run(data, fitted, &vec![0.0; data.len()], data.first, stretch),
    }
}

/// Runs after which a gain that depends on PV is that of PV run free: each run is right for as many samples more as the dead time
/// has, and mostly for many more.
const RUNS: usize = 50;
/// Change of PV at which a run repeats the one before (standard deviations of PV).
const SAME: f64 = 1e-6;

/// A model run free from sample `from` on, with errors `e` before it, anew every `stretch` samples.
fn free_run(data: &IdData, fitted: &Fitted, e: &[f64], from: usize, stretch: usize) -> Vec<f64> {
    let Fitted { model, hypothesis, .. } = fitted;
    let run = |data: &IdData, of: &IdData| {
        let signals = OnData { hypothesis, data: of }.signals(&model.theta);
        simulate(model, data, &signals, e, from, stretch)
    };
    let mut free = run(data, data);
    if !hypothesis.effects.iter().any(|effect| effect.bends()) {
        return free;
    }
    // What bends with PV must not know what was measured.
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

/// What the held-out samples gain from the second model in log-likelihood, in standard deviations.
pub fn gained(before: &Judged, after: &Judged) -> f64 {
    let pairs = before.log_likelihoods.iter().zip(&after.log_likelihoods);
    let by: Vec<f64> = pairs.map(|(before, after)| after - before).collect();
    by.iter().sum::<f64>() / (by.iter().map(|by| by * by).sum::<f64>().sqrt().max(f64::MIN_POSITIVE))
}

/// The model without the effect at `at`, fitted, and by how many standard deviations the held-out samples speak for the model with
/// it, which is judged already.
pub fn without(data: &IdData, best: &Fitted, with: &Judged, at: usize) -> (Fitted, f64) {
    let without = fit_anew(data, best.hypothesis.without(at), None);
    let held_out = gained(&judge(data, &without, data), with);
    (without, held_out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::hypotheses::process::gain_of_pv::again;
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
        let bent = Hypothesis::default().with(again(&data, 0.1).expect("a gain"));
        let fitted = fit_anew(&data, bent, None);
        let run = |data: &IdData| free_run(data, &fitted, &vec![0.0; data.len()], data.split, data.len());
        let before = run(&data);
        let from = data.split + 1;
        data.y[from..].iter_mut().for_each(|y| *y += 2.0);
        let off = before.iter().zip(run(&data)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-4, "{off}");
    }
}
