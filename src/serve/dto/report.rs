//! The report of one loop: `diagnose --format json` and `GET /api/v1/loops/{id}/diagnosis`.
//!
//! Numbers have full precision; one that does not exist is null.

mod opinions;
mod residual;
mod unit;

pub use opinions::{ReportAgreement, ReportOpinion, ReportQuantity, ReportSays, ReportThreshold};
pub use residual::{
    ReportCandidate, ReportEffect, ReportParameter, ReportResidual, ReportStem, ReportTraced,
};

use super::finite;
use crate::diagnosis::{self, Diagnosis, Verdict};
use crate::residual::{Findings, Structure};
use crate::results::{Compensated, Judged, Outcome, Run, Seen};
use crate::signal::SpanSource;
use serde::{Deserialize, Serialize};
use unit::OpUnit;
use utoipa::ToSchema;

/// What a diagnosis found, loop by loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Report {
    /// The loop's name.
    pub r#loop: String,
    /// How the file was read, in one line; null in the daemon, which reads no file.
    pub read_as: Option<String>,
    /// `stiction`, `no_stiction` or `not_identifiable`.
    pub verdict: ReportVerdict,
    /// The verdict in one line, with the numbers it rests on.
    pub reason: String,
    /// Why nothing can be said, for machines (`flat_pv`, `gaps`, …); null otherwise.
    pub reason_code: Option<String>,
    /// Friction parameter, S/2 (`f_unit`); null only when not identifiable.
    pub f: Option<f64>,
    /// 95 % interval of f: that of the profile likelihood, with the error of the valve models (`f_unit`).
    pub f_ci95: Option<[f64; 2]>,
    /// Unit of everything that is measured along OP: `% OP`, or `OP units` where the span is not known.
    pub f_unit: String,
    /// True when OP's span is neither given nor told by limits or unit, and `f_unit` was judged from OP's values.
    pub f_unit_assumed: bool,
    /// The span of OP in its own unit; null where it is not known.
    pub op_span: Option<f64>,
    /// Where the span is known from: `given`, `limits`, `unit`, `values`, or `unknown`.
    pub op_span_source: String,
    /// Least f that counts as stiction (`f_unit`): of the span, and of what OP covered where the span is not known, which is
    /// no larger; null where nothing could be weighed.
    #[serde(default)]
    pub f_threshold: Option<f64>,
    /// f as a share of OP's range in the window (-).
    pub f_of_op_range: Option<f64>,
    /// Probability of friction (0..1); null where nothing was traced.
    pub posterior: Option<f64>,
    /// Evidence for friction against the best explanation without it (-): twice the logarithm of the odds where it was traced.
    pub delta_aic: Option<f64>,
    /// The best explanation without friction that was weighed against the declared model, in words.
    pub rival: Option<String>,
    /// How evenly the record shares the declared model's evidence: its block mean in standard errors (-).
    pub steadiness: Option<f64>,
    /// Largest f tried (`f_unit`), in the traced stretch where the verdict comes from there: it may be more than `aic_curve` has, whose
    /// f are those of the diagnosed window.
    pub f_max: Option<f64>,
    /// The least f that nine of ten records such as this would have shown (`f_unit`), for `no_stiction` no less than the upper
    /// end of `f_ci95`; null where this one could have shown none, or nothing was traced.
    #[serde(default)]
    pub f_detectable: Option<f64>,
    /// Srinivasan's d of the same window, for comparison (`f_unit`).
    pub d_srinivasan: Option<f64>,
    /// The samples the verdict rests on.
    pub window: ReportWindow,
    /// What is left to see of friction while a term of write-back acts; null where none acted in the window.
    #[serde(default)]
    pub compensated: Option<ReportCompensated>,
    /// How the record was acquired; null where its stamps do not say.
    #[serde(default)]
    pub acquisition: Option<ReportAcquisition>,
    /// How the record became that window; null when it never did.
    pub preparation: Option<ReportPreparation>,
    /// What the denoising stage did; null when there is no window.
    pub denoise: Option<ReportDenoise>,
    /// The oscillation of OP; null when none was found.
    pub oscillation: Option<ReportOscillation>,
    /// The linear part at f; null when not identifiable.
    pub model: Option<ReportModel>,
    /// What the model leaves unexplained.
    pub residual: ReportResidual,
    /// AIC over f, for plotting; null when not identifiable.
    pub aic_curve: Option<ReportCurve>,
    /// What the published methods say of the same window: information beside the verdict; empty without a window.
    #[serde(default)]
    pub opinions: Vec<ReportOpinion>,
    /// How they agree; null without a window.
    #[serde(default)]
    pub agreement: Option<ReportAgreement>,
    /// True where they contradict the verdict so that somebody should look at the loop.
    #[serde(default)]
    pub doubtful: bool,
}

