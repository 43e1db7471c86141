//! Plant time: the wall clock, or a clock that runs faster from a set start, for a simulated plant and for tests.

use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::time::Instant;

/// Plant time; cheap to copy.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
    /// Seconds since the Unix epoch at `start`; `None` asks the wall clock each time, so that it follows its corrections.
    epoch: Option<f64>,
    speed: f64,
    /// What a clock set by hand shows (s), as bits.
    hand: Option<&'static AtomicU64>,
}

impl Clock {
    /// The wall clock.
    pub fn wall() -> Self {
        Self { start: Instant::now(), epoch: None, speed: 1.0, hand: None }
    }

    /// A clock that shows `epoch` (s since the Unix epoch) now and runs `speed` times as fast as the wall. A speed that is
    /// not a positive number counts as 1.
    pub fn plant(epoch: f64, speed: f64) -> Self {
        let speed = if speed.is_finite() && speed > 0.0 { speed } else { 1.0 };
        Self { start: Instant::now(), epoch: Some(epoch), speed, hand: None }
    }

    /// A clock that shows `epoch` until it is set: the clock of a record. Nothing is due by it, whoever sets it asks.
    pub fn by_hand(epoch: f64) -> Self {
        // Eight bytes for each replay, so that a clock stays a plain copy.
        let hand: &'static AtomicU64 = Box::leak(Box::new(AtomicU64::new(epoch.to_bits())));
        Self { hand: Some(hand), ..Self::plant(epoch, 1.0) }
    }

    /// Sets a clock made by [`Clock::by_hand`]; any other goes on as it does.
    pub fn set(&self, now: f64) {
        if let Some(hand) = self.hand {
            hand.store(now.to_bits(), SeqCst);
        }
    }

    /// Now (s since the Unix epoch).
    pub fn now(&self) -> f64 {
        if let Some(hand) = self.hand {
            return f64::from_bits(hand.load(SeqCst));
        }
        match self.epoch {
            Some(epoch) => epoch + self.elapsed().as_secs_f64(),
            None => SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64()),
        }
    }

    /// Plant time since the clock was made; never goes backwards.
    pub fn elapsed(&self) -> Duration {
        if let (Some(_), Some(epoch)) = (self.hand, self.epoch) {
            return Duration::try_from_secs_f64(self.now() - epoch).unwrap_or_default();
        }
        self.start.elapsed().mul_f64(self.speed)
    }

    /// Waits until that much plant time has passed since the clock was made.
    pub async fn sleep_until(&self, elapsed: Duration) {
        if self.hand.is_some() {
            return std::future::pending().await;
        }
        tokio::time::sleep_until(self.start + elapsed.div_f64(self.speed)).await;
    }

    /// Waits for that much plant time.
    pub async fn sleep(&self, plant: Duration) {
        tokio::time::sleep(plant.div_f64(self.speed)).await;
    }
}
