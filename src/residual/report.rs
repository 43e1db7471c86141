//! The report: the outcome in the plant's units, with the verdict, the sentences that operators read, and the errors of the model
//! before and after.
//!
//! The sentence of an effect is in its own file ([`super::effect::EffectModel::describe`]), that of the verdict in `verdict.rs`,
//! and that of a fault of the data in [`super::data_quality`].

use super::checks;
use super::data_quality::{Fact, is_measured, of_gate};
use super::detectable::detectable;
use super::effect::EffectModel;
use super::findings::{Curves, Described, Effect, Evidence, Findings, Kind, Lasting, Structure, Traced};
use super::fit::{Fitted, fit_anew};
use super::held_out::{Validation, held_out_gain, validate};
use super::hypothesis::{Hypothesis, direct_lags};
use super::interval::{excluded_below_the_largest, interval};
use super::response::pv_follows_stem;
use super::settings::Settings;
use super::verdict::{Question, friction_before};
use crate::diagnosis::verdict::of_archive;
use crate::diagnosis::{Diagnosis, Model, NotIdentifiable, Verdict};
use crate::sysid::armax::{Armax, ORDER};
use crate::sysid::iddata::{IdData, Units};
use crate::sysid::unrecorded::told_by_op;
use crate::sysid::valve::{Rest, ValveModel};

/// J is told to be another than S where it is estimated to differ by more than this share of S: a valve whose J is S within a tenth
/// may be estimated so far off, because its stem has mass and its actuator a lag. Of slip jumps beyond this distance 361 of 409
/// were there, beyond 0.3 406 of 475 (`calibrate posterior`).
const APART: f64 = 0.4;

/// The outcome of all steps: what a report is made of.
pub struct Outcome {
    /// The record as it was measured.
    pub recorded: IdData,
    /// The record with wrong samples repaired.
    pub data: IdData,
    /// The declared model, fitted to the record as it was measured.
    pub declared: Fitted,
    /// The likeliest hypothesis, fitted to the repaired record.
    pub best: Fitted,
    /// The faults that the signals alone show.
    pub facts: Vec<Fact>,
    /// For each effect of the likeliest hypothesis the evidence for it, and twice the log odds against the hypothesis without it.
    pub added: Vec<(Evidence, f64)>,
    /// The kinds that the held-out samples rejected, with the evidence.
    pub rejected: Vec<(Kind, Evidence)>,
    /// The kinds of next effect at the last step, with their posteriors; `None` for no further effect.
    pub candidates: Vec<(Option<Kind>, f64)>,
    /// Logarithm of the odds for friction, over all hypotheses of the last step (-).
    pub friction_log_odds: f64,
    /// The evidence for a slip jump J that differs from S, where there is friction.
    pub slip_jump: Evidence,
    /// Whether a controller makes OP of PV.
    pub closed_loop: bool,
}

/// The findings, and the two models whose errors they publish, each with the record that it was fitted to.
pub struct Report {
    /// The findings in the plant's units.
    pub findings: Findings,
    /// The record as it was measured, and the declared model.
    pub before: (IdData, Fitted),
    /// The repaired record, and the model with the effects.
    pub after: (IdData, Fitted),
}

