//! The fit of one hypothesis: an ARMAX by prediction error, and its score ([`crate::sysid::criterion`]).
//!
//! Every hypothesis that leads the screening is fitted in the same way. A fit starts *cold*, from the high-order ARX by
//! Hannan–Rissanen ([`fit_anew`]), *warm*, from the model of a similar hypothesis ([`fit_near`]), or both ([`fit_quick`]).

use super::findings::Kind;
use super::hypothesis::{Hypothesis, OnData};
use super::valve_search::cost;
use crate::sysid::armax::{Armax, ORDER, Signals, Start, hannan_rissanen};
use crate::sysid::arx::{Arx, ArxFit};
use crate::sysid::criterion;
use crate::sysid::iddata::{IdData, LONGEST_LAG};

/// Dead times nk from which a cold start is tried: the best by Hannan–Rissanen.
const DELAYS: usize = 3;
/// Iterations of each of them, before those far behind are left.
const FIRST: usize = 4;
/// Log-likelihood behind the best fit so far up to which a dead time is fitted further (-). The likelihood is flat along a valley
/// of C, so that the best dead time may be so far behind after the first iterations.
const VALLEY: f64 = 25.0;
/// Further iterations of those that are not left.
const MOST: usize = 16;
/// Iterations of a warm start.
pub const NEAR: usize = 5;

/// Peaks of the likelihood over the change time around which every time is tried.
const PEAKS: usize = 4;
/// Times tried on each side of a peak (samples).
const BESIDE: usize = 2;
/// Most moves of one change.
const RETIMED: usize = 3;

/// A hypothesis with its fit.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The hypothesis, with its smooth parameters as fitted.
    pub hypothesis: Hypothesis,
    /// Its linear part.
    pub model: Armax,
    /// Its score (see [`criterion`]); minus infinity where it has positive feedback but is about what is between OP and PV.
    pub score: f64,
}

impl Fitted {
    fn new(data: &IdData, mut hypothesis: Hypothesis, model: Armax) -> Self {
        hypothesis.set_smooth(&model.theta);
        let score = scored(data, &hypothesis, model.log_likelihood);
        let is_impossible = hypothesis.is_between_op_and_pv() && has_positive_feedback(data, &model);
        let score = if is_impossible { f64::NEG_INFINITY } else { score };
        Self { hypothesis, model, score }
    }

    /// The kind of the last effect.
    pub fn kind(&self) -> Option<Kind> {
        self.hypothesis.effects.last().map(|effect| effect.kind())
    }
}

/// Whether a model has positive feedback: its PV moves with the stem against the sign of the process gain that the controller
/// tells.
///
/// Both B(1) and the largest value of the step response within the longest lag must have the wrong sign. Each alone can be wrong
/// in a right model: B(1) of a slow process lies within its error of 0, and an inverse response begins the other way. False where
/// the sign is not known, or where OP acts beside the stem, so that both share the response.
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

/// The score of a hypothesis with this log-likelihood (-): the tempered log-likelihood less the penalties of the valve, of OP's
/// lags beside the stem and of each effect (see [`criterion::score`]).
pub fn scored(data: &IdData, hypothesis: &Hypothesis, log_likelihood: f64) -> f64 {
    let (mut rate, mut alternatives) = cost(hypothesis.valve.as_ref());
    rate += hypothesis.direct_rate(data);
    for effect in &hypothesis.effects {
        rate += effect.rate();
        alternatives *= effect.alternatives();
    }
    criterion::score(log_likelihood, rate, alternatives, data.counted())
}

/// The high-order ARX of a hypothesis, fitted. `near`: a fit whose Student-t weights are nearly right.
pub fn arx(data: &IdData, hypothesis: &Hypothesis, near: Option<&ArxFit>) -> ArxFit {
    let (signals, y) = (hypothesis.signals(data), hypothesis.pv(data));
    Arx::new(data, &y, &signals.shapes).fit(&signals.x, near)
}

/// The values of a hypothesis' smooth parameters.
fn smooth_values(hypothesis: &Hypothesis) -> Vec<f64> {
    hypothesis.smooth().iter().map(|smooth| smooth.value).collect()
}

