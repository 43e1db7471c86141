//! Loops with a known truth: the paper's six cases a wide random family, and one for calibration.

mod calibration;
mod draw;
mod paper;
mod random;

pub use calibration::calibration;
pub use paper::{SineUnit, level_sinusoidal, table2, table2_loop};
pub use random::{SOUND_KINDS, random_sound, random_sticky};

use super::plant::{LoopSpec, Run, SpecError, simulate};

/// What is true of a scenario's valve.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Whether the valve sticks (or has a dead band).
    pub sticky: bool,
    /// Dead band plus stick band S (% of OP); 0 for a sound valve.
    pub s: f64,
    /// Slip jump J (% of OP); 0 for a dead band only.
    pub j: f64,
    /// The scenario in words.
    pub kind: String,
}

/// A loop, the seed it is to be run with, how long, and the truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// The loop.
    pub spec: LoopSpec,
    /// What is true of it.
    pub truth: Truth,
    /// Seed of its noise and loads.
    pub seed: u64,
    /// Samples to run.
    pub n: usize,
    /// Samples at the start that belong to the transient.
    pub warm_up: usize,
}

impl Scenario {
    /// The record after the transient: `n - warm_up` samples.
    ///
    /// # Errors
    /// [`SpecError`] where a number of the specification makes no sense.
    pub fn run(&self) -> Result<Run, SpecError> {
        Ok(simulate(&self.spec, self.n, self.seed)?.after(self.warm_up))
    }
}

/// How often `op` reverses by more than `s`: turning points a swing larger than `s` apart.
pub fn reverses_beyond(op: &[f64], s: f64) -> usize {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    // The direction of the present swing; none until OP has moved by more than s at all.
    let mut rising = None;
    let mut count = 0;
    for &u in op {
        low = low.min(u);
        high = high.max(u);
        let (down, up) = (high - u > s, u - low > s);
        match rising {
            None if up || down => rising = Some(up),
            Some(true) if down => {
                rising = Some(false);
                count += 1;
            }
            Some(false) if up => {
                rising = Some(true);
                count += 1;
            }
            _ => continue,
        }
        (low, high) = (u, u);
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reversals_by_hand() {
        // 0 -> 3 -> 0 -> 3: two reversals of 3, none of more than 3; the ripple of 1 on the way does not count.
        let op = [0.0, 2.0, 1.0, 3.0, 1.0, 2.0, 0.0, 3.0];
        assert_eq!(reverses_beyond(&op, 2.5), 2);
        assert_eq!(reverses_beyond(&op, 3.0), 0);
        assert_eq!(reverses_beyond(&op, 0.5), 6);
        assert_eq!(reverses_beyond(&[], 1.0), 0);
    }
}
