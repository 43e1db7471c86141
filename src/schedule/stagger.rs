//! When each loop is due: spread evenly over its period.

use crate::signal::LoopId;
use std::collections::HashMap;
use std::time::Duration;

/// A loop and how often it is due.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Which loop.
    pub id: LoopId,
    /// Time between two runs (s of plant time).
    pub period_s: f64,
}

/// First due time and period of each job: of m jobs with the same period P the i-th is due at (i + 1/2) P / m, then every
/// P. A period that is not a positive number counts as a day.
pub fn stagger(jobs: &[Job]) -> Vec<(Duration, Duration)> {
    let period = |job: &Job| {
        let period = Duration::try_from_secs_f64(job.period_s).unwrap_or(Duration::from_secs(86_400));
        period.max(Duration::from_millis(1))
    };
    let mut sizes: HashMap<Duration, u32> = HashMap::new();
    let places: Vec<(Duration, u32)> = jobs
        .iter()
        .map(|job| {
            let size = sizes.entry(period(job)).or_default();
            *size += 1;
            (period(job), *size - 1)
        })
        .collect();
    places
        .into_iter()
        .map(|(period, place)| {
            let share = (f64::from(place) + 0.5) / f64::from(sizes[&period]);
            (period.mul_f64(share), period)
        })
        .collect()
}

/// The first of `offset + k period` that is later than `now`, and that k.
pub fn next_due(offset: Duration, period: Duration, now: Duration) -> (Duration, u64) {
    let Some(since) = now.checked_sub(offset) else {
        return (offset, 0);
    };
    let k = (since.as_nanos() / period.as_nanos().max(1)) as u64 + 1;
    let ahead = Duration::from_nanos((period.as_nanos() - since.as_nanos() % period.as_nanos()) as u64);
    (now + ahead, k)
}
