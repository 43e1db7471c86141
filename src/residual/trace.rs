//! The whole way from a diagnosed window to findings.

use super::backward_elimination::eliminate;
use super::data_quality::{Fact, assess};
use super::decide::{Decided, arx, decide, scored};
use super::findings::{Findings, Kind, Stem};
use super::forward_selection::{compare, table};
use super::hypothesis::Hypothesis;
use super::posterior::{class, log_prior};
use super::report::report;
use super::valve_search::{Effort, Found, search};
use super::{Row, Settings};
use crate::diagnosis::{Diagnosis, Verdict, region};
use crate::signal::Window;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{Rest, Start, StopRule, ValveModel};
use std::cell::RefCell;

/// What the selection ends with.
pub struct Outcome {
    /// The window as it was recorded.
    pub recorded: IdData,
    /// The window with wrong samples repaired.
    pub data: IdData,
    /// The declared model on the window as it was recorded.
    pub declared: Decided,
    /// The likeliest hypothesis.
    pub best: Decided,
    /// What the signals alone show.
    pub facts: Vec<Fact>,
    /// Posterior of each effect of the likeliest hypothesis, and twice the log odds against none.
    pub added: Vec<(f64, f64)>,
    /// The kinds at the last step.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// Logarithm of the odds for friction, over all hypotheses of the last step.
    pub friction: f64,
    /// Logarithm of the odds for a J of its own, where there is friction.
    pub slip_jump: f64,
}

/// See [`super::trace`].
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let mut findings = trace_one(window, diagnosis, settings)?;
    findings.stem = window.mv.as_ref().and_then(|mv| stem(window, mv, settings));
    Some(findings)
}

/// OP to the measured stem: no process hides the valve there.
fn stem(window: &Window, mv: &[f64], settings: &Settings) -> Option<Stem> {
    let window = Window { pv: mv.to_vec(), mv: None, sp: None, ..window.clone() };
    let unknown = Diagnosis::bare(Verdict::NoStiction, "the stem follows OP");
    let findings = trace_one(&window, &unknown, settings)?;
    Some(Stem { friction: findings.friction_after, findings: Some(Box::new(findings)) })
}

/// The record that is fitted; stems start at the first large extremum of OP.
pub fn iddata(window: &Window) -> Option<IdData> {
    let found = region::analyse(&window.op);
    let start = region::start_of(&found, &window.op, 0, window.len() / 3);
    let start =
        start.map_or(Start { index: 0, is_max: true }, |s| Start { index: s.index, is_max: s.is_max });
    IdData::new(window, start)
}

fn trace_one(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let mut recorded = iddata(window)?;
    recorded.units.span = settings.op_span;
    let mut data = recorded.clone();
    let f = diagnosis.estimate.as_ref().map_or(0.0, |e| e.f) / data.units.u;
    let valve = (f > 0.0).then(|| ValveModel::one_parameter(f));
    let (found, facts) = prepare(&mut data, settings);
    // The window is too short for the friction that was found: hypotheses without it would compete with none.
    if found.is_empty() && diagnosis.verdict == Verdict::Stiction {
        return None;
    }
    let declared = decide(&recorded, Hypothesis { valve, effects: Vec::new() }, None);
    let mut outcome = select(&data, settings, found)?;
    outcome.recorded = recorded;
    outcome.facts = facts;
    outcome.declared = declared;
    outcome.data = data;
    Some(report(outcome, diagnosis, settings))
}

/// Repairs what the signals alone show to be wrong, and finds the valves of the repaired record.
fn prepare(data: &mut IdData, settings: &Settings) -> (Vec<Found>, Vec<Fact>) {
    let known = informed(settings, data.units.u);
    let recorded = data.y.clone();
    let valves = RefCell::new(None);
    let likeliest_stem = |data: &IdData| {
        let found = search(data, &Hypothesis::default(), &known, Effort::Whole);
        let sound =
            scored(data, &Hypothesis::default(), arx(data, &Hypothesis::default(), None).log_likelihood);
        let valve = found.first().filter(|found| found.score > sound).map(|found| found.valve);
        let stem = Hypothesis { valve, effects: Vec::new() }.stem(data).0;
        valves.replace(Some((data.y.clone(), found)));
        stem
    };
    let facts = assess(data, &likeliest_stem, None);
    // What was found on the record as it is now need not be found again.
    let found = valves.into_inner().filter(|(y, _)| *y == data.y && recorded == data.y).map(|found| found.1);
    let found = found.unwrap_or_else(|| search(data, &Hypothesis::default(), &known, Effort::Whole));
    (direct(data, &known, found), facts)
}

