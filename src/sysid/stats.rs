//! Mean, variance, standard deviation, median and range of a slice, and its normalisation. Empty input gives 0.

pub use crate::signal::quantile;

/// Arithmetic mean.
pub fn mean(v: &[f64]) -> f64 {
    if v.is_empty() { 0.0 } else { v.iter().sum::<f64>() / v.len() as f64 }
}

/// Mean square about the mean (divided by N).
pub fn variance(v: &[f64]) -> f64 {
    let m = mean(v);
    if v.is_empty() { 0.0 } else { v.iter().map(|x| (x - m) * (x - m)).sum::<f64>() / v.len() as f64 }
}

/// Standard deviation (divided by N).
pub fn sd(v: &[f64]) -> f64 {
    variance(v).sqrt()
}

/// Grid points in a standard deviation of a normalised signal: far finer than any measurement, far coarser than rounding.
const GRAINS: f64 = 4_294_967_296.0;

/// `(v - m) / s`, rounded to multiples of 2^-32.
///
/// The same signal in another unit differs in the last digits, and a search may then choose the other one of two nearly equal fits.
/// Rounded to a grid that no measurement resolves, the signal gives the same numbers in every unit.
pub fn normalised(v: &[f64], m: f64, s: f64) -> Vec<f64> {
    v.iter().map(|x| ((x - m) / s * GRAINS).round() / GRAINS).collect()
}

/// The median.
pub fn median(v: &[f64]) -> f64 {
    quantile(v, 0.5)
}

/// Least and largest value; `(0, 0)` for an empty slice.
pub fn range(v: &[f64]) -> (f64, f64) {
    if v.is_empty() {
        return (0.0, 0.0);
    }
    v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &x| (lo.min(x), hi.max(x)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hand_values() {
        let v = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(mean(&v), 2.5);
        assert_eq!(variance(&v), 1.25);
        assert_eq!(median(&v), 2.5);
        assert_eq!(quantile(&v, 1.0), 4.0);
        assert_eq!(range(&v), (1.0, 4.0));
        assert_eq!(normalised(&v, 2.5, 0.5), [3.0, -3.0, 1.0, -1.0]);
        assert_eq!((mean(&[]), sd(&[]), median(&[]), range(&[])), (0.0, 0.0, 0.0, (0.0, 0.0)));
    }

    #[test]
    fn a_signal_is_normalised_to_the_same_numbers_in_every_unit() {
        let v: Vec<f64> = (0..2000).map(|k| 40.0 + (0.37 * f64::from(k)).sin()).collect();
        let of = |v: &[f64]| normalised(v, mean(v), sd(v));
        let own = of(&v);
        let mut differ = 0;
        for (scale, shift) in [(0.01, 0.0), (1e3, 0.0), (0.16, 4.0), (276.48, 0.0), (1.0, 273.15)] {
            let other: Vec<f64> = v.iter().map(|x| shift + scale * x).collect();
            differ += own.iter().zip(of(&other)).filter(|(a, b)| *a != b).count();
        }
        // Rounding of values and mean is some thousandths of a grain: so many of 10,000 lie where it decides between two.
        assert!(differ <= 50, "{differ}");
        let turned: Vec<f64> = v.iter().map(|x| -x).collect();
        assert!(own.iter().zip(of(&turned)).all(|(a, b)| *a == -b));
    }
}
