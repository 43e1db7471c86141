//! Values that stand for no measurement among good samples.

use super::Sample;

/// Values of this and beyond are no measurement: 1E+30 stands for none in some exports, and more would overflow the sums.
pub const LARGEST_VALUE: f64 = 1e30;
/// Values that links, historians and loggers write where nothing was measured.
const OUTAGES: [f64; 14] = [
    0.0,
    -1.0,
    -99.0,
    -999.0,
    -999.25,
    -9999.0,
    -99_999.0,
    999.0,
    9999.0,
    99_999.0,
    -32_768.0,
    32_767.0,
    65_535.0,
    4_294_967_295.0,
];
/// How many times further than it spreads a tag lives from such a value; from zero it is once.
const FAR: f64 = 10.0;

/// Which of these values are no measurements among good samples: the tag lives far from them otherwise. A tag that stands still
/// lives far from nothing but zero.
pub fn outages(samples: &[Sample]) -> Vec<f64> {
    let times = |value: f64| samples.iter().filter(|s| s.value == value).count();
    let few = |value: &f64| (1..=samples.len() / 2).contains(&times(*value));
    let candidates: Vec<f64> = OUTAGES.into_iter().filter(few).collect();
    if candidates.is_empty() {
        return candidates;
    }
    // None of them is among the others, so that two kinds do not hide each other.
    let others: Vec<f64> = samples.iter().map(|s| s.value).filter(|v| !candidates.contains(v)).collect();
    if others.is_empty() {
        return Vec::new();
    }
    let (low, high) = (quantile(&others, 0.02), quantile(&others, 0.98));
    let spread = high - low;
    let far = |value: &f64| {
        let away = (low - value).max(value - high);
        if *value == 0.0 { away > spread } else { spread > 0.0 && away > FAR * spread }
    };
    candidates.into_iter().filter(far).collect()
}

/// The q-quantile (0..1), interpolated between order statistics.
pub fn quantile(v: &[f64], q: f64) -> f64 {
    if v.is_empty() {
        return 0.0;
    }
    let at = q.clamp(0.0, 1.0) * (v.len() - 1) as f64;
    let (place, part) = (at.floor() as usize, at.fract());
    let mut own = v.to_vec();
    let (_, &mut low, above) = own.select_nth_unstable_by(place, f64::total_cmp);
    let high = above.iter().copied().min_by(f64::total_cmp).unwrap_or(low);
    low + part * (high - low)
}
