//! What the selection found, in the plant's units.

use super::candidate::{Candidate, FRICTION_COST};
use super::direct::is_repaired;
use super::evidence::Judge;
use super::fit::{errors, loss_of, minimise};
use super::model::{Data, Element, Spec};
use super::needless::Added;
use super::regress::{Quick, all_errors, restructure};
use super::run::{free_run, held_out};
use super::{Curves, Effect, Findings, Friction, Kind, Parameter, Settings, checks, rival};
use crate::diagnosis::{Diagnosis, Model, Residual, Verdict};
use crate::sysid::stats::median;
use crate::sysid::whiteness::is_white;
use std::cell::OnceCell;

/// Values of f to each side in an interval, and the 95 % point of a threshold's likelihood ratio (Hansen, table 1).
const INTERVAL: i32 = 40;
/// Error one step ahead, as a share of the declared model's, up to which dynamics that run free better take its place.
const AS_GOOD: f64 = 1.01;
/// Values of f to each side when it is refined.
const FINER: i32 = 40;
const THRESHOLD_95: f64 = 7.35;

/// What the selection ends with.
pub struct Outcome {
    /// The declared model with its coefficients as they were, and estimated once more where clocks disagree.
    pub compared: Spec,
    pub declared: Spec,
    /// The model with the effects.
    pub base: Candidate,
    /// The declared model with its dynamics estimated once more.
    pub refit: Spec,
    /// The effects in the order they were added.
    pub added: Vec<Added>,
    /// What a verdict of stiction needs that the declared model did not give.
    pub needed: Option<Needed>,
    /// Candidates fitted.
    pub tried: usize,
}

/// Puts the findings into the plant's units.
pub fn report(data: &Data, diagnosis: &Diagnosis, settings: &Settings, outcome: Outcome) -> Findings {
    let Outcome { compared, declared, base, refit, added, needed, tried } = outcome;
    let needed = needed.as_ref();
    // Without a diagnosis, as on the stem, whatever was found is the model.
    let stands = added.is_empty() && diagnosis.window.is_some();
    // Without effects the same model, friction and dynamics estimated together or dynamics once more, may still predict
    // better than at first; the verdict then stands all the same: nothing was found that the diagnosis did not know.
    let was = held_out(data, &declared);
    let now = held_out(data, &base.spec);
    let again = now.0 <= was.0 && now.1 <= was.1 && now != was;
    let after = if !stands || again {
        base.spec.clone()
    } else {
        let dynamics = held_out(data, &refit);
        if dynamics.0 <= AS_GOOD * was.0 && dynamics.1 <= was.1 { refit } else { declared.clone() }
    };
    let (stage, counts) = after.stage(data);
    let mut e = Vec::new();
    errors(data, &stage, after.orders, &after.linear, &mut e);
    let scored = |spec: &Spec| -> (Residual, Vec<f64>, Vec<f64>) {
        let (stage, e) = all_errors(data, spec);
        let (one, run) = held_out(data, spec);
        let kept: Vec<f64> =
            (data.first..data.len()).filter(|&k| stage.weight[k] > 0.0).map(|k| e[k]).collect();
        let residual = Residual {
            white: is_white(&kept, spec.orders.na + spec.orders.nc),
            one_step_rmse: one * data.scale.y,
            free_run_rmse: run * data.scale.y,
        };
        let free = free_run(data, spec, &stage, &e, data.first);
        (residual, e, free)
    };
    let (before, e_before, free_before) = scored(&compared);
    let (mut now, e_after, mut free_after) = scored(&after);
    // Over other samples than the declared model's a run that is no worse may have the larger error: then the declared run stands.
    if is_repaired(&after) && now.free_run_rmse > before.free_run_rmse {
        (now.free_run_rmse, free_after) = (before.free_run_rmse, free_before.clone());
    }
    let mut effects = Vec::new();
    let mut gamma = after.linear.gamma.as_slice();
    for ((term, count), added) in after.terms.iter().zip(&counts).zip(&added) {
        let (own, rest) = gamma.split_at(*count);
        gamma = rest;
        let (parameters, explanation) = term.describe(data, own, &after.linear);
        effects.push(Effect {
            kind: added.kind,
            delta_aic: added.evidence,
            tag: term.tag().map(str::to_string),
            parameters,
            explanation,
        });
    }
    if let Some(slip) = added.iter().find(|added| added.kind == Kind::SlipJump) {
        effects.push(slip_effect(data, &after.element, slip.kind, slip.evidence));
    }
    let failed = checks::failed(data, &stage, &e, after.orders.na + after.orders.nc);
    let unit = |v: &[f64]| -> Vec<f64> { v.iter().map(|y| y * data.scale.y + data.scale.y0).collect() };
    let scaled = |v: &[f64]| -> Vec<f64> { v.iter().map(|y| y * data.scale.y).collect() };
    let friction_before = diagnosis.estimate.as_ref().map_or_else(Friction::default, |e| Friction {
        f: e.f,
        f_ci95: e.f_ci95,
        lag: 0.0,
        delta_aic: e.delta_aic,
    });
    let (friction_after, verdict, reason) = if stands {
        let jointly = |base| verdict_after(data, settings, base, diagnosis, needed).0;
        let friction = if again { jointly(&base) } else { friction_before };
        (friction, diagnosis.verdict.clone(), diagnosis.reason.clone())
    } else {
        verdict_after(data, settings, &base, diagnosis, needed)
    };
    Findings {
        effects,
        before,
        after: now,
        unexplained: !now.white,
        failed,
        friction_before,
        friction_after,
        verdict,
        reason,
        model: model(data, &after),
        curves: Curves {
            t0: data.scale.t0,
            ts: data.scale.ts,
            split: data.split,
            pv: unit(&data.y),
            free_before: unit(&free_before),
            free_after: unit(&free_after),
            residual_before: scaled(&e_before),
            residual_after: scaled(&e_after),
        },
        stem: None,
        tried,
    }
}

