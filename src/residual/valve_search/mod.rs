//! The search for the valve beside given effects: a grid, then a beam search over cells of thresholds, by turns with the
//! dynamics (alternating maximisation).

mod beam;
mod cells;

use super::effect::EffectModel;
use super::hypotheses::{Proposal, best};
use super::hypothesis::Hypothesis;
use super::screening::Screen;
use crate::sysid::arx::{Arx, ArxFit};
use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::iddata::IdData;
use crate::sysid::valve::batch::{Batch, LANES};
use crate::sysid::valve::{StopRule, ValveModel};
use beam::Held;
use cells::Family;

/// Values of S in the grid: finer towards 0, since weak friction is a small share of the largest reversal.
const VALUES: usize = 20;
/// Power by which they crowd there.
const CROWDED: f64 = 1.6;
/// Ratios J/S in the grid.
const RATIOS: [f64; 3] = [1.0, 0.5, 0.1];
/// Fewest reversals of a stem that says anything about S.
pub const LEAST_REVERSALS: f64 = 4.0;
/// Valves of the grid from which the beam starts.
const STARTS: usize = 3;
/// Least S, as a share of the largest.
const LEAST_S: f64 = 0.01;
/// Factor to each side of S in a narrow search.
const NARROW: f64 = 1.6;
/// Valves returned.
const RETURNED: usize = 4;
/// Ratios J/S that are tried where J is no threshold.
const LAGS: [f64; 6] = [0.0, 0.2, 0.4, 0.6, 0.8, 1.3];

/// A valve with its fit.
#[derive(Clone, Debug)]
pub struct Found {
    /// The valve, without what the effects change about it.
    pub valve: ValveModel,
    /// The high-order ARX with its stem.
    pub fit: ArxFit,
    /// Log-likelihood less what the valve's parameters cost.
    pub score: f64,
}

/// Sum of the rates of a valve's parameters, and the alternatives it was chosen from.
pub fn cost(valve: Option<&ValveModel>) -> (f64, f64) {
    let Some(valve) = valve else { return (0.0, 1.0) };
    let of_j = match valve.rule {
        _ if valve.j == valve.s => 0.0,
        StopRule::Reversal => REGULAR,
        _ => THRESHOLD,
    };
    (THRESHOLD + of_j, StopRule::ALL.len() as f64)
}

/// A fit of a valve beside `effects`, and what it is worth.
fn rated(data: &IdData, arx: &Arx<'_>, effects: &Hypothesis, valve: ValveModel, near: Option<&ArxFit>) -> Found {
    let hypothesis = effects.with_valve(Some(valve));
    let x = hypothesis.to_process(data, hypothesis.stem(data).0);
    let fit = arx.fit(&x, near);
    let score = fit.log_likelihood - cost(Some(&valve)).0 * data.counted().ln();
    Found { valve, fit, score }
}

/// The grid over families and S: the best valves of different families.
fn grid(data: &IdData, arx: &Arx<'_>, effects: &Hypothesis) -> Vec<ValveModel> {
    let mut best: Vec<(f64, ValveModel)> = Vec::new();
    let s = |i: usize| 2.0 * data.f_max * (i as f64 / VALUES as f64).powf(CROWDED);
    let mut full = ValveModel::default();
    effects.effects.iter().for_each(|effect| effect.on_valve(&mut full));
    let mut stems = Vec::new();
    for rule in StopRule::ALL {
        for ratio in RATIOS {
            let valve = |i: usize| ValveModel { s: s(i), j: ratio * s(i), rule, ..full };
            let mut found: Option<(f64, ValveModel)> = None;
            for few in (1..=VALUES).collect::<Vec<_>>().chunks(LANES) {
                let lanes: [ValveModel; LANES] =
                    std::array::from_fn(|l| valve(few.get(l).copied().unwrap_or(few[few.len() - 1])));
                let mut batch = Batch::new(&lanes, data.start, data.split);
                batch.run(&data.u, &mut stems);
                let turns = batch.turns();
                for l in (0..few.len()).filter(|l| turns[*l] >= LEAST_REVERSALS) {
                    let x: Vec<f64> = stems.iter().map(|x| x[l]).collect();
                    let deviance = arx.deviance(&effects.to_process(data, x));
                    if found.is_none_or(|found| deviance < found.0) {
                        let plain = ValveModel { asymmetry: 0.0, drift: 0.0, ..lanes[l] };
                        found = Some((deviance, plain));
                    }
                }
            }
            best.extend(found);
        }
    }
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Dead bands of all rules are one valve.
    best.dedup_by(|b, a| a.1.s == b.1.s && (a.1.j - b.1.j).abs() < 1e-9 && a.1.j < 0.2 * a.1.s);
    best.into_iter().map(|found| found.1).collect()
}

/// The families of a beam search about a valve.
fn families(about: &ValveModel) -> Vec<Family> {
    let free = [StopRule::Stop, StopRule::Slip].map(|rule| Family { rule, ratio: None });
    let tied = StopRule::ALL.map(|rule| Family { rule, ratio: Some(1.0) });
    let ratio = about.j / about.s;
    let lagging = if ratio == 1.0 { 0.5 } else { ratio };
    let lagging = Family { rule: StopRule::Reversal, ratio: Some(lagging) };
    free.into_iter().chain(tied).chain([lagging]).collect()
}

/// S from the least that is told from none to the largest at which a stem turns.
fn whole(data: &IdData) -> (f64, f64) {
    (2.0 * LEAST_S * data.f_max, 2.0 * data.f_max)
}

