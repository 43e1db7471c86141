//! A window on its way to a worker, and what the worker says on its way back. Both ways everything is exact: the diagnosis is
//! the same wherever it is made.

use crate::app::persistence::rows::{diagnosis_row, summary};
use crate::fleet::convert::{self, block};
use crate::fleet::message::{Answer, Effect, Run as RunMessage, Window};
use crate::residual;
use crate::results::{Basis, Outcome, Run, Told, Trigger, basis};
use crate::schedule::Asked;
use crate::serve::dto::{BasisText, Report};
use crate::signal::{LoopId, Record};
use crate::store::{codec, unpack};
use std::sync::Arc;

/// Samples of a window, of all its tags together: 5 MB where they are unpacked. An edge diagnoses what is longer by itself.
const MOST_SAMPLES: usize = 200_000;
/// Longest text about a window (bytes); it takes some thousand.
const MOST_BASIS: usize = 1 << 20;

/// The message that asks for a diagnosis; `None` for what cannot be written, or would not be read.
pub(super) fn of(asked: &Asked, answer_within_s: f64) -> Option<Window> {
    let samples: usize = basis::series(&asked.record).map(|(_, samples)| samples.len()).sum();
    (samples <= MOST_SAMPLES).then_some(())?;
    Some(Window {
        control_loop: asked.id.to_string(),
        basis: BasisText::text(&asked.basis)?,
        tags: basis::series(&asked.record).map(|(tag, samples)| block(tag, "", samples)).collect(),
        started: asked.started,
        on_demand: asked.trigger == Trigger::OnDemand,
        answer_within_s,
    })
}

/// What is to be diagnosed.
///
/// # Errors
/// What does not fit together, in one line.
pub(super) fn read(window: &Window) -> Result<(Basis, Record), String> {
    let text = Some(&window.basis).filter(|text| text.len() <= MOST_BASIS);
    let basis =
        text.and_then(|text| BasisText::read(text)).ok_or("its settings cannot be read by this version")?;
    let (mut record, mut left) = (Record::default(), MOST_SAMPLES);
    for tag in &window.tags {
        let samples = codec::decode_at_most(&tag.block, left).ok_or_else(|| {
            format!("tag {:?} is damaged, or the window has more than {MOST_SAMPLES} samples", tag.tag)
        })?;
        left -= samples.len();
        basis::put(&mut record, &tag.tag, samples);
    }
    let (record, lost) = basis.cut(record);
    if lost.is_empty() {
        Ok((basis, record))
    } else {
        Err(format!("samples of {} are missing", lost.join(", ")))
    }
}

/// What a run says, for who asked and for who keeps it.
pub(super) fn message(run: &Run) -> RunMessage {
    let effects = run.effects().unwrap_or_default().into_iter();
    let effects = effects.map(|(kind, tag)| Effect { kind: kind.to_string(), tag }).collect();
    convert::run(diagnosis_row(run, &run.summary()), effects, run.unexplained())
}

/// The run that a message tells of, with the loop's name where it is kept.
pub(super) fn run(id: LoopId, message: &RunMessage) -> Option<Run> {
    let row = convert::diagnosis_row(message);
    let basis = row.basis.as_deref().and_then(unpack).and_then(|text| BasisText::read(&text)).map(Arc::new);
    let told = told(message)?;
    Some(Run {
        id,
        started: row.finished - row.took_s,
        finished: row.finished,
        took_s: row.took_s,
        trigger: if row.on_demand { Trigger::OnDemand } else { Trigger::Periodic },
        op_span: basis.as_ref().and_then(|basis| basis.op_span),
        basis,
        outcome: Outcome::Elsewhere(Box::new(told)),
    })
}

/// What an answer says; `None` where the worker could not tell.
pub(super) fn answered(answer: &Answer) -> Option<Told> {
    told(answer.run.as_ref()?)
}

fn told(message: &RunMessage) -> Option<Told> {
    let row = convert::diagnosis_row(message);
    let report = row.report.as_deref().and_then(unpack);
    let read = report.as_deref().and_then(Report::read);
    // A report that this version cannot read is no diagnosis to it.
    (report.is_none() || read.is_some()).then_some(())?;
    let effect = |effect: &Effect| {
        let kind = residual::Kind::ALL.into_iter().find(|kind| kind.as_str() == effect.kind)?;
        Some((kind, effect.tag.clone()))
    };
    Some(Told {
        summary: summary(&row),
        quality: read.as_ref().map(|report| report.quality().to_string()).unwrap_or_default(),
        doubtful: read.as_ref().is_some_and(|report| report.doubtful),
        structure: read.as_ref().and_then(Report::structure),
        report: report.map(Into::into),
        effects: message.effects.iter().filter_map(effect).collect(),
        unexplained: message.unexplained,
    })
}