/// What the data says about the valve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReportVerdict {
    /// f above the threshold, with enough evidence.
    Stiction,
    /// The model without friction explains the data as well.
    NoStiction,
    /// The data cannot tell: never the same as healthy.
    NotIdentifiable,
}

/// The window that was fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportWindow {
    /// Time of the first sample (s).
    pub start: Option<f64>,
    /// Time of the last sample (s).
    pub end: Option<f64>,
    /// Samples.
    pub n: usize,
    /// Sample period (s).
    pub ts_s: Option<f64>,
    /// `good`, `fair` or `poor`, see [`WindowQuality`].
    pub quality: WindowQuality,
    /// Share of the samples that are missing and do not count (0..1).
    #[serde(default)]
    pub missing: Option<f64>,
    /// What an archive did to the record before it came here; null where nothing shows.
    #[serde(default)]
    pub history: Option<ReportHistory>,
}

/// How the record was acquired; a number that the record does not tell is null.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportAcquisition {
    /// Period of the controller's scans (s).
    pub scan_s: Option<f64>,
    /// Period of the polls (s).
    pub poll_s: Option<f64>,
    /// Standard deviation of the polls' instants (s).
    pub jitter_s: Option<f64>,
    /// Polls in one scan.
    pub polls_per_scan: Option<f64>,
    /// Whether the samples were put on the controller's ticks.
    pub recovered: bool,
    /// By how much later than OP PV is recorded (s), where OP tells that the controller had it before; it was moved back.
    #[serde(default)]
    pub pv_late_s: f64,
    /// What it means, where it is worth a sentence.
    pub note: Option<String>,
}

impl ReportAcquisition {
    /// Whether the diagnosed samples are not those of the record: they are on the controller's ticks, or PV was moved.
    pub fn moves_samples(&self) -> bool {
        self.recovered || self.pv_late_s > 0.0
    }

    fn new(found: &diagnosis::Acquisition) -> Self {
        Self {
            scan_s: found.scan_s.and_then(finite),
            poll_s: found.poll_s.and_then(finite),
            jitter_s: found.jitter_s.and_then(finite),
            polls_per_scan: found.polls_per_scan.and_then(finite),
            recovered: found.recovered,
            pv_late_s: found.pv_late_s,
            note: found.sentence(),
        }
    }
}

/// What an archive did to a record: compressed, averaged or exception-reported values bend f.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportHistory {
    /// `swinging_door`, `exception`, `interpolated`, `held` or `averaged`.
    pub kind: String,
    /// What it was seen by.
    pub evidence: String,
    /// What it means for f.
    pub note: String,
}

impl ReportHistory {
    /// What was found, as the report says it.
    pub fn new(found: &diagnosis::HistoryFound) -> Self {
        let note = found.kind.note().to_string();
        Self { kind: found.kind.as_str().to_string(), evidence: found.to_string(), note }
    }
}

/// How far the window is measured rather than filled in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WindowQuality {
    /// At most 2 % of the samples missing, OP and PV at most half a sample period apart.
    Good,
    /// At most 10 % missing, OP and PV at most one sample period apart.
    Fair,
    /// Anything worse, and a record that never became a window.
    Poor,
}

