//! Whether the structure of a loop's last model still holds: then nothing is searched for again.
//!
//! A structure is what a search finds and a fit takes as given: friction or none, the kind of valve, no effect beside it. On a
//! new window all coefficients, S and J are fitted anew. The structure holds where
//!
//! 1. friction is told as before: a valve with nearly the last one's S has the evidence that a verdict asks for, or, where there
//!    was none, no valve of a coarse grid comes near,
//! 2. the residual fails no test that it passed when the structure was found (each is failed by chance once in a hundred), or
//!    no effect promises more than it costs: the score tests with which a search begins,
//! 3. the signals show no sample that is wrong.
//!
//! Elsewhere, and after [`MOST_CONFIRMED`] windows in a row, everything is searched for again.
//!
//! Source: Ljung, System Identification, 1999, chapter 16 (model validation).

use super::data_quality::{Fact, assess};
use super::decide::{Decided, decide, scored};
use super::findings::{Findings, Structure};
use super::forward_selection::table;
use super::hypotheses::ALL;
use super::hypothesis::Hypothesis;
use super::posterior::{class, log_prior};
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
/// Score by which no friction leads the best valve of the coarse grid: a search finds valves that are likelier, by less (-).
const CLEAR: f64 = 8.0;
/// Factor within which S stays from one window to the next: a valve that changes more is searched for.
const STAYS: f64 = 1.1;

/// The verdict that goes with a structure.
fn verdict_of(last: &Structure) -> Verdict {
    if last.valve.is_some() { Verdict::Stiction } else { Verdict::NoStiction }
}

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
    let prepared = prepared(record, diagnosed).ok()?;
    if prepared.preparation.compensated > 0.0 || prepared.window.mv.is_some() {
        return None;
    }
    if last.valve.is_none() && unanswered(&prepared.problem, &prepared.region).is_some() {
        return None;
    }
    let Prepared { preparation, window: own, .. } = &prepared;
    let bare = Diagnosis { preparation: preparation.clone(), ..Diagnosis::bare(verdict_of(last), "") };
    let whole = window(record, &bare, diagnosed)?;
    let settings = settings_of(record, own, diagnosed, settings);
    let (data, facts) = assessed(&whole, &settings, last)?;
    let outcome = fitted(&data, facts, last)?;
    let likeliest = outcome.best.clone();
    let mut findings = report(outcome, &bare, &settings);
    let as_before = findings.verdict == verdict_of(last) && findings.structure.is_some();
    let passes = findings.failed.iter().all(|test| last.failed.contains(test));
    if !as_before || !(passes || !promising(&data, &likeliest)) {
        return None;
    }
    findings.reason += "; the last model still fits";
    let (failed, confirmed_now) = (last.failed.clone(), last.confirmed + 1);
    findings.structure = findings.structure.map(|now| Structure { failed, confirmed: confirmed_now, ..now });
    let known = Known {
        verdict: findings.verdict.clone(),
        reason: findings.reason.clone(),
        f: findings.friction_after.f,
        f_ci95: findings.friction_after.f_ci95,
        delta_aic: findings.friction_after.delta_aic,
        model: findings.model.clone(),
        residual: findings.after,
    };
    Some((confirmed(prepared, known), findings))
}

/// Whether any effect promises more than it costs.
fn promising(data: &IdData, base: &Decided) -> bool {
    let screen = Screen::new(data, base);
    let promised = ALL.iter().flat_map(|hypothesis| hypothesis.propose(&screen)).map(|proposal| {
        let other = base.hypothesis.with(proposal.effect);
        let other = other.with_valve(proposal.valve.or(base.hypothesis.valve));
        scored(data, &other, base.model.log_likelihood + proposal.gain)
    });
    promised.fold(f64::NEG_INFINITY, f64::max) > base.score
}

/// The record that is fitted, where no sample of it is wrong.
fn assessed(whole: &Window, settings: &Settings, last: &Structure) -> Option<(IdData, Vec<Fact>)> {
    let mut data = iddata(whole)?;
    data.units.span = settings.op_span;
    let stem = |data: &IdData| {
        let valve = last.valve.map(|valve| scaled(valve, 1.0 / data.units.u));
        Hypothesis { valve, effects: Vec::new() }.stem(data).0
    };
    let facts = assess(&mut data, &stem, None);
    data.direct = last.direct;
    facts.iter().all(lasts).then_some((data, facts))
}

/// The models of the structure and of what competes with it; `None` where something else is likelier.
fn fitted(data: &IdData, facts: Vec<Fact>, last: &Structure) -> Option<Outcome> {
    let none = Hypothesis::default();
    let near: Vec<ValveModel> =
        last.valve.map(|valve| scaled(valve, 1.0 / data.units.u)).into_iter().collect();
    let effort = if near.is_empty() { Effort::Grid } else { Effort::Same };
    let found = search(data, &none, &near, effort);
    let mut decided = vec![decide(data, none.clone(), None)];
    let mut classes = Vec::new();
    for found in found {
        let hypothesis = none.with_valve(Some(found.valve));
        if !classes.contains(&class(&hypothesis)) {
            classes.push(class(&hypothesis));
            decided.push(decide(data, hypothesis, Some(&found.fit)));
        }
    }
    let sticks = |d: &Decided| d.hypothesis.valve.is_some();
    let best = |friction: bool| {
        let own = decided.iter().filter(|d| sticks(d) == friction);
        own.max_by(|a, b| a.score.total_cmp(&b.score))
    };
    let (sound, stuck) = (best(false)?, best(true)?);
    let as_before = match (near.first(), stuck.hypothesis.valve) {
        (Some(last), Some(now)) => (now.s / last.s).ln().abs() <= STAYS.ln(),
        _ => stuck.score <= sound.score - CLEAR,
    };
    if !as_before {
        return None;
    }
    let likeliest = if last.valve.is_some() { stuck } else { sound };
    let table = table(&decided, &none);
    Some(Outcome {
        recorded: data.clone(),
        data: data.clone(),
        declared: likeliest.clone(),
        best: likeliest.clone(),
        facts,
        added: Vec::new(),
        candidates: Vec::new(),
        friction: table.log_odds(sticks),
        slip_jump: table.log_odds_within(sticks, |d| class(&d.hypothesis) == 2) + log_prior(1),
    })
}
