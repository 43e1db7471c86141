//! When something last came of a tag, on the daemon's steady clock: stamps are a source's, whose clock may be hours off ours.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// What is known of one tag; times are those since the daemon's start (s). Written by the tag's one writer.
#[derive(Debug)]
pub struct Heard {
    /// By how much the stamp of the newest good sample was ahead of the time at which it came (s, as bits).
    ahead: AtomicU64,
    /// When its source was last there and would have told a change (s, as bits).
    there: AtomicU64,
}

impl Default for Heard {
    fn default() -> Self {
        let never = || AtomicU64::new(f64::NAN.to_bits());
        Self { ahead: never(), there: never() }
    }
}

impl Heard {
    /// A good sample of this stamp (s) came now.
    pub fn sample(&self, t: f64, now_s: f64) {
        self.ahead.store((t - now_s).to_bits(), Relaxed);
    }

    /// Its source is there now, and tells every change.
    pub fn seen(&self, now_s: f64) {
        self.there.store(now_s.to_bits(), Relaxed);
    }

    /// What the clock that stamps the tag shows now (s), as far as its newest good sample tells; `None` before one has come.
    pub fn shows(&self, now_s: f64) -> Option<f64> {
        let ahead = f64::from_bits(self.ahead.load(Relaxed));
        ahead.is_finite().then_some(now_s + ahead)
    }

    /// Whether its source, which tells every change, has been there within so long (s).
    pub fn was_there(&self, now_s: f64, within_s: f64) -> bool {
        self.away(now_s).is_some_and(|away_s| away_s <= within_s)
    }

    /// How long ago its source, which tells every change, was last there (s); `None` where it never was.
    pub fn away(&self, now_s: f64) -> Option<f64> {
        let there = f64::from_bits(self.there.load(Relaxed));
        there.is_finite().then_some(now_s - there)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_of_a_source_goes_on_though_nothing_comes() {
        let heard = Heard::default();
        assert_eq!(heard.shows(5.0), None);
        // Five hours behind.
        heard.sample(-18_000.0, 0.0);
        assert_eq!((heard.shows(0.0), heard.shows(600.0)), (Some(-18_000.0), Some(-17_400.0)));
        heard.sample(-17_000.0, 700.0);
        assert_eq!(heard.shows(701.0), Some(-16_999.0));
        // A stamp that is no time tells none.
        heard.sample(f64::NAN, 800.0);
        assert_eq!(heard.shows(801.0), None);
    }

    #[test]
    fn a_source_is_there_for_a_while_after_it_was() {
        let heard = Heard::default();
        assert!(!heard.was_there(0.0, f64::INFINITY), "it never was");
        assert_eq!(heard.away(0.0), None);
        heard.seen(100.0);
        assert_eq!(heard.away(160.0), Some(60.0));
        assert!(heard.was_there(160.0, 60.0) && !heard.was_there(161.0, 60.0));
    }
}
