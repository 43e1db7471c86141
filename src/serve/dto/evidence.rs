//! The picture behind a verdict as JSON: columns for plots.

use super::report::{Report, ReportEffect};
use super::{finite, rfc3339};
use crate::results::{Known, Residuals, Run};
use crate::serve::picture::{self, Band};
use crate::serve::words;
use crate::signal::Window;
use serde::Serialize;
use utoipa::ToSchema;

/// What the latest diagnosis of a loop saw, for drawing.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct LoopEvidence {
    /// The loop's name.
    pub r#loop: String,
    /// When the diagnosis was made.
    pub time: Option<String>,
    /// The verdict, as an operator would say it.
    pub words: String,
    /// The effects that were found, in words, in the report's order.
    pub effects: Vec<EffectWords>,
    /// What is to be known beside them, in words: between which kinds the record lies, and whether the model simulates worse
    /// with them.
    pub notes: Vec<String>,
    /// What is still to be seen in the residual, in words.
    pub left: Vec<String>,
    /// The window that was fitted; null when the record never became one.
    pub window: Option<EvidenceWindow>,
    /// Dead band plus stick band (2f) over OP and PV; null without friction.
    pub band: Option<EvidenceBand>,
    /// What the models leave over; null when nothing could be traced.
    pub residual: Option<EvidenceResidual>,
}

/// An effect, as an operator would say it.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct EffectWords {
    /// Which.
    pub kind: String,
    /// What it is, in a line, with its tag.
    pub title: String,
    /// What it means, in a sentence that says how sure it is.
    pub meaning: String,
    /// What to do: what to look at first, and from a posterior of 0.9 on what costs money or a shutdown.
    pub advice: String,
    /// Probability that it is there (0..1).
    pub posterior: Option<f64>,
    /// With its numbers.
    pub detail: String,
}

impl From<&ReportEffect> for EffectWords {
    fn from(found: &ReportEffect) -> Self {
        let said = words::effect(found);
        let title = said.as_ref().map_or_else(|| found.kind.replace('_', " "), |said| said.title.clone());
        let (meaning, advice) = said.map(|said| (said.meaning, said.advice)).unwrap_or_default();
        Self {
            kind: found.kind.clone(),
            title: found.tag.as_ref().map_or_else(|| title.clone(), |tag| format!("{title}: {tag}")),
            meaning,
            advice,
            posterior: found.posterior,
            detail: found.explanation.clone(),
        }
    }
}

/// The window that was fitted, on an equal grid; of a kept report each value to 1/65534 of its signal's range.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct EvidenceWindow {
    /// First time.
    pub start: Option<String>,
    /// Sample period (s).
    pub ts_s: Option<f64>,
    /// Controller output (OP unit).
    pub op: Vec<Option<f64>>,
    /// Process variable (PV unit).
    pub pv: Vec<Option<f64>>,
    /// Set point (PV unit), where recorded.
    pub sp: Option<Vec<Option<f64>>>,
    /// Measured stem position, where there is one.
    pub mv: Option<Vec<Option<f64>>>,
    /// Stem position that the friction found implies (OP unit); null when f is not known.
    pub stem: Option<Vec<Option<f64>>>,
}

/// Dead band plus stick band (2f), what the fitted element draws in one swing: where the stem turns round it stands until OP has come back by 2f.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct EvidenceBand {
    /// Friction parameter, S/2 (OP unit).
    pub f_op: Option<f64>,
    /// OP where the stem turns round, below and above (OP unit).
    pub op_turns: [Option<f64>; 2],
    /// The stem there (OP unit).
    pub stem_turns: [Option<f64>; 2],
    /// Its corners, each OP and PV: the stem stands from the first to the second and from the third to the fourth.
    pub corners: Vec<[Option<f64>; 2]>,
    /// Whether PV follows the stem; if not, the band stands upright.
    pub follows: bool,
}

