//! Rows of a store as messages, and back: nothing is lost on the way.

use super::message::{AlarmChange, AlarmState, Effect, Model, Run, TagSamples};
use crate::signal::Sample;
use crate::store::{AlarmRow, DiagnosisRow, ModelRow, TransitionRow, codec};

/// Samples of a tag.
pub fn block(tag: &str, source: &str, samples: &[Sample]) -> TagSamples {
    let (tag, source, block) = (tag.to_string(), source.to_string(), codec::encode(samples));
    TagSamples { tag, source, block: block.into(), set_back: false, after: None }
}

/// A run, with what a store does not keep of it: effects and the unexplained share.
pub fn run(row: DiagnosisRow, effects: Vec<Effect>, unexplained: Option<f64>) -> Run {
    Run {
        control_loop: row.control_loop,
        finished: row.finished,
        took_s: row.took_s,
        on_demand: row.on_demand,
        outcome: row.outcome,
        reason_code: row.reason_code,
        reason: row.reason,
        f: row.f,
        f_low: row.f_ci95.map(|[low, _]| low),
        f_high: row.f_ci95.map(|[_, high]| high),
        f_in_percent: row.f_in_percent,
        delta_aic: row.delta_aic,
        version: row.version,
        report: row.report,
        basis: row.basis,
        effects,
        unexplained,
    }
}

/// The row of a run.
pub fn diagnosis_row(run: &Run) -> DiagnosisRow {
    DiagnosisRow {
        control_loop: run.control_loop.clone(),
        finished: run.finished,
        took_s: run.took_s,
        on_demand: run.on_demand,
        outcome: run.outcome.clone(),
        reason_code: run.reason_code.clone(),
        reason: run.reason.clone(),
        f: run.f,
        f_ci95: run.f_low.zip(run.f_high).map(|(low, high)| [low, high]),
        f_in_percent: run.f_in_percent,
        delta_aic: run.delta_aic,
        version: run.version.clone(),
        report: run.report.clone(),
        basis: run.basis.clone(),
    }
}

/// A model.
pub fn model(row: ModelRow) -> Model {
    Model { version: row.version, since: row.since, effects: row.effects }
}

/// The row of a model.
pub fn model_row(control_loop: &str, model: &Model) -> ModelRow {
    ModelRow {
        control_loop: control_loop.to_string(),
        version: model.version,
        since: model.since,
        effects: model.effects.clone(),
    }
}

/// How an alarm stands.
pub fn alarm(row: AlarmRow) -> AlarmState {
    AlarmState {
        subject: row.control_loop,
        kind: row.kind,
        active: row.active,
        acknowledged: row.acknowledged,
        latched: row.latched,
        shelved_until: row.shelved_until,
        one_shot: row.one_shot,
        suppressed: row.suppressed,
        out_of_service: row.out_of_service,
        votes: row.votes,
        pending: row.pending,
        raises: row.raises,
        priority: row.priority,
        trend: row.trend,
        since: row.since,
        raised_at: row.raised_at,
        detail: row.detail,
        by: row.by,
        comment: row.comment,
    }
}

/// The row of an alarm.
pub fn alarm_row(state: AlarmState) -> AlarmRow {
    AlarmRow {
        control_loop: state.subject,
        kind: state.kind,
        active: state.active,
        acknowledged: state.acknowledged,
        latched: state.latched,
        shelved_until: state.shelved_until,
        one_shot: state.one_shot,
        suppressed: state.suppressed,
        out_of_service: state.out_of_service,
        votes: state.votes,
        pending: state.pending,
        raises: state.raises,
        priority: state.priority,
        trend: state.trend,
        since: state.since,
        raised_at: state.raised_at,
        detail: state.detail,
        by: state.by,
        comment: state.comment,
    }
}

/// What happened to an alarm.
pub fn change(row: TransitionRow) -> AlarmChange {
    AlarmChange {
        at: row.at,
        before: row.before,
        after: row.after,
        cause: row.cause,
        priority: row.priority,
        detail: row.detail,
        by: row.by,
        comment: row.comment,
    }
}

/// The row of a change.
pub fn change_row(subject: &str, kind: &str, change: &AlarmChange) -> TransitionRow {
    TransitionRow {
        control_loop: subject.to_string(),
        kind: kind.to_string(),
        at: change.at,
        before: change.before.clone(),
        after: change.after.clone(),
        cause: change.cause.clone(),
        priority: change.priority.clone(),
        detail: change.detail.clone(),
        by: change.by.clone(),
        comment: change.comment.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost::Message;

    #[test]
    fn rows_come_back_from_the_wire_as_they_were() {
        let row = DiagnosisRow {
            control_loop: "FIC101".into(),
            finished: 1_700_000_000.25,
            took_s: 0.5,
            on_demand: true,
            outcome: "stiction".into(),
            reason_code: Some("flat_pv".into()),
            reason: "f = 2.5".into(),
            f: Some(2.5),
            f_ci95: Some([2.4, 2.6]),
            f_in_percent: true,
            delta_aic: Some(440.0),
            version: "0.1.0".into(),
            report: Some(vec![1, 2]),
            basis: Some(vec![3]),
        };
        let bytes = run(row.clone(), Vec::new(), Some(0.2)).encode_to_vec();
        assert_eq!(diagnosis_row(&Run::decode(&bytes[..]).expect("ours")), row);

        let row = AlarmRow {
            control_loop: "FIC101".into(),
            kind: "stiction".into(),
            active: true,
            shelved_until: Some(7.0),
            votes: "sc".into(),
            raises: "1 2".into(),
            since: Some(1.0),
            raised_at: Some(2.0),
            detail: "sticks".into(),
            by: Some("eve".into()),
            ..AlarmRow::default()
        };
        let bytes = alarm(row.clone()).encode_to_vec();
        assert_eq!(alarm_row(AlarmState::decode(&bytes[..]).expect("ours")), row);

        let row = TransitionRow {
            control_loop: "FIC101".into(),
            kind: "stiction".into(),
            at: 3.0,
            before: "normal".into(),
            after: "unacknowledged".into(),
            cause: "raised".into(),
            priority: Some("high".into()),
            detail: "sticks".into(),
            by: None,
            comment: None,
        };
        let bytes = change(row.clone()).encode_to_vec();
        let back = AlarmChange::decode(&bytes[..]).expect("ours");
        assert_eq!(change_row("FIC101", "stiction", &back), row);

        let row =
            ModelRow { control_loop: "FIC101".into(), version: 3, since: 4.0, effects: "drift\t\n".into() };
        assert_eq!(model_row("FIC101", &model(row.clone())), row);
    }
}
