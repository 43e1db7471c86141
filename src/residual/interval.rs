//! The interval of f: a profile likelihood, of a threshold.
//!
//! ```text
//! LR(f) = 2 tau (ln L_max - ln L(f)),   the hull of {LR <= 7.35}, to the next f tried on each side, widened by OP's median step
//! ```
//!
//! f decides at which samples the stem turns, so its likelihood is that of a threshold: 7.35 is the 95 % point of its
//! likelihood ratio where chi-squared would say 3.84. A turn lies somewhere between two samples, which no likelihood knows:
//! hence the step of OP. The likelihood is tempered as in the verdict: a model of a valve is nearly right only.
//!
//! The error of the models of valves is added to both ends (`sysid/valve/model_error.rs`).
//!
//! Source: Hansen, Econometrica 2000, 68, 575, table 1.

use super::hypothesis::Hypothesis;
use super::valve_search::hidden;
use crate::sysid::arx::Arx;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::{median, quantile};
use crate::sysid::valve::ValveModel;
use crate::sysid::valve::model_error::with_model_error;

/// 95 % point of the likelihood ratio of a threshold.
const THRESHOLD_95: f64 = 7.35;
/// S tried to each side, as `ln(S / S_hat)`.
const STEPS: [f64; 18] = [
    0.001, 0.002, 0.004, 0.007, 0.012, 0.02, 0.03, 0.05, 0.08, 0.12, 0.18, 0.27, 0.4, 0.6, 0.9, 1.3, 1.9, 2.7,
];
/// Steps beyond the last value inside after which the search to one side ends.
const BEYOND: usize = 4;

/// The 95 % interval of f beside the effects (normalised OP); without friction from 0 to what could be hidden.
///
/// `fast`: where the controller scanned between the samples, the quantile of OP's steps of those where OP moves fast. A turn that
/// no sample met then lies beyond both of its neighbours, by as much as OP moves from one to the next there.
pub fn interval(data: &IdData, hypothesis: &Hypothesis, fast: Option<f64>) -> [f64; 2] {
    let Some(valve) = hypothesis.valve else { return [0.0, hidden(data, hypothesis, THRESHOLD_95)] };
    let (signals, y) = (hypothesis.signals(data), hypothesis.pv(data));
    let arx = Arx::new(data, &y, &signals.shapes);
    let best = arx.fit(&signals.x, None);
    let mut most = best.log_likelihood;
    // J keeps its size or its share of S, whichever is likelier.
    let profile = |s: f64| -> f64 {
        let share = ValveModel { s, j: valve.j * s / valve.s, ..valve };
        let size = ValveModel { s, ..valve };
        let both = if valve.j == valve.s { vec![share] } else { vec![share, size] };
        let stems = both.into_iter().map(|valve| {
            let other = hypothesis.with_valve(Some(valve));
            other.to_process(data, other.stem(data).0)
        });
        let fits = stems.map(|stem| arx.fit(&stem, Some(&best)));
        fits.map(|fit| fit.log_likelihood).fold(f64::NEG_INFINITY, f64::max)
    };
    let mut sides: [Vec<(f64, f64)>; 2] = [vec![(valve.s, most)], vec![(valve.s, most)]];
    for (side, rated) in [-1.0, 1.0].into_iter().zip(&mut sides) {
        let mut beyond = 0;
        for step in STEPS {
            let s = valve.s * f64::exp(side * step);
            let log_likelihood = profile(s);
            most = most.max(log_likelihood);
            rated.push((s, log_likelihood));
            beyond = if 2.0 * TEMPERING * (most - log_likelihood) > THRESHOLD_95 { beyond + 1 } else { 0 };
            if beyond == BEYOND || s > 2.0 * data.f_max {
                break;
            }
        }
    }
    let excluded = |own: &(f64, f64)| 2.0 * TEMPERING * (most - own.1) > THRESHOLD_95;
    // Between the last value inside and the first outside the likelihood was not asked.
    let end = |rated: &[(f64, f64)]| {
        let last = rated.iter().rposition(|own| !excluded(own)).unwrap_or(0);
        rated.get(last + 1).map(|own| 0.5 * own.0)
    };
    let (low, high) = (end(&sides[0]).unwrap_or(0.0), end(&sides[1]).unwrap_or(data.f_max).max(valve.f()));
    let steps: Vec<f64> = data.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let step = fast.map_or_else(|| median(&steps), |fast| quantile(&steps, fast));
    with_model_error(valve.f(), [(low - step).max(0.0), high + step])
}