pub fn slip_effect(data: &Data, element: &Element, kind: Kind, delta_aic: f64) -> Effect {
    let f = element.f * data.scale.u;
    let (s, j) = (2.0 * f, 2.0 * f * (1.0 - element.lag));
    let parameters =
        vec![Parameter { name: "s", value: s, unit: "OP" }, Parameter { name: "j", value: j, unit: "OP" }];
    let (does, by) =
        if element.lag < 0.0 { ("slips beyond OP by", "") } else { ("lags OP by", " while it moves") };
    let explanation = format!("the stem {does} {:.3}{by}: S {s:.3}, J {j:.3}", (f * element.lag).abs());
    Effect { kind, delta_aic, tag: None, parameters, explanation }
}

/// What a verdict of stiction needs that the declared model did not give.
#[derive(Clone, Debug)]
pub struct Needed {
    /// Gain in AIC, over the sound loop and over every rival.
    pub aic: f64,
    /// Evidence in the long model.
    pub long: f64,
    /// Period of OP's oscillation (samples).
    period: Option<f64>,
    rivalled: OnceCell<bool>,
}

impl Needed {
    /// What the declared model did not find takes more, and what it found, nothing.
    pub fn after(settings: &Settings, diagnosis: &Diagnosis, ts: f64) -> Option<Self> {
        let times = match diagnosis.verdict {
            Verdict::Stiction => return None,
            Verdict::NoStiction => 2.0,
            Verdict::NotIdentifiable(_) => 4.0,
        };
        let aic = settings.evidence_threshold;
        let period = diagnosis.oscillation.map(|oscillation| oscillation.period / ts);
        Some(Self { aic, long: times * aic, period, rivalled: OnceCell::new() })
    }

    /// Whether a load of any shape or a stop explains the record about as well as the valve of `spec`, the model that is to be
    /// reported: a slip jump and the verdict go by one answer.
    pub fn is_rivalled(&self, data: &Data, spec: &Spec) -> bool {
        *self.rivalled.get_or_init(|| rival::ahead(data, spec, self.period, self.aic) <= self.aic)
    }
}

/// Friction with the effects in place, and what it means.
pub fn verdict_after(
    data: &Data,
    settings: &Settings,
    base: &Candidate,
    diagnosis: &Diagnosis,
    needed: Option<&Needed>,
) -> (Friction, Verdict, String) {
    let mut base = base.clone();
    base.spec.element.f = finer(data, &base.spec);
    let base = &base;
    let element = base.spec.element;
    let [by_armax, by_long] = of_valve(data, base);
    let f = element.f * data.scale.u;
    let stood = needed.is_none();
    // An ARMAX of low order takes a stem that rests for slow dynamics it lacks: where it is the first to see friction, the long
    // model has to see it, too. Where both see none, the verdict goes.
    let evidence = if stood { by_armax.max(by_long) } else { by_armax.min(by_long) };
    // An effect of friction says that there is some: it cannot take away the verdict it describes.
    let of_friction = |kind| matches!(kind, Kind::AsymmetricFriction | Kind::FrictionDrift);
    let described = stood && base.spec.terms.iter().all(|t| of_friction(t.kind()));
    let mut sticky = f > settings.f_threshold && (described || evidence > settings.evidence_threshold);
    sticky &= needed.is_none_or(|needed| by_long > needed.long);
    // Where no friction is found with the effects either, the diagnosis says how much could be hidden.
    let hidden = diagnosis.estimate.as_ref().filter(|_| !stood).map_or(f, |e| e.f_ci95[1].max(f));
    let within = if sticky { interval(data, &base.spec) } else { [0.0, hidden] };
    // An effect that gives a verdict back has to leave no doubt that there is friction.
    sticky &= stood || within[0] > settings.f_threshold;
    let rivalled = sticky && needed.is_some_and(|needed| needed.is_rivalled(data, &base.spec));
    sticky &= !rivalled;
    let verdict = match (&diagnosis.verdict, sticky) {
        (_, true) => Verdict::Stiction,
        (Verdict::NotIdentifiable(why), false) => Verdict::NotIdentifiable(why.clone()),
        _ => Verdict::NoStiction,
    };
    let f = if sticky { f } else { 0.0 };
    let friction = Friction {
        f,
        f_ci95: if sticky { within } else { [0.0, within[1]] },
        lag: if sticky { element.lag * f } else { 0.0 },
        delta_aic: evidence.max(0.0),
    };
    let only_described = described && sticky && evidence <= settings.evidence_threshold;
    let stands = if only_described { ": the verdict stands" } else { "" };
    let reason = if rivalled {
        "with the effects a periodic load or a stop explains the record about as well as friction".to_string()
    } else {
        format!("with the effects f = {f:.3}, evidence {:.0}{stands}", evidence.max(0.0))
    };
    (friction, verdict, reason)
}

