//! `[schedule]`.

use serde::Deserialize;

/// `[schedule]`: how often, how many at once, how long.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Time between two diagnoses of a loop (s); a loop may have its own.
    pub period_s: f64,
    /// Diagnoses that run at the same time.
    pub parallelism: usize,
    /// Longest time a diagnosis may take (s), on the wall clock.
    pub deadline_s: f64,
    /// Runs on demand that may wait for a free slot; those that are due wait as long as it takes, each loop once.
    pub queue: usize,
    /// Diagnoses remembered of each loop, as summaries.
    pub keep_results: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self { period_s: 3600.0, parallelism: 1, deadline_s: 30.0, queue: 256, keep_results: 200 }
    }
}

impl Config {
    /// Everything wrong with it, by field; empty when it can be used.
    pub fn validate(&self) -> Vec<(&'static str, String)> {
        let mut wrong = Vec::new();
        let mut unless = |ok: bool, field, message: String| {
            if !ok {
                wrong.push((field, message));
            }
        };
        let (period, deadline) = (self.period_s, self.deadline_s);
        unless(
            (1.0..=31.0 * 86_400.0).contains(&period),
            "period_s",
            format!("{period} must be 1 to 2678400"),
        );
        unless((0.1..=3600.0).contains(&deadline), "deadline_s", format!("{deadline} must be 0.1 to 3600"));
        let (slots, queue, keep) = (self.parallelism, self.queue, self.keep_results);
        unless((1..=256).contains(&slots), "parallelism", format!("{slots} must be 1 to 256"));
        unless((1..=100_000).contains(&queue), "queue", format!("{queue} must be 1 to 100000"));
        unless((1..=10_000).contains(&keep), "keep_results", format!("{keep} must be 1 to 10000"));
        wrong
    }
}
