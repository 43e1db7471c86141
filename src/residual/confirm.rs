//! Whether the structure of a loop's last model still holds: then nothing is searched for again.
//!
//! A structure is what a search finds and a fit takes as given: friction or none, the kind of valve, effects that last. On a new
//! window all coefficients, S and J are fitted anew. The structure holds where
//!
//! 1. friction is told as before: a valve with nearly the last one's S has the evidence that a verdict asks for, or, where there
//!    was none, no valve of a coarse grid has half of it,
//! 2. the residual fails no test that it passed when the structure was found (each is failed by chance once in a hundred), or
//!    no effect that a search would begin with is likelier than none,
//! 3. each of its effects is likelier than not,
//! 4. the signals show no sample that is wrong.
//!
//! Elsewhere, and after [`MOST_CONFIRMED`] windows in a row, everything is searched for again.
//!
//! Source: Ljung, System Identification, 1999, chapter 16 (model validation).

use super::data_quality::{Fact, assess};
use super::decide::{Decided, NEAR, decide, decide_near, scored};
use super::findings::{Findings, Structure};
use super::forward_selection::table;
use super::hypotheses::{ALL, again};
use super::hypothesis::Hypothesis;
use super::posterior::{class, log_prior, probability};
use super::report::{lasts, report, scaled};
use super::screening::Screen;
use super::trace::{Outcome, iddata};
use super::valve_search::{Effort, search};
use super::{Settings, settings_of, window};
use crate::diagnosis::confirmed::{Known, confirmed};
use crate::diagnosis::verdict::{Prepared, prepared, unanswered};
use crate::diagnosis::{self, Diagnosis, Verdict};
use crate::signal::{Record, Window};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;

/// Windows in a row on which a structure may be confirmed before all is searched for again: what the tests overlook is found
/// within half a day of hourly diagnoses.
pub const MOST_CONFIRMED: u32 = 11;
/// Share of the evidence that a verdict asks for, from which friction is searched for where there was none (-).
const WORTH: f64 = 0.5;
/// Factor within which S stays from one window to the next: a valve that changes more is searched for.
const STAYS: f64 = 1.1;

/// The diagnosis and its findings where the structure `last` still holds on a record; `None` where all has to be searched for.
pub fn confirm(
    record: &Record,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
    last: &Structure,
) -> Option<(Diagnosis, Findings)> {
    if last.confirmed >= MOST_CONFIRMED {
        return None;
    }
    let prepared = prepared(record, diagnosed);
    let bare = match &prepared {
        Ok(prepared) => standing(prepared, last),
        Err(refused) => (**refused).clone(),
    };
    let whole = window(record, &bare, diagnosed)?;
    if bare.preparation.compensated > 0.0 || whole.mv.is_some() {
        return None;
    }
    let settings = settings_of(record, bare.window.as_ref().unwrap_or(&whole), diagnosed, settings);
    let (data, facts) = assessed(&whole, &settings, last)?;
    let outcome = fitted(&data, facts, last, WORTH * settings.evidence_threshold)?;
    if outcome.friction == f64::NEG_INFINITY && bare.verdict == Verdict::NoStiction {
        return None;
    }
    let likeliest = outcome.best.clone();
    let mut findings = report(outcome, &bare, &settings);
    let as_before = (findings.verdict == Verdict::Stiction) == last.valve.is_some();
    let passes = findings.failed.iter().all(|test| last.failed.contains(test));
    if !as_before || !(passes || !another(&data, &likeliest)) {
        return None;
    }
    findings.reason += "; the last model still fits";
    let (failed, confirmed_now) = (last.failed.clone(), last.confirmed + 1);
    findings.structure = Some(Structure { failed, confirmed: confirmed_now, ..findings.structure.take()? });
    let known = Known {
        verdict: findings.verdict.clone(),
        reason: findings.reason.clone(),
        f: findings.friction_after.f,
        f_ci95: findings.friction_after.f_ci95,
        delta_aic: findings.friction_after.delta_aic,
        model: findings.model.clone(),
        residual: findings.after,
    };
    let diagnosis = prepared.map_or(bare, |prepared| confirmed(prepared, known));
    Some((diagnosis, findings))
}

/// What a diagnosis says where friction is as it was.
fn standing(prepared: &Prepared, last: &Structure) -> Diagnosis {
    let (verdict, reason) = match unanswered(&prepared.problem, &prepared.region) {
        _ if last.valve.is_some() => (Verdict::Stiction, String::new()),
        Some(why) => (Verdict::NotIdentifiable(why.clone()), why.to_string()),
        None => (Verdict::NoStiction, String::new()),
    };
    let (preparation, window) = (prepared.preparation.clone(), Some(prepared.window.clone()));
    Diagnosis { preparation, window, ..Diagnosis::bare(verdict, reason) }
}

