//! The steps from a diagnosed window to findings.
//!
//! 1. The window becomes the record that is fitted ([`iddata_for_friction`]).
//! 2. Samples that are wrong by the signals alone are repaired ([`super::data_quality`]).
//! 3. The valve is searched for ([`super::valve_search`]), with OP beside the stem where friction is likelier only so.
//! 4. The declared model is fitted: the diagnosed friction, without effects.
//! 5. Effects are selected on the fitted samples ([`super::selection`]) and rejected by the held-out ones
//!    ([`super::rejection`]), with friction and without; the likelier end counts.
//! 6. The outcome is put into the plant's units and a verdict ([`super::report`]).

use super::data_quality::{Fact, assess};
use super::findings::{Evidence, Kind, Stem};
use super::fit::{Fitted, arx, fit_anew, scored};
use super::forward_selection::{Comparison, table};
use super::hypothesis::Hypothesis;
use super::posterior::{friction_class, log_prior};
use super::rejection::select_and_reject;
use super::report::{Outcome, Report, report};
use super::selection::Selected;
use super::settings::Settings;
use super::valve_search::{Effort, Found, LEAST_REVERSALS, search};
use crate::diagnosis::region;
use crate::diagnosis::{Diagnosis, Verdict};
use crate::signal::Window;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{Rest, Start, StopRule, ValveModel, reversals};
use std::cell::RefCell;

/// [`super::trace`] with the models before and after.
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Report> {
    let mut report = trace_one(window, diagnosis, settings, true)?;
    report.findings.stem = window.mv.as_ref().and_then(|mv| trace_stem(window, mv, settings));
    Some(report)
}

/// Traces OP to the measured stem as PV is traced: no process stands between them.
fn trace_stem(window: &Window, mv: &[f64], settings: &Settings) -> Option<Stem> {
    let window = Window { pv: mv.to_vec(), mv: None, sp: None, ..window.clone() };
    let unknown = Diagnosis::bare(Verdict::NoStiction, "the stem follows OP");
    let findings = trace_one(&window, &unknown, settings, false)?.findings;
    Some(Stem { friction: findings.friction_after, findings: Some(Box::new(findings)) })
}

/// The record that is fitted: its stems start at the first large extremum of OP.
pub fn iddata(window: &Window) -> Option<IdData> {
    let found = region::analyse(&window.op);
    let start = region::start_of(&found, &window.op, 0, window.len() / 3);
    IdData::new(window, start.unwrap_or(Start { index: 0, is_max: true }))
}

/// The record that is fitted where friction `f` (OP unit) is known. Its stem starts at the first large extremum of OP, unless it
/// reverses fewer than [`LEAST_REVERSALS`] times in the fitted samples: then it starts at the extremum after which it reverses
/// most. `None` where no start gives enough reversals, so that this friction cannot be tested.
pub fn iddata_for_friction(window: &Window, f: f64) -> Option<IdData> {
    let data = iddata(window)?;
    let valve = ValveModel::one_parameter(f / data.units.u);
    if f <= 0.0 || stem_reversals(&data, &valve) >= LEAST_REVERSALS {
        return Some(data);
    }
    let found = region::analyse(&window.op);
    // From the latest to the earliest: `max_by` returns the last of equals, and the earliest start has the most samples.
    let later = found.extrema.iter().rev().map(|extremum| extremum.index).filter(|at| *at > data.start.index);
    let start = |from| region::start_of(&found, &window.op, from, window.len());
    let begun = later.filter_map(|from| IdData::new(window, start(from)?));
    let rated = begun.map(|data| (stem_reversals(&data, &valve), data));
    rated.filter(|own| own.0 >= LEAST_REVERSALS).max_by(|a, b| a.0.total_cmp(&b.0)).map(|own| own.1)
}

