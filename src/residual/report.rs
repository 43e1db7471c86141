//! What was found, in the plant's units.

use super::Settings;
use super::checks;
use super::data_quality::Fact;
use super::detectable::detectable;
use super::effect::EffectModel;
use super::findings::{Curves, Effect, Evidence, Findings, Kind, Lasting, Parameter, Structure};
use super::fit::{Fitted, fit_anew};
use super::held_out::{Judged, gained, judge};
use super::hypothesis::{Hypothesis, direct_lags};
use super::response::follows;
use super::trace::Outcome;
use super::verdict::{Question, friction_before};
use crate::diagnosis::verdict::of_archive;
use crate::diagnosis::{Diagnosis, Model};
use crate::sysid::armax::{Armax, ORDER};
use crate::sysid::iddata::{IdData, Units};
use crate::sysid::valve::{Rest, ValveModel};

/// J is another than S where it is told to differ by more than this share of S: no model of a valve holds closer than a tenth,
/// and J/S is told within another tenth on 48 of 67 valves whose stems have mass
/// (`tracing_rates --generators C --effects slip_jump --seeds 2 --first-seed 311 --clean 172 --evidence`).
const APART: f64 = 0.2;
/// An effect in numbers and in one sentence.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// Its numbers.
    pub parameters: Vec<Parameter>,
    /// Where it acts, for kinds that have more than one place.
    pub place: Option<&'static str>,
    /// One sentence.
    pub explanation: String,
}

impl Described {
    /// With no numbers yet.
    pub fn new(explanation: String) -> Self {
        Self { parameters: Vec::new(), place: None, explanation }
    }

    /// With one number more.
    pub fn with(mut self, name: &'static str, value: f64, unit: &'static str) -> Self {
        self.parameters.push(Parameter { name, value, unit });
        self
    }

    /// With its place.
    pub fn at(mut self, place: &'static str) -> Self {
        self.place = Some(place);
        self
    }
}

/// Least `|A|` and `|B|` that a load is divided by: where PV integrates, or does not answer at all, its size has no end.
const LEAST: [f64; 2] = [1e-3, 1e-6];

fn settled(left: f64, least: f64) -> f64 {
    1.0 / if left.abs() < least { least.copysign(left) } else { left }
}

/// What a load of 1 in the equation is worth at the valve once it has settled, `1/B(1)` (OP unit).
pub fn in_op(data: &IdData, model: &Armax) -> f64 {
    settled(model.b.iter().sum(), LEAST[1]) * data.units.u
}

/// What it does to PV if nothing controls it, `1/A(1)` (PV unit); of an integrating process in its first thousand samples.
pub fn in_pv(data: &IdData, model: &Armax) -> f64 {
    settled(1.0 + model.a.iter().sum::<f64>(), LEAST[0]) * data.units.y
}

/// What a wave of amplitude 1 in the equation does to PV, and is worth at the valve (PV unit, OP unit).
pub fn of_wave(data: &IdData, model: &Armax, w: f64) -> [f64; 2] {
    let of = |numbers: &mut dyn Iterator<Item = f64>, least: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (lag, number) in numbers.enumerate() {
            let (s, c) = (w * lag as f64).sin_cos();
            (re, im) = (re + number * c, im - number * s);
        }
        settled(re.hypot(im), least)
    };
    let a = of(&mut [1.0].into_iter().chain(model.a), LEAST[0]);
    let b = of(&mut model.b.into_iter(), LEAST[1]);
    [a * data.units.y, b * data.units.u]
}

