//! A diagnosis with everything it rests on, in one file: samples, settings, version, report.

use super::{BasisText, Report};
use crate::results::{Basis, Run, Trigger, basis};
use crate::schedule;
use crate::serve::LoopInfo;
use crate::signal::{Quality, Record, Sample};
use crate::version::BUILD;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the file calls itself.
pub const FORMAT: &str = "stictiond bundle 1";
/// Most samples of all tags in one bundle; about 40 bytes each.
pub const MOST_SAMPLES: usize = 1_000_000;

/// A diagnosis with everything it rests on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Bundle {
    /// `stictiond bundle 1`.
    pub format: String,
    /// Version of the daemon that made the report, and behind a `+` the identity of its build.
    pub version: String,
    /// The loop.
    pub r#loop: BundleLoop,
    /// When the run began (s since the Unix epoch).
    pub started: f64,
    /// When it ended (s since the Unix epoch).
    pub finished: f64,
    /// Whether somebody asked for it.
    pub on_demand: bool,
    /// Settings, what the run before found, and which samples.
    pub basis: BasisText,
    /// The report.
    pub report: Report,
    /// The samples.
    pub samples: Vec<BundleTag>,
}

/// The loop as it is configured, without addresses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BundleLoop {
    /// Its name.
    pub id: String,
    /// For people.
    pub description: String,
    /// For people.
    pub group: String,
    /// Time between two diagnoses (s).
    pub period_s: f64,
}

/// The samples of one tag, as they came: three columns of equal length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BundleTag {
    /// `op`, `pv`, `sp`, `mode`, `mv` or another tag's name.
    pub tag: String,
    /// Stamps (s since the Unix epoch).
    pub t: Vec<f64>,
    /// Values; null where there is no number.
    pub value: Vec<Option<f64>>,
    /// Qualities: `good`, `stale`, `bad:…`.
    pub quality: Vec<String>,
}

impl Bundle {
    /// The bundle of a run on `record`; `None` for a run that failed.
    pub fn of(info: &LoopInfo, run: &Run, basis: &Basis, record: &Record) -> Option<Self> {
        Some(Self {
            format: FORMAT.to_string(),
            version: BUILD.to_string(),
            r#loop: BundleLoop {
                id: info.id.to_string(),
                description: info.description.clone(),
                group: info.group.clone(),
                period_s: info.period_s,
            },
            started: run.started,
            finished: run.finished,
            on_demand: run.trigger == Trigger::OnDemand,
            basis: basis.into(),
            report: Report::of(run)?,
            samples: basis::series(record).map(|(tag, samples)| BundleTag::of(tag, samples)).collect(),
        })
    }

    /// The bundle in a text.
    ///
    /// # Errors
    /// What is wrong with it, in one line.
    pub fn read(text: &str) -> Result<Self, String> {
        let bundle: Self =
            serde_json::from_str(text).map_err(|error| format!("not a diagnosis bundle: {error}"))?;
        if bundle.format != FORMAT {
            return Err(format!("a bundle of format {:?}, this version reads {FORMAT:?}", bundle.format));
        }
        Ok(bundle)
    }

    /// What the run worked on, samples included.
    ///
    /// # Errors
    /// What does not fit together, in one line.
    pub fn record(&self) -> Result<(Basis, Record), String> {
        let schedule = schedule::Config { period_s: self.r#loop.period_s, ..schedule::Config::default() };
        if let Some((_, message)) = schedule.validate().into_iter().find(|(field, _)| *field == "period_s") {
            return Err(format!("its settings cannot be used: period_s: {message}"));
        }
        if ![self.started, self.finished].iter().all(|t| (0.0..1e11).contains(t)) {
            return Err("it began or ended at no time that there is".into());
        }
        let basis = self.basis.basis()?;
        let mut record = Record::default();
        for own in &self.samples {
            basis::put(&mut record, &own.tag, own.samples()?);
        }
        let (record, lost) = basis.cut(record);
        match lost.is_empty() {
            true => Ok((basis, record)),
            false => Err(format!("the samples of {} are not those that were diagnosed", lost.join(", "))),
        }
    }
}

impl BundleTag {
    fn of(tag: &str, samples: &[Sample]) -> Self {
        Self {
            tag: tag.to_string(),
            t: samples.iter().map(|s| s.t).collect(),
            value: samples.iter().map(|s| Some(s.value).filter(|value| value.is_finite())).collect(),
            quality: samples.iter().map(|s| s.quality.as_str().to_string()).collect(),
        }
    }

    fn samples(&self) -> Result<Vec<Sample>, String> {
        let wrong = |what: &str| format!("tag {:?}: {what}", self.tag);
        if self.t.len() != self.value.len() || self.t.len() != self.quality.len() {
            return Err(wrong("columns of unequal length"));
        }
        let rows = self.t.iter().zip(&self.value).zip(&self.quality);
        rows.map(|((t, value), quality)| {
            let named = Quality::named(quality);
            let quality = named.ok_or_else(|| wrong("a quality that there is not"))?;
            Ok(Sample { t: *t, value: value.unwrap_or(f64::NAN), quality })
        })
        .collect()
    }
}
