//! What is said of a loop as rows of the store, and back.

use crate::alarm::{Observation, Saved};
use crate::residual::Kind;
use crate::results::{Change, KnownEffect, ModelVersion, Remembered, Restored, Summary, Trigger};
use crate::serve::dto::{BasisText, Report};
use crate::signal::LoopId;
use crate::store::{AlarmRow, DiagnosisRow, ModelRow, Reader, Row, StoreError, TransitionRow, pack, unpack};

/// A change as rows.
pub(super) fn rows(change: Change) -> Vec<Row> {
    let control_loop = change.id.to_string();
    let mut rows = Vec::with_capacity(2 + change.transitions.len());
    if let Some((run, summary)) = &change.run {
        rows.push(Row::Diagnosis(DiagnosisRow {
            control_loop: control_loop.clone(),
            finished: summary.time,
            took_s: summary.took_s,
            on_demand: summary.trigger == Trigger::OnDemand,
            outcome: summary.outcome.to_string(),
            reason_code: summary.reason_code.as_deref().map(str::to_string),
            reason: summary.reason.clone(),
            f: summary.f,
            f_ci95: summary.f_ci95,
            f_in_percent: summary.f_in_percent,
            delta_aic: summary.delta_aic,
            version: env!("CARGO_PKG_VERSION").to_string(),
            report: Report::text(run).as_deref().and_then(pack),
            basis: run.basis.as_deref().and_then(BasisText::text).as_deref().and_then(pack),
        }));
    }
    if let Some(ModelVersion { version, since, effects }) = change.model {
        let effects =
            effects.iter().map(|(kind, tag)| format!("{kind}\t{}\n", tag.as_deref().unwrap_or_default()));
        rows.push(Row::Model(ModelRow {
            control_loop: control_loop.clone(),
            version,
            since,
            effects: effects.collect(),
        }));
    }
    for transition in change.transitions {
        rows.push(Row::Transition(TransitionRow {
            control_loop: control_loop.clone(),
            at: transition.at,
            before: transition.from.as_str().to_string(),
            after: transition.to.as_str().to_string(),
            cause: transition.cause.as_str().to_string(),
            by: change.by.clone().filter(|_| change.acted),
            comment: change.comment.clone().filter(|_| change.acted),
        }));
    }
    let Saved { active, acknowledged, shelved_until, votes, since, raised_at } = change.alarm;
    rows.push(Row::Alarm(AlarmRow {
        control_loop,
        active,
        acknowledged,
        shelved_until,
        votes: votes.into_iter().map(vote).collect(),
        since,
        raised_at,
        by: change.by,
        comment: change.comment,
    }));
    rows
}

/// What was kept of a loop.
pub(super) fn remembered(reader: &Reader, id: &LoopId, room: usize) -> Result<Remembered, StoreError> {
    let rows = reader.last_diagnoses(id.as_str(), room)?;
    let diagnosed = rows.iter().rev().find_map(|row| {
        let text = unpack(row.report.as_ref()?)?;
        let quality = Report::read(&text)?.quality().to_string();
        let restored = Restored { finished: row.finished, took_s: row.took_s, quality, report: text.into() };
        Some((restored, summary(row)))
    });
    let model = reader.model(id.as_str())?.map(|row| ModelVersion {
        version: row.version,
        since: row.since,
        effects: row.effects.lines().filter_map(effect).collect(),
    });
    let alarm = reader.alarm(id.as_str())?.map(|row| {
        let votes = row.votes.chars().filter_map(voted).collect();
        let AlarmRow { active, acknowledged, shelved_until, since, raised_at, by, comment, .. } = row;
        (Saved { active, acknowledged, shelved_until, votes, since, raised_at }, by, comment)
    });
    Ok(Remembered {
        summaries: rows.iter().map(summary).collect(),
        diagnosed,
        model: model.unwrap_or_default(),
        alarm,
    })
}

fn summary(row: &DiagnosisRow) -> Summary {
    Summary {
        time: row.finished,
        took_s: row.took_s,
        trigger: if row.on_demand { Trigger::OnDemand } else { Trigger::Periodic },
        outcome: row.outcome.clone().into(),
        reason_code: row.reason_code.clone().map(Into::into),
        reason: row.reason.clone(),
        f: row.f,
        f_ci95: row.f_ci95,
        f_in_percent: row.f_in_percent,
        delta_aic: row.delta_aic,
    }
}

/// An effect that this version knows.
fn effect(line: &str) -> Option<KnownEffect> {
    let (name, tag) = line.split_once('\t')?;
    let kind = Kind::ALL.into_iter().find(|kind| kind.as_str() == name)?;
    Some((kind, Some(tag.to_string()).filter(|tag| !tag.is_empty())))
}

/// Votes as letters: sticky, clean, between.
const VOTES: [(char, Observation); 3] =
    [('s', Observation::Sticky), ('c', Observation::Clean), ('b', Observation::Between)];

fn vote(vote: Observation) -> char {
    VOTES.iter().find(|(_, known)| *known == vote).map_or('u', |(letter, _)| *letter)
}

fn voted(letter: char) -> Option<Observation> {
    VOTES.iter().find(|(known, _)| *known == letter).map(|(_, vote)| *vote)
}