/// Traces the PV of one window. `closed_loop`: a controller makes OP of PV, so that it tells the sign of the process gain.
fn trace_one(
    window: &Window,
    diagnosis: &Diagnosis,
    settings: &Settings,
    closed_loop: bool,
) -> Option<Report> {
    let diagnosed = diagnosis.estimate.as_ref().filter(|_| diagnosis.verdict == Verdict::Stiction);
    let mut recorded = iddata_for_friction(window, diagnosed.map_or(0.0, |estimate| estimate.f))?;
    recorded.units.span = settings.op_span;
    recorded.gain_sign = recorded.gain_sign.filter(|_| closed_loop);
    let mut data = recorded.clone();
    let f = diagnosis.estimate.as_ref().map_or(0.0, |e| e.f) / data.units.u;
    let valve = (f > 0.0).then(|| ValveModel::one_parameter(f));
    let (found, facts) = prepare(&mut data, settings);
    // The declared model has the same least scale of errors (by PV's quantum): otherwise the two could not be compared.
    recorded.least_scale = data.least_scale;
    // The window is too short for the diagnosed friction: every hypothesis would be one without friction.
    if found.is_empty() && diagnosis.verdict == Verdict::Stiction {
        return None;
    }
    let declared = fit_anew(&recorded, Hypothesis { valve, effects: Vec::new() }, None);
    let (selected, rejected) = select_likelier(&data, settings, &found)?;
    let Selected { best, added, candidates, friction_log_odds, slip_jump } = selected;
    let outcome = Outcome {
        recorded,
        data,
        declared,
        best,
        facts,
        added,
        rejected,
        candidates,
        friction_log_odds,
        slip_jump,
        closed_loop,
    };
    Some(report(outcome, diagnosis, settings))
}

/// How often the stem of a valve reverses from its start to the last fitted sample.
fn stem_reversals(data: &IdData, valve: &ValveModel) -> f64 {
    let (mut stem, mut direction) = (Vec::new(), Vec::new());
    valve.run(&data.u, data.start, data.split, &mut stem, &mut direction);
    reversals(&direction[data.start.index..data.split]) as f64
}

/// Repairs the samples that are wrong by the signals alone, and searches for the valves of the repaired record.
fn prepare(data: &mut IdData, settings: &Settings) -> (Vec<Found>, Vec<Fact>) {
    let known = known_valves(settings, data.units.u);
    let recorded = data.y.clone();
    let searched = |data: &IdData| {
        (search(data, &Hypothesis::default(), &known, Effort::Whole), score_without_friction(data))
    };
    let valves = RefCell::new(None);
    let likeliest_stem = |data: &IdData| {
        let (found, without_friction) = searched(data);
        let valve = found.first().filter(|found| found.score > without_friction).map(|found| found.valve);
        let stem = Hypothesis { valve, effects: Vec::new() }.stem(data).0;
        valves.replace(Some((data.y.clone(), (found, without_friction))));
        stem
    };
    let facts = assess(data, &likeliest_stem);
    // The search inside `assess` holds where nothing was repaired, neither before it nor after it.
    let found = valves.into_inner().filter(|(y, _)| *y == data.y && recorded == data.y).map(|found| found.1);
    let (found, without_friction) = found.unwrap_or_else(|| searched(data));
    (search_beside_op(data, &known, found, without_friction), facts)
}

/// Score of the hypothesis without friction and without effects, by its high-order ARX (-).
fn score_without_friction(data: &IdData) -> f64 {
    let none = Hypothesis::default();
    scored(data, &none, arx(data, &none, None).log_likelihood)
}

/// Searches for the valve with OP acting beside the stem ([`IdData::direct`]), where no valve is likelier than none without that
/// term. The term stays only where friction is likelier than none with it.
///
/// * `found`: the valves that were found without the term.
/// * `without_friction`: see [`score_without_friction`].
fn search_beside_op(
    data: &mut IdData,
    known: &[ValveModel],
    found: Vec<Found>,
    without_friction: f64,
) -> Vec<Found> {
    let none = Hypothesis::default();
    if found.first().is_some_and(|found| found.score > without_friction) {
        return found;
    }
    data.direct = true;
    let beside = search(data, &none, known, Effort::Whole);
    let likelier = |found: &Found| {
        let hypothesis = none.with_valve(Some(found.valve));
        scored(data, &hypothesis, found.fit.log_likelihood) > without_friction
    };
    if beside.first().is_some_and(likelier) {
        return beside;
    }
    data.direct = false;
    found
}

