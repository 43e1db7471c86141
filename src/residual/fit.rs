//! The fit that decides: every hypothesis that leads the screening is fitted by ARMAX in the same way and scored by one criterion.

use super::Kind;
use super::hypothesis::{Hypothesis, OnData};
use super::valve_search::cost;
use crate::sysid::armax::{Armax, ORDER, Start, hannan_rissanen};
use crate::sysid::arx::{Arx, ArxFit};
use crate::sysid::criterion;
use crate::sysid::iddata::{IdData, LONGEST_LAG};

/// Delays from which a fit starts.
const DELAYS: usize = 3;
/// Iterations of each before the delays far behind are left.
const FIRST: usize = 4;
/// Log-likelihood behind the best fit so far up to which a delay goes on: in a flat valley of C the delay that wins in the end may
/// be so far behind after the first iterations.
const VALLEY: f64 = 25.0;
/// Iterations of those that go on.
const MOST: usize = 16;
/// Iterations of a fit that starts from one nearly right.
pub const NEAR: usize = 5;

/// Stretches of samples in which every time of a change is tried.
const PEAKS: usize = 4;
/// Samples to each side of a peak that its stretch takes in.
const BESIDE: usize = 2;
/// How often a change is moved, at most.
const RETIMED: usize = 3;

/// A hypothesis with its fit.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The hypothesis, its smooth parameters as fitted.
    pub hypothesis: Hypothesis,
    /// Its model.
    pub model: Armax,
    /// Its score (see [`criterion`]).
    pub score: f64,
}

impl Fitted {
    fn new(data: &IdData, mut hypothesis: Hypothesis, model: Armax) -> Self {
        hypothesis.set_smooth(&model.theta);
        let score = scored(data, &hypothesis, model.log_likelihood);
        let runs_away = hypothesis.is_of_the_valve() && has_positive_feedback(data, &model);
        let score = if runs_away { f64::NEG_INFINITY } else { score };
        Self { hypothesis, model, score }
    }

    /// The kind of the last effect.
    pub fn kind(&self) -> Option<Kind> {
        self.hypothesis.effects.last().map(|effect| effect.kind())
    }
}

/// Whether PV of a model moves with the stem in the direction in which the controller's feedback is positive: in the end, by B(1),
/// and by the largest value of its step response within the longest lag. Either alone can be wrong of a model that is right: B(1)
/// of a slow process lies within its error of 0, and an inverse response begins the other way. Where OP acts beside the stem,
/// both share the response, and nothing is said.
pub fn has_positive_feedback(data: &IdData, model: &Armax) -> bool {
    let Some(sign) = data.gain_sign.filter(|_| !data.direct) else { return false };
    let mut y = [0.0; ORDER + LONGEST_LAG];
    for k in ORDER..y.len() {
        let stepped: f64 = model.b.iter().take(k - ORDER + 1).sum();
        y[k] = stepped - model.a.iter().enumerate().map(|(i, a)| a * y[k - 1 - i]).sum::<f64>();
    }
    let largest = y.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0);
    sign * largest < 0.0 && sign * model.b.iter().sum::<f64>() < 0.0
}

/// The score of a hypothesis with this log-likelihood.
pub fn scored(data: &IdData, hypothesis: &Hypothesis, log_likelihood: f64) -> f64 {
    let (mut rate, mut alternatives) = cost(hypothesis.valve.as_ref());
    rate += hypothesis.direct_rate(data);
    for effect in &hypothesis.effects {
        rate += effect.rate();
        alternatives *= effect.alternatives();
    }
    criterion::score(log_likelihood, rate, alternatives, data.counted())
}

/// The high-order ARX of a hypothesis.
pub fn arx(data: &IdData, hypothesis: &Hypothesis, near: Option<&ArxFit>) -> ArxFit {
    let (signals, y) = (hypothesis.signals(data), hypothesis.pv(data));
    Arx::new(data, &y, &signals.shapes).fit(&signals.x, near)
}

/// Values of a hypothesis' smooth parameters.
fn smooth_values(hypothesis: &Hypothesis) -> Vec<f64> {
    hypothesis.smooth().iter().map(|smooth| smooth.value).collect()
}

