//! The error of f that is due to the valve models, and how it widens the interval of f.
//!
//! A real valve differs from every model, in the same way at each turn of the stem. The likelihood of one record does not show by how
//! much f is wrong then. So both ends of the interval are moved as if f had one more, independent error.
//! The relative standard deviation of this error is calibrated on simulated valves that are none of the models:
//!
//! ```text
//! ln(end / f)^2 = ln(end of the likelihood / f)^2 + (1.96 MODEL_SD)^2
//! ```
//!
//! Two windows of one valve have the same error, so their intervals are compared without it.

/// Relative standard deviation of f by which a valve differs from its models.
pub const MODEL_SD: f64 = 0.08;
/// 97.5 % point of the normal distribution.
pub const NORMAL_95: f64 = 1.96;

/// Widens the interval `[low, high]` of f, which its likelihood gives, by the error of the models (any unit). An end at 0 stays at 0.
pub fn with_model_error(f: f64, [low, high]: [f64; 2]) -> [f64; 2] {
    let apart = |end: f64| (end / f).ln().hypot(NORMAL_95 * MODEL_SD).exp();
    if f > 0.0 && low >= 0.0 && high.is_finite() { [f / apart(low), f * apart(high)] } else { [low, high] }
}

/// The inverse of [`with_model_error`]: the interval of f that its likelihood alone gives (any unit).
pub fn without_model_error(f: f64, [low, high]: [f64; 2]) -> [f64; 2] {
    let apart = |end: f64| {
        let whole = (end / f).ln();
        (whole * whole - (NORMAL_95 * MODEL_SD).powi(2)).max(0.0).sqrt().exp()
    };
    if f > 0.0 && low >= 0.0 && high.is_finite() { [f / apart(low), f * apart(high)] } else { [low, high] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_windows_have_the_error_of_the_models_in_common() {
        for own in [[1.9, 2.3], [2.0, 2.0], [0.0, 2.01], [0.7, 9.0]] {
            let back = without_model_error(2.0, with_model_error(2.0, own));
            assert!(back.iter().zip(own).all(|(a, b)| (a - b).abs() < 1e-7), "{own:?} {back:?}");
        }
    }

    #[test]
    fn the_error_of_the_models_adds_to_that_of_the_likelihood() {
        let alone = (NORMAL_95 * MODEL_SD).exp();
        let [low, high] = with_model_error(2.0, [2.0, 2.0]);
        assert!((low - 2.0 / alone).abs() < 1e-12 && (high - 2.0 * alone).abs() < 1e-12);
        // Three and four are five: here in units of the models' error.
        let ends = [-0.75, 4.0 / 3.0].map(|times: f64| 2.0 * (times * NORMAL_95 * MODEL_SD).exp());
        let [low, high] = with_model_error(2.0, ends);
        assert!((low - 2.0 * (-1.25 * NORMAL_95 * MODEL_SD).exp()).abs() < 1e-12);
        assert!((high - 2.0 * (5.0 / 3.0 * NORMAL_95 * MODEL_SD).exp()).abs() < 1e-12);
        assert_eq!(with_model_error(2.0, [0.0, 3.0])[0], 0.0, "friction that may be none stays so");
        assert_eq!(with_model_error(0.0, [0.0, 3.0]), [0.0, 3.0]);
    }
}