/// Lets OP act beside the stem where friction is believed only so; `found`: the valves without such a term.
fn direct(data: &mut IdData, known: &[ValveModel], found: Vec<Found>) -> Vec<Found> {
    let none = Hypothesis::default();
    let sound = scored(data, &none, arx(data, &none, None).log_likelihood);
    if found.first().is_some_and(|found| found.score > sound) {
        return found;
    }
    data.direct = true;
    let beside = search(data, &none, known, Effort::Whole);
    let likelier =
        |found: &Found| scored(data, &none.with_valve(Some(found.valve)), found.fit.log_likelihood) > sound;
    if beside.first().is_some_and(likelier) {
        return beside;
    }
    data.direct = false;
    found
}

/// See [`super::first_step`].
pub fn first_step(window: &Window, settings: &Settings) -> Vec<Row> {
    let Some(mut data) = iddata(window) else { return Vec::new() };
    let (found, _) = prepare(&mut data, settings);
    let decided = compare(&data, &Hypothesis::default(), &found, &mut Vec::new(), None);
    let row = |d: &Decided| Row {
        kind: d.kind(),
        friction: class(&d.hypothesis),
        log_likelihood: d.model.log_likelihood,
        cost: TEMPERING * d.model.log_likelihood - d.score,
    };
    table(&decided, &Hypothesis::default()).decided().map(row).collect()
}

/// Places of a stem at the start, from which an informed search begins.
const PLACES: usize = 10;

/// Valves with the friction that is known, at every place at the start.
fn informed(settings: &Settings, unit: f64) -> Vec<ValveModel> {
    let Some((f, j)) = settings.friction.filter(|friction| friction.0 > 0.0) else { return Vec::new() };
    let s = 2.0 * f / unit;
    let shares = j.map_or_else(|| vec![0.15, 0.3, 0.45, 0.6], |j| vec![j / (2.0 * f)]);
    let rests = (0..=PLACES)
        .flat_map(|i| [false, true].map(|turned| Rest { turned, beyond: i as f64 / PLACES as f64 }));
    let valves = rests
        .flat_map(|rest| StopRule::ALL.map(|rule| ValveModel { s, rule, rest, ..ValveModel::default() }));
    valves.flat_map(|valve| shares.iter().map(move |share| ValveModel { j: share * s, ..valve })).collect()
}

/// Forward selection with backward elimination; `found`: the valves without an effect.
fn select(data: &IdData, settings: &Settings, mut found: Vec<Found>) -> Option<Outcome> {
    let mut pool = Vec::new();
    let mut effects = Hypothesis::default();
    let mut added: Vec<(f64, f64)> = Vec::new();
    let mut steps = 0;
    loop {
        steps += 1;
        let decided = compare(data, &effects, &found, &mut pool, settings.only);
        let table = table(&decided, &effects);
        let kinds = table.kinds();
        let (kind, posterior) = *kinds.first()?;
        // Two effects that stand in for each other would take turns without end.
        let full = added.len() >= settings.most_effects || steps > 2 * settings.most_effects;
        let next = table.best(kind).filter(|_| kind.is_some() && posterior > 0.5 && !full);
        let none = table.best(None)?;
        let Some(next) = next else {
            let sticks = |d: &Decided| d.hypothesis.valve.is_some();
            return Some(Outcome {
                recorded: IdData::default(),
                data: IdData::default(),
                declared: none.clone(),
                best: none.clone(),
                facts: Vec::new(),
                added,
                candidates: kinds.iter().copied().take(3).collect(),
                friction: table.log_odds(sticks),
                slip_jump: table.log_odds_within(sticks, |d| class(&d.hypothesis) == 2) + log_prior(1),
            });
        };
        added.push((posterior, 2.0 * (next.score - none.score)));
        let mut keep: Vec<usize> = (0..added.len()).collect();
        let best = eliminate(data, next.clone(), &pool, &mut keep);
        added = keep.iter().map(|at| added[*at]).collect();
        effects = best.hypothesis.clone();
        if let Some(valve) = effects.valve {
            pool.retain(|other| *other != valve);
            pool.insert(0, valve);
        }
        found = search(data, &effects, &pool, Effort::Near);
    }
}