/// A hypothesis of the first step, for calibration: friction or none, with one effect or none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// The kind of its effect; `None` without one.
    pub kind: Option<Kind>,
    /// Friction: 0 for none, 1 for J = S, 2 for J free.
    pub friction: usize,
    /// Log-likelihood (-).
    pub log_likelihood: f64,
    /// Penalty of its parameters and alternatives (-).
    pub cost: f64,
}

/// See [`super::first_step`].
pub fn first_step(window: &Window, settings: &Settings) -> Vec<Row> {
    let Some(mut data) = iddata(window) else { return Vec::new() };
    let (found, _) = prepare(&mut data, settings);
    let fitted = Comparison::new(&data, &Hypothesis::default(), &found, None, false).finish(&mut Vec::new());
    let row = |d: &Fitted| Row {
        kind: d.kind(),
        friction: friction_class(&d.hypothesis),
        log_likelihood: d.model.log_likelihood,
        cost: TEMPERING * d.model.log_likelihood - d.score,
    };
    table(&fitted, &Hypothesis::default()).fitted().map(row).collect()
}

/// Positions of the stem at the start from which a search with known friction begins.
const PLACES: usize = 10;

/// The valves with the friction that is known: every stop rule, and several positions of the stem at the start. Where J is not
/// known, several shares of S. `unit`: OP units in one standard deviation of OP.
fn known_valves(settings: &Settings, unit: f64) -> Vec<ValveModel> {
    let Some((f, j)) = settings.friction.filter(|friction| friction.0 > 0.0) else { return Vec::new() };
    let s = 2.0 * f / unit;
    let shares = j.map_or_else(|| vec![0.15, 0.3, 0.45, 0.6], |j| vec![j / (2.0 * f)]);
    let rests = (0..=PLACES)
        .flat_map(|i| [false, true].map(|turned| Rest { turned, beyond: i as f64 / PLACES as f64 }));
    let valves = rests
        .flat_map(|rest| StopRule::ALL.map(|rule| ValveModel { s, rule, rest, ..ValveModel::default() }));
    valves.flat_map(|valve| shares.iter().map(move |share| ValveModel { j: share * s, ..valve })).collect()
}

/// The selection with friction or the one without, whichever ends in the likelier hypothesis.
///
/// Effects are added one by one, so friction may be the best first step and yet not the best explanation: several steps of a
/// load look like a stem that stands still and then moves, and none of these steps is worth its penalty alone. The selection
/// without friction may therefore add twice as many effects, each with its own penalty.
fn select_likelier(
    data: &IdData,
    settings: &Settings,
    found: &[Found],
) -> Option<(Selected, Vec<(Kind, Evidence)>)> {
    let first = Comparison::new(data, &Hypothesis::default(), found, settings.only, false);
    let (sticky, of_sticky) = select_and_reject(data, settings, &first)?;
    // Friction that is known is not tested.
    if settings.friction.is_some() || sticky.best.hypothesis.valve.is_none() {
        return Some((sticky, of_sticky));
    }
    let more = Settings { most_effects: 2 * settings.most_effects, ..settings.clone() };
    let Some((sound, of_sound)) = select_and_reject(data, &more, &first.without_friction()) else {
        return Some((sticky, of_sticky));
    };
    let log_posterior = |fitted: &Fitted| fitted.score + log_prior(fitted.hypothesis.effects.len());
    let friction_log_odds =
        sticky.friction_log_odds.min(log_posterior(&sticky.best) - log_posterior(&sound.best));
    let (likelier, rejected) = if friction_log_odds > 0.0 { (sticky, of_sticky) } else { (sound, of_sound) };
    Some((Selected { friction_log_odds, ..likelier }, rejected))
}
