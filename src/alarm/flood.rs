//! A bound on how many alarms a plant may raise in a time. What is over it is grouped and counted: it stays visible, and
//! nobody is called for each of them.

use super::config::{Config, Priority};
use std::collections::VecDeque;

/// Parts of `flood_s` that raises are counted in, which bounds the memory.
const PARTS: f64 = 60.0;

/// The rate of the whole plant.
#[derive(Clone, Debug, Default)]
pub struct Flood {
    /// Number of a part of `flood_s`, and raises in it; oldest first.
    counts: VecDeque<(i64, usize)>,
    since: Option<f64>,
    grouped: usize,
}

/// What an operator is told of a flood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloodView {
    /// Since when (s); `None` while there is none.
    pub since: Option<f64>,
    /// Alarms grouped in it, or in the last one.
    pub grouped: usize,
    /// Alarms raised within `flood_s`.
    pub recent: usize,
}

impl Flood {
    /// An alarm was raised at `now`; whether it is grouped. One of high priority is counted and never grouped.
    pub fn raised(&mut self, priority: Priority, now: f64, config: &Config) -> bool {
        // A flood ends with a tick only: who calls that lets go of the alarms that it grouped.
        self.age(now, config);
        self.count(part(now, config), 1);
        if self.since.is_none() && self.recent() > config.flood_raises {
            (self.since, self.grouped) = (Some(now), 0);
        }
        let grouped = self.since.is_some() && priority < Priority::High;
        self.grouped += usize::from(grouped);
        grouped
    }

    /// Lets time pass; true when a flood has ended, which is when half the rate that began it is undercut.
    pub fn tick(&mut self, now: f64, config: &Config) -> bool {
        self.age(now, config);
        let over = self.since.is_some() && 2 * self.recent() <= config.flood_raises;
        if over {
            self.since = None;
        }
        over
    }

    /// What is going on.
    pub fn view(&self) -> FloodView {
        FloodView { since: self.since, grouped: self.grouped, recent: self.recent() }
    }

    /// Forgets what was raised longer ago than `flood_s`.
    fn age(&mut self, now: f64, config: &Config) {
        self.set_back(now, config);
        let oldest = part(now - config.flood_s, config);
        while self.counts.front().is_some_and(|(at, _)| *at <= oldest) {
            self.counts.pop_front();
        }
    }

    /// Of a clock that was set back: what was raised "later" was raised just now, or the flood would last as long as the clock
    /// takes to come there again.
    fn set_back(&mut self, now: f64, config: &Config) {
        let (present, mut later) = (part(now, config), 0);
        while let Some((at, count)) = self.counts.back()
            && *at > present
        {
            later += count;
            self.counts.pop_back();
        }
        if later > 0 {
            self.count(present, later);
        }
        self.since = self.since.map(|since| since.min(now));
    }

    /// Counts so many raises in a part that is the latest or a new one.
    fn count(&mut self, part: i64, raises: usize) {
        match self.counts.back_mut() {
            Some((last, count)) if *last == part => *count += raises,
            _ => self.counts.push_back((part, raises)),
        }
    }

    fn recent(&self) -> usize {
        self.counts.iter().map(|(_, count)| count).sum()
    }
}

fn part(t: f64, config: &Config) -> i64 {
    (t * PARTS / config.flood_s).floor() as i64
}
