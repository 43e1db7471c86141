//! The valve recursion: from OP to the position of the stem, for every model of a valve.
//!
//! ```text
//! x[k] = p[k] - dir[k] (S - J)/2          position of the stem
//! p[k] = u[k]  where the stem moves,  p[k-1] where it rests;  p is held within the stops
//! dir  = direction of the last move, +1 or -1
//!
//! The stem turns     where  dir (p - u) > S (1 + asymmetry dir)
//! The stem goes on   where  dir (u - p) > J after a rest,  > r otherwise
//! ```
//!
//! `p` is OP at the last move. S, J and r are multiplied by [`growth`] where the valve has a drift.
//! `diagnosis::friction` is the same recursion for one f, with the range of f that gives the same stem.

use super::model::{Start, StopRule, ValveModel};

impl ValveModel {
    /// Factor on S and J at sample `k` of `span` fitted ones: [`growth`] of this valve's drift.
    pub fn growth(&self, k: usize, span: usize) -> f64 {
        growth(self.drift, k, span)
    }

    /// Runs OP through the valve.
    ///
    /// * `u`: OP, N values (OP unit); before `start` the stem follows it.
    /// * `span`: number of samples over which [`ValveModel::drift`] is counted.
    /// * `x`: receives the position of the stem, N values (OP unit); `dir` the direction of its last move, +1 or -1.
    pub fn run(&self, u: &[f64], start: Start, span: usize, x: &mut Vec<f64>, dir: &mut Vec<f64>) {
        x.clear();
        dir.clear();
        let mut stem = Stem::new(self, start);
        for (k, &u) in u.iter().enumerate() {
            let grown = self.growth(k, span);
            if k <= start.index {
                stem.place(self, u, grown, k == start.index);
            } else {
                stem.step(self, u, grown);
            }
            x.push(stem.position - self.lag() * grown * stem.direction);
            dir.push(stem.direction);
        }
    }
}

/// Factor on S and J at sample `k` of `span`, `1 + drift (2 k/span - 1)`; beyond `span` up to `1 + 2 drift`, never below 0.
pub fn growth(drift: f64, k: usize, span: usize) -> f64 {
    (1.0 + drift * ((2.0 * k as f64 / span as f64).min(3.0) - 1.0)).max(0.0)
}

/// The state of one stem.
#[derive(Clone, Copy, Debug)]
struct Stem {
    /// `p`: OP at the last move (OP unit).
    position: f64,
    /// Direction of the last move, +1 or -1.
    direction: f64,
    /// Whether the stem rests.
    rests: bool,
}

impl Stem {
    fn new(valve: &ValveModel, start: Start) -> Self {
        let direction = if start.is_max != valve.rest.turned { 1.0 } else { -1.0 };
        Self { position: 0.0, direction, rests: true }
    }

    /// Sets the stem before the start, where it follows OP, and at the start, where [`Rest`](super::model::Rest) says how far it
    /// lies beyond.
    fn place(&mut self, valve: &ValveModel, u: f64, grown: f64, at_start: bool) {
        let beyond = if at_start { valve.s * grown * valve.rest.beyond } else { 0.0 };
        self.position = u + self.direction * beyond;
        self.rests = valve.rule != StopRule::Reversal;
    }

    /// Advances the stem by one sample; `grown` is the factor on S, J and r.
    fn step(&mut self, valve: &ValveModel, u: f64, grown: f64) {
        let onward = self.direction * (u - self.position);
        let turns = -onward > valve.s * grown * (1.0 + valve.asymmetry * self.direction);
        let ahead = if self.rests { valve.j } else { valve.resolution };
        if turns || onward > ahead * grown {
            let (low, high) = valve.limits();
            self.position = u.max(low).min(high);
            self.direction = if turns { -self.direction } else { self.direction };
            self.rests = valve.rule == StopRule::Slip;
        } else {
            self.rests = valve.rule != StopRule::Reversal;
        }
    }
}
