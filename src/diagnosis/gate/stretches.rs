//! Stretches of time in which a tag has samples, or the loop is in automatic.

use crate::signal::Sample;

/// Longest hole inside a stretch (sample periods): nobody knows what the stem does in a longer one.
const LONGEST_HOLE: f64 = 60.0;
/// Time for which a mode that cannot be read is the last known one (sample periods): a few lost polls are no change of mode.
const MODE_LOST: f64 = 6.0;

/// The stretches `[from, to]` of samples without a long hole (s); `ts`: sample period (s).
pub fn runs(kept: &[Sample], ts: f64) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    for s in kept {
        match found.last_mut() {
            Some(last) if s.t - last.1 <= LONGEST_HOLE * ts => last.1 = s.t,
            _ => found.push((s.t, s.t)),
        }
    }
    found
}

/// The stretches of time by the mode of the controller (s); between them the mode is not known.
pub struct Modes {
    /// In automatic.
    pub automatic: Vec<(f64, f64)>,
    /// Not in automatic.
    pub other: Vec<(f64, f64)>,
}

impl Modes {
    /// The stretches by the samples of the mode. A mode holds from its stamp on; one that cannot be read is the last known one
    /// for a few samples.
    pub fn of(mode: &[Sample], ts: f64) -> Self {
        let mut samples: Vec<Sample> = mode.iter().filter(|s| s.t.is_finite()).copied().collect();
        samples.sort_by(|a, b| a.t.total_cmp(&b.t));
        let mut found = Self { automatic: Vec::new(), other: Vec::new() };
        let mut open: Option<(f64, bool)> = None;
        let mut lost: Option<f64> = None;
        for s in &samples {
            let known = (s.quality.is_good() && s.value.is_finite()).then_some(s.value >= 0.5);
            if known.is_none() {
                lost.get_or_insert(s.t);
            }
            let overdue = lost.filter(|since| s.t - since > MODE_LOST * ts);
            if let Some((from, automatic)) = open {
                let changed = known.is_some_and(|known| known != automatic);
                if let Some(until) = overdue.or(changed.then_some(s.t)) {
                    found.push(automatic, (from, until - 1e-3 * ts));
                    open = None;
                }
            }
            if let Some(automatic) = known {
                lost = None;
                open = open.or(Some((s.t, automatic)));
            }
        }
        if let Some((from, automatic)) = open {
            // The last known mode holds until something else is known.
            found.push(automatic, (from, f64::INFINITY));
        }
        found
    }

    fn push(&mut self, automatic: bool, stretch: (f64, f64)) {
        if automatic { self.automatic.push(stretch) } else { self.other.push(stretch) }
    }

    /// The stretches in which the loop may be in automatic: all that are not known to be in another mode.
    pub fn perhaps_automatic(&self) -> Vec<(f64, f64)> {
        let mut found = Vec::with_capacity(self.other.len() + 1);
        let mut from = f64::NEG_INFINITY;
        for other in &self.other {
            found.push((from, other.0));
            from = other.1;
        }
        found.push((from, f64::INFINITY));
        found
    }
}

/// The sum of the lengths of the stretches (s).
pub fn lasting(stretches: &[(f64, f64)]) -> f64 {
    stretches.iter().map(|(from, to)| to - from).sum()
}

/// The length of the longest stretch (s).
pub fn longest(stretches: &[(f64, f64)]) -> f64 {
    stretches.iter().map(|(from, to)| to - from).fold(0.0, f64::max)
}

/// The longest stretch (s), of equally long ones the first.
pub fn longest_of(stretches: &[(f64, f64)]) -> Option<(f64, f64)> {
    let lasts = |own: &(f64, f64)| own.1 - own.0;
    stretches.iter().rev().max_by(|a, b| lasts(a).total_cmp(&lasts(b))).copied()
}

/// The overlaps of two ordered lists of stretches (s).
pub fn intersect(a: &[(f64, f64)], b: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (mut i, mut j) = (0, 0);
    let mut found = Vec::new();
    while i < a.len() && j < b.len() {
        let (from, to) = (a[i].0.max(b[j].0), a[i].1.min(b[j].1));
        if from <= to {
            found.push((from, to));
        }
        if a[i].1 < b[j].1 { i += 1 } else { j += 1 }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::{BadReason, Quality};

    fn bad(t: f64) -> Sample {
        Sample { t, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) }
    }

    #[test]
    fn of_equally_long_stretches_the_first_is_taken() {
        assert_eq!(longest_of(&[(0.0, 90.0), (200.0, 500.0), (600.0, 900.0)]), Some((200.0, 500.0)));
        assert_eq!(longest_of(&[]), None);
    }

    #[test]
    fn the_time_is_split_by_mode_and_what_is_not_known_is_neither() {
        let mode = [
            bad(0.0),
            Sample::good(10.0, 1.0),
            Sample::good(30.0, 0.0),
            Sample::good(50.0, 1.0),
            // Not read for longer than a few polls.
            bad(60.0),
            bad(68.0),
            Sample::good(80.0, 0.0),
        ];
        let modes = Modes::of(&mode, 1.0);
        let edge = 1e-3;
        assert_eq!(modes.automatic, [(10.0, 30.0 - edge), (50.0, 60.0 - edge)]);
        assert_eq!(modes.other, [(30.0, 50.0 - edge), (80.0, f64::INFINITY)]);
        let perhaps = modes.perhaps_automatic();
        let ends = (f64::NEG_INFINITY, f64::INFINITY);
        assert_eq!(perhaps, [(ends.0, 30.0), (50.0 - edge, 80.0), (f64::INFINITY, ends.1)]);
        assert!((lasting(&intersect(&modes.automatic, &[(0.0, 100.0)])) - 30.0).abs() < 0.01);
        let none = Modes::of(&[bad(0.0), bad(1.0)], 1.0);
        assert!(none.automatic.is_empty() && none.other.is_empty());
        assert_eq!(none.perhaps_automatic(), [ends]);
    }
}
