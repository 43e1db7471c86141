//! One time line for all that is simulated: a steady one that begins at 0 with the run, and what the daemon's clock shows at
//! each moment of it.

use std::time::Duration;
use tokio::time::Instant;

/// What clocks show at the begin (2026-01-01T00:00:00Z).
const EPOCH: f64 = 1_767_225_600.0;
/// Time is told to a millisecond (s).
const NEAR_S: f64 = 0.002;

/// The time line.
#[derive(Clone, Debug)]
pub struct TimeLine {
    /// Steady time at the begin of this life (s), and that moment.
    base: f64,
    began: Option<Instant>,
    /// From when on (s) clocks show how much more than the steady time.
    ahead: Vec<(f64, f64)>,
}

impl TimeLine {
    pub fn new() -> Self {
        Self { base: 0.0, began: None, ahead: vec![(0.0, EPOCH)] }
    }

    /// Steady time (s).
    pub fn now(&self) -> f64 {
        self.base + self.began.map_or(0.0, |began| began.elapsed().as_secs_f64())
    }

    /// A life begins, on a runtime of its own.
    pub fn begin(&mut self) {
        self.began = Some(Instant::now());
    }

    /// It has ended, and nothing runs for a while.
    pub fn end(&mut self, rest: Duration) {
        self.base = self.now() + rest.as_secs_f64();
        self.began = None;
    }

    /// What clocks show.
    pub fn wall(&self) -> f64 {
        self.now() + self.ahead.last().map_or(0.0, |(_, ahead)| *ahead)
    }

    /// Clocks are set.
    pub fn jump(&mut self, by: f64) {
        let (now, ahead) = (self.now(), self.ahead.last().map_or(0.0, |(_, ahead)| *ahead));
        self.ahead.push((now, ahead + by));
    }

    /// When clocks showed `stamp`, between two moments.
    pub fn when(&self, stamp: f64, from: f64, to: f64) -> Option<f64> {
        let moments = self.ahead.iter().map(|(_, ahead)| stamp - ahead);
        moments.rev().find(|moment| (from - NEAR_S..=to + NEAR_S).contains(moment))
    }

    /// The moments at which clocks showed `stamp`.
    pub fn moments(&self, stamp: f64) -> Vec<f64> {
        let ends = self.ahead.iter().skip(1).map(|(end, _)| *end).chain([f64::INFINITY]);
        let shown = self.ahead.iter().zip(ends).filter_map(|((begin, ahead), end)| {
            let moment = stamp - ahead;
            (begin - NEAR_S..=end + NEAR_S).contains(&moment).then_some(moment)
        });
        shown.collect()
    }

    /// Whether clocks showed `stamp` at some moment between two.
    pub fn showed(&self, stamp: f64, from: f64, to: f64) -> bool {
        let ends = self.ahead.iter().skip(1).map(|(end, _)| *end).chain([f64::INFINITY]);
        self.ahead.iter().zip(ends).any(|((begin, ahead), end)| {
            let (first, last) = (from.max(*begin), to.min(end));
            first <= last && (first - NEAR_S..=last + NEAR_S).contains(&(stamp - ahead))
        })
    }
}
