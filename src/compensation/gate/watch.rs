//! What takes more than one step to see: a set point that moves, polls that are missed.

use super::conditions::{Denial, Inputs, Limits, Time};
use std::collections::VecDeque;

/// Missed polls are counted over this long (s).
const POLLS_OVER_S: f64 = 60.0;

/// Watches the set point.
#[derive(Clone, Debug, Default)]
pub(super) struct SetPoint {
    /// When it was last seen to move fast (mono, s); never seen counts as moving.
    fast_at: Option<f64>,
    /// Its last sample, when and what.
    last: Option<(f64, f64)>,
}

impl SetPoint {
    /// Whether it moves, or has not been slow for long enough.
    pub(super) fn moves(&mut self, inputs: &Inputs, now: Time, limits: &Limits) -> bool {
        if let Some(sp) = inputs.sp.filter(|sp| sp.quality.is_good() && sp.value.is_finite()) {
            let slow = self.last.is_some_and(|(t, value)| {
                t == sp.t || (sp.value - value).abs() <= limits.sp_rate * (sp.t - t).abs()
            });
            if !slow {
                self.fast_at = Some(now.mono);
            }
            self.last = Some((sp.t, sp.value));
        }
        let settled = self.fast_at.is_some_and(|at| now.mono - at >= limits.sp_settle_s);
        !settled
    }
}

/// Counts missed polls.
#[derive(Clone, Debug, Default)]
pub(super) struct Polls {
    /// The counter at the last step.
    last: Option<u64>,
    /// When polls were missed within the last minute (mono, s), and how many.
    missed: VecDeque<(f64, u64)>,
}

impl Polls {
    /// Whether too many were missed within any minute up to now.
    pub(super) fn missed(&mut self, inputs: &Inputs, now: Time, limits: &Limits) -> Option<Denial> {
        let last = self.last.replace(inputs.missed_polls).unwrap_or(inputs.missed_polls);
        let more = inputs.missed_polls.saturating_sub(last);
        if more > 0 {
            self.missed.push_back((now.mono, more));
        }
        let over = |&(at, _): &(f64, u64)| now.mono - at >= POLLS_OVER_S;
        // Each entry is one poll at least: the newest of them are too many already where there are more than allowed.
        while self.missed.front().is_some_and(over)
            || self.missed.len() as u64 > limits.max_missed_polls.saturating_add(1)
        {
            self.missed.pop_front();
        }
        let sum: u64 = self.missed.iter().map(|(_, more)| more).sum();
        (sum > limits.max_missed_polls).then_some(Denial::PollOverrun)
    }
}