/// Whether any effect is likelier than none: the best of each kind that promises to be is fitted.
fn another(data: &IdData, base: &Decided) -> bool {
    let screen = Screen::new(data, base);
    let pays = |score: f64| score + log_prior(1) > base.score;
    ALL.iter().any(|kind| {
        let promised = kind.propose(&screen).into_iter().map(|proposal| {
            let other = base.hypothesis.with(proposal.effect);
            let other = other.with_valve(proposal.valve.or(base.hypothesis.valve));
            (scored(data, &other, base.model.log_likelihood + proposal.gain), other)
        });
        let best = promised.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|best| pays(best.0));
        best.is_some_and(|(_, other)| pays(decide_near(data, other, &base.model, NEAR).score))
    })
}

/// The record that is fitted, where no sample of it is wrong.
fn assessed(whole: &Window, settings: &Settings, last: &Structure) -> Option<(IdData, Vec<Fact>)> {
    let mut data = iddata(whole)?;
    data.units.span = settings.op_span;
    let stem = |data: &IdData| Hypothesis { valve: valve_of(data, last), effects: Vec::new() }.stem(data).0;
    let facts = assess(&mut data, &stem, None);
    data.direct = last.direct;
    facts.iter().all(lasts).then_some((data, facts))
}

/// The last valve in the units of the data.
fn valve_of(data: &IdData, last: &Structure) -> Option<ValveModel> {
    last.valve.map(|valve| scaled(valve, 1.0 / data.units.u))
}

/// The models of the structure and of what competes with it; `None` where something else is likelier.
///
/// * `worth`: evidence for friction from which it is looked for, where there was none (-).
fn fitted(data: &IdData, facts: Vec<Fact>, last: &Structure, worth: f64) -> Option<Outcome> {
    let effects = last.effects.iter().map(|effect| again(data, effect)).collect::<Option<Vec<_>>>()?;
    let none = Hypothesis { valve: None, effects };
    let valve = valve_of(data, last);
    let effort = if valve.is_none() { Effort::Grid } else { Effort::Same };
    let starts: Vec<ValveModel> = valve.into_iter().collect();
    let mut decided = vec![decide(data, none.clone(), None)];
    let mut classes = Vec::new();
    for found in search(data, &none, &starts, effort) {
        let hypothesis = none.with_valve(Some(found.valve));
        if !classes.contains(&class(&hypothesis)) {
            classes.push(class(&hypothesis));
            decided.push(decide(data, hypothesis, Some(&found.fit)));
        }
    }
    let sticks = |d: &Decided| d.hypothesis.valve.is_some();
    let sound = decided.first()?;
    let stuck = decided.iter().skip(1).max_by(|a, b| a.score.total_cmp(&b.score));
    let likeliest = match (valve, stuck.map(|stuck| (stuck, stuck.hypothesis.valve))) {
        (Some(last), Some((stuck, Some(now)))) => {
            Some(stuck).filter(|_| (now.s / last.s).ln().abs() <= STAYS.ln())?
        }
        (Some(_), _) => return None,
        (None, stuck) => {
            Some(sound).filter(|_| stuck.is_none_or(|s| 2.0 * (s.0.score - sound.score) <= worth))?
        }
    };
    let declared = match likeliest.hypothesis.effects.is_empty() {
        true => likeliest.clone(),
        false => decide(data, Hypothesis { effects: Vec::new(), ..likeliest.hypothesis.clone() }, None),
    };
    let table = table(&decided, &none);
    Some(Outcome {
        recorded: data.clone(),
        data: data.clone(),
        declared,
        added: needed(data, likeliest)?,
        best: likeliest.clone(),
        facts,
        candidates: Vec::new(),
        friction: table.log_odds(sticks),
        slip_jump: table.log_odds_within(sticks, |d| class(&d.hypothesis) == 2) + log_prior(1),
    })
}

/// Posterior of each effect, and twice the log odds against none; `None` where one is not needed.
fn needed(data: &IdData, best: &Decided) -> Option<Vec<(f64, f64)>> {
    let each = 0..best.hypothesis.effects.len();
    each.map(|at| {
        let without = decide(data, best.hypothesis.without(at), None);
        let gained = best.score - without.score;
        let posterior = probability(gained + log_prior(1));
        (posterior > 0.5).then_some((posterior, 2.0 * gained))
    })
    .collect()
}
