//! Loops and their diagnoses as JSON.

use super::cause::LoopCause;
use super::params::{AlarmKind, AlarmState};
use super::report::{Report, ReportModel, ReportResidual};
use super::writeback::WritebackView;
use super::{age, finite, rfc3339};
use crate::history::TagSpec;
use crate::results::{AlarmView, Known, Origin, Run, Summary, Trigger, f_unit};
use crate::serve::{LoopInfo, Standing};
use crate::signal::{Quality, Sample};
use serde::Serialize;
use utoipa::ToSchema;

/// A number with what it takes to believe it.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Quantity {
    /// `op`, `pv`, `sp`, `mode`, `mv` or the name of an extra tag.
    pub tag: String,
    /// The value; null where there is none.
    pub value: Option<f64>,
    /// Engineering unit; empty when none is configured.
    pub unit: String,
    /// When it was measured.
    pub time: Option<String>,
    /// How long ago it was last known to hold (s of plant time), whatever the clock of its source shows: since it came, or since its
    /// source was last there, where that sends changes only and tells all of them. Null where nothing has arrived.
    pub age_s: Option<f64>,
    /// `good`, `stale`, `bad:…`, or `none` when nothing has arrived.
    pub quality: &'static str,
}

impl Quantity {
    /// The newest sample of a tag, and how long ago it was last known to hold (s).
    pub fn new(tag: &TagSpec, newest: Option<(Sample, f64)>) -> Self {
        let sample = newest.map(|(sample, _)| sample);
        let usable = sample.filter(|s| !matches!(s.quality, Quality::Bad(_)));
        Self {
            tag: tag.kind.name().to_string(),
            value: usable.and_then(|s| finite(s.value)),
            unit: tag.unit.clone(),
            time: sample.and_then(|s| rfc3339(s.t)),
            age_s: newest.and_then(|(_, age_s)| finite(age_s)),
            quality: sample.map_or("none", |s| s.quality.as_str()),
        }
    }
}

/// A run in a few numbers.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct RunItem {
    /// When it ended.
    pub time: Option<String>,
    /// A verdict, `deadline_exceeded` or `panicked`.
    pub outcome: String,
    /// The outcome, as an operator would say it.
    pub words: String,
    /// The outcome in one line, with the numbers it rests on.
    pub reason: String,
    /// Why nothing could be said, for machines; null otherwise.
    pub reason_code: Option<String>,
    /// Friction (`f_unit`).
    pub f: Option<f64>,
    /// Its 95 % interval (`f_unit`).
    pub f_ci95: Option<[f64; 2]>,
    /// `% OP`, or `OP units` where the span is not known.
    pub f_unit: String,
    /// Evidence for friction against the best explanation without it (-).
    pub delta_aic: Option<f64>,
    /// How long it took on the wall clock (s).
    pub took_s: Option<f64>,
    /// `periodic` or `on_demand`.
    pub trigger: &'static str,
}

impl From<&Summary> for RunItem {
    fn from(summary: &Summary) -> Self {
        Self {
            time: rfc3339(summary.time),
            outcome: summary.outcome.to_string(),
            words: summary.words(),
            reason: summary.reason.clone(),
            reason_code: summary.reason_code.as_deref().map(str::to_string),
            f: summary.f.and_then(finite),
            f_ci95: summary.f_ci95.and_then(|[low, high]| Some([finite(low)?, finite(high)?])),
            f_unit: f_unit(summary.f_in_percent).to_string(),
            delta_aic: summary.delta_aic.and_then(finite),
            took_s: finite(summary.took_s),
            trigger: match summary.trigger {
                Trigger::Periodic => "periodic",
                Trigger::OnDemand => "on_demand",
            },
        }
    }
}

