//! What is said of a loop as rows of the store, and back.

use crate::alarm::{AlarmId, Cause, Flags, Kind, Observation, Point, Priority, Saved, State, Transition};
use crate::residual;
use crate::results::{
    AlarmChange, Change, Compensated, KeptAlarm, KnownEffect, MOST_CHANGES, ModelVersion, Outcome,
    Remembered, Restored, RestoredAlarm, Run, Summary, Trigger,
};
use crate::serve::dto::{BasisText, Report};
use crate::signal::LoopId;
use crate::store::{AlarmRow, DiagnosisRow, ModelRow, Reader, Row, StoreError, TransitionRow, pack, unpack};
use crate::version::BUILD;

/// A change as rows.
pub(super) fn rows(change: Change) -> Vec<Row> {
    let mut rows = Vec::with_capacity(2 + 2 * change.alarms.len());
    if let Some((run, summary)) = &change.run {
        rows.push(Row::Diagnosis(diagnosis_row(run, summary)));
    }
    if let Some((id, ModelVersion { version, since, effects })) = change.model {
        let control_loop = id.to_string();
        let effects =
            effects.iter().map(|(kind, tag)| format!("{kind}\t{}\n", tag.as_deref().unwrap_or_default()));
        rows.push(Row::Model(ModelRow { control_loop, version, since, effects: effects.collect() }));
    }
    for alarm in change.alarms {
        alarm_rows(alarm, &mut rows);
    }
    rows
}

/// A run as a row.
pub(in crate::app) fn diagnosis_row(run: &Run, summary: &Summary) -> DiagnosisRow {
    DiagnosisRow {
        control_loop: run.id.to_string(),
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
        version: match &run.outcome {
            Outcome::Elsewhere(told) => told.version.clone(),
            _ => BUILD.to_string(),
        },
        report: Report::text(run).as_deref().and_then(pack),
        basis: run.basis.as_deref().and_then(BasisText::text).as_deref().and_then(pack),
    }
}

fn alarm_rows(kept: KeptAlarm, rows: &mut Vec<Row>) {
    let KeptAlarm { id, saved, transitions, acted, by, comment, detail } = kept;
    let (control_loop, kind) = (id.subject.to_string(), id.kind.as_str().to_string());
    let priority = saved.priority.map(|priority| priority.as_str().to_string());
    for transition in transitions {
        rows.push(Row::Transition(TransitionRow {
            control_loop: control_loop.clone(),
            kind: kind.clone(),
            at: transition.at,
            before: transition.from.as_str().to_string(),
            after: transition.to.as_str().to_string(),
            cause: transition.cause.as_str().to_string(),
            priority: priority.clone(),
            detail: detail.clone(),
            by: by.clone().filter(|_| acted),
            comment: comment.clone().filter(|_| acted),
        }));
    }
    let Saved { flags, votes, pending, raises, trend, .. } = saved;
    rows.push(Row::Alarm(AlarmRow {
        control_loop,
        kind,
        active: flags.active,
        acknowledged: flags.acknowledged,
        latched: flags.latched,
        shelved_until: flags.shelved_until,
        one_shot: flags.one_shot,
        suppressed: flags.suppressed,
        out_of_service: flags.out_of_service,
        votes: votes.into_iter().map(vote).collect(),
        pending,
        raises: raises.iter().map(f64::to_string).collect::<Vec<_>>().join(" "),
        priority,
        trend: trend.iter().map(point).collect(),
        since: flags.since,
        raised_at: flags.raised_at,
        detail,
        by,
        comment,
    }));
}

/// Alarms as they were kept; of kinds that this version knows.
pub(in crate::app) fn remembered_alarms(rows: Vec<AlarmRow>) -> Vec<RestoredAlarm> {
    let restored = |row: AlarmRow| {
        let id = AlarmId::new(LoopId::new(row.control_loop), Kind::named(&row.kind)?);
        let flags = Flags {
            active: row.active,
            acknowledged: row.acknowledged,
            latched: row.latched,
            shelved_until: row.shelved_until,
            one_shot: row.one_shot,
            suppressed: row.suppressed,
            out_of_service: row.out_of_service,
            since: row.since,
            raised_at: row.raised_at,
        };
        let saved = Saved {
            flags,
            votes: row.votes.chars().filter_map(voted).collect(),
            pending: row.pending,
            raises: row.raises.split_whitespace().filter_map(|at| at.parse().ok()).collect(),
            priority: row.priority.as_deref().and_then(Priority::named),
            trend: row.trend.lines().filter_map(pointed).collect(),
        };
        let AlarmRow { by, comment, detail, .. } = row;
        Some(RestoredAlarm { id, saved, by, comment, detail })
    };
    rows.into_iter().filter_map(restored).collect()
}

/// A model as it was kept.
pub(in crate::app) fn remembered_model(row: &ModelRow) -> ModelVersion {
    ModelVersion {
        version: row.version,
        since: row.since,
        effects: row.effects.lines().filter_map(effect).collect(),
    }
}

/// What alarms did, the last of it, oldest first.
pub(super) fn remembered_changes(reader: &Reader) -> Result<Vec<AlarmChange>, StoreError> {
    Ok(reader.last_transitions(MOST_CHANGES)?.into_iter().filter_map(remembered_change).collect())
}

