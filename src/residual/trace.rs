//! The whole way from a diagnosed window to findings.

use super::backward_elimination::eliminate;
use super::data_quality::{Fact, assess};
use super::findings::{Evidence, Findings, Kind, Stem};
use super::fit::{Fitted, arx, fit_anew, scored};
use super::forward_selection::{compare, table};
use super::held_out::{judge, without};
use super::hypothesis::Hypothesis;
use super::posterior::{Table, class, log_prior};
use super::report::report;
use super::response::evidence;
use super::valve_search::{Effort, Found, LEAST_REVERSALS, search};
use super::{Row, Settings};
use crate::diagnosis::region;
use crate::diagnosis::{Diagnosis, Verdict};
use crate::signal::Window;
use crate::sysid::criterion::TEMPERING;
use crate::sysid::iddata::IdData;
use crate::sysid::valve::{Rest, Start, StopRule, ValveModel, reversals};
use std::cell::RefCell;

/// All that a report is made of.
pub struct Outcome {
    /// The window as it was recorded.
    pub recorded: IdData,
    /// The window with wrong samples repaired.
    pub data: IdData,
    /// The declared model on the window as it was recorded.
    pub declared: Fitted,
    /// The likeliest hypothesis.
    pub best: Fitted,
    /// What the signals alone show.
    pub facts: Vec<Fact>,
    /// What speaks for each effect of the likeliest hypothesis, and twice the log odds against none.
    pub added: Vec<(Evidence, f64)>,
    /// What was likeliest until held-out samples spoke against it.
    pub rejected: Vec<(Kind, Evidence)>,
    /// The kinds at the last step.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// Logarithm of the odds for friction, over all hypotheses of the last step.
    pub friction: f64,
    /// What speaks for a J of its own, where there is friction.
    pub slip_jump: Evidence,
}

/// See [`super::trace`].
pub fn trace(window: &Window, diagnosis: &Diagnosis, settings: &Settings) -> Option<Findings> {
    let mut findings = trace_one(window, diagnosis, settings, true)?;
    findings.stem = window.mv.as_ref().and_then(|mv| stem(window, mv, settings));
    Some(findings)
}

/// OP to the measured stem: no process hides the valve there.
fn stem(window: &Window, mv: &[f64], settings: &Settings) -> Option<Stem> {
    let window = Window { pv: mv.to_vec(), mv: None, sp: None, ..window.clone() };
    let unknown = Diagnosis::bare(Verdict::NoStiction, "the stem follows OP");
    let findings = trace_one(&window, &unknown, settings, false)?;
    Some(Stem { friction: findings.friction_after, findings: Some(Box::new(findings)) })
}

/// The record that is fitted; stems start at the first large extremum of OP.
pub fn iddata(window: &Window) -> Option<IdData> {
    let found = region::analyse(&window.op);
    let start = region::start_of(&found, &window.op, 0, window.len() / 3);
    IdData::new(window, start.unwrap_or(Start { index: 0, is_max: true }))
}

/// The record that is fitted where friction `f` (OP unit) is known. Usually it starts at the first large extremum of OP. If the
/// stem turns fewer than [`LEAST_REVERSALS`] times in its fitted samples, it starts at the extremum after which the stem turns
/// most. `None` if no start gives enough turns: the friction could not be tested there.
pub fn iddata_beside(window: &Window, f: f64) -> Option<IdData> {
    let data = iddata(window)?;
    let valve = ValveModel::one_parameter(f / data.units.u);
    if f <= 0.0 || turns(&data, &valve) >= LEAST_REVERSALS {
        return Some(data);
    }
    let found = region::analyse(&window.op);
    // The earliest of equals has most samples.
    let later = found.extrema.iter().rev().map(|extremum| extremum.index).filter(|at| *at > data.start.index);
    let start = |from| region::start_of(&found, &window.op, from, window.len());
    let begun = later.filter_map(|from| IdData::new(window, start(from)?));
    let rated = begun.map(|data| (turns(&data, &valve), data));
    rated.filter(|own| own.0 >= LEAST_REVERSALS).max_by(|a, b| a.0.total_cmp(&b.0)).map(|own| own.1)
}

