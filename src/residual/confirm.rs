//! Confirmation: whether the structure of a loop's last model still holds on a new window. Where it does, nothing is searched for.
//!
//! The structure is what a search finds and a fit takes as given: friction or none, the stop rule of the valve, the effects that
//! last. All coefficients, S and J are fitted anew on the new window. The structure holds where all of these are true:
//!
//! 1. The verdict on friction is as before. With friction: PV answers OP, the evidence suffices for a verdict, and f is within a
//!    factor [`STAYS`] of the last f or does not differ from it significantly. Without: no valve of the grid is likelier.
//! 2. The residual fails no test that it passed when the structure was found (chance fails each once in a hundred), and every
//!    effect is still needed. Where that is not so: no further effect is likelier than none, and a whole search finds no valve
//!    that is likelier than none.
//! 3. Friction was tested on an earlier window, or cannot be tested on this one.
//! 4. The signals alone show no wrong sample.
//!
//! An effect that is no longer likelier than not is left out.
//!
//! Otherwise, and once [`LASTS_S`] have passed, everything is searched for again.
//!
//! Source: Ljung, System Identification, 1999, chapter 16 (model validation).

use super::data_quality::{Fact, assess};
use super::findings::{Evidence, Findings, Friction, Structure};
use super::fit::{Fitted, NEAR, fit_anew, fit_near, retime, scored};
use super::forward_selection::{CLOSE, FITTED, table};
use super::held_out::{validate, without_effect};
use super::hypotheses::load::oscillating_load::Oscillating;
use super::hypotheses::{ALL, Propose, restored};
use super::hypothesis::Hypothesis;
use super::posterior::{friction_class, log_prior};
use super::report::{Outcome, lasts, report, scaled};
use super::response::effect_evidence;
use super::screening::Screen;
use super::selection::{friction_log_odds, slip_jump_evidence};
use super::settings::Settings;
use super::trace::iddata_for_friction;
use super::valve_search::{Effort, Found, search};
use super::window::{settings_of, window_of};
use crate::diagnosis::confirmed::{Known, confirmed};
use crate::diagnosis::gate::{Gated, gate};
use crate::diagnosis::verdict::{Prepared, prepared, unanswered};
use crate::diagnosis::{self, Diagnosis, NotIdentifiable, Verdict};
use crate::signal::{Record, Window};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::ValveModel;
use crate::sysid::valve::model_error::without_model_error;
use std::f64::consts::SQRT_2;

/// Time for which a structure may be confirmed before all is searched for again: what the tests overlook is found within a day
/// (s).
pub const LASTS_S: f64 = 86_400.0;
/// Factor within which f stays from one window to the next, however narrow its interval: a change that is larger and
/// significant is searched for.
const STAYS: f64 = 1.1;

/// The diagnosis and its findings where the structure `last` still holds on a record; `None` where all has to be searched for.
pub fn confirm(
    record: &Record,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
    last: &Structure,
) -> Option<(Diagnosis, Findings)> {
    confirm_gated(record, &gate(record, diagnosed), diagnosed, settings, last)
}