impl WindowQuality {
    /// The grade as the report writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Poor => "poor",
        }
    }

    /// The grade of a window, by the share of missing samples (0..1) and the worst time between an OP and
    /// its PV sample as a multiple of the sample period.
    fn of(gap_share: f64, skew_of_ts: f64) -> Self {
        if gap_share <= 0.02 && skew_of_ts <= 0.5 {
            Self::Good
        } else if gap_share <= 0.1 && skew_of_ts <= 1.0 {
            Self::Fair
        } else {
            Self::Poor
        }
    }
}

/// How the record became the window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportPreparation {
    /// Share of the record's samples that were missing or bad (0..1).
    pub gap_share: Option<f64>,
    /// Worst time between an OP sample and the PV sample it is paired with (s).
    pub worst_skew_s: Option<f64>,
    /// Samples dropped because their stamp repeats an earlier one.
    pub duplicates: usize,
    /// Samples that arrived out of order and were sorted in.
    pub out_of_order: usize,
    /// Low-pass decimation factor (1: none).
    pub decimation: usize,
}

/// What the denoising stage did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportDenoise {
    /// True when the soft threshold was applied.
    pub applied: bool,
    /// Noise sd of OP as a share of its sd (-).
    pub noise_share: Option<f64>,
}

/// The most regular oscillation of OP.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportOscillation {
    /// Mean period (s).
    pub period_s: Option<f64>,
    /// `r = mean(T) / (3 sd(T))` (-); above 1 is regular.
    pub regularity_r: Option<f64>,
    /// Half the mean peak-to-trough height of OP (`f_unit`).
    pub op_amplitude: Option<f64>,
}

/// The linear part `A(q) y = B(q) x + C(q) e` at f.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportModel {
    /// Order of A.
    pub na: usize,
    /// Number of coefficients in B.
    pub nb: usize,
    /// Order of C.
    pub nc: usize,
    /// Delay (samples).
    pub nk: usize,
    /// Root mean square of the prediction error (PV unit).
    pub rmse: Option<f64>,
    /// `a1..a_na`.
    pub a: Vec<Option<f64>>,
    /// `b1..b_nb` (PV unit per OP unit).
    pub b: Vec<Option<f64>>,
    /// `c1..c_nc`.
    pub c: Vec<Option<f64>>,
}

/// AIC over f, by increasing f.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportCurve {
    /// Friction (`f_unit`).
    pub f: Vec<Option<f64>>,
    /// AIC at that f, less the AIC at the estimate (-).
    pub aic: Vec<Option<f64>>,
}

/// Friction while a term of write-back acts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportCompensated {
    /// f as of before the term (`f_unit`); null where it is not known.
    pub f_before: Option<f64>,
    /// `consistent`, `changed` or `no_longer_visible`.
    pub seen: String,
}

impl ReportCompensated {
    fn new(own: Compensated) -> Self {
        Self { f_before: own.f_before.and_then(finite), seen: own.seen.as_str().to_string() }
    }

    /// What was written; `None` for a word that this version does not know.
    pub fn read(&self) -> Option<Compensated> {
        let seen = Seen::ALL.into_iter().find(|own| own.as_str() == self.seen)?;
        Some(Compensated { f_before: self.f_before, seen })
    }
}

/// A loop and its diagnosis, where OP's span is not known.
impl From<(&str, &Diagnosis)> for Report {
    fn from((name, diagnosis): (&str, &Diagnosis)) -> Self {
        Self::new(name, None, diagnosis)
    }
}