/// Puts what was found into the plant's units; the held-out samples give the errors before and after.
pub fn report(outcome: Outcome, diagnosis: &Diagnosis, settings: &Settings) -> Findings {
    let Outcome {
        recorded,
        mut data,
        declared,
        mut best,
        facts,
        mut added,
        rejected,
        candidates,
        friction,
        slip_jump,
    } = outcome;
    if best.hypothesis.valve.is_none() {
        best = without_direct(&mut data, best);
    }
    let (before, mut after) = (judge(&recorded, &declared, &data), judge(&data, &best, &data));
    // Two models are compared on one PV: where PV was repaired, the declared one is fitted to it as well.
    let declared_there =
        (!facts.is_empty()).then(|| judge(&data, &fit_anew(&data, declared.hypothesis.clone(), None), &data));
    let agrees = gained(declared_there.as_ref().unwrap_or(&before), &after) >= 0.0;
    let question = Question { data: &data, best: &best, log_odds: friction, diagnosis, settings };
    let mut answer = question.answer(agrees, || follows(&recorded, &declared));
    let valve = if answer.by_tracing { best.hypothesis.valve } else { declared.hypothesis.valve };
    let valve = valve.filter(|_| answer.tells_stiction());
    // The published model has the friction that is believed, and no other.
    if valve != best.hypothesis.valve {
        data.direct &= valve.is_some();
        // Beside a valve that sticks those effects are unasked that stood in for it.
        if best.hypothesis.valve.is_none() {
            best.hypothesis.effects.clear();
            added.clear();
        }
        best = with_friction(&data, &best.hypothesis, valve, &mut added);
        after = judge(&data, &best, &data);
    }
    // What rows that were read apart would have shown nobody knows.
    let together = diagnosis.preparation.apart().is_none();
    let shown = together.then(|| detectable(&data, &best, settings.evidence_threshold)).flatten();
    let f_detectable = answer.bound(&data, shown);
    let (stem, dir) = best.hypothesis.stem(&data);
    let failed = checks::failed(&data, (&stem, &dir), &after.e, 2 * ORDER);
    let undisputed = answer.agrees_with(diagnosis)
        && settings.compensated == 0.0
        && valve.is_some() == answer.tells_stiction()
        && candidates.first().is_none_or(|(kind, posterior)| kind.is_none() && *posterior > 0.5);
    let structure = structure(&data, &best.hypothesis, &facts).filter(|_| undisputed);
    let structure = structure.map(|found| Structure { asked: answer.asked, failed: failed.clone(), ..found });
    let slip_jump = answer.tells_stiction().then_some(slip_jump);
    Findings {
        effects: effects(&data, &best, facts, added, slip_jump),
        rejected,
        candidates,
        simulates_worse: after.residual.free_run_rmse > 1.0001 * before.residual.free_run_rmse,
        unexplained: !after.residual.white,
        failed,
        friction_before: friction_before(diagnosis),
        friction_after: answer.friction,
        f_detectable,
        verdict: answer.verdict,
        reason: answer.reason + &of_archive(&diagnosis.preparation),
        model: model(&data, &best.model),
        curves: curves([&recorded, &data], [&before, &after]),
        before: before.residual,
        after: after.residual,
        stem: None,
        structure,
    }
}

/// Records and what a model predicts of them, before and after.
fn curves([recorded, data]: [&IdData; 2], [before, after]: [&Judged; 2]) -> Curves {
    let unit = |v: &[f64], of: &IdData| v.iter().map(|y| y * of.units.y + of.units.y0).collect();
    let scaled = |v: &[f64]| v.iter().map(|y| y * data.units.y).collect();
    Curves {
        t0: data.units.t0,
        ts: data.units.ts,
        split: data.split,
        pv: unit(&recorded.y, recorded),
        free_before: unit(&before.free, recorded),
        free_after: unit(&after.free, data),
        residual_before: scaled(&before.one_step),
        residual_after: scaled(&after.one_step),
    }
}

/// What is named: facts of the samples, the effects of the model with what `added` them, and the slip jump where it is told.
fn effects(
    data: &IdData,
    best: &Fitted,
    facts: Vec<Fact>,
    added: Vec<(Evidence, f64)>,
    slip_jump: Option<Evidence>,
) -> Vec<Effect> {
    let of_samples = |fact: Fact| Effect {
        posterior: fact.posterior,
        ..named(fact.kind, None, f64::NAN, None, fact.described)
    };
    let mut effects: Vec<Effect> = facts.into_iter().map(of_samples).collect();
    let (_, mut gamma) = best.model.gamma.split_at(direct_lags(data).min(best.model.gamma.len()));
    for (effect, (evidence, delta_aic)) in best.hypothesis.effects.iter().zip(added) {
        let mut own = Vec::new();
        effect.shapes(data, &mut own);
        let (own, rest) = gamma.split_at(own.len().min(gamma.len()));
        gamma = rest;
        let described = effect.describe(data, &best.model, own);
        let tag = effect.tag().map(str::to_string);
        effects.push(named(effect.kind(), Some(evidence), delta_aic, tag, described));
    }
    let apart = |valve: &ValveModel| (valve.j / valve.s - 1.0).abs() > APART;
    let told = slip_jump.filter(|evidence| evidence.posterior(Kind::SlipJump) > 0.5);
    if let Some((valve, evidence)) = best.hypothesis.valve.filter(apart).zip(told) {
        let [s, j] = [valve.s, valve.j].map(|band| band * data.units.u);
        let described = slip(s, j, &data.units);
        effects.push(named(Kind::SlipJump, Some(evidence), 2.0 * evidence.log_odds, None, described));
    }
    effects
}

