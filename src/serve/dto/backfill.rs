//! Diagnoses over the past as JSON.

use super::report::ReportHistory;
use super::{finite, rfc3339};
use crate::backfill::{Item, Timeline};
use crate::diagnosis::HistoryKind;
use crate::results::f_unit;
use crate::serve::{BackfillPhase, BackfillRun};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What a backfill is to do.
#[derive(Clone, Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BackfillBody {
    /// Which loop.
    pub r#loop: String,
    /// From this time on: RFC 3339, or seconds since the Unix epoch; with `file` it may be left out.
    #[serde(default)]
    pub from: Option<String>,
    /// Up to this time; now, or the end of the file, where it is left out.
    #[serde(default)]
    pub to: Option<String>,
    /// Length of a window (s), 10 to 32000000; 1,500 sample periods where it is left out.
    #[serde(default)]
    pub window_s: Option<f64>,
    /// From one diagnosis to the next (s), 10 to 32000000; a quarter of a window where it is left out.
    #[serde(default)]
    pub step_s: Option<f64>,
    /// Read what the loop's OPC UA servers keep into the store first.
    #[serde(default)]
    pub read_devices: bool,
    /// A table of samples in the folder of `[tables]`, in place of the store: its name there.
    #[serde(default)]
    pub file: Option<String>,
    /// What the table leaves in doubt, by the names of the command line's options: `time`, `op`, `pv`, `sp`, `mv`, `mode`,
    /// `tag`, `value`, `time_format`, `tz`, `time_unit`, `encoding`, `decimal`, `separator`, `auto_values`, `good_values`, `sheet`.
    #[serde(default)]
    pub table: BTreeMap<String, String>,
}

/// The job over a loop's past.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct BackfillJob {
    /// Which loop.
    pub r#loop: String,
    /// From.
    pub from: Option<String>,
    /// To.
    pub to: Option<String>,
    /// `reading`, `diagnosing`, `done`, `cancelled` or `failed`.
    pub phase: &'static str,
    /// Why it failed; else null.
    pub error: Option<String>,
    /// Slices read or windows diagnosed.
    pub done: usize,
    /// Of how many; 0 while that is not known.
    pub of: usize,
    /// When it was begun.
    pub started: Option<String>,
    /// When it ended; null while it runs.
    pub ended: Option<String>,
    /// What it found; null until it is done.
    pub report: Option<BackfillReport>,
}

impl From<&BackfillRun> for BackfillJob {
    fn from(job: &BackfillRun) -> Self {
        Self {
            r#loop: job.request.id.to_string(),
            from: rfc3339(job.request.from),
            to: rfc3339(job.request.to),
            phase: job.phase.as_str(),
            error: match &job.phase {
                BackfillPhase::Failed(why) => Some(why.clone()),
                _ => None,
            },
            done: job.done,
            of: job.of,
            started: rfc3339(job.started),
            ended: job.ended.and_then(rfc3339),
            report: job.found.as_ref().map(|found| BackfillReport {
                read_as: job.read_as.clone(),
                ..BackfillReport::new(job.request.id.as_str(), found)
            }),
        }
    }
}

/// What the past says of one loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BackfillReport {
    /// The loop's name.
    pub r#loop: String,
    /// How the file was read, in one line; null where the record is no file's.
    pub read_as: Option<String>,
    /// Begin of the record (s, on its clock).
    pub begin: Option<f64>,
    /// Length of a window (s).
    pub window_s: f64,
    /// From the end of one window to the end of the next (s).
    pub step_s: f64,
    /// Drop-outs of OP, to zero or to a value that stands for none, marked bad and not fitted (samples).
    pub op_drop_outs: usize,
    /// The same of PV, marked bad and not fitted (samples).
    pub pv_drop_outs: usize,
    /// Time in gaps of PV longer than five sample periods (s).
    pub gaps_s: Option<f64>,
    /// What an archive did to the samples, by the kind that most windows show; null where none does.
    pub history: Option<BackfillHistory>,
    /// When the alarm would have been raised and cleared; a null end holds until the record's.
    pub alarms: Vec<BackfillAlarm>,
    /// The windows, oldest first.
    pub items: Vec<BackfillItem>,
}