/// Cold starts by Hannan–Rissanen, one for each dead time, the best first. `near`: an ARX fit whose weights are nearly right.
fn starts(data: &IdData, hypothesis: &Hypothesis, input: &OnData<'_>, near: Option<&ArxFit>) -> Vec<Start> {
    let (signals, y) = (input.signals_of(hypothesis), hypothesis.pv(data));
    let long = Arx::new(data, &y, &signals.shapes).fit(&signals.x, near);
    hannan_rissanen(data, &y, &signals, &long, &smooth_values(hypothesis))
}

/// Fits a hypothesis from cold starts: the best of several dead times.
pub fn fit_anew(data: &IdData, hypothesis: Hypothesis, near: Option<&ArxFit>) -> Fitted {
    let input = OnData::new(&hypothesis, data);
    let starts = starts(data, &hypothesis, &input, near);
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

/// Fits the hypothesis that all others are compared with. It keeps its score where its feedback is positive.
pub fn fit_base(data: &IdData, hypothesis: Hypothesis) -> Fitted {
    let mut base = fit_anew(data, hypothesis, None);
    base.score = scored(data, &base.hypothesis, base.model.log_likelihood);
    base
}

/// Fits a hypothesis from a warm start: the coefficients of a model that is nearly right. `most`: number of iterations.
pub fn fit_near(data: &IdData, hypothesis: Hypothesis, near: &Armax, most: usize) -> Fitted {
    let input = OnData::new(&hypothesis, data);
    let mut start = near.clone();
    start.theta = smooth_values(&hypothesis);
    let model = start.fit(data, &data.y, &input, most);
    Fitted::new(data, hypothesis, model)
}

/// Fits a hypothesis a few iterations from a warm start, and a few from the best cold start; returns the better of both.
pub fn fit_quick(data: &IdData, hypothesis: Hypothesis, near: &Armax) -> Fitted {
    let warm = fit_near(data, hypothesis.clone(), near, NEAR);
    let input = OnData::new(&hypothesis, data);
    let start = starts(data, &hypothesis, &input, None).into_iter().next();
    let Some(start) = start else { return warm };
    let model = start.model.fit(data, &data.y, &input, NEAR);
    if model.log_likelihood > warm.model.log_likelihood { Fitted::new(data, hypothesis, model) } else { warm }
}

/// Moves the change time of the last effect to the likeliest time, as long as there is a likelier one.
///
/// ```text
/// ln L(t) ~ sum over k < t of l(e0[k])  +  sum over k >= t of l(e1[k])
/// ```
///
/// `l` is the log-likelihood of one error, `e0` the errors of the same model without the change, and `e1` those with the change
/// from the start of the record on. This leaves out what 1/C carries across t. So the best times are rated by their exact errors
/// before one of them is fitted. Before t these are e0, so that only the losses from t on are computed for each time.
pub fn retime(data: &IdData, mut best: Fitted) -> Fitted {
    for _ in 0..RETIMED {
        let Some(last) = best.hypothesis.effects.last().filter(|last| last.change_time().is_some()) else {
            break;
        };
        let count = best.hypothesis.effects.len();
        let at = |at: usize| {
            let mut hypothesis = best.hypothesis.clone();
            hypothesis.effects[count - 1] = last.with_change_time(at);
            hypothesis
        };
        let input = OnData::new(&best.hypothesis, data);
        let losses_of = |at: Hypothesis| losses(data, &best.model, &input.signals_of(&at), data.first);
        let (without, with) = (losses_of(at(data.len())), losses_of(at(0)));
        let sums = running_sums(&without);
        let rated = |time: usize| {
            let hypothesis = at(time);
            let signals = input.signals_of(&hypothesis);
            (log_likelihood_of_change(data, &best.model, &signals, time, &sums), hypothesis)
        };
        let times = likeliest_times(data, best.model.nk, &without, &with).into_iter().map(rated);
        let Some((most, other)) = times.max_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        if last.change_time().is_some_and(|own| most <= rated(own).0) {
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

/// Loss of each fitted row from sample `from` on: minus its log-likelihood, but for a constant, of a model with these signals.
fn losses(data: &IdData, model: &Armax, signals: &Signals, from: usize) -> Vec<f64> {
    let e = model.errors(data, &data.y, signals, data.split).e;
    let per = 1.0 / (model.nu * model.scale * model.scale);
    let loss = |k: usize| 0.5 * (model.nu + 1.0) * (data.weight[k] * per * e[k] * e[k]).ln_1p();
    (from..data.split).map(loss).collect()
}

/// The sums of no loss, of the first, of the first two, and so on.
fn running_sums(losses: &[f64]) -> Vec<f64> {
    let mut sums = vec![0.0];
    losses.iter().for_each(|loss| sums.push(sums[sums.len() - 1] + loss));
    sums
}

/// Log-likelihood, but for a constant, of a model whose change sets in at sample `at`: before it the losses are those without the
/// change.
///
/// * `sums`: running sums of the losses without the change.
fn log_likelihood_of_change(data: &IdData, model: &Armax, signals: &Signals, at: usize, sums: &[f64]) -> f64 {
    let at = at.clamp(data.first, data.split);
    let before = sums[at - data.first];
    -losses(data, model, signals, at).iter().fold(before, |sum, loss| sum + loss)
}

/// The likeliest times of a change, and the times beside them (samples).
///
/// * `nk`: the dead time (samples).
/// * `without`: losses without the change.
/// * `with`: losses with the change from the start of the record on.
fn likeliest_times(data: &IdData, nk: usize, without: &[f64], with: &[f64]) -> Vec<usize> {
    let mut sum: f64 = with.iter().sum();
    let mut rated: Vec<(f64, usize)> = Vec::new();
    for (row, (without, with)) in without.iter().zip(with).enumerate() {
        rated.push((sum, row));
        sum += without - with;
    }
    let edge = LONGEST_LAG..rated.len().saturating_sub(LONGEST_LAG);
    rated.retain(|(_, row)| edge.contains(row));
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    // PV shows a change of the stem one dead time later.
    let (before, after) = (nk + BESIDE, BESIDE);
    let mut peaks: Vec<usize> = Vec::new();
    for (_, row) in rated {
        let time = data.first + row;
        if peaks.len() < PEAKS && peaks.iter().all(|peak| peak.abs_diff(time) > before) {
            peaks.push(time);
        }
    }
    peaks.into_iter().flat_map(|peak| peak - before..=peak + after).collect()
}

/// Refines the parameters of the last effect in which the likelihood jumps: a coordinate search with finer and finer steps.
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
    use crate::residual::hypotheses::ALL;
    use crate::residual::screening::Screen;
    use crate::residual::tests::behind_dead_band;
    use crate::sysid::valve::ValveModel;

    #[test]
    fn the_losses_of_a_change_are_those_without_it_before_its_time_to_the_last_bit() {
        let mut data = behind_dead_band(700, |k| if k < 350 { 0.0 } else { 0.3 });
        let s = 2.0 / data.units.u;
        for with_missing in [false, true] {
            if with_missing {
                data.rows().filter(|k| k % 13 < 2).for_each(|k| data.weight[k] = 0.0);
            }
            let valve = Some(ValveModel { s, j: s, ..ValveModel::default() });
            let base = fit_base(&data, Hypothesis { valve, effects: Vec::new() });
            let screen = Screen::new(&data, &base);
            let proposed = ALL.iter().flat_map(|kind| kind.propose(&screen)).map(|proposal| proposal.effect);
            let changes: Vec<_> = proposed.filter(|effect| effect.change_time().is_some()).collect();
            let mut kinds: Vec<Kind> = changes.iter().map(|effect| effect.kind()).collect();
            kinds.sort();
            kinds.dedup();
            assert_eq!(kinds.len(), 3, "steps, changes of gain, changes of dead time: {kinds:?}");
            for effect in changes {
                let fitted = fit_near(&data, base.hypothesis.with(effect), &base.model, 2);
                let last = &fitted.hypothesis.effects[0];
                let at = |at: usize| Hypothesis {
                    valve: fitted.hypothesis.valve,
                    effects: vec![last.with_change_time(at)],
                };
                let of = |at: &Hypothesis| losses(&data, &fitted.model, &at.signals(&data), data.first);
                let sums = running_sums(&of(&at(data.len())));
                for time in [data.first - 3, data.first, 300, 351, data.split - 1, data.split, data.len()] {
                    let plain = -of(&at(time)).iter().sum::<f64>();
                    let signals = at(time).signals(&data);
                    let found = log_likelihood_of_change(&data, &fitted.model, &signals, time, &sums);
                    assert_eq!(found.to_bits(), plain.to_bits(), "{time} {last:?}");
                }
            }
        }
    }

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