/// `closed`: OP is what a controller makes of PV.
fn trace_one(window: &Window, diagnosis: &Diagnosis, settings: &Settings, closed: bool) -> Option<Findings> {
    let diagnosed = diagnosis.estimate.as_ref().filter(|_| diagnosis.verdict == Verdict::Stiction);
    let mut recorded = iddata_beside(window, diagnosed.map_or(0.0, |estimate| estimate.f))?;
    recorded.units.span = settings.op_span;
    recorded.gain_sign = recorded.gain_sign.filter(|_| closed);
    let mut data = recorded.clone();
    let f = diagnosis.estimate.as_ref().map_or(0.0, |e| e.f) / data.units.u;
    let valve = (f > 0.0).then(|| ValveModel::one_parameter(f));
    let (found, facts) = prepare(&mut data, settings);
    // The declared model is rated with the same least scale (PV's quantum), or the two could not be compared.
    recorded.least_scale = data.least_scale;
    // The window is too short for the friction that was found: hypotheses without it would compete with none.
    if found.is_empty() && diagnosis.verdict == Verdict::Stiction {
        return None;
    }
    let declared = fit_anew(&recorded, Hypothesis { valve, effects: Vec::new() }, None);
    let (selected, rejected) = select_either(&data, settings, found)?;
    let Selected { best, added, candidates, friction, slip_jump } = selected;
    let outcome =
        Outcome { recorded, data, declared, best, facts, added, rejected, candidates, friction, slip_jump };
    Some(report(outcome, diagnosis, settings))
}

/// How often a stem turns from its start to the last fitted sample.
fn turns(data: &IdData, valve: &ValveModel) -> f64 {
    let (mut stem, mut direction) = (Vec::new(), Vec::new());
    valve.run(&data.u, data.start, data.split, &mut stem, &mut direction);
    reversals(&direction[data.start.index..data.split]) as f64
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
    let facts = assess(data, &likeliest_stem);
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
    let fitted = compare(&data, &Hypothesis::default(), &found, &mut Vec::new(), None, false);
    let row = |d: &Fitted| Row {
        kind: d.kind(),
        friction: class(&d.hypothesis),
        log_likelihood: d.model.log_likelihood,
        cost: TEMPERING * d.model.log_likelihood - d.score,
    };
    table(&fitted, &Hypothesis::default()).fitted().map(row).collect()
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

/// What a selection ends with.
struct Selected {
    best: Fitted,
    added: Vec<(Evidence, f64)>,
    candidates: Vec<(Option<Kind>, f64)>,
    friction: f64,
    slip_jump: Evidence,
}

/// What a selection goes on from: effects, what was found to speak for them, and the valves beside them.
struct Begun {
    effects: Hypothesis,
    added: Vec<(Evidence, f64)>,
    found: Vec<Found>,
    pool: Vec<ValveModel>,
    /// Whether no valve competes.
    sound: bool,
}

impl Begun {
    /// From the beginning, with the valves that were found.
    fn beside(found: Vec<Found>) -> Self {
        Self { effects: Hypothesis::default(), added: Vec::new(), found, pool: Vec::new(), sound: false }
    }

    /// From the beginning, with a valve that is sound.
    fn sound() -> Self {
        Self { sound: true, ..Self::beside(Vec::new()) }
    }
}

/// Selects effects, then asks the held-out samples about each: one that is less likely than not with them goes, is not added
/// again, and the selection goes on. The second value is what was rejected.
fn select_confirmed(
    data: &IdData,
    settings: &Settings,
    mut begun: Begun,
) -> Option<(Selected, Vec<(Kind, Evidence)>)> {
    let mut rejected: Vec<(Kind, Evidence)> = Vec::new();
    let (found, sound) = (begun.found.clone(), begun.sound);
    loop {
        let mut selected = select(data, settings, &rejected, begun)?;
        let mut posteriors = Vec::new();
        let with = judge(data, &selected.best, data);
        for (at, (told, _)) in selected.added.iter_mut().enumerate() {
            let held_out = without(data, &selected.best, &with, at).1;
            *told = evidence(data, &selected.best.hypothesis, at, [told.log_odds, held_out]);
            let kind = selected.best.hypothesis.effects[at].kind();
            posteriors.push((told.posterior(kind), at, kind));
        }
        let least = posteriors.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, at, kind)) = least.filter(|least| least.0 <= 0.5) else {
            selected.candidates = with_rejected(selected.candidates, &rejected);
            return Some((selected, rejected));
        };
        rejected.push((kind, selected.added.remove(at).0));
        let effects = selected.best.hypothesis.without(at);
        let mut pool: Vec<ValveModel> = selected.best.hypothesis.valve.into_iter().collect();
        pool.extend(found.iter().map(|found| found.valve));
        let found = match effects.effects.is_empty() {
            true => found.clone(),
            false if sound => Vec::new(),
            false => search(data, &effects, &pool, Effort::Near),
        };
        begun = Begun { effects, added: selected.added, found, pool, sound };
    }
}

/// The candidates with those that were rejected. The rejected take their share from the others, which split the rest in the
/// same proportions.
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

/// Logarithm of the odds for friction; minus infinity where no hypothesis with friction was `fitted`, so that nothing was asked.
/// Where the feedback of all those with friction is positive, friction was asked and is not there.
pub fn friction(table: &Table<'_>, fitted: &[Fitted]) -> f64 {
    let sticks = |d: &Fitted| d.hypothesis.valve.is_some();
    if fitted.iter().any(sticks) { table.log_odds(sticks).max(f64::MIN) } else { f64::NEG_INFINITY }
}

