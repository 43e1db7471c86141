//! A transmitter that repeats one value to the last bit is frozen: real measurements carry noise.

/// Watches one tag for a value that stays exactly the same.
///
/// A pure state: [`Frozen::update`] takes the time as an argument.
///
/// ```
/// use stictiond::collect::Frozen;
/// let mut frozen = Frozen::new(10.0);
/// assert!(!frozen.update(0.0, 1.5));
/// assert!(!frozen.update(10.0, 1.5)); // for exactly the limit, not longer
/// assert!(frozen.update(10.5, 1.5));
/// assert!(!frozen.update(11.0, 1.6));
/// ```
#[derive(Clone, Debug)]
pub struct Frozen {
    limit_s: f64,
    held: Option<Held>,
}

#[derive(Clone, Copy, Debug)]
struct Held {
    value: f64,
    since: f64,
    seen: f64,
}

impl Frozen {
    /// Flags a value that stayed the same for longer than `limit_s` (s).
    pub fn new(limit_s: f64) -> Self {
        Self { limit_s, held: None }
    }

    /// Takes the value read at time `t` (s); true when it has not changed for longer than the limit.
    ///
    /// The period counts only while the tag is watched: after a silence longer than the limit, or a clock
    /// set back, it starts anew, because nobody knows what the value did meanwhile.
    pub fn update(&mut self, t: f64, value: f64) -> bool {
        match &mut self.held {
            Some(held) if same(held.value, value) && t >= held.seen && t - held.seen <= self.limit_s => {
                held.seen = t;
                t - held.since > self.limit_s
            }
            _ => {
                self.held = Some(Held { value, since: t, seen: t });
                false
            }
        }
    }

    /// The watched value has not changed up to time `t` (s), as a source that tells of changes alone would have said. Returns
    /// the value when that has been so for longer than the limit.
    ///
    /// ```
    /// use stictiond::collect::Frozen;
    /// let mut frozen = Frozen::new(10.0);
    /// frozen.update(0.0, 1.5);
    /// assert_eq!(frozen.unchanged(10.0), None);
    /// assert_eq!(frozen.unchanged(10.5), Some(1.5));
    /// ```
    pub fn unchanged(&mut self, t: f64) -> Option<f64> {
        let held = self.held.as_mut().filter(|held| t >= held.seen)?;
        held.seen = t;
        (t - held.since > self.limit_s).then_some(held.value)
    }
}

fn same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_change_in_the_last_bit_is_a_change() {
        let mut frozen = Frozen::new(1.0);
        let value = 50.0_f64;
        for k in 0..20 {
            let alive = if k % 2 == 0 { value } else { value.next_up() };
            assert!(!frozen.update(f64::from(k), alive));
        }
    }

    #[test]
    fn a_silence_longer_than_the_limit_starts_anew() {
        let mut frozen = Frozen::new(10.0);
        frozen.update(0.0, 1.0);
        assert!(!frozen.update(20.0, 1.0));
        assert!(!frozen.update(30.0, 1.0));
        assert!(frozen.update(30.5, 1.0));
    }

    #[test]
    fn a_clock_set_back_starts_anew() {
        let mut frozen = Frozen::new(10.0);
        frozen.update(1000.0, 1.0);
        assert!(!frozen.update(5.0, 1.0));
        assert!(!frozen.update(15.0, 1.0));
        assert!(frozen.update(15.1, 1.0));
    }

    #[test]
    fn a_value_that_is_not_told_again_is_watched_all_the_same() {
        let mut frozen = Frozen::new(10.0);
        assert_eq!(frozen.unchanged(5.0), None, "there is none");
        frozen.update(100.0, 1.0);
        assert_eq!(frozen.unchanged(105.0), None);
        assert_eq!(frozen.unchanged(90.0), None, "before it was told");
        assert_eq!(frozen.unchanged(111.0), Some(1.0));
        // Told again with a new stamp it is what it was, and a change is one.
        assert!(frozen.update(120.0, 1.0));
        assert!(!frozen.update(121.0, 2.0));
        assert_eq!(frozen.unchanged(130.0), None);
    }

    proptest! {
        /// Against the definition: stale when every sample of the last `limit` and one older are equal.
        #[test]
        fn agrees_with_the_definition(values in prop::collection::vec(0u8..2, 1..200), limit in 1u8..10) {
            let mut frozen = Frozen::new(f64::from(limit));
            for k in 0..values.len() {
                let run = values[..=k].iter().rev().take_while(|v| **v == values[k]).count() - 1;
                let stale = frozen.update(k as f64, f64::from(values[k]));
                prop_assert_eq!(stale, run > usize::from(limit));
            }
        }
    }
}