/// A loop in the list.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopItem {
    /// The loop's name.
    pub id: String,
    /// What it controls.
    pub description: String,
    /// Which part of the plant.
    pub group: String,
    /// The latest verdict: `stiction`, `no_stiction`, `not_identifiable`; null before the first diagnosis.
    pub verdict: Option<String>,
    /// The verdict, as an operator would say it.
    pub words: Option<String>,
    /// The verdict in one line, with the numbers it rests on.
    pub reason: Option<String>,
    /// Why nothing can be said, for machines.
    pub reason_code: Option<String>,
    /// Friction (`f_unit`); null when not identifiable.
    pub f: Option<f64>,
    /// Its 95 % interval (`f_unit`).
    pub f_ci95: Option<[f64; 2]>,
    /// `% OP`, or `OP units` where the span is not known; null before the first diagnosis.
    pub f_unit: Option<String>,
    /// Evidence for friction against the best explanation without it (-).
    pub delta_aic: Option<f64>,
    /// When it was diagnosed.
    pub time: Option<String>,
    /// How long ago that is (s of plant time).
    pub age_s: Option<f64>,
    /// Time between two diagnoses (s of plant time).
    pub period_s: f64,
    /// How good the data behind it was: `good`, `fair`, `poor`.
    pub quality: Option<String>,
    /// True where the published methods contradict the verdict so that somebody should look at the loop.
    pub doubtful: bool,
    /// The latest run, when it failed (`deadline_exceeded`, `panicked`) after that; null otherwise.
    pub failure: Option<String>,
    /// The state of its alarm on stiction.
    pub alarm: AlarmState,
    /// Its other alarms that are not normal.
    pub other_alarms: Vec<OtherAlarm>,
    /// The loop that this one may calm down with, by an order of the work list that stands and the latest look at the plant.
    pub swings_with: Option<String>,
    /// 100 for a loop that does its work, 0 for one that does none of it, by the latest look at the plant; null where that is not
    /// known.
    pub score: Option<f64>,
    /// What its swing costs by the latest look at the plant (`cost_unit`); null where there is no price, or the loop was passed over.
    pub cost: Option<f64>,
    /// The unit of `cost`, as `[loop.cost]` has it.
    pub cost_unit: Option<String>,
    /// What needs looking at: 5 unacknowledged, 4 acknowledged, 3 stiction without alarm yet, 2 returned unacknowledged
    /// or latched, 1 cannot be told, 0 nothing; an alarm that is silent counts as 1.
    pub severity: u8,
}

/// An alarm of a loop that is not about stiction.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct OtherAlarm {
    /// What it is about.
    pub kind: AlarmKind,
    /// What the operator sees.
    pub state: AlarmState,
}

impl From<&AlarmView> for OtherAlarm {
    fn from(view: &AlarmView) -> Self {
        Self { kind: view.id.kind.into(), state: view.state.into() }
    }
}

impl LoopItem {
    /// A loop as it is known at `now` (s), and how it stands among others.
    pub fn new(info: &LoopInfo, known: &Known, standing: Standing, now: f64) -> Self {
        let (cost, cost_unit) = standing.cost.unzip();
        let summary = known.summary.as_ref();
        let item = summary.map(RunItem::from);
        let verdict = summary.map(|s| s.outcome.as_ref());
        let judged = known.diagnosed.as_ref().and_then(|run| run.judged());
        let diagnosis = judged.map(|judged| &judged.diagnosis);
        let failed = known.last.as_ref().filter(|last| Some(last.outcome.as_ref()) != verdict);
        let restored = || Some(known.restored.as_ref()?.quality.clone());
        Self {
            id: info.id.to_string(),
            description: info.description.clone(),
            group: info.group.clone(),
            verdict: verdict.map(str::to_string),
            words: item.as_ref().map(|i| i.words.clone()),
            reason: summary.map(|s| s.reason.clone()),
            reason_code: summary.and_then(|s| s.reason_code.as_deref()).map(str::to_string),
            f: item.as_ref().and_then(|i| i.f),
            f_ci95: item.as_ref().and_then(|i| i.f_ci95),
            f_unit: item.as_ref().map(|i| i.f_unit.clone()),
            delta_aic: item.as_ref().and_then(|i| i.delta_aic),
            time: summary.and_then(|s| rfc3339(s.time)),
            age_s: summary.and_then(|s| age(now, s.time)),
            period_s: info.period_s,
            quality: diagnosis.map(|d| super::report::quality(d).as_str().to_string()).or_else(restored),
            doubtful: match judged {
                Some(judged) => judged.is_doubtful(),
                None => known.restored.as_ref().is_some_and(|restored| restored.doubtful),
            },
            failure: failed.map(|last| last.outcome.to_string()),
            alarm: known.alarm.state.into(),
            swings_with: known.swings_with.as_ref().map(|id| id.to_string()),
            other_alarms: known.others.iter().map(OtherAlarm::from).collect(),
            score: standing.score.and_then(finite),
            cost: cost.and_then(finite),
            cost_unit,
            severity: severity(known.alarm.state.into(), verdict),
        }
    }
}