/// Reports an outcome. The errors before and after are those on the held-out samples. These samples have also rejected effects
/// and may keep the verdict of the diagnosis: they helped to choose the model whose errors they give.
pub fn report(outcome: Outcome, diagnosis: &Diagnosis, settings: &Settings) -> Report {
    let Outcome {
        recorded,
        mut data,
        declared,
        mut best,
        facts,
        mut added,
        mut rejected,
        mut candidates,
        friction_log_odds,
        slip_jump,
        closed_loop,
    } = outcome;
    if best.hypothesis.valve.is_none() {
        best = without_direct(&mut data, best);
    }
    let (before, mut after) = (validate(&recorded, &declared, &data), validate(&data, &best, &data));
    // Two models are compared on the same PV: where PV was repaired, the declared model is fitted to the repaired PV, too.
    let declared_on_repaired = (!facts.is_empty())
        .then(|| validate(&data, &fit_anew(&data, declared.hypothesis.clone(), None), &data));
    let agrees = held_out_gain(declared_on_repaired.as_ref().unwrap_or(&before), &after) >= 0.0;
    let question = Question { data: &data, best: &best, log_odds: friction_log_odds, diagnosis, settings };
    let mut answer = question.answer(agrees, || pv_follows_stem(&recorded, &declared));
    let valve = if answer.by_tracing { best.hypothesis.valve } else { declared.hypothesis.valve };
    let valve = valve.filter(|_| answer.tells_stiction());
    // The published model has the friction of the verdict, and no other.
    if valve != best.hypothesis.valve {
        data.direct &= valve.is_some();
        // Effects that were selected without friction may only have imitated the valve that sticks.
        if best.hypothesis.valve.is_none() {
            best.hypothesis.effects.clear();
            added.clear();
        }
        best = with_valve(&data, &best.hypothesis, valve, &mut added);
        after = validate(&data, &best, &data);
    }
    // Where OP and PV of a row were read at different times, the least f that would have shown is not known.
    let read_together =
        Question { data: &data, best: &best, log_odds: friction_log_odds, diagnosis, settings }
            .apart()
            .is_none();
    let fast = diagnosis.preparation.unseen_moves();
    let shown_in = |data: &IdData, fitted: &Fitted| {
        let shown = || detectable(data, fitted, settings.evidence_threshold, fast);
        read_together.then(shown).flatten()
    };
    let mut shown = shown_in(&data, &best);
    // The filter before decimation looks ahead: there OP of a row tells of PV to come, whatever the controller does.
    let may_tell = closed_loop && diagnosis.preparation.decimation <= 1;
    let beside = (may_tell && answer.is_open(settings.evidence_threshold))
        .then(|| beside_unrecorded(&data, &best))
        .flatten();
    let (known, none) = beside.as_ref().map_or((&data, &best), |(data, none)| (data, none));
    if beside.is_some() && answer.excludes(&data, shown) {
        answer.hides_beyond_samples(&data, interval(known, &none.hypothesis, fast)[1]);
        // What OP tells only ever raises the bound.
        let anew = shown_in(known, none);
        shown = shown.zip(anew).map(|(before, anew)| before.max(anew)).or(shown).or(anew);
    }
    let f_detectable = answer.bound(&data, shown);
    answer.tell_excluded(&data, || excluded_below_the_largest(known, &none.hypothesis, fast));
    let (stem, dir) = best.hypothesis.stem(&data);
    let failed = checks::failed(&data, (&stem, &dir), &after.e, 2 * ORDER);
    // A record on which tracing and diagnosis differ, or which lies between two kinds of effect, has to be searched again.
    let undisputed = answer.agrees_with(diagnosis)
        && !is_of_no_row(&answer.verdict)
        && settings.compensated == 0.0
        && valve.is_some() == answer.tells_stiction()
        && candidates.first().is_none_or(|(kind, posterior)| kind.is_none() && *posterior > 0.5);
    let structure = structure(&data, &best.hypothesis, &facts).filter(|_| undisputed);
    let structure = structure.map(|found| Structure { asked: answer.asked, failed: failed.clone(), ..found });
    let slip_jump = answer.tells_stiction().then_some(slip_jump);
    let late_s = diagnosis.preparation.acquisition.as_ref().map_or(0.0, |found| found.pv_late_s);
    let of_gate = of_gate(late_s, data.units.ts);
    let facts: Vec<Fact> = of_gate.into_iter().chain(facts).collect();
    let of_samples = facts.len();
    let mut effects = effects(&data, &best, facts, added, slip_jump);
    if is_of_no_row(&answer.verdict) {
        // No model of rows describes such a record. What is wrong with its samples is told all the same.
        effects.truncate(of_samples);
        rejected.clear();
        candidates.clear();
    }
    let archive = of_archive(&diagnosis.preparation, &answer.verdict);
    let findings = Findings {
        traced: traced(&data),
        effects,
        rejected,
        candidates,
        simulates_worse: after.residual.free_run_rmse > 1.0001 * before.residual.free_run_rmse,
        unexplained: !after.residual.white,
        failed,
        friction_before: friction_before(diagnosis),
        friction_after: answer.friction,
        f_detectable,
        f_max: data.f_max * data.units.u,
        verdict: answer.verdict,
        reason: answer.reason + &archive,
        model: model(&data, &best.model),
        curves: curves([&recorded, &data], [&before, &after]),
        before: before.residual,
        after: after.residual,
        stem: None,
        structure,
    };
    Report { findings, before: (recorded, declared), after: (data, best) }
}

/// Whether a record is refused because OP and PV of its rows do not belong together.
fn is_of_no_row(verdict: &Verdict) -> bool {
    use NotIdentifiable::{Compressed, ReadApart};
    matches!(verdict, Verdict::NotIdentifiable(ReadApart { .. } | Compressed { .. }))
}

