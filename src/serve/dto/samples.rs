//! Trends as JSON: columns, because a screen wants columns and they are a third of the size of rows.

use super::{finite, rfc3339};
use crate::history::Trend;
use crate::signal::{Quality, Sample};
use serde::Serialize;
use utoipa::ToSchema;

/// The trends of one loop.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Samples {
    /// The loop's name.
    pub r#loop: String,
    /// From when; null when not asked.
    pub from: Option<String>,
    /// Up to when; null when not asked.
    pub to: Option<String>,
    /// Its tags.
    pub tags: Vec<TagSamples>,
}

/// The trend of one tag.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct TagSamples {
    /// `op`, `pv`, `sp`, `mode`, `mv` or the name of an extra tag.
    pub tag: String,
    /// Engineering unit; empty when none is configured.
    pub unit: String,
    /// Samples that lay between the limits, before thinning.
    pub found: usize,
    /// The last sample before `from`: a value that is sent only when it changes holds until the next. Null where there is none, and
    /// in events.
    pub before: Option<SampleItem>,
    /// Whether no good value was repeated in all that is remembered: the source may send changes only.
    pub by_changes: bool,
    /// Times, ascending.
    pub time: Vec<Option<String>>,
    /// Values; null where bad.
    pub value: Vec<Option<f64>>,
    /// Qualities: `good`, `stale`, `bad:…`.
    pub quality: Vec<&'static str>,
}

/// One sample.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SampleItem {
    /// When.
    pub time: Option<String>,
    /// Its value; null where bad.
    pub value: Option<f64>,
    /// Its quality: `good`, `stale`, `bad:…`.
    pub quality: &'static str,
}

impl From<&Sample> for SampleItem {
    fn from(sample: &Sample) -> Self {
        Self { time: rfc3339(sample.t), value: value(sample), quality: sample.quality.as_str() }
    }
}

/// The value of a sample that is not bad.
fn value(sample: &Sample) -> Option<f64> {
    finite(sample.value).filter(|_| !matches!(sample.quality, Quality::Bad(_)))
}

impl From<&Trend> for TagSamples {
    fn from(trend: &Trend) -> Self {
        Self {
            tag: trend.tag.kind.name().to_string(),
            unit: trend.tag.unit.clone(),
            found: trend.found,
            before: trend.before.as_ref().map(SampleItem::from),
            by_changes: trend.by_changes,
            time: trend.samples.iter().map(|s| rfc3339(s.t)).collect(),
            value: trend.samples.iter().map(value).collect(),
            quality: trend.samples.iter().map(|s| s.quality.as_str()).collect(),
        }
    }
}
