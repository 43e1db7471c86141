//! What was found, in the plant's units.

use super::data_quality::Fact;
use super::decide::{Decided, decide, has_positive_feedback};
use super::detectable::detectable;
use super::effect::EffectModel;
use super::findings::{Curves, Effect, Evidence, Findings, Friction, Kind, Lasting, Parameter, Structure};
use super::held_out::{gained, judge};
use super::hypothesis::{Hypothesis, direct_lags};
use super::interval::interval;
use super::posterior::probability;
use super::response::follows;
use super::trace::Outcome;
use super::{Settings, checks};
use crate::diagnosis::{Diagnosis, Model, NotIdentifiable, Verdict};
use crate::signal::told;
use crate::sysid::armax::{Armax, ORDER};
use crate::sysid::iddata::{IdData, Units};
use crate::sysid::valve::{Rest, ValveModel};

/// J is another than S where it is told to differ by more than this share of S: no model of a valve holds closer than a tenth,
/// and J/S is told within another tenth on 48 of 67 valves whose stems have mass
/// (`tracing_rates --generators C --effects slip_jump --seeds 2 --first-seed 311 --clean 172 --evidence`).
const APART: f64 = 0.2;
/// Share of the largest f from which a bound excludes nothing.
const EXCLUDES_NOTHING: f64 = 0.98;

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

/// Puts what was found into the plant's units; the held-out samples are read here, once.
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
    let agrees = gained(&before, &after) >= 0.0;
    let traced = friction_found(&data, &best, friction, diagnosis, settings);
    // Without a valve that reverses often enough in this window nothing was asked of friction.
    let asked = friction > f64::NEG_INFINITY;
    let decides = asked && (agrees || traced.1 == diagnosis.verdict);
    let (mut friction_after, mut verdict, mut reason) =
        if decides { traced } else { standing(diagnosis, asked) };
    if !decides && verdict == Verdict::Stiction && !follows(&recorded, &declared) {
        let why = NotIdentifiable::StemNotFollowed;
        (verdict, reason) = (Verdict::NotIdentifiable(why.clone()), why.to_string());
    }
    let valve = if decides { best.hypothesis.valve } else { declared.hypothesis.valve };
    let valve = valve.filter(|_| verdict == Verdict::Stiction);
    // The published model has the friction that is believed, and no other.
    if valve != best.hypothesis.valve {
        data.direct &= valve.is_some();
        best = with_friction(&data, &best.hypothesis, valve, &mut added);
        after = judge(&data, &best, &data);
    }
    let mut f_detectable = detectable(&data, &best, settings.evidence_threshold).map(|f| f * data.units.u);
    if verdict == Verdict::NoStiction {
        let most = data.f_max * data.units.u;
        // What the record would not have shown it does not exclude.
        let bound = friction_after.f_ci95[1].max(f_detectable.unwrap_or(0.0));
        friction_after.f_ci95[1] = bound;
        // Nor would it have shown what its likelihood leaves possible.
        f_detectable = f_detectable.map(|_| bound);
        if f_detectable.is_none() && bound >= EXCLUDES_NOTHING * most {
            let why = NotIdentifiable::HiddenFriction { reversal: data.units.along_op(2.0 * most) };
            (verdict, reason) = (Verdict::NotIdentifiable(why.clone()), why.to_string());
        } else if decides {
            reason += &format!("; f up to {} could be hidden", data.units.along_op(bound));
        }
    }
    let (stem, dir) = best.hypothesis.stem(&data);
    let failed = checks::failed(&data, (&stem, &dir), &after.e, 2 * ORDER);
    let sticks = |verdict: &Verdict| *verdict == Verdict::Stiction;
    let undisputed = (decides || !asked)
        && valve.is_some() == sticks(&verdict)
        && sticks(&diagnosis.verdict) == sticks(&verdict)
        && candidates.first().is_none_or(|(kind, posterior)| kind.is_none() && *posterior > 0.5)
        && diagnosis.preparation.compensated == 0.0;
    let structure = structure(&data, &best.hypothesis, &facts).filter(|_| undisputed);
    let structure = structure.map(|found| Structure { asked, failed: failed.clone(), ..found });
    let mut effects: Vec<Effect> = facts
        .into_iter()
        .map(|fact| Effect {
            posterior: fact.posterior,
            ..named(fact.kind, None, f64::NAN, None, fact.described)
        })
        .collect();
    let (_, mut gamma) = best.model.gamma.split_at(direct_lags(&data).min(best.model.gamma.len()));
    for (effect, (evidence, delta_aic)) in best.hypothesis.effects.iter().zip(added) {
        let mut own = Vec::new();
        effect.shapes(&data, &mut own);
        let (own, rest) = gamma.split_at(own.len().min(gamma.len()));
        gamma = rest;
        let described = effect.describe(&data, &best.model, own);
        let tag = effect.tag().map(str::to_string);
        effects.push(named(effect.kind(), Some(evidence), delta_aic, tag, described));
    }
    let apart = |valve: &ValveModel| (valve.j / valve.s - 1.0).abs() > APART;
    let slips = verdict == Verdict::Stiction && slip_jump.posterior(Kind::SlipJump) > 0.5;
    if let Some(valve) = best.hypothesis.valve.filter(|valve| slips && apart(valve)) {
        let [s, j] = [valve.s, valve.j].map(|band| band * data.units.u);
        let described = slip(s, j, &data.units);
        effects.push(named(Kind::SlipJump, Some(slip_jump), 2.0 * slip_jump.log_odds, None, described));
    }
    let unit = |v: &[f64], data: &IdData| v.iter().map(|y| y * data.units.y + data.units.y0).collect();
    let scaled = |v: &[f64]| v.iter().map(|y| y * data.units.y).collect();
    Findings {
        effects,
        rejected,
        candidates,
        simulates_worse: after.residual.free_run_rmse > 1.0001 * before.residual.free_run_rmse,
        unexplained: !after.residual.white,
        failed,
        friction_before: friction_before(diagnosis),
        friction_after,
        f_detectable,
        verdict,
        reason,
        model: model(&data, &best.model),
        curves: Curves {
            t0: data.units.t0,
            ts: data.units.ts,
            split: data.split,
            pv: unit(&recorded.y, &recorded),
            free_before: unit(&before.free, &recorded),
            free_after: unit(&after.free, &data),
            residual_before: scaled(&before.e),
            residual_after: scaled(&after.e),
        },
        before: before.residual,
        after: after.residual,
        stem: None,
        structure,
    }
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
fn without_direct(data: &mut IdData, best: Decided) -> Decided {
    if !data.direct {
        return best;
    }
    data.direct = false;
    decide(data, best.hypothesis, None)
}