/// The one-step residual before and after effects were added, and what is in it.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct EvidenceResidual {
    /// First time.
    pub start: Option<String>,
    /// Sample period (s).
    pub ts_s: Option<f64>,
    /// First held-out sample: nothing was fitted to it, but it may have rejected effects.
    pub split: usize,
    /// Of the declared model (PV unit).
    pub before: Vec<Option<f64>>,
    /// With the effects (PV unit).
    pub after: Vec<Option<f64>>,
    /// Periods of the spectrum (s).
    pub period_s: Vec<Option<f64>>,
    /// Power at each period (PV unit²) of the declared model's residual.
    pub power_before: Vec<Option<f64>>,
    /// … with the effects.
    pub power_after: Vec<Option<f64>>,
    /// Correlation of the declared model's residual with its own past, from lag 1 on (-).
    pub acf_before: Vec<Option<f64>>,
    /// … with the effects.
    pub acf_after: Vec<Option<f64>>,
    /// Correlation of the declared model's residual with past OP, from lag 0 on (-).
    pub ccf_before: Vec<Option<f64>>,
    /// … with the effects.
    pub ccf_after: Vec<Option<f64>>,
    /// Correlations of white noise stay within ± this, 99 of 100 (-).
    pub limit: Option<f64>,
}

fn column(values: &[f64]) -> Vec<Option<f64>> {
    values.iter().map(|value| finite(*value)).collect()
}

impl LoopEvidence {
    /// The picture behind the latest diagnosis; of one from before the start only the words are left. `None` before the first.
    pub fn latest(known: &Known) -> Option<Self> {
        if let Some(run) = &known.diagnosed {
            return Self::new(run);
        }
        let restored = known.restored.as_ref()?;
        let report = Report::read(&restored.report)?;
        Some(Self::said(report, restored.finished))
    }

    /// The picture behind a run; `None` for a run that failed.
    fn new(run: &Run) -> Option<Self> {
        let judged = run.judged()?;
        let window = judged.diagnosis.shown_window();
        let window = window.as_deref().filter(|window| !window.is_empty());
        let stem = picture::stem(judged);
        let f = judged.friction().map_or(0.0, |(f, ..)| f);
        let band = window.zip(stem.as_ref()).and_then(|(window, stem)| picture::band(window, stem, f));
        let residual = judged.residuals.as_ref().filter(|r| !r.before.is_empty());
        Some(Self {
            window: window.map(|window| EvidenceWindow {
                start: rfc3339(window.t0),
                ts_s: finite(window.ts),
                op: column(&window.op),
                pv: column(&window.pv),
                sp: window.sp.as_deref().map(column),
                mv: window.mv.as_deref().map(column),
                stem: stem.as_deref().map(column),
            }),
            band: window.zip(band).map(|(window, band)| EvidenceBand::new(&band, &window.pv)),
            residual: residual.map(|residual| EvidenceResidual::new(residual, window)),
            ..Self::said(Report::of(run)?, run.finished)
        })
    }

    /// What is said, without a picture.
    fn said(report: Report, finished: f64) -> Self {
        Self {
            words: words::verdict(&report),
            effects: report.residual.effects.iter().map(EffectWords::from).collect(),
            notes: words::notes(&report),
            left: report.residual.failed_tests.iter().map(|test| words::failed_test(test)).collect(),
            time: rfc3339(finished),
            r#loop: report.r#loop,
            window: None,
            band: None,
            residual: None,
        }
    }
}

impl EvidenceBand {
    fn new(band: &Band, pv: &[f64]) -> Self {
        let corners = picture::corners(band, pv);
        Self {
            f_op: finite(band.f),
            op_turns: band.op.map(finite),
            stem_turns: band.stem.map(finite),
            corners: corners.iter().map(|corner| corner.map(finite)).collect(),
            follows: band.pv.is_some(),
        }
    }
}

impl EvidenceResidual {
    fn new(residual: &Residuals, window: Option<&Window>) -> Self {
        let inside = picture::inside(residual, window);
        Self {
            start: rfc3339(residual.t0),
            ts_s: finite(residual.ts),
            split: residual.split,
            before: column(&residual.before.values()),
            after: column(&residual.after.values()),
            period_s: column(&inside.period),
            power_before: column(&inside.power[0]),
            power_after: column(&inside.power[1]),
            acf_before: column(&inside.with_itself[0]),
            acf_after: column(&inside.with_itself[1]),
            ccf_before: column(&inside.with_op[0]),
            ccf_after: column(&inside.with_op[1]),
            limit: finite(inside.limit),
        }
    }
}