/// Evidence of the model's valve against the same model without one: in AIC, and in the long model, less what the valve costs.
fn of_valve(data: &Data, base: &Candidate) -> [f64; 2] {
    let mut sound = base.spec.clone();
    sound.element.f = 0.0;
    sound.loss = f64::INFINITY;
    minimise(data, &mut sound, true, 12);
    restructure(data, &mut sound, true, 4);
    let judge = Judge::new(data, &sound.stage(data).0, sound.orders.nk);
    let by_long = judge.gain(data, &base.spec.stage(data).0, base.spec.orders.nk) - FRICTION_COST;
    [Candidate::new(data, sound, base.paid).aic - base.aic, by_long]
}

/// f between the values of the scan, the middle of the range that gives this very stem.
fn finer(data: &Data, spec: &Spec) -> f64 {
    let centre = spec.element.f;
    if centre <= 0.0 {
        return centre;
    }
    let (mut stage, _) = spec.stage(data);
    let mut trial = spec.clone();
    // The lag and the stem's place at the start keep their size in OP units while f moves.
    let (lag, rest) = (spec.element.lag * centre, spec.element.rest * centre);
    let (least, most) = Element::LAGS;
    let mut rated: Vec<(f64, f64)> = Vec::new();
    for i in -FINER..=FINER {
        let f = centre * (1.0 + 0.1 * f64::from(i) / f64::from(FINER));
        trial.element =
            Element { f, lag: (lag / f).clamp(least, most), rest: (rest / f).min(1.0), ..spec.element };
        trial.restage(data, &mut stage);
        let mut e = Vec::new();
        errors(data, &stage, trial.orders, &trial.linear, &mut e);
        let long = Quick::long_arx(data, &stage, spec.orders.nk).loss;
        rated.push((f, loss_of(data, &stage, &e).ln() + long.ln()));
    }
    let least = rated.iter().map(|r| r.1).fold(f64::INFINITY, f64::min);
    // Values that tie are one cell: its middle stands for it.
    let tied: Vec<f64> = rated.iter().filter(|r| r.1 <= least + 1e-9).map(|r| r.0).collect();
    0.5 * (tied[0] + tied[tied.len() - 1])
}

/// The 95 % interval of f with the terms in place, widened by OP's median step as the diagnosis does (OP unit).
pub fn interval(data: &Data, spec: &Spec) -> [f64; 2] {
    let (mut stage, _) = spec.stage(data);
    let mut trial = spec.clone();
    let f = spec.element.f;
    let mut rated = Vec::new();
    for i in -INTERVAL..=INTERVAL {
        let other = f * (1.0 + 0.8 * f64::from(i) / f64::from(INTERVAL));
        trial.element = Element { f: other, rest: (spec.element.rest * f / other).min(1.0), ..spec.element };
        trial.restage(data, &mut stage);
        rated.push((trial.element.f, Quick::long_arx(data, &stage, spec.orders.nk).loss));
    }
    let n = (data.split - data.first) as f64;
    let least = rated.iter().map(|r| r.1).fold(f64::INFINITY, f64::min);
    let inside = rated.iter().filter(|r| n * (r.1 / least).ln() <= THRESHOLD_95).map(|r| r.0);
    let (low, high) = inside.fold((f, f), |(low, high), f| (low.min(f), high.max(f)));
    let steps: Vec<f64> = stage.u.windows(2).map(|w| (w[1] - w[0]).abs()).collect();
    let step = median(&steps);
    [(low - step).max(0.0) * data.scale.u, (high + step) * data.scale.u]
}