/// Where a fit starts from nothing, the best delay first; `near`: an ARX whose weights are nearly right.
fn starts(data: &IdData, hypothesis: &Hypothesis, near: Option<&ArxFit>) -> Vec<Start> {
    let (signals, y) = (hypothesis.signals(data), hypothesis.pv(data));
    let long = Arx::new(data, &y, &signals.shapes).fit(&signals.x, near);
    hannan_rissanen(data, &y, &signals, &long, &smooth_values(hypothesis))
}

/// Fits a hypothesis from nothing.
pub fn fit_anew(data: &IdData, hypothesis: Hypothesis, near: Option<&ArxFit>) -> Fitted {
    let input = OnData { hypothesis: &hypothesis, data };
    let starts = starts(data, &hypothesis, near);
    let begun = starts.into_iter().take(DELAYS).map(|start| start.model.fit(data, &data.y, &input, FIRST));
    let mut begun: Vec<Armax> = begun.collect();
    begun.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    let mut model: Option<Armax> = None;
    for start in begun {
        let most = model.as_ref().map_or(f64::NEG_INFINITY, |model| model.log_likelihood);
        if start.log_likelihood >= most - VALLEY {
            let fitted = start.fit(data, &data.y, &input, MOST);
            model = model.filter(|_| most >= fitted.log_likelihood).or(Some(fitted));
        }
    }
    let model = model.unwrap_or_default();
    Fitted::new(data, hypothesis, model)
}

/// Fits the hypothesis that all others are compared with: it keeps its score whichever way its feedback is.
pub fn fit_base(data: &IdData, hypothesis: Hypothesis) -> Fitted {
    let mut base = fit_anew(data, hypothesis, None);
    base.score = scored(data, &base.hypothesis, base.model.log_likelihood);
    base
}

/// Fits a hypothesis from a model that is nearly right, in at most `most` iterations.
pub fn fit_near(data: &IdData, hypothesis: Hypothesis, near: &Armax, most: usize) -> Fitted {
    let input = OnData { hypothesis: &hypothesis, data };
    let mut start = near.clone();
    start.theta = smooth_values(&hypothesis);
    let model = start.fit(data, &data.y, &input, most);
    Fitted::new(data, hypothesis, model)
}

/// Fits a hypothesis a few iterations from nothing and from a model that may be right; the better of both.
pub fn fit_quick(data: &IdData, hypothesis: Hypothesis, near: &Armax) -> Fitted {
    let warm = fit_near(data, hypothesis.clone(), near, NEAR);
    let input = OnData { hypothesis: &hypothesis, data };
    let start = starts(data, &hypothesis, None).into_iter().next();
    let Some(start) = start else { return warm };
    let model = start.model.fit(data, &data.y, &input, NEAR);
    if model.log_likelihood > warm.model.log_likelihood { Fitted::new(data, hypothesis, model) } else { warm }
}

/// Moves the last effect's change to the time that explains most, if there is a better one, again and again.
///
/// ```text
/// ln L(t) ~ sum_{k < t} l(e0[k]) + sum_{k >= t} l(e1[k])
/// ```
///
/// `e0` are the errors of the same model without the change, `e1` those with the change from the start on: what 1/C carries
/// over t is left out, so the best times are rated with it before one is fitted.
pub fn retime(data: &IdData, mut best: Fitted) -> Fitted {
    for _ in 0..RETIMED {
        let Some(last) = best.hypothesis.effects.last().filter(|last| last.at().is_some()) else { break };
        let count = best.hypothesis.effects.len();
        let at = |at: usize| {
            let mut hypothesis = best.hypothesis.clone();
            hypothesis.effects[count - 1] = last.moved(at);
            hypothesis
        };
        let held =
            |hypothesis: &Hypothesis| -> f64 { -losses(data, &best.model, hypothesis).iter().sum::<f64>() };
        let times = times(data, &best.model, &at(data.len()), &at(0));
        let rated = times.into_iter().map(at).map(|hypothesis| (held(&hypothesis), hypothesis));
        let Some((rated, other)) = rated.max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        if rated <= held(&best.hypothesis) {
            break;
        }
        let better = fit_near(data, other, &best.model, NEAR);
        if better.score <= best.score {
            break;
        }
        best = better;
    }
    best
}