/// See `LoopItem::severity`.
pub fn severity(alarm: AlarmState, verdict: Option<&str>) -> u8 {
    match (alarm, verdict) {
        (AlarmState::Unacknowledged, _) => 5,
        (AlarmState::Acknowledged, _) => 4,
        (AlarmState::Shelved | AlarmState::SuppressedByDesign | AlarmState::OutOfService, _) => 1,
        (_, Some("stiction")) => 3,
        (
            AlarmState::ReturnedUnacknowledged
            | AlarmState::LatchedUnacknowledged
            | AlarmState::LatchedAcknowledged,
            _,
        ) => 2,
        (_, None | Some("not_identifiable")) => 1,
        _ => 0,
    }
}

/// One page of loops.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopList {
    /// When.
    pub time: Option<String>,
    /// Loops that pass the filters, on all pages.
    pub total: usize,
    /// The loops of this page.
    pub items: Vec<LoopItem>,
    /// `after` of the next page; null on the last.
    pub next: Option<String>,
}

/// One loop.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopDetail {
    /// As in the list.
    #[serde(flatten)]
    pub item: LoopItem,
    /// Span of OP (OP unit), where known.
    pub op_span: Option<f64>,
    /// Limits of OP (OP unit), where known.
    pub op_limits: Option<[f64; 2]>,
    /// Least f that counts as stiction (`f_unit`): what the latest diagnosis went by, else what is configured, where OP's span
    /// is known; null otherwise.
    pub f_threshold: Option<f64>,
    /// Why it was not at rest, by the latest look at the plant; null where it was at rest or could not be judged, and before the first
    /// look since the start.
    pub cause: Option<LoopCause>,
    /// The newest sample of each tag.
    pub values: Vec<Quantity>,
    /// Write-back; null where it is not enabled, or not built in.
    pub writeback: Option<WritebackView>,
    /// The latest run of any kind.
    pub last_run: Option<RunItem>,
}

impl LoopDetail {
    /// See `f_threshold`; `configured`: in per cent, where OP's span is known.
    pub fn f_threshold(known: &Known, configured: Option<f64>) -> Option<f64> {
        let used = latest_report(known).and_then(|report| report.f_threshold);
        used.or(configured).and_then(finite)
    }
}

/// The report of the latest diagnosis, be it of before the start.
fn latest_report(known: &Known) -> Option<Report> {
    match &known.diagnosed {
        Some(run) => Report::of(run),
        None => Report::read(&known.restored.as_ref()?.report),
    }
}

/// The latest diagnosis of a loop in full.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopDiagnosis {
    /// The report, as `diagnose --format json` writes it; its times are seconds since the Unix epoch.
    #[serde(flatten)]
    pub report: Report,
    /// When it was made.
    pub time: Option<String>,
    /// How long ago that is (s of plant time).
    pub age_s: Option<f64>,
    /// First time of the window.
    pub window_start: Option<String>,
    /// Last time of the window.
    pub window_end: Option<String>,
    /// First time of the stretch in which effects were looked for; null where nothing was traced.
    pub traced_start: Option<String>,
    /// Last time of that stretch.
    pub traced_end: Option<String>,
    /// How long it took on the wall clock (s).
    pub took_s: Option<f64>,
}

impl LoopDiagnosis {
    /// The diagnosis of a run at `now` (s); `None` for a run that failed.
    pub fn new(run: &Run, now: f64) -> Option<Self> {
        Some(Self::of(Report::of(run)?, run.finished, run.took_s, now))
    }

    /// The latest diagnosis of a loop at `now` (s), be it of before the start.
    pub fn latest(known: &Known, now: f64) -> Option<Self> {
        if let Some(run) = &known.diagnosed {
            return Self::new(run, now);
        }
        let restored = known.restored.as_ref()?;
        Some(Self::of(Report::read(&restored.report)?, restored.finished, restored.took_s, now))
    }

    fn of(report: Report, finished: f64, took_s: f64, now: f64) -> Self {
        let traced = report.residual.traced.as_ref();
        Self {
            time: rfc3339(finished),
            age_s: age(now, finished),
            window_start: report.window.start.and_then(rfc3339),
            window_end: report.window.end.and_then(rfc3339),
            traced_start: traced.and_then(|own| own.start).and_then(rfc3339),
            traced_end: traced.and_then(|own| own.end).and_then(rfc3339),
            took_s: finite(took_s),
            report,
        }
    }
}

/// The runs of a loop, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct RunList {
    /// The loop's name.
    pub r#loop: String,
    /// Its runs.
    pub items: Vec<RunItem>,
    /// `after` of the next page; null on the last.
    pub next: Option<String>,
}

/// Where a disturbance that was traced to other loops starts.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopOrigin {
    /// From this loop to where it starts, or once around where the loops drive each other.
    pub path: Vec<String>,
    /// The loop it starts in; null where the loops drive each other and not exactly one of them sticks.
    pub starts_in: Option<String>,
    /// Whether the valve of that loop sticks.
    pub sticky: bool,
}