/// A change of which people know; `None` for a kind that this version does not.
pub(in crate::app) fn remembered_change(row: TransitionRow) -> Option<AlarmChange> {
    let transition = Transition {
        from: State::named(&row.before)?,
        to: State::named(&row.after)?,
        at: row.at,
        cause: Cause::named(&row.cause)?,
    };
    Some(AlarmChange {
        number: 0,
        id: AlarmId::new(LoopId::new(row.control_loop), Kind::named(&row.kind)?),
        transition,
        priority: row.priority.as_deref().and_then(Priority::named).unwrap_or(Priority::Low),
        grouped: false,
        detail: row.detail,
        by: row.by,
        comment: row.comment,
        told: true,
    })
}

/// What was said of a loop; its model is a state, and read for itself.
pub(super) fn remembered(reader: &Reader, id: &LoopId, room: usize) -> Result<Remembered, StoreError> {
    let rows = reader.last_diagnoses(id.as_str(), room)?;
    // What a run worked on is read of those where it matters only: of all it would be far more than is kept of them.
    let source = |row: &DiagnosisRow| -> Result<Option<u64>, StoreError> {
        let text = match &row.basis {
            Some(basis) => unpack(basis),
            None => reader.basis(id.as_str(), row.finished)?.as_deref().and_then(unpack),
        };
        Ok(text.and_then(|text| BasisText::read(&text)).and_then(|basis| basis.source))
    };
    let mut diagnosed = rows.iter().rev().find_map(|row| {
        let text = unpack(row.report.as_ref()?)?;
        let report = Report::read(&text)?;
        let restored = Restored {
            finished: row.finished,
            took_s: row.took_s,
            quality: report.quality().to_string(),
            doubtful: report.doubtful,
            // Another build may find something else in the same samples.
            structure: report.structure().filter(|_| row.version == BUILD),
            source: None,
            report: text.into(),
        };
        Some((restored, summary(row), report.window.end))
    });
    let mut known = None;
    if let Some((restored, told, _)) = &mut diagnosed {
        let row = rows.iter().find(|row| row.finished.to_bits() == told.time.to_bits());
        known = row.map(&source).transpose()?.flatten();
        restored.source = known;
    }
    let mut runs = rows.iter().rev().map(|row| (row, summary(row)));
    // What it says of a compensated valve is in the report of the latest only, and in the reason of all.
    let stuck = runs.find(|(row, own)| own.outcome == "stiction" && !is_compensated(row));
    let is_of_valve = |row: &DiagnosisRow| -> Result<bool, StoreError> {
        Ok(source(row)?.zip(known).is_none_or(|(own, known)| own == known))
    };
    let before = match stuck {
        Some((row, own)) if is_of_valve(row)? => own.before(),
        _ => None,
    };
    let said = rows.iter().rev().find(|row| row.is_verdict());
    let fitted_until = match (said, &diagnosed) {
        (Some(row), Some((_, told, end))) if row.finished.to_bits() == told.time.to_bits() => *end,
        // Runs that said nothing of the valve came since.
        (Some(row), _) if is_of_valve(row)? => fitted_until(row),
        _ => None,
    };
    let summaries = rows.iter().map(summary).collect();
    let diagnosed = diagnosed.map(|(restored, told, _)| (restored, told));
    Ok(Remembered { summaries, diagnosed, before, fitted_until, ..Remembered::default() })
}

/// Time of the last sample that a whole run fitted (s).
fn fitted_until(row: &DiagnosisRow) -> Option<f64> {
    Report::read(&unpack(row.report.as_ref()?)?)?.window.end
}

/// A run in a few numbers.
pub(in crate::app) fn summary(row: &DiagnosisRow) -> Summary {
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
        compensated: compensated(row),
    }
}

/// What a run said of a compensated valve stands in its report, which is read of such runs only.
fn compensated(row: &DiagnosisRow) -> Option<Compensated> {
    let report = row.report.as_ref().filter(|_| is_compensated(row))?;
    Report::read(&unpack(report)?)?.compensated.as_ref()?.read()
}

/// Whether a run was of a valve that a term acted on, as its reason says.
fn is_compensated(row: &DiagnosisRow) -> bool {
    row.reason.starts_with("compensated")
}

/// An effect that this version knows.
fn effect(line: &str) -> Option<KnownEffect> {
    let (name, tag) = line.split_once('\t')?;
    let kind = residual::Kind::ALL.into_iter().find(|kind| kind.as_str() == name)?;
    Some((kind, Some(tag.to_string()).filter(|tag| !tag.is_empty())))
}

/// Votes as letters: sticky, clean, between.
const VOTES: [(char, Observation); 3] =
    [('s', Observation::Present), ('c', Observation::Absent), ('b', Observation::Between)];

fn vote(vote: Observation) -> char {
    VOTES.iter().find(|(_, known)| *known == vote).map_or('u', |(letter, _)| *letter)
}

fn voted(letter: char) -> Option<Observation> {
    VOTES.iter().find(|(known, _)| *known == letter).map(|(_, vote)| *vote)
}

/// A point of f over time as a line of text.
fn point(Point { t, f, variance, scatter, count }: &Point) -> String {
    format!("{t} {f} {variance} {scatter} {count}\n")
}

fn pointed(line: &str) -> Option<Point> {
    let mut parts = line.split(' ');
    let mut number = || parts.next()?.parse::<f64>().ok();
    let (t, f, variance, scatter) = (number()?, number()?, number()?, number()?);
    let count = parts.next()?.parse().ok()?;
    Some(Point { t, f, variance, scatter, count })
}
