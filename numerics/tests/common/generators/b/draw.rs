//! Random numbers of one case: the same case gives the same numbers.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use stictiond_numerics::residual::Kind;

use super::super::{Case, Size};

/// A range that a number is drawn from.
pub type Range = (f64, f64);
/// A range for each size of effect: small, medium, large.
pub type Sized3 = [Range; 3];

/// The source of everything random in a record.
pub struct Draw(Pcg64Mcg);

impl Draw {
    /// The numbers of a case; a case that gave no usable loop is drawn anew under the next `attempt`.
    pub fn of(case: &Case, attempt: u64) -> Self {
        let effect = case.effect.map_or(0, |kind| 1 + Kind::ALL.iter().take_while(|&&k| k != kind).count());
        let words =
            [effect as u64, case.size as u64, case.variant as u64, case.seed, case.tags as u64, attempt];
        Self(Pcg64Mcg::seed_from_u64(words.iter().fold(HASH_START, |hash, &word| mixed(hash ^ word))))
    }

    /// Evenly between the ends.
    pub fn uniform(&mut self, (low, high): Range) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Evenly in the logarithm between the ends.
    pub fn log_uniform(&mut self, (low, high): Range) -> f64 {
        self.uniform((low.ln(), high.ln())).exp()
    }

    /// A whole number, both ends included.
    pub fn whole(&mut self, low: usize, high: usize) -> usize {
        self.0.random_range(low..=high)
    }

    /// A normal number of mean 0 and sd 1.
    pub fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    /// True with the given probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.0.random::<f64>() < probability
    }

    /// Plus or minus one.
    pub fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// One of the choices.
    pub fn pick<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.whole(0, choices.len() - 1)]
    }

    /// A number from the range that belongs to the size.
    pub fn sized(&mut self, size: Size, ranges: &Sized3) -> f64 {
        self.uniform(ranges[size as usize])
    }
}

/// First value of the hash.
const HASH_START: u64 = 0x0b5e_55ed_c0de_cafe;

/// A word whose bits depend on all bits of the given one (the last step of SplitMix64).
fn mixed(word: u64) -> u64 {
    let mut z = word.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