impl Report {
    /// The report of a loop; `op_span` (OP unit) as in the record that was diagnosed.
    pub fn new(name: &str, op_span: Option<f64>, diagnosis: &Diagnosis) -> Self {
        let unit = OpUnit::new(op_span);
        let estimate = diagnosis.estimate.as_ref();
        let prepared = Some(&diagnosis.preparation).filter(|preparation| preparation.n > 0);
        let (verdict, reason_code) = verdict(&diagnosis.verdict);
        Self {
            r#loop: name.to_string(),
            read_as: None,
            verdict,
            reason: diagnosis.reason.clone(),
            reason_code,
            f: estimate.and_then(|e| unit.scale(e.f)),
            f_ci95: estimate.and_then(|e| Some([unit.scale(e.f_ci95[0])?, unit.scale(e.f_ci95[1])?])),
            f_unit: unit.name.to_string(),
            f_unit_assumed: unit.assumed,
            op_span: op_span.and_then(finite),
            op_span_source: SpanSource::default().as_str().to_string(),
            f_threshold: estimate.and_then(|_| unit.scale(diagnosis.preparation.f_threshold)),
            f_of_op_range: estimate.and_then(|e| finite(e.f_of_op_range)),
            posterior: None,
            delta_aic: estimate.and_then(|e| finite(e.delta_aic)),
            rival: estimate.map(|e| e.rival.name().to_string()),
            steadiness: estimate.and_then(|e| finite(e.steadiness)),
            f_max: estimate.and_then(|e| unit.scale(e.f_max)),
            f_detectable: None,
            d_srinivasan: estimate.and_then(|e| unit.scale(e.d)),
            window: ReportWindow {
                history: diagnosis.preparation.history.as_deref().map(ReportHistory::new),
                ..window(prepared)
            },
            compensated: None,
            acquisition: diagnosis.preparation.acquisition.as_deref().map(ReportAcquisition::new),
            preparation: prepared.map(preparation),
            denoise: prepared.map(|p| ReportDenoise {
                applied: p.denoise.applied,
                noise_share: finite(p.denoise.noise_share),
            }),
            oscillation: diagnosis.oscillation.map(|o| ReportOscillation {
                period_s: finite(o.period),
                regularity_r: finite(o.regularity_r),
                op_amplitude: unit.scale(o.op_amplitude),
            }),
            model: estimate.map(|e| model(&e.model)),
            residual: ReportResidual::declared(diagnosis.residual.as_ref()),
            aic_curve: estimate.map(|e| ReportCurve {
                f: e.curve.iter().map(|point| unit.scale(point.f)).collect(),
                aic: e.curve.iter().map(|point| finite(point.aic)).collect(),
            }),
            opinions: Vec::new(),
            agreement: None,
            doubtful: false,
        }
    }
}

impl Report {
    /// The report of a run, with what was traced; `None` for a run that failed.
    pub fn of(run: &Run) -> Option<Self> {
        if let Outcome::Elsewhere(told) = &run.outcome {
            return Self::read(told.report.as_ref()?);
        }
        let source = run.basis.as_ref().map_or_else(SpanSource::default, |basis| basis.op_span_source);
        let mut report = Self::judged(run.id.as_str(), (run.op_span, source), run.judged()?);
        report.reason = run.reasoned(&report.reason);
        report.compensated = run.compensated().map(ReportCompensated::new);
        Some(report)
    }

    /// The report of a loop with all that was judged; `op_span`: OP's span (OP unit), and where it is known from.
    pub fn judged(name: &str, (op_span, source): (Option<f64>, SpanSource), judged: &Judged) -> Self {
        let mut report = Self::new(name, op_span, &judged.diagnosis);
        if let Some(found) = &judged.findings {
            report = report.with_findings(op_span, &judged.diagnosis, found);
        }
        let unit = OpUnit::new(op_span);
        report.opinions = judged.opinions.iter().map(|own| ReportOpinion::new(own, &unit)).collect();
        report.agreement = judged.agreement.as_ref().map(ReportAgreement::from);
        report.doubtful = judged.is_doubtful();
        report.with_span_from(source)
    }

    /// The report with where OP's span is known from.
    pub fn with_span_from(mut self, source: SpanSource) -> Self {
        self.op_span_source = source.as_str().to_string();
        self.f_unit_assumed |= source == SpanSource::Values;
        self
    }

    /// The stretch in which effects were looked for, where it is another than the diagnosed window.
    pub fn traced_elsewhere(&self) -> Option<&ReportTraced> {
        let window = &self.window;
        let near = |own: Option<f64>, other: Option<f64>| {
            // Half a sample: the two were computed along different ways.
            own.zip(other).zip(window.ts_s).is_some_and(|((own, other), ts)| (own - other).abs() < 0.5 * ts)
        };
        let same = |traced: &&ReportTraced| {
            traced.n == window.n && near(traced.start, window.start) && near(traced.end, window.end)
        };
        self.residual.traced.as_ref().filter(|traced| !same(traced))
    }