/// The same effects with this valve, fitted; without one those go that say how friction differs.
fn with_friction(
    data: &IdData,
    hypothesis: &Hypothesis,
    valve: Option<ValveModel>,
    added: &mut Vec<(Evidence, f64)>,
) -> Decided {
    let mut other = hypothesis.with_valve(valve);
    let told = std::mem::take(&mut other.effects).into_iter().zip(added.drain(..));
    let means_something = |effect: &dyn EffectModel| valve.is_some() || !effect.kind().is_of_friction();
    (other.effects, *added) = told.filter(|(effect, _)| means_something(effect.as_ref())).unzip();
    decide(data, other, None)
}

/// What the diagnosis says where tracing does not decide; `asked`: whether it asked at all.
fn standing(diagnosis: &Diagnosis, asked: bool) -> (Friction, Verdict, String) {
    let mut reason = diagnosis.reason.clone();
    if asked {
        reason += "; with effects beside friction the verdict would be another, but that model predicts the last fifth of the \
                   samples worse";
    }
    (friction_before(diagnosis), diagnosis.verdict.clone(), reason)
}

/// Friction as the diagnosis has it.
fn friction_before(diagnosis: &Diagnosis) -> Friction {
    diagnosis.estimate.as_ref().map_or_else(Friction::default, |e| Friction {
        f: e.f,
        f_ci95: e.f_ci95,
        lag: 0.0,
        delta_aic: e.delta_aic,
        posterior: f64::NAN,
    })
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

/// Friction beside the effects, and what it means: stiction where f is above its threshold with enough evidence.
fn friction_found(
    data: &IdData,
    best: &Decided,
    log_odds: f64,
    diagnosis: &Diagnosis,
    settings: &Settings,
) -> (Friction, Verdict, String) {
    let unit = data.units.u;
    let evidence = 2.0 * log_odds;
    let f = best.hypothesis.valve.map_or(0.0, |valve| valve.f() * unit);
    let unseen = diagnosis.preparation.acquisition.as_ref().is_some_and(|found| found.unseen_scans());
    let within = interval(data, &best.hypothesis, unseen).map(|f| f * unit);
    let sticks = f > settings.f_threshold && evidence > settings.evidence_threshold && within[0] > 0.0;
    let followed = !sticks || follows(data, best);
    let sticks = sticks && followed;
    let verdict = match &diagnosis.verdict {
        _ if !followed => Verdict::NotIdentifiable(NotIdentifiable::StemNotFollowed),
        _ if sticks => Verdict::Stiction,
        Verdict::NotIdentifiable(why) => Verdict::NotIdentifiable(why.clone()),
        _ if has_positive_feedback(data, &best.model) => {
            Verdict::NotIdentifiable(NotIdentifiable::NoResponse)
        }
        _ => Verdict::NoStiction,
    };
    let friction = Friction {
        f: if sticks { f } else { 0.0 },
        f_ci95: if sticks { within } else { [0.0, within[1]] },
        lag: best.hypothesis.valve.filter(|_| sticks).map_or(0.0, |valve| valve.lag() * unit),
        delta_aic: evidence.max(0.0),
        posterior: probability(log_odds),
    };
    let reason = match &verdict {
        Verdict::Stiction => {
            let (per, unit) = settings.op_span.map_or((1.0, ""), |span| (100.0 / span, " % OP"));
            let [low, high] = within.map(|f| told(per * f));
            format!("f = {}{unit} [{low}, {high}], evidence {evidence:.0}", told(per * f))
        }
        Verdict::NoStiction if evidence > settings.evidence_threshold => {
            let per = settings.op_span.map_or(1.0, |span| 100.0 / span);
            let unit = if settings.op_span.is_some() { " % OP" } else { "" };
            let why = match within[0] > 0.0 {
                true => format!("its f of {}{unit} is too small to matter", told(per * f)),
                false => format!("f may be 0 as well as {}{unit}", told(per * within[1])),
            };
            format!("friction predicts PV better, evidence {evidence:.0}, but {why}")
        }
        Verdict::NoStiction => format!("no friction needed, evidence {:.0}", friction.delta_aic),
        Verdict::NotIdentifiable(why) => why.to_string(),
    };
    (friction, verdict, reason)
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
