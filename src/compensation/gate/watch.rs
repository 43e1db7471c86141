//! What takes more than one step to see: a set point that moves, polls that are missed.

use super::conditions::{Denial, Inputs, Limits, Time};

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
    /// Since when (mono, s), and what the counter was then.
    since: Option<(f64, u64)>,
}

impl Polls {
    /// Whether too many were missed within the minute.
    pub(super) fn missed(&mut self, inputs: &Inputs, now: Time, limits: &Limits) -> Option<Denial> {
        let (since, base) = *self.since.get_or_insert((now.mono, inputs.missed_polls));
        let too_many = inputs.missed_polls.saturating_sub(base) > limits.max_missed_polls;
        if now.mono - since >= POLLS_OVER_S {
            self.since = Some((now.mono, inputs.missed_polls));
        }
        too_many.then_some(Denial::PollOverrun)
    }
}
