//! What friction a record could hide: the bound that goes with "no friction needed".

use super::{Search, places, whole};
use crate::residual::hypothesis::Hypothesis;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{StopRule, ValveModel};

/// S of the friction that could be hidden: values tried from the largest down, each so much smaller than the one before.
const HIDDEN: f64 = 0.85;
/// J/S and rules of the valves that are tried there.
const HIDING: [(StopRule, f64); 4] =
    [(StopRule::Reversal, 1.0), (StopRule::Reversal, 0.5), (StopRule::Reversal, 0.1), (StopRule::Slip, 0.5)];
/// Places at the start that are tried there.
const HIDDEN_PLACES: usize = 12;

/// The largest f that the record does not exclude beside these effects, where no friction is needed (normalised OP).
///
/// ```text
/// LR(f) = 2 tau (ln L(0) - max over J, rule and place at the start of ln L(f)),   the largest f with LR <= bound
/// ```
///
/// The likelihood is tempered as in the verdict: a model of a valve is nearly right only. Values of S lie `1 / 0.85` apart:
/// the bound is the next above the last that is not excluded.
pub fn hidden(data: &IdData, effects: &Hypothesis, bound: f64) -> f64 {
    let (y, shapes) = (effects.pv(data), effects.shapes(data));
    let search = Search::new(data, effects, (&y, &shapes));
    let none = effects.with_valve(None);
    let free = search.arx.fit(&none.to_process(data, none.stem(data).0), None);
    let (least, most) = whole(data);
    let mut s = most;
    while s > least {
        let valves = HIDING.iter().flat_map(|(rule, ratio)| {
            let valve = ValveModel { s, j: ratio * s, rule: *rule, ..ValveModel::default() };
            let rests = places(data, &valve).into_iter().take(HIDDEN_PLACES);
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