/// What an archive did to the samples.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BackfillHistory {
    /// Kind, evidence in the first window that shows it, and what it means for f.
    #[serde(flatten)]
    pub found: ReportHistory,
    /// Windows that show it.
    pub windows: usize,
}

impl BackfillHistory {
    fn of(items: &[Item]) -> Option<Self> {
        let found = || items.iter().filter_map(|item| item.history);
        let windows = |kind| found().filter(|other| other.kind == kind).count();
        let most = HistoryKind::ALL.into_iter().max_by_key(|kind| windows(*kind))?;
        let first = found().find(|found| found.kind == most)?;
        Some(Self { found: ReportHistory::new(&first), windows: windows(most) })
    }
}

/// A stretch in which the alarm would have held.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BackfillAlarm {
    /// Raised (s, on the record's clock).
    pub from: Option<f64>,
    /// Cleared (s, on the record's clock).
    pub to: Option<f64>,
    /// Raised, where the record's clock counts from 1970.
    pub from_time: Option<String>,
    /// Cleared, where the record's clock counts from 1970.
    pub to_time: Option<String>,
}

/// One window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct BackfillItem {
    /// Begin (s, on the record's clock).
    pub from: Option<f64>,
    /// End (s, on the record's clock).
    pub to: Option<f64>,
    /// `stiction`, `no_stiction` or `not_identifiable`.
    pub verdict: String,
    /// Why, in one line.
    pub reason: String,
    /// Friction (`f_unit`).
    pub f: Option<f64>,
    /// Its 95 % interval.
    pub f_ci95: Option<[f64; 2]>,
    /// Unit of f.
    pub f_unit: String,
    /// Evidence (-).
    pub delta_aic: Option<f64>,
    /// Effects in the model beside friction and linear dynamics.
    pub effects: Vec<String>,
    /// Good samples of PV over those that its sample period asks for (0..1).
    pub good_share: Option<f64>,
}

/// A time on a clock that counts from 1970, not from the record's begin.
fn dated(t: f64) -> Option<String> {
    rfc3339(t).filter(|_| t >= 1e8)
}

impl BackfillReport {
    /// The report of a loop.
    pub fn new(name: &str, timeline: &Timeline) -> Self {
        let [op_drop_outs, pv_drop_outs] = timeline.drop_outs;
        let alarm = |raised: &crate::backfill::Raised| BackfillAlarm {
            from: finite(raised.from),
            to: raised.to.and_then(finite),
            from_time: dated(raised.from),
            to_time: raised.to.and_then(dated),
        };
        Self {
            r#loop: name.to_string(),
            read_as: None,
            begin: finite(timeline.begin),
            window_s: timeline.cut.window_s,
            step_s: timeline.cut.step_s,
            op_drop_outs,
            pv_drop_outs,
            gaps_s: finite(timeline.gaps_s),
            history: BackfillHistory::of(&timeline.items),
            alarms: timeline.raised.iter().map(alarm).collect(),
            items: timeline.items.iter().map(BackfillItem::from).collect(),
        }
    }
}

impl From<&Item> for BackfillItem {
    fn from(item: &Item) -> Self {
        let said = &item.summary;
        Self {
            from: finite(item.from),
            to: finite(item.to),
            verdict: said.outcome.to_string(),
            reason: said.reason.clone(),
            f: said.f.and_then(finite),
            f_ci95: said.f_ci95.and_then(|[low, high]| Some([finite(low)?, finite(high)?])),
            f_unit: f_unit(said.f_in_percent).to_string(),
            delta_aic: said.delta_aic.and_then(finite),
            effects: item.effects.iter().map(|(kind, _)| kind.as_str().to_string()).collect(),
            good_share: finite(item.good_share),
        }
    }
}
