//! Hits and misses of a method, counted over records whose truth is known.

use super::opinion::Says;

/// Answers on sticking and on sound valves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Sticking valves with the answer that they stick.
    pub found: usize,
    /// Sticking valves with the answer that they are sound.
    pub missed: usize,
    /// Sticking valves without an answer.
    pub silent_sticky: usize,
    /// Sound valves with the answer that they are sound.
    pub cleared: usize,
    /// Sound valves with the answer that they stick.
    pub alarms: usize,
    /// Sound valves without an answer.
    pub silent_sound: usize,
}

impl Tally {
    /// Counts one answer on a valve of which it is known whether it sticks.
    pub fn add(&mut self, sticky: bool, says: Says) {
        let to = match (sticky, says) {
            (true, Says::Sticks) => &mut self.found,
            (true, Says::Sound) => &mut self.missed,
            (true, Says::CannotTell) => &mut self.silent_sticky,
            (false, Says::Sound) => &mut self.cleared,
            (false, Says::Sticks) => &mut self.alarms,
            (false, Says::CannotTell) => &mut self.silent_sound,
        };
        *to += 1;
    }

    /// Number of sticking valves.
    pub fn sticky(&self) -> usize {
        self.found + self.missed + self.silent_sticky
    }

    /// Number of sound valves.
    pub fn sound(&self) -> usize {
        self.cleared + self.alarms + self.silent_sound
    }

    /// Number of right answers.
    pub fn right(&self) -> usize {
        self.found + self.cleared
    }

    /// Number of answers.
    pub fn told(&self) -> usize {
        self.right() + self.missed + self.alarms
    }
}

/// Wilson's 95 % interval (0..1) of a share of `hits` in `of`; none where `of` is 0.
///
/// ```text
/// (p + z²/2n ± z sqrt(p (1 - p)/n + z²/4n²)) / (1 + z²/n)        z = 1.96, p = hits/n
/// ```
///
/// Source: Wilson, J. Am. Stat. Assoc. 1927, 22, 209.
pub fn wilson(hits: usize, of: usize) -> Option<[f64; 2]> {
    if of == 0 {
        return None;
    }
    let (n, p, z) = (of as f64, hits as f64 / of as f64, 1.96);
    let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    Some([(middle - half).clamp(0.0, 1.0), (middle + half).clamp(0.0, 1.0)])
}

/// The value below which a share (0..1) of the values lie; none without values.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values.get((values.len().saturating_sub(1) as f64 * share).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let mut tally = Tally::default();
        for (sticky, says) in [
            (true, Says::Sticks),
            (true, Says::Sound),
            (true, Says::CannotTell),
            (false, Says::Sound),
            (false, Says::Sound),
            (false, Says::Sticks),
        ] {
            tally.add(sticky, says);
        }
        assert_eq!((tally.sticky(), tally.sound(), tally.right(), tally.told()), (3, 3, 3, 5));
        // Wilson's interval of 8 in 10, from his formula by hand.
        let [low, high] = wilson(8, 10).expect("of ten");
        assert!((low - 0.4902).abs() < 1e-4 && (high - 0.9433).abs() < 1e-4, "{low} {high}");
        let [low, high] = wilson(0, 5).expect("of five");
        assert!(low == 0.0 && (high - 0.4345).abs() < 1e-4, "{high}");
        assert_eq!((wilson(0, 0), quantile(&[], 0.5)), (None, None));
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 1.0), Some(3.0));
    }
}
