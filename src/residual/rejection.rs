//! Rejection: an effect goes where the held-out samples make it less likely than not.
//!
//! ```text
//! P(effect) = posterior(log odds on the fitted samples, z on the held-out samples),   rejected where P <= 1/2
//! ```
//!
//! z is by how many standard deviations the held-out samples are likelier with the effect than without it
//! ([`super::held_out`]), and the posterior is a share that was counted on simulated loops ([`super::posterior`]). The least
//! likely effect is rejected first. It is never added again, and the selection goes on without it.

use super::findings::{Evidence, Kind};
use super::forward_selection::Comparison;
use super::held_out::{validate, without_effect};
use super::posterior::log_prior;
use super::response::effect_evidence;
use super::selection::{Selected, SelectionStart, select};
use super::settings::Settings;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Selects effects, and rejects those that the held-out samples speak against. The second value has the rejected kinds, each
/// with the evidence at which it was rejected. `None` where no hypothesis could be fitted.
///
/// * `first`: the first step, beside no effects.
pub fn select_and_reject(
    data: &IdData,
    settings: &Settings,
    first: &Comparison<'_>,
) -> Option<(Selected, Vec<(Kind, Evidence)>)> {
    let mut rejected: Vec<(Kind, Evidence)> = Vec::new();
    let mut start = SelectionStart::new(first.clone());
    loop {
        let mut selected = select(data, settings, &rejected, start)?;
        let mut posteriors = Vec::new();
        let with = validate(data, &selected.best, data);
        for (at, (evidence, _)) in selected.added.iter_mut().enumerate() {
            let (without, held_out) = without_effect(data, &selected.best, &with, at);
            let over_none = selected.best.score - without.score + log_prior(1);
            let told = [evidence.log_odds, over_none, held_out];
            *evidence = effect_evidence(data, &selected.best.hypothesis, at, told);
            let kind = selected.best.hypothesis.effects[at].kind();
            posteriors.push((evidence.posterior(kind), at, kind));
        }
        let least = posteriors.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, at, kind)) = least.filter(|least| least.0 <= 0.5) else {
            selected.candidates = with_rejected(selected.candidates, &rejected);
            return Some((selected, rejected));
        };
        rejected.push((kind, selected.added.remove(at).0));
        let effects = selected.best.hypothesis.without(at);
        let mut pool: Vec<ValveModel> = selected.best.hypothesis.valve.into_iter().collect();
        pool.extend(&first.valves);
        // Beside no effects the first step is what it was: only the valves offered to it are others.
        let comparison =
            if effects.effects.is_empty() { first.clone() } else { first.beside(&effects, &pool) };
        start = SelectionStart { effects, added: selected.added, comparison, pool };
    }
}

/// The posteriors of the candidates and of the rejected kinds together. A rejected kind keeps its posterior; the others share
/// what is left in the same proportions as before.
fn with_rejected(
    candidates: Vec<(Option<Kind>, f64)>,
    rejected: &[(Kind, Evidence)],
) -> Vec<(Option<Kind>, f64)> {
    let mut all = candidates;
    let sum: f64 = all.iter().map(|own| own.1).sum();
    if sum > 0.0 {
        all.iter_mut().for_each(|own| own.1 /= sum);
    }
    for (kind, evidence) in rejected {
        let own = evidence.posterior(*kind);
        all.iter_mut().for_each(|other| other.1 *= 1.0 - own);
        all.push((Some(*kind), own));
    }
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::residual::hypothesis::Hypothesis;
    use crate::residual::tests::behind_dead_band;
    use crate::residual::valve_search::{Effort, search};

    fn told(selected: &Selected) -> String {
        let Selected { best, added, candidates, friction_log_odds, slip_jump } = selected;
        format!("{best:?} {added:?} {candidates:?} {friction_log_odds:?} {slip_jump:?}")
    }

    #[test]
    fn a_selection_that_starts_again_ends_as_if_nothing_had_been_fitted_before() {
        // A load that has gone where the held-out samples begin.
        let data = behind_dead_band(900, |k| if (400..726).contains(&k) { 0.2 } else { 0.0 });
        assert_eq!(data.split, 726);
        let (settings, none) = (Settings { most_effects: 1, ..Settings::default() }, Hypothesis::default());
        let found = search(&data, &none, &[], Effort::Grid);
        let anew = || Comparison::new(&data, &none, &found, None, false);
        let (selected, rejected) = select_and_reject(&data, &settings, &anew()).expect("fitted");
        assert_eq!(rejected.len(), 1, "{rejected:?}");
        let before = select(&data, &settings, &[], SelectionStart::new(anew())).expect("fitted").best;
        let effects = before.hypothesis.without(0);
        let mut pool: Vec<ValveModel> = effects.valve.into_iter().collect();
        pool.extend(found.iter().map(|found| found.valve));
        let start = SelectionStart { effects, added: Vec::new(), comparison: anew(), pool };
        let mut plain = select(&data, &settings, &rejected, start).expect("fitted");
        plain.candidates = with_rejected(plain.candidates, &rejected);
        assert_eq!(told(&selected), told(&plain));

        let alone = Comparison::new(&data, &none, &[], None, true);
        let [shared, plain] = [anew().without_friction(), alone].map(|first| {
            let (selected, rejected) = select_and_reject(&data, &settings, &first).expect("fitted");
            format!("{} {rejected:?}", told(&selected))
        });
        assert_eq!(shared, plain);
    }

    #[test]
    fn what_is_left_of_the_candidates_shares_what_rejected_ones_leave() {
        let evidence = Evidence { log_odds: 40.0, over_none: 40.0, held_out: -1.1, beside_friction: false };
        let told = with_rejected(vec![(None, 0.05)], &[(Kind::LoadStep, evidence)]);
        let sum: f64 = told.iter().map(|own| own.1).sum();
        assert!((sum - 1.0).abs() < 1e-12 && told[0] == (None, 1.0 - 2.0 / 11.0), "{told:?}");
    }
}
