//! How often the wall clock was set back, as far as the store's rounds have seen it.

/// A clock that goes back by less (s) was only corrected.
pub(super) const SET_BACK_S: f64 = 1.0;

/// What the store's rounds have seen of the clock.
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
    /// The clock is compared with this from now on (s).
    pub(super) fn begin(&mut self, told: f64) {
        self.told = told;
    }

    /// Looks at the clock, which shows `now` (s): whether it was set back since the look before.
    pub(super) fn look(&mut self, now: f64) -> bool {
        let is_back = self.is_back(now);
        (self.count, self.told) = (self.by(now), now);
        is_back
    }

    /// How often it was set back.
    pub(super) fn count(&self) -> u32 {
        self.count
    }

    /// How often it was set back by the time that it shows `now` (s), also if no round has looked since.
    pub(super) fn by(&self, now: f64) -> u32 {
        self.count.saturating_add(u32::from(self.is_back(now)))
    }

    fn is_back(&self, now: f64) -> bool {
        now < self.told - SET_BACK_S
    }
}