impl From<Origin> for LoopOrigin {
    fn from(origin: Origin) -> Self {
        Self {
            path: origin.path.iter().map(ToString::to_string).collect(),
            starts_in: origin.starts_in.map(|id| id.to_string()),
            sticky: origin.sticky,
        }
    }
}

/// The fitted model of a loop.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopModel {
    /// The loop's name.
    pub r#loop: String,
    /// When it was fitted.
    pub time: Option<String>,
    /// The verdict it belongs to.
    pub verdict: String,
    /// Why, in one line.
    pub reason: String,
    /// Friction (`f_unit`).
    pub f: Option<f64>,
    /// Unit of f.
    pub f_unit: String,
    /// Sample period of the model (s).
    pub ts_s: Option<f64>,
    /// Counted from 1; a new version whenever the effects change.
    pub version: u64,
    /// Since when this version holds.
    pub since: Option<String>,
    /// The linear part; null when not identifiable.
    pub model: Option<ReportModel>,
    /// The effects beside friction and linear dynamics, and the error before and after them.
    pub residual: ReportResidual,
    /// Where the disturbance starts, if another loop drives this one; null otherwise.
    pub origin: Option<LoopOrigin>,
}

impl LoopModel {
    /// The model of the latest diagnosis and its version; `None` where nothing was ever diagnosed.
    pub fn latest(known: &Known, origin: Option<Origin>) -> Option<Self> {
        let (report, version) = (latest_report(known)?, &known.model);
        let summary = known.summary.as_ref()?;
        Some(Self {
            r#loop: report.r#loop,
            time: rfc3339(summary.time),
            verdict: summary.outcome.to_string(),
            reason: report.reason,
            f: report.f,
            f_unit: report.f_unit,
            ts_s: report.window.ts_s,
            version: version.version,
            since: rfc3339(version.since),
            model: report.model,
            residual: report.residual,
            origin: origin.map(LoopOrigin::from),
        })
    }
}

/// A diagnosis that was begun and is not done.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Begun {
    /// The loop's name.
    pub r#loop: String,
    /// `running`: fetch the diagnosis later, or listen to the events.
    pub state: &'static str,
}

#[cfg(test)]
mod tests {
    use super::super::report::ReportTraced;
    use super::*;
    use crate::alarm;
    use crate::diagnosis::{Diagnosis, NotIdentifiable, Verdict};
    use crate::results::{Restored, Results};
    use crate::signal::LoopId;
    use std::sync::Arc;

    #[test]
    fn the_traced_stretch_has_its_times() {
        let nothing = Diagnosis::bare(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), "made for a test");
        let mut report = Report::from(("FIC101", &nothing));
        assert_eq!(LoopDiagnosis::of(report.clone(), 0.0, 0.1, 1.0).traced_start, None);
        let start = 1_767_225_600.0;
        report.residual.traced = Some(ReportTraced { start: Some(start), end: Some(start + 60.0), n: 61 });
        let told = LoopDiagnosis::of(report, 0.0, 0.1, 1.0);
        assert_eq!(told.traced_start.as_deref(), Some("2026-01-01T00:00:00Z"));
        assert_eq!(told.traced_end.as_deref(), Some("2026-01-01T00:01:00Z"));
    }

    #[test]
    fn the_least_f_that_counts_is_in_the_unit_of_f_or_not_told() {
        let id = LoopId::new("FIC101");
        let results = Results::new(std::slice::from_ref(&id), 1, &alarm::Config::default());
        let mut known = results.get(&id, 0.0).expect("it is there");
        assert_eq!(LoopDetail::f_threshold(&known, None), None, "before the first diagnosis, without a span");
        assert_eq!(LoopDetail::f_threshold(&known, Some(0.05)), Some(0.05));
        // 0.05 % of the 16 mA that OP covered.
        let nothing = Diagnosis::bare(Verdict::NotIdentifiable(NotIdentifiable::FlatPv), "made for a test");
        let report = Report { f_threshold: Some(0.008), ..Report::from(("FIC101", &nothing)) };
        known.restored = Some(Arc::new(Restored {
            finished: 0.0,
            took_s: 0.1,
            quality: "good".into(),
            doubtful: false,
            structure: None,
            source: None,
            report: serde_json::to_string(&report).expect("JSON").into(),
        }));
        assert_eq!(LoopDetail::f_threshold(&known, None), Some(0.008));
    }
}