/// [`confirm`] for a record that is gated already.
///
/// * `gated`: what [`gate`] made of the record with the settings of the diagnosis.
pub fn confirm_gated(
    record: &Record,
    gated: &Gated,
    diagnosed: &diagnosis::Settings,
    settings: &Settings,
    last: &Structure,
) -> Option<(Diagnosis, Findings)> {
    let prepared = prepared(record, gated, diagnosed);
    let bare = match &prepared {
        Ok(prepared) => diagnosis_if_unchanged(prepared, last),
        Err(refused) => (**refused).clone(),
    };
    let whole = window_of(gated, &bare)?;
    let age = whole.t0 + whole.len() as f64 * whole.ts - last.searched;
    let settings = settings_of(record, [&whole, bare.window.as_ref().unwrap_or(&whole)], diagnosed, settings);
    let compensated = bare.preparation.compensated > 0.0 || settings.compensated > 0.0;
    if !(0.0..LASTS_S).contains(&age) || compensated || whole.mv.is_some() {
        return None;
    }
    let (data, facts) = faultless_record(&whole, &settings, last)?;
    let outcome = fit_structure(&data, facts, last)?;
    // Friction was tested, or cannot be tested on this window.
    let unasked = matches!(bare.verdict, Verdict::NotIdentifiable(_)) && last.valve.is_none();
    let asked = outcome.friction_log_odds > f64::NEG_INFINITY;
    // Friction that is tested for the first time is searched for as a whole.
    if !asked && !unasked || asked && !last.asked && last.valve.is_none() {
        return None;
    }
    let likeliest = outcome.best.clone();
    let mut findings = report(outcome, &bare, &settings).findings;
    let as_before = match last.valve {
        Some(last) => {
            findings.verdict == Verdict::Stiction && f_is_unchanged(&last, &findings.friction_after)
        }
        None => findings.verdict != Verdict::Stiction,
    };
    let all_needed = likeliest.hypothesis.effects.len() == last.effects.len();
    let passes = all_needed && findings.failed.iter().all(|test| last.failed.contains(test));
    // The searches are long: they are made only where the residual does not pass.
    let holds = as_before
        && (passes
            || !some_effect_is_likelier(&data, &likeliest) && !some_valve_is_likelier(&data, &likeliest));
    if !holds {
        return None;
    }
    let Structure { ref failed, confirmed, searched, .. } = *last;
    let (failed, confirmed, asked) = (failed.clone(), confirmed + 1, last.asked || asked);
    findings.reason += "; the last model still fits";
    findings.structure = Some(Structure { failed, confirmed, searched, asked, ..findings.structure.take()? });
    let diagnosis = match (prepared, &bare.verdict) {
        (Ok(prepared), Verdict::Stiction | Verdict::NoStiction) => confirmed_as(prepared, bare, &findings),
        _ => Diagnosis { reason: findings.reason.clone(), ..bare },
    };
    Some((diagnosis, findings))
}

/// Whether f is that of the last valve, as far as the two windows can tell.
///
/// The difference of two estimates with the same variance has an interval √2 times as wide as theirs. The error of the valve
/// models is left out of the interval, because both estimates have the same one.
fn f_is_unchanged(last: &ValveModel, now: &Friction) -> bool {
    let apart = last.f() - now.f;
    let [low, high] = without_model_error(now.f, now.f_ci95);
    let limit = if apart > 0.0 { high - now.f } else { now.f - low };
    (now.f / last.f()).ln().abs() <= STAYS.ln() || apart.abs() <= SQRT_2 * limit
}

/// The diagnosis with the friction and the model of the findings.
fn confirmed_as(prepared: Prepared, bare: Diagnosis, findings: &Findings) -> Diagnosis {
    let Friction { f, f_ci95, delta_aic, .. } = findings.friction_after;
    let (reason, model) = (findings.reason.clone(), findings.model.clone());
    let known =
        Known { verdict: bare.verdict, reason, f, f_ci95, delta_aic, model, residual: findings.after };
    confirmed(prepared, known)
}

/// What the diagnosis says if friction is as it was. A valve does not stick where PV does not answer OP: a search decides then.
fn diagnosis_if_unchanged(prepared: &Prepared, last: &Structure) -> Diagnosis {
    let why = unanswered(&prepared.problem, &prepared.region);
    let why = match last.valve {
        // Friction that was found needs no further reversals of OP.
        Some(_) => why.filter(|why| *why == NotIdentifiable::NoResponse),
        None => why.or_else(|| prepared.preparation.apart()),
    };
    let (verdict, reason) = match why {
        Some(why) => (Verdict::NotIdentifiable(why.clone()), why.to_string()),
        None if last.valve.is_some() => (Verdict::Stiction, String::new()),
        None => (Verdict::NoStiction, String::new()),
    };
    let (preparation, window) = (prepared.preparation.clone(), Some(prepared.window.clone()));
    Diagnosis { preparation, window, ..Diagnosis::bare(verdict, reason) }
}

/// Whether any further effect is likelier than none. The effects whose gain by the score tests exceeds their penalty are fitted,
/// and the best of each kind is fitted to the end where it comes near.
fn some_effect_is_likelier(data: &IdData, base: &Fitted) -> bool {
    let screen = Screen::new(data, base);
    let enough = base.score - log_prior(1);
    ALL.iter().any(|kind| {
        let promised = kind.propose(&screen).into_iter().filter_map(|proposal| {
            let other = base.hypothesis.with(proposal.effect);
            let other = other.with_valve(proposal.valve.or(base.hypothesis.valve));
            let promised = scored(data, &other, base.model.log_likelihood + proposal.gain);
            (promised > enough).then_some((promised, other))
        });
        let mut promised: Vec<(f64, Hypothesis)> = promised.collect();
        promised.sort_by(|a, b| b.0.total_cmp(&a.0));
        let near = |other| retime(data, fit_near(data, other, &base.model, NEAR));
        let fitted = promised.into_iter().take(FITTED).map(|(_, other)| near(other));
        let best = fitted.max_by(|a, b| a.score.total_cmp(&b.score));
        best.filter(|best| best.score > enough - CLOSE)
            .is_some_and(|best| best.score > enough || fit_anew(data, best.hypothesis, None).score > enough)
    })
}

