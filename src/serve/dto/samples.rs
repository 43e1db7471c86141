//! Trends as JSON: columns, because a screen wants columns and they are a third of the size of rows.

use super::{finite, rfc3339};
use crate::history::Trend;
use crate::signal::Quality;
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
    /// Times, ascending.
    pub time: Vec<Option<String>>,
    /// Values; null where bad.
    pub value: Vec<Option<f64>>,
    /// Qualities: `good`, `stale`, `bad:…`.
    pub quality: Vec<&'static str>,
}

impl From<&Trend> for TagSamples {
    fn from(trend: &Trend) -> Self {
        let usable = |quality| !matches!(quality, Quality::Bad(_));
        Self {
            tag: trend.tag.kind.name().to_string(),
            unit: trend.tag.unit.clone(),
            found: trend.found,
            time: trend.samples.iter().map(|s| rfc3339(s.t)).collect(),
            value: trend.samples.iter().map(|s| finite(s.value).filter(|_| usable(s.quality))).collect(),
            quality: trend.samples.iter().map(|s| s.quality.as_str()).collect(),
        }
    }
}