/// The stretch of the record that was traced: the rows of the window, fitted or held out.
fn traced(data: &IdData) -> Traced {
    Traced { start: data.time(0.0), end: data.time(data.len().saturating_sub(1) as f64), n: data.len() }
}

/// Measured PV, free runs and residuals (PV unit), before and after.
fn curves([recorded, data]: [&IdData; 2], [before, after]: [&Validation; 2]) -> Curves {
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

/// The effects of the report: faults of the data, the effects of the model with their evidence (`added`), and the slip jump where J
/// differs from S.
fn effects(
    data: &IdData,
    best: &Fitted,
    facts: Vec<Fact>,
    added: Vec<(Evidence, f64)>,
    slip_jump: Option<Evidence>,
) -> Vec<Effect> {
    let of_samples = |fact: Fact| Effect {
        posterior: fact.posterior,
        ..reported(fact.kind, None, f64::NAN, None, fact.described)
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
        effects.push(reported(effect.kind(), Some(evidence), delta_aic, tag, described));
    }
    let apart = |valve: &ValveModel| (valve.j / valve.s - 1.0).abs() > APART;
    let told = slip_jump.filter(|evidence| evidence.posterior(Kind::SlipJump) > 0.5);
    if let Some((valve, evidence)) = best.hypothesis.valve.filter(apart).zip(told) {
        let [s, j] = [valve.s, valve.j].map(|band| band * data.units.u);
        let described = describe_slip_jump(s, j, &data.units);
        effects.push(reported(Kind::SlipJump, Some(evidence), 2.0 * evidence.log_odds, None, described));
    }
    effects
}

/// A valve in another unit of OP: S, J and resolution times `by`.
pub fn scaled(valve: ValveModel, by: f64) -> ValveModel {
    ValveModel { s: by * valve.s, j: by * valve.j, resolution: by * valve.resolution, ..valve }
}

/// Whether a fault of the data is one of the tag, so that it lasts, and not one of this window.
pub fn lasts(fact: &Fact) -> bool {
    fact.kind == Kind::QuantisedPv
}

/// What the fit of the next window may take as given; `None` where an effect comes and goes, or where samples are wrong.
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

/// The model without the term of OP beside the stem: without friction OP is the stem.
fn without_direct(data: &mut IdData, best: Fitted) -> Fitted {
    if !data.direct {
        return best;
    }
    data.direct = false;
    fit_anew(data, best.hypothesis, None)
}

/// The record with what OP tells of PV beyond its samples as inputs beside the stem, and the model without friction fitted to it.
/// `None` where OP tells nothing of that.
///
/// Without these inputs no valve predicts PV as well as OP does, whether it sticks or not.
fn beside_unrecorded(data: &IdData, none: &Fitted) -> Option<(IdData, Fitted)> {
    let unrecorded =
        told_by_op(&data.u, &data.y, data.sp.as_deref(), data.gain_sign, |k| is_measured(data, k))?;
    let data = IdData { unrecorded, ..data.clone() };
    let none = fit_anew(&data, none.hypothesis.clone(), None);
    Some((data, none))
}

/// The model with this valve, or without friction, fitted. Effects that are no longer likelier than not are dropped, and without
/// friction those that describe friction.
fn with_valve(
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
    // The posterior of an effect may depend on whether there is friction beside it.
    let stays = |effect: &dyn EffectModel, evidence: &Evidence| {
        (beside_friction || !effect.kind().is_of_friction()) && evidence.posterior(effect.kind()) > 0.5
    };
    (other.effects, *added) = anew.filter(|(effect, (told, _))| stays(effect.as_ref(), told)).unzip();
    fit_anew(data, other, None)
}

/// An entry of the report.
fn reported(
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

/// The slip jump of a valve in a sentence; S and J (OP unit).
fn describe_slip_jump(s: f64, j: f64, units: &Units) -> Described {
    let lag = 0.5 * (s - j);
    let does = if lag < 0.0 { "slips beyond OP by" } else { "lags OP by" };
    let while_moving = if lag < 0.0 { "" } else { " while it moves" };
    let [lag, told_s, told_j] = [lag.abs(), s, j].map(|band| units.along_op(band));
    Described::new(format!("the stem {does} {lag}{while_moving}: S {told_s}, J {told_j}"))
        .with("s", s, "OP")
        .with("j", j, "OP")
}

/// The linear part (ARMAX) in the plant's units.
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
