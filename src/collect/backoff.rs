//! When to try a lost device again: later and later, and not at the moment everyone else does.

use rand::RngExt;
use rand_pcg::Pcg32;
use std::time::Duration;
use tokio::time::Instant;

/// Exponential back-off with jitter. Pure: the time is an argument, the jitter comes from a seed.
///
/// After the n-th failure in a row the pause is min(base 2^(n-1), longest) u, u uniform in [0.5, 1).
#[derive(Debug)]
pub(super) struct Backoff {
    base: Duration,
    longest: Duration,
    failures: u32,
    until: Option<Instant>,
    random: Pcg32,
}

impl Backoff {
    pub(super) fn new(base: Duration, longest: Duration, random: Pcg32) -> Self {
        Self { base, longest, failures: 0, until: None, random }
    }

    /// Whether an attempt may be made at `now`.
    pub(super) fn due(&self, now: Instant) -> bool {
        self.until.is_none_or(|until| now >= until)
    }

    /// An attempt failed at `now`; returns the pause before the next.
    pub(super) fn failed(&mut self, now: Instant) -> Duration {
        let factor = 1u32.checked_shl(self.failures).unwrap_or(u32::MAX);
        self.failures = self.failures.saturating_add(1);
        let pause =
            self.base.saturating_mul(factor).min(self.longest).mul_f64(self.random.random_range(0.5..1.0));
        self.until = Some(now + pause);
        pause
    }

    /// The device answered.
    pub(super) fn reset(&mut self) {
        self.failures = 0;
        self.until = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn backoff(seed: u64) -> Backoff {
        let ms = Duration::from_millis;
        Backoff::new(ms(100), ms(1000), Pcg32::seed_from_u64(seed))
    }

    #[test]
    fn pauses_double_up_to_the_longest_and_stay_within_the_jitter() {
        let now = Instant::now();
        let mut backoff = backoff(1);
        for nominal in [100.0, 200.0, 400.0, 800.0, 1000.0, 1000.0] {
            let pause = backoff.failed(now).as_secs_f64() * 1000.0;
            assert!((0.5 * nominal..nominal).contains(&pause), "{pause} of {nominal}");
        }
        // Far past the width of any shift the longest pause still holds.
        let most = (0..200).map(|_| backoff.failed(now)).max().unwrap();
        assert!(most < Duration::from_secs(1));
    }

    #[test]
    fn an_attempt_waits_for_the_pause_and_an_answer_ends_it() {
        let now = Instant::now();
        let mut backoff = backoff(2);
        assert!(backoff.due(now));
        let pause = backoff.failed(now);
        assert!(!backoff.due(now + pause - Duration::from_nanos(1)));
        assert!(backoff.due(now + pause));
        backoff.reset();
        assert!(backoff.due(now));
        assert!(backoff.failed(now) < Duration::from_millis(100));
    }

    #[test]
    fn two_seeds_differ_and_one_repeats() {
        let now = Instant::now();
        let pauses = |seed| (backoff(seed).failed(now), backoff(seed).failed(now));
        assert_eq!(pauses(1).0, pauses(1).1);
        assert_ne!(pauses(1).0, pauses(2).0);
    }
}
