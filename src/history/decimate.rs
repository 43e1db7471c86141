//! Thins a trend for a screen so that what a person would notice survives: every bucket keeps its lowest and
//! highest value and, where it has one, a bad sample, which the screen draws as a gap.

use crate::signal::{Quality, Sample};

/// Thins `samples` (in order of time) to at most `points` (at least 3) samples, in the same order.
///
/// The samples are cut into `points / 3` buckets of equal count; each yields its minimum, its maximum and its first
/// bad sample. Values are never averaged, so every returned sample was measured.
pub fn decimate(samples: &[Sample], points: usize) -> Vec<Sample> {
    let points = points.max(3);
    if samples.len() <= points {
        return samples.to_vec();
    }
    let buckets = points / 3;
    let mut kept = Vec::with_capacity(points);
    for bucket in 0..buckets {
        let from = bucket * samples.len() / buckets;
        let to = (bucket + 1) * samples.len() / buckets;
        let mut picks = extremes(&samples[from..to]);
        picks.sort_unstable();
        kept.extend(picks.iter().flatten().map(|&at| samples[from + at]));
    }
    kept
}

/// Positions of the minimum, the maximum and the first bad sample; none twice.
fn extremes(bucket: &[Sample]) -> [Option<usize>; 3] {
    let (mut low, mut high, mut bad) = (None, None, None);
    for (at, sample) in bucket.iter().enumerate() {
        if matches!(sample.quality, Quality::Bad(_)) || !sample.value.is_finite() {
            bad = bad.or(Some(at));
            continue;
        }
        if low.is_none_or(|l: usize| sample.value < bucket[l].value) {
            low = Some(at);
        }
        if high.is_none_or(|h: usize| sample.value > bucket[h].value) {
            high = Some(at);
        }
    }
    if low == high {
        high = None;
    }
    [low, high, bad]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::BadReason;
    use proptest::prelude::*;

    fn bad(t: f64) -> Sample {
        Sample { t, value: f64::NAN, quality: Quality::Bad(BadReason::Timeout) }
    }

    #[test]
    fn a_single_spike_and_a_single_gap_survive() {
        let mut samples: Vec<Sample> = (0..10_000).map(|i| Sample::good(f64::from(i), 50.0)).collect();
        samples[4321].value = 99.0;
        samples[4322].value = 1.0;
        samples[7000] = bad(7000.0);
        let thin = decimate(&samples, 300);
        assert!(thin.len() <= 300);
        assert!(thin.contains(&samples[4321]) && thin.contains(&samples[4322]));
        assert!(thin.iter().any(|s| s.t == 7000.0 && !s.quality.is_good()));
    }

    #[test]
    fn short_records_are_returned_as_they_are() {
        let samples = [Sample::good(0.0, 1.0), bad(1.0), Sample::good(2.0, 3.0)];
        assert_eq!(decimate(&samples, 0).len(), 3);
        assert_eq!(decimate(&[], 10), vec![]);
    }

    proptest! {
        #[test]
        fn bounded_ordered_and_keeps_the_range(
            values in proptest::collection::vec((-1e6f64..1e6, proptest::bool::weighted(0.1)), 1..800),
            points in 0usize..200,
        ) {
            let samples: Vec<Sample> = values
                .iter()
                .enumerate()
                .map(|(i, &(v, is_bad))| if is_bad { bad(i as f64) } else { Sample::good(i as f64, v) })
                .collect();
            let thin = decimate(&samples, points);
            prop_assert!(thin.len() <= points.max(3));
            prop_assert!(thin.windows(2).all(|w| w[0].t < w[1].t));
            let range = |s: &[Sample]| {
                s.iter().filter(|s| s.quality.is_good()).fold((f64::MAX, f64::MIN), |(lo, hi), s| {
                    (lo.min(s.value), hi.max(s.value))
                })
            };
            prop_assert_eq!(range(&thin), range(&samples));
            prop_assert_eq!(
                thin.iter().any(|s| !s.quality.is_good()),
                samples.iter().any(|s| !s.quality.is_good())
            );
        }
    }
}