/// Whether a whole search finds a valve that is likelier than none, where there was none.
fn some_valve_is_likelier(data: &IdData, base: &Fitted) -> bool {
    let none = &base.hypothesis;
    let found = || search(data, none, &[], Effort::Whole).into_iter();
    let sticks = |found: Found| fit_anew(data, none.with_valve(Some(found.valve)), Some(&found.fit));
    none.valve.is_none() && found().any(|found| sticks(found).score > base.score)
}

/// The record that is fitted; `None` where the signals alone show a wrong sample.
fn faultless_record(whole: &Window, settings: &Settings, last: &Structure) -> Option<(IdData, Vec<Fact>)> {
    let mut data = iddata_for_friction(whole, last.valve.map_or(0.0, |valve| valve.f()))?;
    data.units.span = settings.op_span;
    let stem = |data: &IdData| Hypothesis { valve: valve_of(data, last), effects: Vec::new() }.stem(data).0;
    let facts = assess(&mut data, &stem);
    data.direct = last.direct;
    facts.iter().all(lasts).then_some((data, facts))
}

/// The valve of the last structure, in standard deviations of OP.
fn valve_of(data: &IdData, last: &Structure) -> Option<ValveModel> {
    last.valve.map(|valve| scaled(valve, 1.0 / data.units.u)).filter(|valve| valve.s.is_finite())
}

/// The structure fitted to the record, without the effects that are no longer needed; `None` where a competitor is likelier.
fn fit_structure(data: &IdData, facts: Vec<Fact>, last: &Structure) -> Option<Outcome> {
    let effects = last.effects.iter().map(|effect| restored(data, effect)).collect::<Option<Vec<_>>>()?;
    let mut none = Hypothesis { valve: None, effects };
    loop {
        match fit_with_effects(data, &facts, last, &none)? {
            Ok(outcome) => return Some(outcome),
            Err(needless) => none = none.without(needless),
        }
    }
}

/// The structure fitted with the effects of `none`, or the number of an effect that is not needed.
fn fit_with_effects(
    data: &IdData,
    facts: &[Fact],
    last: &Structure,
    none: &Hypothesis,
) -> Option<Result<Outcome, usize>> {
    let valve = valve_of(data, last);
    if valve.is_some() != last.valve.is_some() {
        return None;
    }
    let effort = if valve.is_none() { Effort::Grid } else { Effort::Same };
    let starts: Vec<ValveModel> = valve.into_iter().collect();
    let mut decided = vec![fit_anew(data, none.clone(), None)];
    let mut classes = Vec::new();
    for found in search(data, none, &starts, effort) {
        let hypothesis = none.with_valve(Some(found.valve));
        if !classes.contains(&friction_class(&hypothesis)) {
            classes.push(friction_class(&hypothesis));
            decided.push(fit_anew(data, hypothesis, Some(&found.fit)));
        }
    }
    let sticks = |d: &Fitted| d.hypothesis.valve.is_some();
    if valve.is_some() {
        // The load that imitates a sticking valve best: an oscillating one.
        let screen = Screen::new(data, decided.first()?);
        let load = Oscillating.propose(&screen).into_iter().next();
        decided.extend(load.map(|load| fit_anew(data, none.with(load.effect), None)));
    }
    let sound = decided.first()?;
    let stuck = decided.iter().filter(|d| sticks(d)).max_by(|a, b| a.score.total_cmp(&b.score));
    let likeliest = match (valve, stuck) {
        (Some(_), stuck) => stuck?,
        (None, stuck) => Some(sound).filter(|_| stuck.is_none_or(|s| s.score <= sound.score))?,
    };
    if !likeliest.score.is_finite() {
        return None;
    }
    let declared = match likeliest.hypothesis.effects.is_empty() {
        true => likeliest.clone(),
        false => fit_anew(data, Hypothesis { effects: Vec::new(), ..likeliest.hypothesis.clone() }, None),
    };
    let added = match evidence_if_needed(data, likeliest) {
        Ok(added) => added,
        Err(needless) => return Some(Err(needless)),
    };
    let table = table(&decided, none);
    Some(Ok(Outcome {
        recorded: data.clone(),
        data: data.clone(),
        declared,
        added,
        best: likeliest.clone(),
        facts: facts.to_vec(),
        candidates: Vec::new(),
        friction_log_odds: friction_log_odds(&table, &decided),
        slip_jump: slip_jump_evidence(&table),
        closed_loop: true,
        rejected: Vec::new(),
    }))
}