/// A valve in another unit of OP.
pub fn scaled(valve: ValveModel, by: f64) -> ValveModel {
    ValveModel { s: by * valve.s, j: by * valve.j, resolution: by * valve.resolution, ..valve }
}

/// Whether a fact belongs to the tag and not to this window.
pub fn lasts(fact: &Fact) -> bool {
    fact.kind == Kind::QuantisedPv
}

/// What the next window's fit may take as given: nothing with an effect that comes and goes, or where samples are wrong. Where
/// tracing and diagnosis differ, or the record lies between kinds, there is none either.
fn structure(data: &IdData, hypothesis: &Hypothesis, facts: &[Fact]) -> Option<Structure> {
    let effects: Option<Vec<Lasting>> =
        hypothesis.effects.iter().map(|effect| effect.lasting(data)).collect();
    let effects = effects.filter(|_| facts.iter().all(lasts))?;
    let in_plant = |valve: ValveModel| ValveModel { rest: Rest::default(), ..scaled(valve, data.units.u) };
    Some(Structure {
        valve: hypothesis.valve.map(in_plant),
        direct: data.direct,
        effects,
        searched: data.time(data.len() as f64),
        ..Structure::default()
    })
}

/// The same where OP is the stem and needs no term beside it.
fn without_direct(data: &mut IdData, best: Fitted) -> Fitted {
    if !data.direct {
        return best;
    }
    data.direct = false;
    fit_anew(data, best.hypothesis, None)
}

/// The same effects with this valve or none, fitted; without one those go that say how friction differs.
fn with_friction(
    data: &IdData,
    hypothesis: &Hypothesis,
    valve: Option<ValveModel>,
    added: &mut Vec<(Evidence, f64)>,
) -> Fitted {
    let mut other = hypothesis.with_valve(valve);
    let told = std::mem::take(&mut other.effects).into_iter().zip(added.drain(..));
    let beside_friction = valve.is_some();
    let anew =
        told.map(|(effect, (evidence, gain))| (effect, (Evidence { beside_friction, ..evidence }, gain)));
    // Beside another valve an effect may mean nothing, or be no longer likelier than not.
    let stays = |effect: &dyn EffectModel, evidence: &Evidence| {
        (beside_friction || !effect.kind().is_of_friction()) && evidence.posterior(effect.kind()) > 0.5
    };
    (other.effects, *added) = anew.filter(|(effect, (told, _))| stays(effect.as_ref(), told)).unzip();
    fit_anew(data, other, None)
}

fn named(
    kind: Kind,
    evidence: Option<Evidence>,
    delta_aic: f64,
    tag: Option<String>,
    described: Described,
) -> Effect {
    let Described { parameters, place, explanation } = described;
    let posterior = evidence.map_or(1.0, |evidence| evidence.posterior(kind));
    Effect { kind, posterior, evidence, delta_aic, tag, parameters, place, explanation }
}

/// The slip jump of a valve (OP unit).
fn slip(s: f64, j: f64, units: &Units) -> Described {
    let lag = 0.5 * (s - j);
    let does = if lag < 0.0 { "slips beyond OP by" } else { "lags OP by" };
    let while_moving = if lag < 0.0 { "" } else { " while it moves" };
    let [lag, told_s, told_j] = [lag.abs(), s, j].map(|band| units.along_op(band));
    Described::new(format!("the stem {does} {lag}{while_moving}: S {told_s}, J {told_j}"))
        .with("s", s, "OP")
        .with("j", j, "OP")
}

/// The linear part in the plant's units.
fn model(data: &IdData, model: &Armax) -> Model {
    Model {
        na: ORDER,
        nb: ORDER,
        nc: ORDER,
        nk: model.nk,
        a: model.a.to_vec(),
        b: model.b.iter().map(|b| b * data.units.y / data.units.u).collect(),
        c: model.c.to_vec(),
        rmse: model.scale * data.units.y,
    }
}
