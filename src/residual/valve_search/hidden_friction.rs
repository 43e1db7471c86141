//! The largest friction that a record could hide: the upper end of the interval of f where no friction is needed.

use super::search::{Search, initial_positions, range_of_s};
use crate::residual::hypothesis::Hypothesis;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel};

/// Ratio of the values of S that are tried, from the largest down: the bound is rounded up by as much.
const HIDDEN: f64 = 0.85;
/// Stop rules and J/S of the valves that are tried at each S.
const HIDING: [(StopRule, f64); 4] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Reversal, 0.1), (StopRule::Slip, 0.5)];
/// Positions of the stem at the start that are tried for each of them.
const HIDDEN_PLACES: usize = 12;

/// The largest f that the record does not exclude beside these effects (standard deviations of OP).
///
/// ```text
/// LR(f) = 2 tau (ln L(0) - max over J, stop rule and position at the start of ln L(f)),   the largest f with LR <= bound
/// ```
///
/// The likelihood is tempered as in the verdict, because a model of a valve is only nearly right. The values of S differ by the
/// factor `1 / 0.85`; the result is the next value above the largest that is not excluded.
///
/// * `bound`: the point of the likelihood ratio beyond which an f is excluded (-).
pub fn hidden_friction(data: &IdData, effects: &Hypothesis, bound: f64) -> f64 {
    let (y, shapes) = (effects.pv(data), effects.shapes(data));
    let search = Search::new(data, effects, (&y, &shapes));
    let none = effects.with_valve(None);
    let free = search.arx.fit(&none.to_process(data, none.stem(data).0), None);
    let (least, most) = range_of_s(data);
    let mut s = most;
    while s > least {
        let valves = HIDING.iter().flat_map(|(rule, ratio)| {
            let valve = ValveModel { s, j: ratio * s, rule: *rule, ..ValveModel::default() };
            let rests = initial_positions(data, &valve).into_iter().take(HIDDEN_PLACES);
            rests.map(move |rest| ValveModel { rest, ..valve })
        });
        let stems = valves.map(|valve| search.stem(valve));
        let rated = stems.map(|stem| (search.arx.deviance(&stem), stem));
        let best = rated.min_by(|a, b| a.0.total_cmp(&b.0));
        let excluded = best.is_some_and(|(_, stem)| {
            let fit = search.arx.fit(&stem, Some(&free));
            2.0 * TEMPERING * (free.log_likelihood - fit.log_likelihood) > bound
        });
        if !excluded {
            break;
        }
        s *= HIDDEN;
    }
    (0.5 * s / HIDDEN).min(data.f_max)
}