/// Minus the log-likelihood of each fitted row under a hypothesis with the coefficients of `model`, but for a constant.
fn losses(data: &IdData, model: &Armax, hypothesis: &Hypothesis) -> Vec<f64> {
    let signals = hypothesis.signals(data);
    let e = model.errors(data, &data.y, &signals, data.split).e;
    let per = 1.0 / (model.nu * model.scale * model.scale);
    data.rows().map(|k| 0.5 * (model.nu + 1.0) * (data.weight[k] * per * e[k] * e[k]).ln_1p()).collect()
}

/// The best times of a change from the hypothesis `without` it to the one `with` it from the start, and those beside them.
fn times(data: &IdData, model: &Armax, without: &Hypothesis, with: &Hypothesis) -> Vec<usize> {
    let (before, after) = (losses(data, model, without), losses(data, model, with));
    let mut sum: f64 = after.iter().sum();
    let mut rated: Vec<(f64, usize)> = Vec::new();
    for (row, (before, after)) in before.iter().zip(&after).enumerate() {
        rated.push((sum, row));
        sum += before - after;
    }
    let edge = LONGEST_LAG..rated.len().saturating_sub(LONGEST_LAG);
    rated.retain(|(_, row)| edge.contains(row));
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    // What changes the stem shows a delay later.
    let (before, after) = (model.nk + BESIDE, BESIDE);
    let mut peaks: Vec<usize> = Vec::new();
    for (_, row) in rated {
        let time = data.first + row;
        if peaks.len() < PEAKS && peaks.iter().all(|peak| peak.abs_diff(time) > before) {
            peaks.push(time);
        }
    }
    peaks.into_iter().flat_map(|peak| peak - before..=peak + after).collect()
}

/// Looks to each side of the last effect's parameters in which the likelihood jumps, on finer and finer steps.
pub fn refine(data: &IdData, best: Fitted) -> Fitted {
    let mut best = retime(data, best);
    for step in [1.0, 0.5, 0.25] {
        for _ in 0..3 {
            let Some(last) = best.hypothesis.effects.last() else { return best };
            let others = last.neighbours(data, step);
            let count = best.hypothesis.effects.len();
            let mut better = None;
            for other in others {
                let mut hypothesis = best.hypothesis.clone();
                hypothesis.effects[count - 1] = other;
                let tried = fit_near(data, hypothesis, &best.model, NEAR);
                if tried.score > best.score && better.as_ref().is_none_or(|b: &Fitted| tried.score > b.score)
                {
                    better = Some(tried);
                }
            }
            let Some(better) = better else { break };
            best = better;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positive(sign: Option<f64>, direct: bool, a: [f64; ORDER], b: [f64; ORDER]) -> bool {
        let data = IdData { gain_sign: sign, direct, ..IdData::default() };
        has_positive_feedback(&data, &Armax { a, b, ..Armax::default() })
    }

    #[test]
    fn feedback_is_positive_where_pv_moves_against_what_the_controller_does() {
        let lag = [-0.9, 0.0, 0.0];
        for gain in [0.2f64, -0.2] {
            let b = [gain, 0.0, 0.0];
            assert!(!positive(Some(gain.signum()), false, lag, b));
            assert!(positive(Some(-gain.signum()), false, lag, b));
            assert!(!positive(None, false, lag, b), "the controller does not tell");
            assert!(!positive(Some(-gain.signum()), true, lag, b), "OP acts beside the stem");
        }
    }

    #[test]
    fn neither_an_inverse_response_nor_an_error_of_b_is_positive_feedback() {
        // A drum: its level swells for half a minute before it falls.
        let (integral, swell) = (1.0 / 60.0, 0.5 / 6.0);
        let pole = 1.0 - 1.0 / 6.0;
        let a = [-1.0 - pole, pole, 0.0];
        let b = [integral - swell, swell - pole * integral, 0.0];
        assert!(!positive(Some(1.0), false, a, b));
        assert!(positive(Some(-1.0), false, [-0.9, 0.0, 0.0], [0.2, 0.0, 0.0]));
        // A level whose B(1) is estimated a little below 0.
        assert!(!positive(Some(1.0), false, [-1.0, 0.0, 0.0], [0.041, -0.03, -0.012]));
    }
}
