//! A diagnosis that is made up: what the newest OP of before says of the valve, and an effect that comes and goes, so that the
//! loops' models have versions.

use crate::network::Value;
use std::sync::Arc;
use stictiond::diagnosis::rivals::Rival;
use stictiond::diagnosis::{Diagnosis, Estimate, Model, NotIdentifiable, Preparation, Residual, Verdict};
use stictiond::residual::{Curves, Effect, Findings, Friction, Kind, Traced};
use stictiond::results::Judged;
use stictiond::schedule::{Clock, Diagnose};
use stictiond::signal::Record;

/// The effect comes and goes each time devices have said so many values.
const EVERY: u32 = 64;

/// The function that judges. A sample of this very moment does not count: it may come before or after the record is copied.
pub fn made_up(clock: Clock) -> Diagnose {
    Arc::new(move |record: &Record, _: &_, _: Option<&_>| {
        let now = clock.now();
        let newest = record.op.iter().rev().find(|sample| sample.t != now);
        let value =
            newest.filter(|sample| sample.quality.is_good()).and_then(|sample| Value::of(sample.value));
        let diagnosis = match value {
            Some(value) if value.sticks => verdict(Verdict::Stiction, 2.5, 446.0),
            Some(_) => verdict(Verdict::NoStiction, 0.0, -2.0),
            None => verdict(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0, 0.0),
        };
        // It fits up to there: what a later run finds in newer samples is another vote.
        let end = newest.map_or(now, |sample| sample.t);
        let preparation = Preparation { end, ..diagnosis.preparation.clone() };
        let diagnosis = Diagnosis { preparation, ..diagnosis };
        let drifts = value.is_some_and(|value| value.number / EVERY % 2 == 1);
        Judged { findings: Some(traced(drifts)), ..Judged::from(diagnosis) }
    })
}

/// What the residual was traced to; it says nothing of friction, so that the verdict stands.
fn traced(drifts: bool) -> Findings {
    let drift = Effect {
        kind: Kind::Drift,
        posterior: 0.9,
        evidence: None,
        delta_aic: 31.0,
        tag: None,
        parameters: Vec::new(),
        place: None,
        explanation: "made up".into(),
    };
    let residual = Residual { white: true, one_step_rmse: 0.01, free_run_rmse: 0.01 };
    Findings {
        traced: Traced::default(),
        effects: drifts.then_some(drift).into_iter().collect(),
        rejected: Vec::new(),
        candidates: Vec::new(),
        before: residual,
        after: residual,
        simulates_worse: false,
        unexplained: false,
        failed: Vec::new(),
        friction_before: Friction::default(),
        friction_after: Friction::default(),
        f_detectable: None,
        f_max: 5.0,
        verdict: Verdict::NotIdentifiable(NotIdentifiable::FlatPv),
        reason: "made up".into(),
        model: linear(),
        curves: Curves::default(),
        stem: None,
        structure: None,
    }
}

fn linear() -> Model {
    Model { na: 1, nb: 1, nc: 1, nk: 1, a: vec![-0.5], b: vec![0.1], c: vec![0.0], rmse: 0.01 }
}

fn verdict(verdict: Verdict, f: f64, delta_aic: f64) -> Diagnosis {
    let estimate = Estimate {
        f,
        f_ci95: [f - 0.06, f + 0.05],
        f_of_op_range: 0.4,
        delta_aic,
        rival: Rival::Linear,
        steadiness: 9.0,
        f_max: 5.0,
        d: 2.0 * f,
        curve: Vec::new(),
        model: linear(),
        mv: Vec::new(),
    };
    let told = !matches!(verdict, Verdict::NotIdentifiable(_));
    Diagnosis {
        reason: format!("made up: {}", verdict.as_str()),
        verdict,
        preparation: Preparation { n: 100, ts: 1.0, ..Preparation::default() },
        oscillation: None,
        estimate: told.then_some(estimate),
        residual: None,
        packed: None,
        window: None,
    }
}
