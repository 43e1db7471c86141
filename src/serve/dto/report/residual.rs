//! What the model leaves unexplained, and the effects that it was traced to, as the report writes them.

use super::{OpUnit, finite};
use crate::diagnosis::{self, Verdict};
use crate::residual::{self, Findings, Kind};
use crate::serve::dto::Structure;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The parameter that says where an effect acts.
const PLACE: &str = "where";
/// Most kinds that are told as candidates, `none` among them.
const MOST_CANDIDATES: usize = 3;

/// The residual before and after effects were added to the declared model, on samples to which no coefficient was fitted: the last
/// 20 % of the traced stretch; where nothing was traced, the last 30 % that the diagnosis keeps. The last 20 % also reject effects, so
/// that the errors with the effects may be too small.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportResidual {
    /// The stretch of the record in which effects were looked for; null where nothing was traced.
    #[serde(default)]
    pub traced: Option<ReportTraced>,
    /// White under the declared model; null when not identifiable.
    pub white_before: Option<bool>,
    /// White with the effects.
    pub white_after: Option<bool>,
    /// One-step-ahead error under the declared model (PV unit).
    pub one_step_rmse_before: Option<f64>,
    /// One-step-ahead error with the effects (PV unit), on samples that also rejected effects: it may be too small.
    pub one_step_rmse_after: Option<f64>,
    /// Free-run error under the declared model (PV unit).
    pub free_run_rmse_before: Option<f64>,
    /// Free-run error with the effects (PV unit), on the same samples.
    pub free_run_rmse_after: Option<f64>,
    /// What was added to the declared model, in that order; empty when it suffices.
    pub effects: Vec<ReportEffect>,
    /// The likeliest kinds of effect when the last was looked for, at most three, and always `none`, as the last where three
    /// kinds are likelier: where none of them has more than half, the record lies between them. Empty where nothing was
    /// searched for.
    #[serde(default)]
    pub candidates: Vec<ReportCandidate>,
    /// The free run with the effects is worse than the declared model's.
    #[serde(default)]
    pub simulates_worse: bool,
    /// The residual is not white and no effect explains it.
    pub unexplained: bool,
    /// The tests that the final residual fails: `whiteness`, `line_spectrum`, ….
    pub failed_tests: Vec<String>,
    /// What the next run may take as given; null where it has to search.
    #[serde(default, deserialize_with = "known_structure")]
    pub structure: Option<Structure>,
    /// Friction before the effects (`f_unit`); the report's own f is the one after.
    pub f_before: Option<f64>,
    /// Friction estimated together with the effects (`f_unit`).
    pub f_after: Option<f64>,
    /// The verdict before the effects.
    pub verdict_before: Option<String>,
    /// Friction and residual of OP -> measured stem; null without one.
    pub stem: Option<ReportStem>,
}

/// The stretch of the record that was traced: all that is usable of it, or 2,000 samples around the diagnosed window where that is
/// more. An effect may have set in outside of the diagnosed window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportTraced {
    /// Time of the first sample (s).
    pub start: Option<f64>,
    /// Time of the last sample (s).
    pub end: Option<f64>,
    /// Samples.
    pub n: usize,
}

/// What OP and the measured stem say directly, without a process in between.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportStem {
    /// Friction fitted on OP -> MV (`f_unit`).
    pub f: Option<f64>,
    /// Its 95 % interval (`f_unit`).
    pub f_ci95: Option<[f64; 2]>,
    /// Probability of it (0..1).
    pub posterior: Option<f64>,
    /// Evidence for it (-).
    pub delta_aic: Option<f64>,
    /// Kinetic lag (S - J)/2 (`f_unit`).
    pub lag: Option<f64>,
    /// White with the effects.
    pub white_after: Option<bool>,
    /// One-step-ahead error of the stem before and after the effects (MV unit).
    pub one_step_rmse: [Option<f64>; 2],
    /// Free-run error of the stem before and after the effects (MV unit).
    pub free_run_rmse: [Option<f64>; 2],
    /// Effects on the way from OP to the stem.
    pub effects: Vec<ReportEffect>,
}

/// One effect beside friction and the linear process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportEffect {
    /// Which effect: `oscillating_load`, `measured_disturbance`, ….
    pub kind: String,
    /// Probability that it is there (0..1).
    pub posterior: Option<f64>,
    /// Evidence for it, twice the logarithm of the odds against none (-); null where the signals alone show it.
    pub delta_aic: Option<f64>,
    /// The tag it comes from, where it is measured.
    pub tag: Option<String>,
    /// Its numbers, by name with unit. `where` of a `static_nonlinearity` is a text: `valve` or `process`.
    pub parameters: BTreeMap<String, ReportParameter>,
    /// In one sentence.
    pub explanation: String,
}

/// A number of an effect, or the place where it acts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum ReportParameter {
    /// A number, in the unit that its name says; null where it does not exist.
    Number(Option<f64>),
    /// A place: `valve` or `process`.
    Text(String),
}

impl ReportEffect {
    /// Where it acts, where its kind has more than one place.
    pub fn place(&self) -> Option<&str> {
        match self.parameters.get(PLACE)? {
            ReportParameter::Text(place) => Some(place),
            ReportParameter::Number(_) => None,
        }
    }
}

/// A kind of effect that the record may show.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReportCandidate {
    /// Which: a kind of effect, or `none`.
    pub kind: String,
    /// Its probability (0..1).
    pub posterior: Option<f64>,
}

impl ReportResidual {
    /// The candidates by kind, with their posteriors.
    pub fn kinds(&self) -> Vec<(&str, f64)> {
        self.candidates.iter().filter_map(|own| Some((own.kind.as_str(), own.posterior?))).collect()
    }