/// What speaks for a J of its own among the hypotheses with friction; held-out samples are not asked, because they hardly tell
/// one J from another.
pub fn slip_jump(table: &Table<'_>) -> Evidence {
    let sticks = |d: &Fitted| d.hypothesis.valve.is_some();
    let log_odds = table.log_odds_within(sticks, |d| class(&d.hypothesis) == 2) + log_prior(1);
    Evidence { log_odds, held_out: 0.0, beside_friction: true }
}

/// Forward selection with backward elimination; where what was `rejected` is likeliest, nothing takes its place.
fn select(
    data: &IdData,
    settings: &Settings,
    rejected: &[(Kind, Evidence)],
    begun: Begun,
) -> Option<Selected> {
    let most = settings.most_effects;
    let Begun { mut effects, mut added, mut found, mut pool, sound } = begun;
    let mut steps = 0;
    loop {
        steps += 1;
        let fitted = compare(data, &effects, &found, &mut pool, settings.only, sound);
        let table = table(&fitted, &effects);
        let kinds = table.kinds();
        let (kind, posterior) = *kinds.first()?;
        // Two effects that stand in for each other would take turns without end.
        let full = added.len() >= most || steps > 2 * most;
        let was_rejected = |kind: Option<Kind>| rejected.iter().any(|own| Some(own.0) == kind);
        let addable = kind.is_some() && !was_rejected(kind) && posterior > 0.5 && !full;
        let next = table.best(kind).filter(|_| addable);
        let none = table.best(None)?;
        let Some(next) = next else {
            // What held-out samples have withdrawn says nothing of the valve either.
            let left = table.without(&rejected.iter().map(|own| own.0).collect::<Vec<_>>());
            return Some(Selected {
                best: none.clone(),
                added,
                candidates: kinds.into_iter().filter(|own| !was_rejected(own.0)).collect(),
                friction: friction(&left, &fitted),
                slip_jump: slip_jump(&left),
            });
        };
        // Held-out samples are asked once everything is selected.
        let beside_friction = next.hypothesis.valve.is_some();
        let evidence = Evidence { log_odds: table.log_odds_of(kind), held_out: 0.0, beside_friction };
        added.push((evidence, 2.0 * (next.score - none.score)));
        let mut keep: Vec<usize> = (0..added.len()).collect();
        let best = eliminate(data, next.clone(), &pool, &mut keep);
        added = keep.iter().map(|at| added[*at]).collect();
        effects = best.hypothesis.clone();
        if let Some(valve) = effects.valve {
            pool.retain(|other| *other != valve);
            pool.insert(0, valve);
        }
        if !sound {
            found = search(data, &effects, &pool, Effort::Near);
        }
    }
}

/// What is selected, unless an explanation without friction is likelier once it is searched for on its own.
///
/// Effects are added one by one, so friction may be the best first step and not the best explanation: a stem that stands still
/// and then moves looks like several steps of a load, none of which pays alone. What competes with friction may have twice as
/// many effects, each of them paid for.
fn select_either(
    data: &IdData,
    settings: &Settings,
    found: Vec<Found>,
) -> Option<(Selected, Vec<(Kind, Evidence)>)> {
    let (sticky, of_sticky) = select_confirmed(data, settings, Begun::beside(found))?;
    // A fit that is told the friction does not ask for it.
    if settings.friction.is_some() || sticky.best.hypothesis.valve.is_none() {
        return Some((sticky, of_sticky));
    }
    let more = Settings { most_effects: 2 * settings.most_effects, ..settings.clone() };
    let Some((sound, of_sound)) = select_confirmed(data, &more, Begun::sound()) else {
        return Some((sticky, of_sticky));
    };
    let worth = |fitted: &Fitted| fitted.score + log_prior(fitted.hypothesis.effects.len());
    let friction = sticky.friction.min(worth(&sticky.best) - worth(&sound.best));
    let (likelier, rejected) = if friction > 0.0 { (sticky, of_sticky) } else { (sound, of_sound) };
    Some((Selected { friction, ..likelier }, rejected))
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
        let odds = |fitted: &[Fitted]| friction(&table(fitted, &Hypothesis::default()), fitted);
        assert_eq!(odds(&[none.clone(), of(valve, f64::NEG_INFINITY)]), f64::MIN);
        assert_eq!(odds(std::slice::from_ref(&none)), f64::NEG_INFINITY);
        assert!((odds(&[none, of(valve, 5.0)]) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_left_of_the_candidates_shares_what_rejected_ones_leave() {
        let evidence = Evidence { log_odds: 40.0, held_out: -1.1, beside_friction: false };
        let told = with_rejected(vec![(None, 0.05)], &[(Kind::LoadStep, evidence)]);
        let sum: f64 = told.iter().map(|own| own.1).sum();
        assert!((sum - 1.0).abs() < 1e-12 && told[0] == (None, 1.0 - 7.0 / 84.0), "{told:?}");
    }
}
