//! One number per loop, to sort by: 100 for a loop that does its work, 0 for one that does none of it.
//!
//! ```text
//! score = 100 (1 - sum w_i b_i / sum w_i)      over the indicators that are known
//! ```
//!
//! | i | b_i, 0 (good) to 1 (bad) | w_i |
//! |---|---|---|
//! | service | 1 - service factor | 0.25 |
//! | limits | share of the time at a limit | 0.15 |
//! | oscillation | share of the error's variance in regular oscillations | 0.30 |
//! | variance | 1 - Harris index, where the dead time is known | 0.20 |
//! | stuck | share of the time in which PV stands still while OP moves | 0.10 |
//!
//! The weights are a convention: what a loop in manual costs is worth as much as what an oscillation of a quarter of the
//! variance more does. Who has prices sorts by those instead.

/// Weights of service, limits, oscillation, variance and stuck.
pub const WEIGHTS: [f64; 5] = [0.25, 0.15, 0.30, 0.20, 0.10];

/// What is bad about a loop (0..1 each); none where it is not known, in the order of [`WEIGHTS`].
pub type Bad = [Option<f64>; 5];

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
        assert_eq!(score(&[Some(0.0); 5]), Some(100.0));
        assert_eq!(score(&[Some(1.0), None, None, None, Some(0.0)]), Some(100.0 * (1.0 - 0.25 / 0.35)));
        assert_eq!(score(&[None; 5]), None);
        assert_eq!(score(&[Some(f64::NAN), None, Some(0.5), None, None]), Some(50.0));
    }
}