    /// The free-run error with the effects over that of the declared model (-); `None` where one of them is not known, or the latter
    /// is 0.
    pub fn free_run_ratio(&self) -> Option<f64> {
        let (before, after) = self.free_run_rmse_before.zip(self.free_run_rmse_after)?;
        Some(after / before).filter(|ratio| ratio.is_finite())
    }

    /// The residual where nothing was traced: the declared model stands before and after.
    pub(super) fn declared(residual: Option<&diagnosis::Residual>) -> Self {
        let white = residual.map(|r| r.white);
        let one_step = residual.and_then(|r| finite(r.one_step_rmse));
        let free_run = residual.and_then(|r| finite(r.free_run_rmse));
        ReportResidual {
            traced: None,
            white_before: white,
            white_after: white,
            one_step_rmse_before: one_step,
            one_step_rmse_after: one_step,
            free_run_rmse_before: free_run,
            free_run_rmse_after: free_run,
            effects: Vec::new(),
            candidates: Vec::new(),
            simulates_worse: false,
            unexplained: white == Some(false),
            failed_tests: Vec::new(),
            structure: None,
            f_before: None,
            f_after: None,
            verdict_before: None,
            stem: None,
        }
    }

    /// The residual as it was traced.
    pub(super) fn traced(findings: &Findings, unit: &OpUnit, verdict_before: &Verdict) -> Self {
        // Without a search the declared model was not asked.
        let asked = findings.structure.as_ref().is_none_or(|structure| structure.confirmed == 0);
        let known = asked && !matches!(verdict_before, Verdict::NotIdentifiable(_));
        let residual::Traced { start, end, n } = findings.traced;
        ReportResidual {
            traced: Some(ReportTraced { start: finite(start), end: finite(end), n }),
            white_before: Some(findings.before.white),
            white_after: Some(findings.after.white),
            one_step_rmse_before: finite(findings.before.one_step_rmse),
            one_step_rmse_after: finite(findings.after.one_step_rmse),
            free_run_rmse_before: finite(findings.before.free_run_rmse),
            free_run_rmse_after: finite(findings.after.free_run_rmse),
            effects: effects(findings),
            candidates: candidates(findings),
            simulates_worse: findings.simulates_worse,
            unexplained: findings.unexplained,
            failed_tests: findings.failed.iter().map(|test| test.as_str().to_string()).collect(),
            structure: findings.structure.as_ref().map(Structure::from),
            f_before: unit.scale(findings.friction_before.f).filter(|_| known),
            f_after: unit.scale(findings.friction_after.f).filter(|_| findings.replaces_diagnosis()),
            verdict_before: asked.then(|| verdict_before.as_str().to_string()),
            stem: findings.stem.as_ref().map(|own| stem(own, unit)),
        }
    }
}

/// A structure of another version is none: the report is read all the same.
fn known_structure<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Structure>, D::Error> {
    Ok(serde_json::from_value(serde_json::Value::deserialize(from)?).ok())
}

fn effects(findings: &Findings) -> Vec<ReportEffect> {
    let effect = |e: &residual::Effect| ReportEffect {
        kind: e.kind.as_str().to_string(),
        posterior: finite(e.posterior),
        delta_aic: finite(e.delta_aic),
        tag: e.tag.clone(),
        parameters: parameters(e),
        explanation: e.explanation.clone(),
    };
    findings.effects.iter().map(effect).collect()
}

fn parameters(effect: &residual::Effect) -> BTreeMap<String, ReportParameter> {
    let numbers = effect.parameters.iter();
    let numbers = numbers.map(|p| (p.name.to_string(), ReportParameter::Number(finite(p.value))));
    let place = effect.place.map(|place| (PLACE.to_string(), ReportParameter::Text(place.to_string())));
    numbers.chain(place).collect()
}

fn candidates(findings: &Findings) -> Vec<ReportCandidate> {
    let candidate = |(kind, posterior): &(Option<Kind>, f64)| ReportCandidate {
        kind: kind.map_or("none", Kind::as_str).to_string(),
        posterior: finite(*posterior),
    };
    let (told, rest) = findings.candidates.split_at(MOST_CANDIDATES.min(findings.candidates.len()));
    let mut told: Vec<_> = told.iter().collect();
    // How likely it is that there is no further effect is always told.
    if let Some(none) = rest.iter().find(|(kind, _)| kind.is_none()) {
        told.truncate(MOST_CANDIDATES - 1);
        told.push(none);
    }
    told.into_iter().map(candidate).collect()
}

fn stem(stem: &residual::Stem, unit: &OpUnit) -> ReportStem {
    let inner = stem.findings.as_ref();
    let rmse = |of: &dyn Fn(&diagnosis::Residual) -> f64| {
        [inner.and_then(|f| finite(of(&f.before))), inner.and_then(|f| finite(of(&f.after)))]
    };
    let [low, high] = stem.friction.f_ci95.map(|limit| unit.scale(limit));
    ReportStem {
        f: unit.scale(stem.friction.f),
        f_ci95: low.zip(high).map(|(low, high)| [low, high]),
        posterior: finite(stem.friction.posterior),
        delta_aic: finite(stem.friction.delta_aic),
        lag: unit.scale(stem.friction.lag),
        white_after: inner.map(|f| f.after.white),
        one_step_rmse: rmse(&|residual| residual.one_step_rmse),
        free_run_rmse: rmse(&|residual| residual.free_run_rmse),
        effects: inner.map_or_else(Vec::new, |f| effects(f)),
    }
}
