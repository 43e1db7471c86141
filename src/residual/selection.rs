//! Selection: effects are added one by one, and each addition may make an earlier one needless.
//!
//! One step asks for the posterior of every kind of next effect ([`super::forward_selection`]). The likeliest effect is added
//! where its posterior is above 1/2, effects that it makes needless are dropped ([`super::backward_elimination`]), the valve is
//! searched for again, and the next step follows. The selection ends where no further effect is likelier than not, or at the
//! most effects allowed. The held-out samples are not read here ([`super::rejection`]).

use super::backward_elimination::eliminate;
use super::findings::{Evidence, Kind};
use super::fit::Fitted;
use super::forward_selection::{Comparison, table};
use super::hypothesis::Hypothesis;
use super::posterior::{Table, friction_class, log_prior};
use super::settings::Settings;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// What a selection ends with.
pub struct Selected {
    /// The likeliest hypothesis.
    pub best: Fitted,
    /// For each of its effects the evidence for it, and twice the log odds against the hypothesis without it (-).
    pub added: Vec<(Evidence, f64)>,
    /// The kinds of next effect at the last step, with their posteriors; `None` for no further effect.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// See [`friction_log_odds`].
    pub friction_log_odds: f64,
    /// See [`slip_jump_evidence`].
    pub slip_jump: Evidence,
}

/// Where a selection starts.
pub struct SelectionStart<'a> {
    /// The effects that are in the model already.
    pub effects: Hypothesis,
    /// The evidence for each of them, and twice its log odds (-).
    pub added: Vec<(Evidence, f64)>,
    /// The first step.
    pub comparison: Comparison<'a>,
    /// Valves that were found earlier: they are offered to every hypothesis.
    pub pool: Vec<ValveModel>,
}

impl<'a> SelectionStart<'a> {
    /// A start without effects.
    pub fn new(comparison: Comparison<'a>) -> Self {
        Self { effects: Hypothesis::default(), added: Vec::new(), comparison, pool: Vec::new() }
    }
}

/// Logarithm of the odds for friction, over all hypotheses of a step (-). It is minus infinity where no hypothesis with friction
/// was `fitted`: then friction was not tested. It is the least finite number where every one of them has positive feedback: then
/// friction was tested, and is not there.
pub fn friction_log_odds(table: &Table<'_>, fitted: &[Fitted]) -> f64 {
    let sticks = |d: &Fitted| d.hypothesis.valve.is_some();
    if fitted.iter().any(sticks) { table.log_odds(sticks).max(f64::MIN) } else { f64::NEG_INFINITY }
}

/// The evidence for a slip jump J that differs from S, among the hypotheses with friction. Held-out samples have no part in it:
/// they hardly tell one J from another.
pub fn slip_jump_evidence(table: &Table<'_>) -> Evidence {
    let sticks = |d: &Fitted| d.hypothesis.valve.is_some();
    let log_odds = table.log_odds_within(sticks, |d| friction_class(&d.hypothesis) == 2) + log_prior(1);
    Evidence { log_odds, over_none: log_odds, held_out: 0.0, beside_friction: true }
}

/// Forward selection with backward elimination. A kind in `rejected` is never added; where it is the likeliest, the selection
/// ends, and nothing takes its place. `None` where no hypothesis could be fitted.
pub fn select(
    data: &IdData,
    settings: &Settings,
    rejected: &[(Kind, Evidence)],
    start: SelectionStart<'_>,
) -> Option<Selected> {
    let most = settings.most_effects;
    let SelectionStart { mut effects, mut added, mut comparison, mut pool } = start;
    let mut steps = 0;
    loop {
        steps += 1;
        let fitted = comparison.finish(&mut pool);
        let table = table(&fitted, &effects);
        let kinds = table.kinds();
        let (kind, posterior) = *kinds.first()?;
        // Two effects that imitate each other would be added and dropped by turns without end.
        let full = added.len() >= most || steps > 2 * most;
        let was_rejected = |kind: Option<Kind>| rejected.iter().any(|own| Some(own.0) == kind);
        let addable = kind.is_some() && !was_rejected(kind) && posterior > 0.5 && !full;
        let next = table.best(kind).filter(|_| addable);
        let none = table.best(None)?;
        let Some(next) = next else {
            // A kind that the held-out samples rejected is no evidence on friction either.
            let left = table.without(&rejected.iter().map(|own| own.0).collect::<Vec<_>>());
            return Some(Selected {
                best: none.clone(),
                added,
                candidates: kinds.into_iter().filter(|own| !was_rejected(own.0)).collect(),
                friction_log_odds: friction_log_odds(&left, &fitted),
                slip_jump: slip_jump_evidence(&left),
            });
        };
        // The odds against none and the held-out samples are read after the selection has ended.
        let beside_friction = next.hypothesis.valve.is_some();
        let evidence =
            Evidence { log_odds: table.log_odds_of(kind), over_none: 0.0, held_out: 0.0, beside_friction };
        added.push((evidence, 2.0 * (next.score - none.score)));
        let mut keep: Vec<usize> = (0..added.len()).collect();
        let best = eliminate(data, next.clone(), &pool, &mut keep);
        added = keep.iter().map(|at| added[*at]).collect();
        effects = best.hypothesis.clone();
        if let Some(valve) = effects.valve {
            pool.retain(|other| *other != valve);
            pool.insert(0, valve);
        }
        comparison = comparison.beside(&effects, &pool);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::armax::Armax;

    #[test]
    fn friction_whose_feedback_is_positive_was_asked_and_is_not_there() {
        let of = |valve: Option<ValveModel>, score: f64| Fitted {
            hypothesis: Hypothesis { valve, effects: Vec::new() },
            model: Armax::default(),
            score,
        };
        let (none, valve) = (of(None, 3.0), Some(ValveModel::one_parameter(1.0)));
        let odds = |fitted: &[Fitted]| friction_log_odds(&table(fitted, &Hypothesis::default()), fitted);
        assert_eq!(odds(&[none.clone(), of(valve, f64::NEG_INFINITY)]), f64::MIN);
        assert_eq!(odds(std::slice::from_ref(&none)), f64::NEG_INFINITY);
        assert!((odds(&[none, of(valve, 5.0)]) - 2.0).abs() < 1e-12);
    }
}
