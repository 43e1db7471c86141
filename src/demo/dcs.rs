//! The DCS side of write-back: registers for a term and a heartbeat beside each controller. The term is added to OP while
//! the heart beats and the controller is in automatic, and dropped as soon as either ends. After the heart stood still a term is
//! believed again once it has begun with 0.

/// First register of the first loop's term, counted from 0.
pub const FIRST: u16 = 1000;
/// Registers of one loop: two of the term (f32, ABCD), one of the heartbeat, one spare.
pub const STRIDE: u16 = 4;
/// Terms beyond this are dropped as nonsense [%]: the DCS trusts nobody.
pub const LARGEST: f64 = 6.0;

/// Registers and heartbeats of some loops.
#[derive(Clone, Debug)]
pub struct Dcs {
    timeout_s: f64,
    slots: Vec<Slot>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    words: [u16; STRIDE as usize],
    /// When the heartbeat last changed (s).
    beat: Option<f64>,
    /// Whether a term of 0 has come with a heartbeat since the heart last stood still.
    from_zero: bool,
}

impl Slot {
    /// The term as it stands in the registers [%].
    fn written(&self) -> f64 {
        let [high, low, ..] = self.words;
        f64::from(f32::from_bits(u32::from(high) << 16 | u32::from(low)))
    }

    /// Whether the heart beats at `now` (s).
    fn is_alive(&self, now: f64, timeout_s: f64) -> bool {
        self.beat.is_some_and(|beat| (0.0..=timeout_s).contains(&(now - beat)))
    }
}

impl Dcs {
    /// For `loops` loops; a heartbeat that stands still for longer than `timeout_s` drops the term.
    pub fn new(loops: usize, timeout_s: f64) -> Self {
        Self { timeout_s, slots: vec![Slot::default(); loops] }
    }

    /// The registers, from [`FIRST`] on.
    pub fn image(&self) -> impl Iterator<Item = u16> + '_ {
        self.slots.iter().flat_map(|slot| slot.words)
    }

    /// A write at time `now` (s); false for registers that are not there.
    pub fn write(&mut self, start: u16, words: &[u16], now: f64) -> bool {
        let Some(first) = start.checked_sub(FIRST).map(usize::from) else { return false };
        let stride = usize::from(STRIDE);
        if first + words.len() > self.slots.len() * stride {
            return false;
        }
        for (at, &word) in words.iter().enumerate() {
            let (slot, place) = ((first + at) / stride, (first + at) % stride);
            let slot = &mut self.slots[slot];
            if place == 2 && slot.words[place] != word {
                // An order that was held up somewhere must not bring back what was dropped meanwhile.
                let goes_on = slot.from_zero && slot.is_alive(now, self.timeout_s);
                slot.from_zero = goes_on || slot.written() == 0.0;
                slot.beat = Some(now);
            }
            slot.words[place] = word;
        }
        true
    }

    /// The term as it stands in the registers of a loop [%].
    pub fn written(&self, at: usize) -> f64 {
        self.slots[at].written()
    }

    /// What is added to OP at `now` (s) [%].
    pub fn term(&self, at: usize, now: f64, automatic: bool) -> f64 {
        let slot = &self.slots[at];
        let (alive, term) = (slot.is_alive(now, self.timeout_s), slot.written());
        if alive && slot.from_zero && automatic && term.abs() <= LARGEST { term } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_term_counts_while_the_heart_beats_and_no_longer() {
        let mut dcs = Dcs::new(2, 5.0);
        // What stands in the registers when somebody begins.
        assert!(dcs.write(1004, &[0x3FC0, 0], 1.0) && dcs.write(1006, &[3], 2.0));
        assert_eq!(dcs.term(1, 2.0, true), 0.0, "it did not begin with 0");
        assert!(dcs.write(1004, &[0, 0], 3.0) && dcs.write(1006, &[0], 4.0));
        // 1.5 is 3FC0_0000.
        assert!(dcs.write(1004, &[0x3FC0, 0], 5.0));
        assert_eq!((dcs.written(1), dcs.term(0, 5.0, true)), (1.5, 0.0));
        assert!(dcs.write(1006, &[1], 6.0));
        assert_eq!(
            [dcs.term(1, 6.0, true), dcs.term(1, 11.0, true), dcs.term(1, 11.1, true)],
            [1.5, 1.5, 0.0]
        );
        assert!(dcs.write(1006, &[1], 12.0));
        assert_eq!(dcs.term(1, 12.0, true), 0.0, "the same beat again is none");
        assert!(dcs.write(1006, &[2], 13.0) && dcs.write(1006, &[3], 14.0));
        assert_eq!(dcs.term(1, 14.0, true), 0.0, "what was dropped does not come back");
        assert!(dcs.write(1004, &[0, 0], 15.0) && dcs.write(1006, &[4], 16.0));
        assert!(dcs.write(1004, &[0x3FC0, 0], 17.0) && dcs.write(1006, &[5], 18.0));
        assert_eq!(
            (dcs.term(1, 18.0, true), dcs.term(1, 18.0, false), dcs.term(0, 18.0, true)),
            (1.5, 0.0, 0.0)
        );
        let nonsense = 7.0_f32.to_bits();
        dcs.write(1004, &[(nonsense >> 16) as u16, nonsense as u16], 18.0);
        assert_eq!(dcs.term(1, 18.0, true), 0.0);
        assert!(!dcs.write(999, &[0], 0.0) && !dcs.write(1007, &[0, 0], 0.0));
        assert_eq!(dcs.image().count(), 8);
    }
}