/// The evidence for each effect, and twice its log odds; or the number of the least likely effect, where it is not likelier than
/// not.
fn evidence_if_needed(data: &IdData, best: &Fitted) -> Result<Vec<(Evidence, f64)>, usize> {
    let with = validate(data, best, data);
    let each = best.hypothesis.effects.iter().enumerate().map(|(at, effect)| {
        let (without, held_out) = without_effect(data, best, &with, at);
        let gain = best.score - without.score;
        let over_none = gain + log_prior(1);
        let told = effect_evidence(data, &best.hypothesis, at, [over_none, over_none, held_out]);
        (told.posterior(effect.kind()), (told, 2.0 * gain))
    });
    let (posteriors, added): (Vec<f64>, Vec<_>) = each.unzip();
    let least = (0..added.len()).min_by(|a, b| posteriors[*a].total_cmp(&posteriors[*b]));
    match least {
        // An effect whose posterior is not a number is not needed either.
        Some(least) if !posteriors.iter().all(|own| *own > 0.5) => Err(least),
        _ => Ok(added),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Sample;
    use crate::sysid::valve::model_error::with_model_error;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// OP that swings and wanders, and a PV behind a dead band of 1 that follows by this gain.
    fn record(gain: f64, seed: u64) -> Record {
        let mut draw = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed));
        let mut next = || -> f64 { draw.next().unwrap_or(0.0) };
        let (mut wander, mut stem, mut y) = (0.0, 0.0f64, 0.0);
        let mut record = Record { op_span: Some(100.0), ..Record::default() };
        for t in (0..1500).map(f64::from) {
            wander = 0.9 * wander + 0.4 * next();
            let swing = 5.0 * (0.11 * t).sin() + wander;
            y = 0.8 * y + 0.2 * gain * stem;
            stem = stem.clamp(swing - 0.5, swing + 0.5);
            record.op.push(Sample::good(t, 50.0 + swing));
            record.pv.push(Sample::good(t, 20.0 + y + 0.05 * next()));
        }
        record
    }

    #[test]
    fn a_valve_whose_op_pv_does_not_answer_is_not_taken_to_stick_as_before() {
        let valve = Some(ValveModel { s: 1.0, ..ValveModel::default() });
        let last = Structure { valve, ..Structure::default() };
        let told = |gain: f64, verdict: &Verdict| {
            let said = |seed| {
                let (record, settings) = (record(gain, seed), diagnosis::Settings::default());
                let prepared = prepared(&record, &gate(&record, &settings), &settings);
                diagnosis_if_unchanged(&prepared.expect("it can be fitted"), &last).verdict
            };
            (1..6).filter(|seed| said(*seed) == *verdict).count()
        };
        assert_eq!(told(1.0, &Verdict::Stiction), 5);
        // Noise alone seems to answer in one record of forty.
        assert!(told(0.0, &Verdict::NotIdentifiable(NotIdentifiable::NoResponse)) >= 4);
    }

    #[test]
    fn f_stays_within_a_tenth_or_within_what_two_windows_can_tell() {
        let last = ValveModel { s: 2.0, ..ValveModel::default() };
        let now = |f: f64, half: f64| Friction {
            f,
            f_ci95: with_model_error(f, [f - half, f + half]),
            ..Friction::default()
        };
        assert!(f_is_unchanged(&last, &now(1.09, 0.0)) && f_is_unchanged(&last, &now(0.92, 0.0)));
        assert!(!f_is_unchanged(&last, &now(1.2, 0.1)) && f_is_unchanged(&last, &now(1.2, 0.15)));
        assert!(!f_is_unchanged(&last, &now(0.8, 0.1)) && f_is_unchanged(&last, &now(0.8, 0.15)));
        assert!(!f_is_unchanged(&last, &now(0.0, 0.0)) && !f_is_unchanged(&last, &now(f64::NAN, f64::NAN)));
    }
}
