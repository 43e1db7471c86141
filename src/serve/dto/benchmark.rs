//! How often the published methods and the program are right on labelled records: `benchmark --format json`.

use super::finite;
use super::report::ReportSays;
use crate::detectors::tally::{Tally, quantile, wilson};
use serde::Serialize;

/// A benchmark.
#[derive(Clone, Debug, Serialize)]
pub struct BenchmarkReport {
    /// The folder.
    pub folder: String,
    /// Each method, in the order of `docs/benchmark.md`, and at last the program.
    pub judges: Vec<BenchmarkJudge>,
    /// Record by record.
    pub records: Vec<BenchmarkRecord>,
}

/// How often one of them is right.
#[derive(Clone, Debug, Serialize)]
pub struct BenchmarkJudge {
    /// The method, or `program`.
    pub method: String,
    /// What people call it.
    pub title: String,
    /// Sticking valves that it found, of all of them.
    pub found: BenchmarkShare,
    /// Sticking valves that it called sound.
    pub missed: usize,
    /// Sticking valves that it could not tell of.
    pub cannot_tell_sticky: usize,
    /// Sound valves that it called sound.
    pub cleared: usize,
    /// Sound valves that it called sticking, of all of them.
    pub false_alarms: BenchmarkShare,
    /// Sound valves that it could not tell of.
    pub cannot_tell_sound: usize,
    /// What it said rightly, of all that it said.
    pub right: BenchmarkShare,
    /// Time for one record (ms), median.
    pub ms_median: Option<f64>,
    /// … and the longest.
    pub ms_longest: Option<f64>,
}

/// A share and how sure it is.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct BenchmarkShare {
    /// So many.
    pub n: usize,
    /// Of so many.
    pub of: usize,
    /// Its 95 % interval by Wilson (0..1); null of none.
    pub ci95: Option<[f64; 2]>,
}

impl BenchmarkShare {
    fn new(n: usize, of: usize) -> Self {
        Self { n, of, ci95: wilson(n, of) }
    }
}

/// One record.
#[derive(Clone, Debug, Serialize)]
pub struct BenchmarkRecord {
    /// The loop's name.
    pub r#loop: String,
    /// Whether its valve sticks, by its label.
    pub sticks: bool,
    /// What each method and at last the program says, in the order of `judges`.
    pub says: Vec<ReportSays>,
    /// Whether the methods make the program's verdict doubtful.
    pub doubtful: bool,
}

impl BenchmarkJudge {
    /// What was counted of a judge, and its times (ms).
    pub fn new(method: &str, title: &str, tally: &Tally, ms: &[f64]) -> Self {
        Self {
            method: method.to_string(),
            title: title.to_string(),
            found: BenchmarkShare::new(tally.found, tally.sticky()),
            missed: tally.missed,
            cannot_tell_sticky: tally.silent_sticky,
            cleared: tally.cleared,
            false_alarms: BenchmarkShare::new(tally.alarms, tally.sound()),
            cannot_tell_sound: tally.silent_sound,
            right: BenchmarkShare::new(tally.right(), tally.told()),
            ms_median: quantile(ms, 0.5).and_then(finite),
            ms_longest: quantile(ms, 1.0).and_then(finite),
        }
    }
}
