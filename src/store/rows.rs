//! What the store takes and gives back: plain values. It knows samples; what a diagnosis or an alarm means it does not.

use crate::signal::Sample;
use std::sync::Arc;

/// Names one tag: whose it is, what it is, and where it is read.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TagName {
    /// The loop.
    pub control_loop: String,
    /// `op`, `pv`, … or the name of another tag.
    pub tag: String,
    /// Where it is read and how it is decoded: another source is another tag.
    pub source: String,
    /// Engineering unit.
    pub unit: String,
}

/// Samples of one tag.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Whose.
    pub tag: Arc<TagName>,
    /// In any order.
    pub samples: Vec<Sample>,
}

/// What is written in one go: all of it is durable, or none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Samples.
    pub series: Vec<Series>,
    /// Everything else, in the order it happened.
    pub rows: Vec<Row>,
}

impl Batch {
    /// Nothing to write.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty() && self.series.iter().all(|series| series.samples.is_empty())
    }

    /// Samples in it.
    pub fn samples(&self) -> usize {
        self.series.iter().map(|series| series.samples.len()).sum()
    }
}

/// One row that is no sample. Written twice it is there once.
#[derive(Clone, Debug, PartialEq)]
pub enum Row {
    /// A run and what it said; the key is loop and time.
    Diagnosis(DiagnosisRow),
    /// A version of a loop's model; the key is loop and version.
    Model(ModelRow),
    /// The state of an alarm, in place of the one before; the key is loop and kind.
    Alarm(AlarmRow),
    /// What happened to an alarm; the key is everything but who and why.
    Transition(TransitionRow),
}

impl Row {
    /// Whether it says how something is, and not what happened.
    pub fn is_state(&self) -> bool {
        matches!(self, Row::Alarm(_) | Row::Model(_))
    }

    /// About how much memory it takes (bytes).
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + match self {
                Row::Diagnosis(row) => {
                    row.reason.len()
                        + [&row.report, &row.basis].into_iter().flatten().map(Vec::len).sum::<usize>()
                }
                Row::Model(row) => row.effects.len(),
                Row::Alarm(row) => row.votes.len() + row.trend.len() + row.detail.len(),
                Row::Transition(_) => 64,
            }
    }
}

/// A run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DiagnosisRow {
    /// Which loop.
    pub control_loop: String,
    /// When it ended (s).
    pub finished: f64,
    /// How long it took (s).
    pub took_s: f64,
    /// Whether somebody asked for it.
    pub on_demand: bool,
    /// A verdict, or how it failed.
    pub outcome: String,
    /// Why nothing could be said, for machines.
    pub reason_code: Option<String>,
    /// In one line.
    pub reason: String,
    /// Friction.
    pub f: Option<f64>,
    /// Its interval.
    pub f_ci95: Option<[f64; 2]>,
    /// Unit of both: per cent of OP's span, or OP's own.
    pub f_in_percent: bool,
    /// Evidence (-).
    pub delta_aic: Option<f64>,
    /// Version of the daemon that said it.
    pub version: String,
    /// The whole report as compressed text, see [`pack`]; `None` for a run that failed.
    pub report: Option<Vec<u8>>,
    /// What it worked on as compressed text; `None` where nobody told.
    pub basis: Option<Vec<u8>>,
}

impl DiagnosisRow {
    /// Whether it says that the valve sticks, or that it does not.
    pub fn is_verdict(&self) -> bool {
        matches!(self.outcome.as_str(), "stiction" | "no_stiction")
    }
}

/// Puts a whole run in the place of its summary among the last of a loop; before them where it has none.
pub(super) fn put_whole(last: &mut Vec<DiagnosisRow>, own: DiagnosisRow) {
    match last.iter_mut().find(|row| row.finished == own.finished) {
        Some(row) => *row = own,
        None => last.insert(0, own),
    }
}

/// A version of a loop's model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelRow {
    /// Which loop.
    pub control_loop: String,
    /// Counted from 1.
    pub version: u64,
    /// Since when (s).
    pub since: f64,
    /// Its effects, as text.
    pub effects: String,
}

/// The state of an alarm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlarmRow {
    /// Which loop, or which collector.
    pub control_loop: String,
    /// What it is about.
    pub kind: String,
    /// The condition holds.
    pub active: bool,
    /// Somebody has seen it.
    pub acknowledged: bool,
    /// The condition went and the alarm stays.
    pub latched: bool,
    /// Until when it is shelved (s).
    pub shelved_until: Option<f64>,
    /// Shelved until its condition goes.
    pub one_shot: bool,
    /// Suppressed by design.
    pub suppressed: bool,
    /// Out of service.
    pub out_of_service: bool,
    /// Votes that count to the next change, oldest first, as text.
    pub votes: String,
    /// Since when a condition holds that has to hold for longer (s).
    pub pending: Option<f64>,
    /// When it was raised last, as text.
    pub raises: String,
    /// The highest priority since then.
    pub priority: Option<String>,
    /// f over time, as text.
    pub trend: String,
    /// When the state last changed (s).
    pub since: Option<f64>,
    /// When the condition was last raised (s).
    pub raised_at: Option<f64>,
    /// What the condition is, in one line.
    pub detail: String,
    /// Who acted last.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// What happened to an alarm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransitionRow {
    /// Which loop, or which collector.
    pub control_loop: String,
    /// What its alarm is about.
    pub kind: String,
    /// When (s).
    pub at: f64,
    /// State before.
    pub before: String,
    /// State after.
    pub after: String,
    /// Why.
    pub cause: String,
    /// How soon somebody had to act.
    pub priority: Option<String>,
    /// What the condition was, in one line.
    pub detail: String,
    /// Who acted.
    pub by: Option<String>,
    /// What they said.
    pub comment: Option<String>,
}

/// Largest text that is unpacked (bytes).
const MAX_TEXT: usize = 1 << 24;

/// Text, compressed; `None` for one that is too long to be read back.
pub fn pack(text: &str) -> Option<Vec<u8>> {
    if text.len() > MAX_TEXT {
        return None;
    }
    zstd::bulk::compress(text.as_bytes(), 3).ok()
}

/// The text of [`pack`]; `None` when these are not its bytes.
pub fn unpack(bytes: &[u8]) -> Option<String> {
    String::from_utf8(zstd::bulk::decompress(bytes, MAX_TEXT).ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn text_comes_back_and_rubbish_does_not(text in "\\PC{0,200}", rubbish in proptest::collection::vec(any::<u8>(), 0..100)) {
            let packed = pack(&text).expect("short");
            let unpacked = unpack(&packed);
            prop_assert_eq!(unpacked.as_deref(), Some(text.as_str()));
            // Whatever it is, it is an answer and no panic.
            let _ = unpack(&rubbish);
        }
    }
}