pub fn model(data: &Data, spec: &Spec) -> Model {
    let o = spec.orders;
    Model {
        na: o.na,
        nb: o.nb,
        nc: o.nc,
        nk: o.nk,
        a: spec.linear.a.clone(),
        b: spec.linear.b.iter().map(|b| b * data.scale.y / data.scale.u).collect(),
        c: spec.linear.c.clone(),
        rmse: spec.loss.sqrt() * data.scale.y,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::NotIdentifiable;
    use crate::residual::model::{Linear, Stage, Term};
    use crate::residual::pose::{self, tests::first_order};

    /// An effect that adds nothing.
    #[derive(Clone, Debug)]
    struct Idle(Kind);

    impl Term for Idle {
        fn kind(&self) -> Kind {
            self.0
        }
        fn boxed(&self) -> Box<dyn Term> {
            Box::new(self.clone())
        }
        fn describe(&self, _: &Data, _: &[f64], _: &Linear) -> (Vec<Parameter>, String) {
            (Vec::new(), String::new())
        }
    }

    #[test]
    fn what_the_declared_model_did_not_find_takes_more_evidence() {
        let settings = Settings::default();
        let unknown = Verdict::NotIdentifiable(NotIdentifiable::FlatOp);
        let all = [Verdict::Stiction, Verdict::NoStiction, unknown].map(|verdict| {
            Needed::after(&settings, &Diagnosis::bare(verdict, ""), 1.0).map(|needed| needed.long)
        });
        assert_eq!(all, [None, Some(40.0), Some(80.0)]);
    }

    #[test]
    fn an_effect_of_friction_does_not_take_away_the_verdict_it_describes() {
        let data = first_order(600);
        let mut sticks = pose::declared(&data, 0.2);
        // Evidence that nothing reaches.
        let settings = Settings { evidence_threshold: 1e9, ..Settings::default() };
        let verdict = |spec: &Spec, of: Verdict| {
            verdict_after(
                &data,
                &settings,
                &Candidate::new(&data, spec.clone(), 0.0),
                &Diagnosis::bare(of.clone(), ""),
                Needed::after(&settings, &Diagnosis::bare(of, ""), 1.0).as_ref(),
            )
        };
        sticks.terms.push(Box::new(Idle(Kind::AsymmetricFriction)));
        let (friction, stays, reason) = verdict(&sticks, Verdict::Stiction);
        assert_eq!(stays, Verdict::Stiction);
        assert!(friction.f > 0.1 * data.scale.u && reason.ends_with("stands"), "{} {reason}", friction.f);
        assert_eq!(verdict(&sticks, Verdict::NoStiction).1, Verdict::NoStiction);
        sticks.terms.push(Box::new(Idle(Kind::LoadStep)));
        let (friction, goes, _) = verdict(&sticks, Verdict::Stiction);
        assert_eq!((goes, friction.f), (Verdict::NoStiction, 0.0));
    }

    /// Samples after each new start, where a free run is nearest, are no measurement.
    #[derive(Clone, Debug)]
    struct Hidden(usize, usize);

    impl Term for Hidden {
        fn kind(&self) -> Kind {
            Kind::FrozenPv
        }
        fn boxed(&self) -> Box<dyn Term> {
            Box::new(self.clone())
        }
        fn data(&self, stage: &mut Stage) {
            let Self(split, stretch) = *self;
            let later = stage.weight.iter_mut().skip(split).enumerate();
            later.filter(|(k, _)| k % stretch < 10).for_each(|(_, weight)| *weight = 0.0);
        }
        fn describe(&self, _: &Data, _: &[f64], _: &Linear) -> (Vec<Parameter>, String) {
            (Vec::new(), String::new())
        }
    }

    #[test]
    fn where_the_samples_that_count_are_the_harder_ones_the_free_run_is_not_called_worse() {
        let data = first_order(600);
        let mut compared = pose::declared(&data, 0.0);
        minimise(&data, &mut compared, false, 12);
        let mut hidden = compared.clone();
        hidden.terms.push(Box::new(Hidden(data.split, data.stretch())));
        assert!(held_out(&data, &hidden).1 > held_out(&data, &compared).1);
        let outcome = Outcome {
            compared: compared.clone(),
            declared: compared.clone(),
            base: Candidate::new(&data, hidden, 0.0),
            refit: compared,
            added: vec![Added { kind: Kind::FrozenPv, evidence: 100.0, paid: 0.0 }],
            needed: None,
            tried: 0,
        };
        let found = report(&data, &Diagnosis::bare(Verdict::NoStiction, ""), &Settings::default(), outcome);
        assert_eq!(found.effects.len(), 1);
        assert_eq!(found.after.free_run_rmse, found.before.free_run_rmse);
        assert_eq!(found.curves.free_after, found.curves.free_before);
    }
}
