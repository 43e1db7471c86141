//! Backward elimination: an effect is dropped where the hypothesis without it is likelier.
//!
//! ```text
//! score(without) + ln prior(m - 1 effects) > score(with) + ln prior(m effects)
//! ```
//!
//! Both are scored on the fitted samples. [`super::rejection`] drops effects by the held-out samples.

use super::fit::{Fitted, fit_anew};
use super::posterior::log_prior;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Further valves that are fitted beside the effects that are left.
const OFFERED: usize = 3;

/// Drops effects one by one, the least needed first, as long as that makes the hypothesis likelier.
///
/// * `pool`: valves that were found earlier; the first of them are fitted as well.
/// * `keep`: a number for each effect; those of dropped effects are removed.
pub fn eliminate(data: &IdData, mut best: Fitted, pool: &[ValveModel], keep: &mut Vec<usize>) -> Fitted {
    loop {
        let count = best.hypothesis.effects.len();
        // The last effect was compared with no effect just now.
        let without = (0..count.saturating_sub(1)).map(|at| (at, fitted_without(data, &best, at, pool)));
        let likelier = without
            .filter(|(_, other)| other.score + log_prior(count - 1) > best.score + log_prior(count))
            .max_by(|a, b| a.1.score.total_cmp(&b.1.score));
        let Some((at, other)) = likelier else { return best };
        keep.remove(at);
        best = other;
    }
}

/// The best fit without the effect at `at`: with the present valve, with one of the `pool`, or without friction.
fn fitted_without(data: &IdData, best: &Fitted, at: usize, pool: &[ValveModel]) -> Fitted {
    let other = best.hypothesis.without(at);
    let mut valves = vec![None];
    for valve in best.hypothesis.valve.iter().chain(pool.iter().take(OFFERED)) {
        if !valves.contains(&Some(*valve)) {
            valves.push(Some(*valve));
        }
    }
    valves
        .into_iter()
        .map(|valve| fit_anew(data, other.with_valve(valve), None))
        .max_by(|a, b| a.score.total_cmp(&b.score))
        .unwrap_or_else(|| best.clone())
}