    /// What the next run may take as given.
    pub fn structure(&self) -> Option<Structure> {
        self.residual.structure.as_ref()?.read()
    }

    /// The report with what was traced: verdict, f, its interval and evidence come from there, whether or not effects were
    /// found; where tracing cannot tell friction the declared model's stand.
    pub fn with_findings(mut self, op_span: Option<f64>, diagnosis: &Diagnosis, found: &Findings) -> Self {
        let unit = OpUnit::new(op_span);
        self.residual = ReportResidual::traced(found, &unit, &diagnosis.verdict);
        if found.structure.as_ref().is_some_and(|structure| structure.confirmed > 0) {
            // None was weighed.
            self.rival = None;
        }
        self.f_detectable = found.f_detectable.and_then(|f| unit.scale(f));
        if !found.replaces_diagnosis() {
            return self;
        }
        let friction = &found.friction_after;
        (self.verdict, self.reason_code) = verdict(&found.verdict);
        self.reason = found.reason.clone();
        self.f_max = unit.scale(found.f_max);
        if self.reason_code.is_some() {
            (self.f, self.f_ci95, self.f_of_op_range, self.delta_aic) = (None, None, None, None);
            return self;
        }
        self.f = unit.scale(friction.f);
        self.f_ci95 = unit.scale(friction.f_ci95[0]).zip(unit.scale(friction.f_ci95[1])).map(|(a, b)| [a, b]);
        self.posterior = finite(friction.posterior);
        self.delta_aic = finite(friction.delta_aic);
        if let Some((low, high)) = diagnosis.op_range() {
            self.f_of_op_range = finite(friction.f / (high - low));
        }
        self.model = Some(model(&found.model));
        self
    }
}

fn verdict(verdict: &Verdict) -> (ReportVerdict, Option<String>) {
    match verdict {
        Verdict::Stiction => (ReportVerdict::Stiction, None),
        Verdict::NoStiction => (ReportVerdict::NoStiction, None),
        Verdict::NotIdentifiable(why) => (ReportVerdict::NotIdentifiable, Some(why.code().to_string())),
    }
}

/// How far the window of a diagnosis is measured rather than filled in.
pub fn quality(diagnosis: &Diagnosis) -> WindowQuality {
    let p = &diagnosis.preparation;
    if p.n > 0 { WindowQuality::of(p.gap_share, p.worst_skew / p.ts) } else { WindowQuality::Poor }
}

fn window(prepared: Option<&diagnosis::Preparation>) -> ReportWindow {
    ReportWindow {
        start: prepared.and_then(|p| finite(p.start)),
        end: prepared.and_then(|p| finite(p.end)),
        n: prepared.map_or(0, |p| p.n),
        ts_s: prepared.and_then(|p| finite(p.ts)),
        quality: prepared
            .map_or(WindowQuality::Poor, |p| WindowQuality::of(p.gap_share, p.worst_skew / p.ts)),
        missing: prepared.and_then(|p| finite(p.missing)),
        history: None,
    }
}

fn preparation(p: &diagnosis::Preparation) -> ReportPreparation {
    ReportPreparation {
        gap_share: finite(p.gap_share),
        worst_skew_s: finite(p.worst_skew),
        duplicates: p.duplicates,
        out_of_order: p.out_of_order,
        decimation: p.decimation,
    }
}

fn model(m: &diagnosis::Model) -> ReportModel {
    let all = |values: &[f64]| values.iter().map(|value| finite(*value)).collect();
    ReportModel {
        na: m.na,
        nb: m.nb,
        nc: m.nc,
        nk: m.nk,
        rmse: finite(m.rmse),
        a: all(&m.a),
        b: all(&m.b),
        c: all(&m.c),
    }
}

#[cfg(test)]
mod tests;
