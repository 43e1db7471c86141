//! One number per loop, to sort by: 100 for a loop that does its work, 0 for one that does none of it.
//!
//! ```text
//! score = 100 (1 - sum w_i b_i / sum w_i)      over the indicators that are known
//! ```
//!
//! | i | b_i, 0 (good) to 1 (bad) | w_i |
//! |---|---|---|
//! | service | 1 - service factor | 5/16 |
//! | limits | share of the time at a limit | 3/16 |
//! | oscillation | share of the error's variance in regular oscillations | 6/16 |
//! | stuck | share of the time in which PV stands still while OP moves | 2/16 |
//!
//! The weights are a convention: an oscillation that is all of the variance costs a little more than a loop in manual. Who has
//! prices sorts by those instead. The Harris index does not count: not every loop has a model that
//! tells the dead time of its process, and without that it says nothing of how one loop compares with another.

/// Weights of service, limits, oscillation and stuck.
pub const WEIGHTS: [f64; 4] = [0.3125, 0.1875, 0.375, 0.125];

/// What is bad about a loop (0..1 each); none where it is not known, in the order of [`WEIGHTS`].
pub type Bad = [Option<f64>; 4];

/// The score (0..100); none where nothing is known.
pub fn score(bad: &Bad) -> Option<f64> {
    let known =
        bad.iter().zip(&WEIGHTS).filter_map(|(bad, weight)| Some((bad.filter(|b| b.is_finite())?, weight)));
    let (sum, weights) =
        known.fold((0.0, 0.0), |(sum, all), (bad, w)| (sum + w * bad.clamp(0.0, 1.0), all + w));
    (weights > 0.0).then(|| 100.0 * (1.0 - sum / weights))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        assert!((WEIGHTS.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!(score(&[Some(0.0); 4]), Some(100.0));
        assert_eq!(score(&[Some(1.0), None, None, Some(0.0)]), Some(100.0 * (1.0 - 5.0 / 7.0)));
        assert_eq!(score(&[None; 4]), None);
        assert_eq!(score(&[Some(f64::NAN), None, Some(0.5), None]), Some(50.0));
    }
}
