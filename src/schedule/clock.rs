//! Plant time: the wall clock, or a clock that runs faster from a set start, for a simulated plant and for tests.

use std::sync::atomic::{AtomicU64, Ordering::SeqCst};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::time::Instant;

/// Plant time; cheap to copy.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Instant,
    /// Seconds since the Unix epoch at `start`; `None` asks the wall clock each time, so that it follows its corrections.
    epoch: Option<f64>,
    speed: f64,
    goes: Goes,
}

/// What moves a clock. What is shared lives as long as the program, a few bytes for each simulation or replay, so that a clock
/// stays a plain copy.
#[derive(Clone, Copy, Debug)]
enum Goes {
    /// Time on the wall.
    Always,
    /// Time on the wall, but between two looks at most `longest`.
    Watched { longest: Duration, seen: &'static Mutex<Seen> },
    /// Whoever sets it (s since the Unix epoch, as bits).
    ByHand(&'static AtomicU64),
    /// Time on the wall, and what it shows is ahead of that by so much (s, as bits).
    Adjusted(&'static AtomicU64),
}

/// The latest look at a clock, and the time on the wall that counted until then.
#[derive(Debug)]
struct Seen {
    at: Instant,
    counted: Duration,
}

impl Clock {
    /// The wall clock.
    pub fn wall() -> Self {
        Self { start: Instant::now(), epoch: None, speed: 1.0, goes: Goes::Always }
    }

    /// A clock that shows `epoch` (s since the Unix epoch) now and runs `speed` times as fast as the wall. A speed that is
    /// not a positive number counts as 1.
    pub fn plant(epoch: f64, speed: f64) -> Self {
        let speed = if speed.is_finite() && speed > 0.0 { speed } else { 1.0 };
        Self { epoch: Some(epoch), speed, ..Self::wall() }
    }

    /// As [`Clock::plant`], but a pause between two looks counts as `longest` on the wall: where everything that a simulation
    /// does looks at its clock, the plant waits for a computer that stands still. `longest` is 1 ms at least.
    pub fn watched(epoch: f64, speed: f64, longest: Duration) -> Self {
        // A clock that no look moves on would never show what is waited for.
        let longest = longest.max(Duration::from_millis(1));
        let seen = Seen { at: Instant::now(), counted: Duration::ZERO };
        Self {
            goes: Goes::Watched { longest, seen: Box::leak(Box::new(Mutex::new(seen))) },
            ..Self::plant(epoch, speed)
        }
    }

    /// A clock that shows `epoch` until it is set: the clock of a record. Nothing is due by it, whoever sets it asks.
    pub fn by_hand(epoch: f64) -> Self {
        let hand = Box::leak(Box::new(AtomicU64::new(epoch.to_bits())));
        Self { goes: Goes::ByHand(hand), ..Self::plant(epoch, 1.0) }
    }

    /// As [`Clock::plant`] at the wall's speed, but it can be set while it goes, as a machine's clock can: what it shows jumps,
    /// and [`Clock::elapsed`] does not.
    pub fn adjusted(epoch: f64) -> Self {
        let ahead = Box::leak(Box::new(AtomicU64::new(0.0f64.to_bits())));
        Self { goes: Goes::Adjusted(ahead), ..Self::plant(epoch, 1.0) }
    }

    /// Sets a clock made by [`Clock::by_hand`] or [`Clock::adjusted`]; any other goes on as it does.
    pub fn set(&self, now: f64) {
        match self.goes {
            Goes::ByHand(hand) => hand.store(now.to_bits(), SeqCst),
            Goes::Adjusted(ahead) => {
                let ahead_s = now - (self.now() - f64::from_bits(ahead.load(SeqCst)));
                ahead.store(ahead_s.to_bits(), SeqCst);
            }
            Goes::Always | Goes::Watched { .. } => {}
        }
    }

    /// Now (s since the Unix epoch).
    pub fn now(&self) -> f64 {
        if let Goes::ByHand(hand) = self.goes {
            return f64::from_bits(hand.load(SeqCst));
        }
        match self.epoch {
            Some(epoch) => {
                let ahead = match self.goes {
                    Goes::Adjusted(ahead) => f64::from_bits(ahead.load(SeqCst)),
                    _ => 0.0,
                };
                epoch + self.elapsed().as_secs_f64() + ahead
            }
            None => SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64()),
        }
    }

    /// Plant time since the clock was made; never goes backwards.
    pub fn elapsed(&self) -> Duration {
        let on_the_wall = match self.goes {
            Goes::Always | Goes::Adjusted(_) => self.start.elapsed(),
            Goes::Watched { longest, seen } => {
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                let now = Instant::now();
                let since = now.saturating_duration_since(seen.at);
                *seen = Seen { at: now, counted: seen.counted + since.min(longest) };
                seen.counted
            }
            Goes::ByHand(_) => {
                let since = self.now() - self.epoch.unwrap_or_default();
                return Duration::try_from_secs_f64(since).unwrap_or_default();
            }
        };
        on_the_wall.mul_f64(self.speed)
    }

    /// Waits until that much plant time has passed since the clock was made.
    pub async fn sleep_until(&self, elapsed: Duration) {
        match self.goes {
            Goes::Always | Goes::Adjusted(_) => {
                tokio::time::sleep_until(self.start + elapsed.div_f64(self.speed)).await;
            }
            Goes::Watched { longest, .. } => loop {
                let left = elapsed.saturating_sub(self.elapsed());
                if left.is_zero() {
                    return;
                }
                // Whoever waits looks, too: nobody else may.
                tokio::time::sleep(left.div_f64(self.speed).min(longest / 2)).await;
            },
            Goes::ByHand(_) => std::future::pending().await,
        }
    }
}
