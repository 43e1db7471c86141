//! `[store]`: where what was measured and said is kept, and for how long.

use serde::Deserialize;
use std::path::PathBuf;

/// `[store]`; without the section nothing is kept.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Folder of the store, made when it is not there; on a disk of this machine.
    pub folder: PathBuf,
    /// Most bytes of its database (MB); what is oldest goes first.
    #[serde(default = "default_max_mb")]
    pub max_mb: u64,
    /// Samples in full are kept for this long (days), then thinned to trends.
    #[serde(default = "default_samples_days")]
    pub samples_days: f64,
    /// Trends, least, mean and most of each `trend_s`, are kept for this long (days); 0 for none.
    #[serde(default = "default_trend_days")]
    pub trend_days: f64,
    /// Time that one point of a trend stands for (s).
    #[serde(default = "default_trend_s")]
    pub trend_s: u32,
    /// Diagnoses and models are kept for this long (days); the latest of a loop always.
    #[serde(default = "default_diagnoses_days")]
    pub diagnoses_days: f64,
    /// What happened to alarms is kept for this long (days); their state always.
    #[serde(default = "default_alarms_days")]
    pub alarms_days: f64,
    /// How often what is new is made durable (ms): a power failure costs at most this much.
    #[serde(default = "default_sync_ms")]
    pub sync_ms: u64,
    /// Samples of one tag that lie together on disk (s).
    #[serde(default = "default_chunk_s")]
    pub chunk_s: u32,
    /// Most memory for diagnoses and alarms that wait while the store fails (MB).
    #[serde(default = "default_queue_mb")]
    pub queue_mb: u64,
}

fn default_max_mb() -> u64 {
    20_000
}

fn default_samples_days() -> f64 {
    30.0
}

fn default_trend_days() -> f64 {
    730.0
}

fn default_trend_s() -> u32 {
    60
}

fn default_diagnoses_days() -> f64 {
    1825.0
}

fn default_alarms_days() -> f64 {
    1825.0
}

fn default_sync_ms() -> u64 {
    1000
}

fn default_chunk_s() -> u32 {
    60
}

fn default_queue_mb() -> u64 {
    64
}

impl Config {
    /// A store in a folder, everything else as it is by default.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
            max_mb: default_max_mb(),
            samples_days: default_samples_days(),
            trend_days: default_trend_days(),
            trend_s: default_trend_s(),
            diagnoses_days: default_diagnoses_days(),
            alarms_days: default_alarms_days(),
            sync_ms: default_sync_ms(),
            chunk_s: default_chunk_s(),
            queue_mb: default_queue_mb(),
        }
    }

    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        let named = !self.folder.as_os_str().is_empty();
        unless(named, "folder", "must name a folder".to_string());
        let counts = [
            ("max_mb", self.max_mb, 16..=100_000_000),
            ("trend_s", u64::from(self.trend_s), 1..=600),
            ("sync_ms", self.sync_ms, 10..=60_000),
            ("chunk_s", u64::from(self.chunk_s), 10..=600),
            ("queue_mb", self.queue_mb, 1..=10_000),
        ];
        for (field, value, range) in counts {
            unless(
                range.contains(&value),
                field,
                format!("{value} must be {} to {}", range.start(), range.end()),
            );
        }
        let days = [
            ("samples_days", self.samples_days, 0.01),
            ("trend_days", self.trend_days, 0.0),
            ("diagnoses_days", self.diagnoses_days, 1.0),
            ("alarms_days", self.alarms_days, 1.0),
        ];
        for (field, value, least) in days {
            unless((least..=36_500.0).contains(&value), field, format!("{value} must be {least} to 36500"));
        }
        let divides = (1..=600).contains(&self.trend_s) && 600 % self.trend_s == 0;
        unless(divides, "trend_s", format!("{} must divide 600 s", self.trend_s));
        wrong
    }
}
