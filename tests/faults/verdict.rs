//! A diagnosis that is made up: what the newest OP of before says of the valve.

use crate::network::Value;
use std::sync::Arc;
use stictiond::diagnosis::rivals::Rival;
use stictiond::diagnosis::{Diagnosis, Estimate, Model, NotIdentifiable, Preparation, Verdict};
use stictiond::schedule::{Clock, Diagnose};
use stictiond::signal::Record;

/// The function that judges. A sample of this very moment does not count: it may come before or after the record is copied.
pub fn made_up(clock: Clock) -> Diagnose {
    Arc::new(move |record: &Record, _: &_, _: Option<&_>| {
        let now = clock.now();
        let newest = record.op.iter().rev().find(|sample| sample.t != now);
        let value =
            newest.filter(|sample| sample.quality.is_good()).and_then(|sample| Value::of(sample.value));
        match value {
            Some(value) if value.sticks => verdict(Verdict::Stiction, 2.5, 446.0),
            Some(_) => verdict(Verdict::NoStiction, 0.0, -2.0),
            None => verdict(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), 0.0, 0.0),
        }
        .into()
    })
}

fn verdict(verdict: Verdict, f: f64, delta_aic: f64) -> Diagnosis {
    let model = Model { na: 1, nb: 1, nc: 1, nk: 1, a: vec![-0.5], b: vec![0.1], c: vec![0.0], rmse: 0.01 };
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
        model,
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