/// S about a valve's.
fn about(data: &IdData, valve: &ValveModel) -> (f64, f64) {
    let (least, most) = whole(data);
    ((valve.s / NARROW).max(least).min(0.5 * most), (valve.s * NARROW).min(most))
}

/// How far a search goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// A grid over all valves, then beams from its best.
    Whole,
    /// Beams from the valves given.
    Near,
}

/// The valves that explain PV best beside the effects of `effects`, the best first and of different kinds.
pub fn search(data: &IdData, effects: &Hypothesis, starts: &[ValveModel], effort: Effort) -> Vec<Found> {
    let shapes = effects.shapes(data);
    let arx = Arx::new(data, &data.y, &shapes);
    let mut found: Vec<Found> =
        starts.iter().map(|valve| rated(data, &arx, effects, *valve, None)).collect();
    if effort == Effort::Whole {
        let few: Vec<ValveModel> = grid(data, &arx, effects).into_iter().take(STARTS).collect();
        found.extend(few.into_iter().map(|valve| rated(data, &arx, effects, valve, None)));
    }
    sort(&mut found);
    let rounds = if effort == Effort::Whole { [2, 1] } else { [1, 1] };
    for (round, starts) in rounds.into_iter().enumerate() {
        let from: Vec<Found> = found.iter().take(starts).cloned().collect();
        for start in &from {
            improve(data, &arx, effects, start, round == 0 && effort == Effort::Whole, &mut found);
        }
        sort(&mut found);
        if from.first().map(|f| f.valve) == found.first().map(|f| f.valve) {
            break;
        }
    }
    let Some(leader) = found.first().cloned() else { return found };
    lags(data, &arx, effects, &leader, &mut found);
    sort(&mut found);
    found.truncate(RETURNED);
    found
}

/// Beams of every family with the dynamics of `start`.
fn improve(
    data: &IdData,
    arx: &Arx<'_>,
    effects: &Hypothesis,
    start: &Found,
    wide: bool,
    found: &mut Vec<Found>,
) {
    let hypothesis = effects.with_valve(Some(start.valve));
    let x = hypothesis.to_process(data, hypothesis.stem(data).0);
    let held = Held::new(data, effects, &start.fit, &x);
    let mut full = ValveModel::default();
    effects.effects.iter().for_each(|effect| effect.on_valve(&mut full));
    let range = if wide { whole(data) } else { about(data, &start.valve) };
    for family in families(&start.valve) {
        for (_, valve) in held.best(family, range, (full.asymmetry, full.drift), 1) {
            let plain = ValveModel { asymmetry: 0.0, drift: 0.0, ..valve };
            found.push(rated(data, arx, effects, plain, Some(&start.fit)));
        }
    }
}

/// The leader as a valve that rests at reversals only, with other lags.
fn lags(data: &IdData, arx: &Arx<'_>, effects: &Hypothesis, leader: &Found, found: &mut Vec<Found>) {
    for ratio in LAGS {
        let valve = ValveModel { j: ratio * leader.valve.s, rule: StopRule::Reversal, ..leader.valve };
        found.push(rated(data, arx, effects, valve, Some(&leader.fit)));
    }
}

/// The best first, one of each kind: rule and whether J is S.
fn sort(found: &mut Vec<Found>) {
    found.retain(|found| found.score.is_finite() && found.valve.is_valid());
    found.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut seen: Vec<(StopRule, bool)> = Vec::new();
    found.retain(|found| {
        let kind = (found.valve.rule, found.valve.j == found.valve.s);
        let new = !seen.contains(&kind);
        seen.push(kind);
        new
    });
}

/// Proposals of an effect that changes the bands: the best valve of the present rule at each value of it.
pub fn banded(
    screen: &Screen<'_>,
    values: &[f64],
    set: impl Fn(&mut ValveModel, f64),
    effect: impl Fn(f64) -> Box<dyn EffectModel>,
) -> Vec<Proposal> {
    let (data, base) = (screen.data, screen.hypothesis());
    let Some(own) = base.valve else { return Vec::new() };
    let arx = Arx::new(data, &data.y, &screen.signals.shapes);
    let fit = arx.fit(&screen.signals.x, None);
    let held = Held::new(data, base, &fit, &screen.signals.x);
    let mut family = Family { rule: own.rule, ratio: Some(own.j / own.s) };
    if own.j != own.s && own.rule != StopRule::Reversal {
        family.ratio = None;
    }
    let full = base.full_valve().unwrap_or(own);
    let mut rated: Vec<(f64, f64, ValveModel)> = Vec::new();
    for &value in values {
        let mut bands = full;
        set(&mut bands, value);
        if bands.asymmetry.abs() < 0.95 && bands.drift.abs() < 0.95 {
            let found = held.best(family, about(data, &own), (bands.asymmetry, bands.drift), 1);
            rated.extend(found.into_iter().map(|(loss, valve)| (loss, value, valve)));
        }
    }
    rated.sort_by(|a, b| a.0.total_cmp(&b.0));
    rated.truncate(2);
    let proposals = rated.into_iter().map(|(_, value, valve)| {
        let plain = ValveModel { asymmetry: own.asymmetry, drift: own.drift, ..valve };
        let effect = effect(value);
        let other = base.with_valve(Some(plain)).with(effect.boxed());
        let x = other.to_process(data, other.stem(data).0);
        let gain = arx.fit(&x, Some(&fit)).log_likelihood - fit.log_likelihood;
        Proposal { effect, valve: Some(plain), gain }
    });
    best(proposals.collect(), 2)
}
