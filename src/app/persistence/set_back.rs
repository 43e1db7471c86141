//! How often the wall clock was set back, as far as anybody has looked.

/// A clock that goes back by less (s) was only corrected.
pub(super) const SET_BACK_S: f64 = 1.0;

/// What was seen of the clock: by the store's rounds, and by who begins to follow rings.
pub(super) struct SetBacks {
    count: u32,
    /// What it showed last (s); NaN before anybody has looked.
    told: f64,
}

impl Default for SetBacks {
    fn default() -> Self {
        Self { count: 0, told: f64::NAN }
    }
}

impl SetBacks {
    /// Sets the time (s) that the next look is compared with. How often the clock was set back so far.
    pub(super) fn begin(&mut self, told: f64) -> u32 {
        self.told = told;
        self.count
    }

    /// Looks at the clock, which shows `now` (s). How often it was set back so far.
    pub(super) fn look(&mut self, now: f64) -> u32 {
        self.count = self.count.saturating_add(u32::from(now < self.told - SET_BACK_S));
        self.told = now;
        self.count
    }
}
