//! A round of the writer that is under way, and when it counts as one that hangs: whoever waits for a disk that does not answer
//! tells nobody.

use std::time::{Duration, Instant};

/// A write or a piece of tidying that takes longer than this hangs: the longest wait for one answer of a database is 120 s, and a
/// disk that works is far quicker.
pub(super) const LONGEST: Duration = Duration::from_secs(180);

/// A round that is under way.
pub(super) struct Running {
    /// When it began, or last got on.
    since: Instant,
    /// The same by the clock (s).
    at: f64,
    /// The log has that it hangs.
    told: bool,
}

impl Running {
    /// One that begins, or gets on, now: by a clock that is never set, and by the other (s).
    pub fn new(since: Instant, at: f64) -> Self {
        Self { since, at, told: false }
    }

    /// It gets on, as a database has answered.
    pub fn answered(&mut self, now: Instant) {
        let lasted = now.saturating_duration_since(self.since);
        *self = Self::new(now, self.at + lasted.as_secs_f64());
    }

    /// Why the store counts as failing at a time, and since when (s); `None` while the round may well be at work.
    pub fn hangs(&mut self, now: Instant) -> Option<(String, f64)> {
        let lasted = now.saturating_duration_since(self.since);
        if lasted <= LONGEST {
            return None;
        }
        let why =
            format!("a round has lasted {} s: the disk or the database does not answer", lasted.as_secs());
        if !std::mem::replace(&mut self.told, true) {
            tracing::error!(
                error = why,
                "the store hangs; what is measured stays in memory until it works again"
            );
        }
        Some((why, self.at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_hangs_once_it_has_lasted_for_longer_than_any_answer_takes() {
        let since = Instant::now();
        let mut running = Running::new(since, 7.0);
        assert_eq!(running.hangs(since + LONGEST), None);
        for s in [1, 60] {
            let why = format!("a round has lasted {} s: the disk or the database does not answer", 180 + s);
            assert_eq!(running.hangs(since + LONGEST + Duration::from_secs(s)), Some((why, 7.0)));
        }
    }

    #[test]
    fn a_round_of_many_answers_does_not_hang_however_long_it_lasts() {
        let since = Instant::now();
        let mut running = Running::new(since, 7.0);
        for answers in 1..=10u32 {
            assert_eq!(running.hangs(since + answers * LONGEST), None);
            running.answered(since + answers * LONGEST);
        }
        let (_, at) = running.hangs(since + 11 * LONGEST + Duration::from_secs(1)).expect("none since");
        assert_eq!(at, 7.0 + 10.0 * LONGEST.as_secs_f64());
    }
}
