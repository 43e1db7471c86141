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
use crate::version::BUILD;
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
        version: BUILD.to_string(),
    })
}

/// Whether a worker of this build may diagnose a window: another may find something else in it.
pub(super) fn is_of_this_build(window: &Window) -> bool {
    window.version == BUILD
}

/// What is to be diagnosed.
///
/// # Errors
/// What does not fit together, in one line.
pub(super) fn read(window: &Window) -> Result<(Basis, Record), String> {
    if !is_of_this_build(window) {
        let asked = &window.version;
        return Err(format!("it was asked by version {asked:?}, and this worker has version {BUILD:?}"));
    }
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

/// The run that a message tells of, with the loop's name where it is kept; and whether this version can read its report and what
/// it worked on. A report that it cannot read is kept for one that can.
pub(super) fn run(id: LoopId, message: &RunMessage) -> (Run, bool) {
    let row = convert::diagnosis_row(message);
    let basis = row.basis.as_deref().and_then(unpack).and_then(|text| BasisText::read(&text)).map(Arc::new);
    let (told, is_read) = told(message);
    let is_whole = is_read && basis.is_some() == row.basis.is_some();
    let run = Run {
        id,
        started: row.finished - row.took_s,
        finished: row.finished,
        took_s: row.took_s,
        trigger: if row.on_demand { Trigger::OnDemand } else { Trigger::Periodic },
        op_span: basis.as_ref().and_then(|basis| basis.op_span),
        basis,
        outcome: Outcome::Elsewhere(Box::new(told)),
    };
    (run, is_whole)
}

/// What an answer says; `None` where the worker could not tell, or this version cannot read what it says.
pub(super) fn answered(answer: &Answer) -> Option<Told> {
    let (told, is_read) = told(answer.run.as_ref()?);
    is_read.then_some(told)
}

/// What a message says of a run, and whether this version can read its report, if it has one.
fn told(message: &RunMessage) -> (Told, bool) {
    let row = convert::diagnosis_row(message);
    let report = row.report.as_deref().and_then(unpack);
    let read = report.as_deref().and_then(Report::read);
    let is_read = read.is_some() == row.report.is_some();
    let effect = |effect: &Effect| {
        let kind = residual::Kind::ALL.into_iter().find(|kind| kind.as_str() == effect.kind)?;
        Some((kind, effect.tag.clone()))
    };
    let told = Told {
        summary: summary(&row),
        quality: read.as_ref().map(|report| report.quality().to_string()).unwrap_or_default(),
        doubtful: read.as_ref().is_some_and(|report| report.doubtful),
        structure: read.as_ref().and_then(Report::structure),
        fitted_until: read.as_ref().and_then(|report| report.window.end),
        report: report.map(Into::into),
        effects: message.effects.iter().filter_map(effect).collect(),
        unexplained: message.unexplained,
        version: row.version,
    };
    (told, is_read)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::pack;

    /// What an edge says of a diagnosis with such a report.
    fn said(report: &str) -> RunMessage {
        RunMessage {
            finished: 100.0,
            outcome: "stiction".to_string(),
            version: "9.9.9".to_string(),
            report: pack(report),
            ..RunMessage::default()
        }
    }

    #[test]
    fn a_diagnosis_whose_report_this_version_cannot_read_is_kept_with_it() {
        let text = "{\"of\":\"a later version\"}";
        let (run, is_whole) = run(LoopId::new("north:FIC1"), &said(text));
        assert!(!is_whole);
        assert_eq!((run.outcome.as_str(), run.finished), ("stiction", 100.0));
        let row = diagnosis_row(&run, &run.summary());
        assert_eq!(row.report.as_deref().and_then(unpack).as_deref(), Some(text));
        assert_eq!(row.version, "9.9.9", "it was made by that version");
        let answer = Answer { run: Some(said(text)), ..Answer::default() };
        assert!(answered(&answer).is_none(), "it is no diagnosis to who asked");
    }

    #[test]
    fn a_run_that_failed_is_whole_and_one_whose_report_is_damaged_is_not() {
        let failed = RunMessage { report: None, ..said("") };
        assert!(run(LoopId::new("a"), &failed).1);
        let damaged = RunMessage { report: Some(vec![1, 2, 3]), ..said("") };
        let (run, is_whole) = run(LoopId::new("a"), &damaged);
        assert!(!is_whole && diagnosis_row(&run, &run.summary()).report.is_none());
    }

    #[test]
    fn a_window_of_another_version_is_refused() {
        let why = |version: &str| {
            let window = Window { version: version.to_string(), ..Window::default() };
            read(&window).expect_err("it has no settings either")
        };
        assert!(why("9.9.9").contains("9.9.9") && why("").contains("version"), "{}", why(""));
        assert!(!why(BUILD).contains("version \""), "{}", why(BUILD));
    }
}
