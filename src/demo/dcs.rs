//! The DCS side of write-back: registers for a term and a heartbeat beside each controller. The term is added to OP while
//! the heart beats and the controller is in automatic, and dropped as soon as either ends.

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
                slot.beat = Some(now);
            }
            slot.words[place] = word;
        }
        true
    }

    /// The term as it stands in the registers of a loop [%].
    pub fn written(&self, at: usize) -> f64 {
        let [high, low, ..] = self.slots[at].words;
        f64::from(f32::from_bits(u32::from(high) << 16 | u32::from(low)))
    }

    /// What is added to OP at `now` (s) [%].
    pub fn term(&self, at: usize, now: f64, automatic: bool) -> f64 {
        let alive = self.slots[at].beat.is_some_and(|beat| (0.0..=self.timeout_s).contains(&(now - beat)));
        let term = self.written(at);
        if alive && automatic && term.abs() <= LARGEST { term } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_term_counts_while_the_heart_beats_and_no_longer() {
        let mut dcs = Dcs::new(2, 5.0);
        // 1.5 is 3FC0_0000.
        assert!(dcs.write(1004, &[0x3FC0, 0], 10.0));
        assert_eq!((dcs.written(1), dcs.term(1, 10.0, true)), (1.5, 0.0), "no heartbeat yet");
        assert!(dcs.write(1006, &[1], 11.0));
        assert_eq!(
            [dcs.term(1, 11.0, true), dcs.term(1, 16.0, true), dcs.term(1, 16.1, true)],
            [1.5, 1.5, 0.0]
        );
        assert!(dcs.write(1006, &[1], 17.0));
        assert_eq!(dcs.term(1, 17.0, true), 0.0, "the same beat again is none");
        assert!(dcs.write(1006, &[2], 18.0));
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
