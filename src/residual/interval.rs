//! The 95 % interval of f, by profile likelihood.
//!
//! ```text
//! LR(f) = 2 tau (ln L_max - ln L(f)),   interval: the hull of {LR <= 7.35}, plus one step of OP at both ends
//! ```
//!
//! Without friction the interval goes from 0 to the largest f that is not excluded, plus the fast step of OP where the controller
//! scanned between the samples ([`unseen_step`]).
//!
//! f is a threshold: it decides at which samples the stem reverses. So the 95 % point of its likelihood ratio is 7.35, and not the
//! 3.84 of chi-squared. Each end is the first tried f outside. The stem reverses at some time between two samples, which the
//! likelihood cannot tell: hence the step of OP at both ends ([`step_of_op`]). The likelihood is tempered as in the verdict, because
//! a model of a valve is only nearly right. The error of the models of valves is added to both ends
//! (`sysid/valve/model_error.rs`).
//!
//! Source: Hansen, Econometrica 2000, 68, 575, table 1.

use super::hypothesis::Hypothesis;
use super::valve_search::{excluded_friction, hidden_friction};
use crate::sysid::arx::Arx;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::stats::{median, quantile};
use crate::sysid::valve::ValveModel;
use crate::sysid::valve::model_error::with_model_error;

/// 95 % point of the likelihood ratio of a threshold.
const THRESHOLD_95: f64 = 7.35;
/// Values of S tried to each side, as `ln(S / S_hat)` (-).
const STEPS: [f64; 18] = [
    0.001, 0.002, 0.004, 0.007, 0.012, 0.02, 0.03, 0.05, 0.08, 0.12, 0.18, 0.27, 0.4, 0.6, 0.9, 1.3, 1.9, 2.7,
];
/// Values outside in a row after which the search to one side ends.
const BEYOND: usize = 4;

/// The step of OP by which every end of an interval of f is moved outwards (standard deviations of OP): the median one.
///
/// * `fast`: where the controller scanned between the samples, a high quantile (0..1) of the steps of OP, which takes the place of
///   the median. An extremum of OP between two samples then lies beyond both, by as much as OP moves from one to the next there.
pub fn step_of_op(data: &IdData, fast: Option<f64>) -> f64 {
    let steps: Vec<f64> = data.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    fast.map_or_else(|| median(&steps), |fast| quantile(&steps, fast))
}

/// The step of OP by which a bound is raised that no estimate of f stands behind (standard deviations of OP): the fast one where the
/// controller scanned between the samples, else 0: where every scan is a sample, how often such a bound holds was counted without it.
///
/// * `fast`: as in [`step_of_op`].
pub fn unseen_step(data: &IdData, fast: Option<f64>) -> f64 {
    fast.map_or(0.0, |_| step_of_op(data, fast))
}

/// The friction that the record excludes beside the effects although it does not exclude the largest: the ends of the longest run
/// of values of f that are excluded, each moved inwards by the step of OP (standard deviations of OP). `None` where nothing is left
/// of the run, and where the largest f is excluded, since the interval has that.
///
/// * `fast`: as in [`step_of_op`].
pub fn excluded_below_the_largest(
    data: &IdData,
    hypothesis: &Hypothesis,
    fast: Option<f64>,
) -> Option<[f64; 2]> {
    let [low, high] = excluded_friction(data, hypothesis, THRESHOLD_95)?;
    let step = step_of_op(data, fast);
    let (low, high) = (low + step, high - step);
    (low < high).then_some([low, high])
}

/// The 95 % interval of f beside the effects (standard deviations of OP). Without friction it goes from 0 to the largest friction
/// that could be hidden.
///
/// * `fast`: as in [`step_of_op`].
pub fn interval(data: &IdData, hypothesis: &Hypothesis, fast: Option<f64>) -> [f64; 2] {
    let Some(valve) = hypothesis.valve else {
        return [0.0, hidden_friction(data, hypothesis, THRESHOLD_95) + unseen_step(data, fast)];
    };
    let step = step_of_op(data, fast);
    let (signals, y) = (hypothesis.signals(data), hypothesis.pv(data));
    let arx = Arx::new(data, &y, &signals.shapes);
    let best = arx.fit(&signals.x, None);
    let mut most = best.log_likelihood;
    // The likelihood at S: J keeps its size, or its share of S, whichever is likelier.
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
    // The end lies between the last value inside and the first value outside: the latter is taken.
    let end = |rated: &[(f64, f64)]| {
        let last = rated.iter().rposition(|own| !excluded(own)).unwrap_or(0);
        rated.get(last + 1).map(|own| 0.5 * own.0)
    };
    let (low, high) = (end(&sides[0]).unwrap_or(0.0), end(&sides[1]).unwrap_or(data.f_max).max(valve.f()));
    with_model_error(valve.f(), [(low - step).max(0.0), high + step])
}
