//! What an archive keeps of a record: compression, exception reports, means, held and interpolated values. Samples in
//! the order of time; the same input gives the same archive.

use crate::signal::Sample;

/// Swinging-door compression: from the last sample kept a line must reach the newest within `deviation` of every one
/// between them, else the one before the newest is kept. At least one sample is kept every `longest_s`.
pub fn swinging_door(series: &[Sample], deviation: f64, longest_s: f64) -> Vec<Sample> {
    let Some(&first) = series.first() else { return Vec::new() };
    let mut kept = vec![first];
    let (mut from, mut before) = (first, first);
    let (mut least, mut most) = (f64::NEG_INFINITY, f64::INFINITY);
    for &s in &series[1..] {
        let slope = |v: f64| (v - from.value) / (s.t - from.t);
        let narrowed = (slope(s.value - deviation).max(least), slope(s.value + deviation).min(most));
        let fits = narrowed.0 <= narrowed.1 && s.t - from.t <= longest_s;
        if !fits && before.t > from.t {
            kept.push(before);
            from = before;
            let slope = |v: f64| (v - from.value) / (s.t - from.t);
            (least, most) = (slope(s.value - deviation), slope(s.value + deviation));
        } else {
            (least, most) = narrowed;
        }
        before = s;
    }
    kept.extend((before.t > from.t).then_some(before));
    kept
}

/// Report by exception: a sample that differs from the last one kept by more than `dead_band`, or comes `longest_s` after
/// it; with `previous` also the one before it, as some archives keep it.
pub fn exception(series: &[Sample], dead_band: f64, longest_s: f64, previous: bool) -> Vec<Sample> {
    let mut kept: Vec<Sample> = series.first().copied().into_iter().collect();
    for pair in series.windows(2) {
        let (before, now) = (pair[0], pair[1]);
        let Some(last) = kept.last().copied() else { continue };
        if (now.value - last.value).abs() > dead_band || now.t - last.t >= longest_s {
            if previous && before.t > last.t {
                kept.push(before);
            }
            kept.push(now);
        }
    }
    kept
}

/// Means over `k` samples, stamped at the end of each.
pub fn averaged(series: &[Sample], k: usize) -> Vec<Sample> {
    let mean = |block: &[Sample]| {
        let sum: f64 = block.iter().map(|s| s.value).sum();
        Sample::good(block[block.len() - 1].t, sum / block.len() as f64)
    };
    series.chunks_exact(k.max(1)).map(mean).collect()
}

/// Means over the last `k` samples, one for each sample.
pub fn moving_average(series: &[Sample], k: usize) -> Vec<Sample> {
    let mean = |window: &[Sample]| {
        let sum: f64 = window.iter().map(|s| s.value).sum();
        Sample::good(window[window.len() - 1].t, sum / window.len() as f64)
    };
    series.windows(k.max(1)).map(mean).collect()
}

/// Every `k`-th value, repeated until the next.
pub fn held(series: &[Sample], k: usize) -> Vec<Sample> {
    let k = k.max(1);
    series.iter().enumerate().map(|(i, s)| Sample::good(s.t, series[i - i % k].value)).collect()
}

/// On equal stamps, straight lines between the samples that were kept.
pub fn interpolated(kept: &[Sample], ts: f64) -> Vec<Sample> {
    let (Some(first), Some(last)) = (kept.first(), kept.last()) else { return Vec::new() };
    let n = ((last.t - first.t) / ts * (1.0 + 1e-9)).floor() as usize;
    let mut at = 0;
    let value = |k: usize| {
        let t = first.t + k as f64 * ts;
        while at + 2 < kept.len() && kept[at + 1].t <= t {
            at += 1;
        }
        let (a, b) = (kept[at], kept[(at + 1).min(kept.len() - 1)]);
        let part = if b.t > a.t { ((t - a.t) / (b.t - a.t)).clamp(0.0, 1.0) } else { 0.0 };
        Sample::good(t, a.value + part * (b.value - a.value))
    };
    (0..=n).map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[f64]) -> Vec<Sample> {
        values.iter().enumerate().map(|(k, v)| Sample::good(k as f64, *v)).collect()
    }

    fn points(series: &[Sample]) -> Vec<(f64, f64)> {
        series.iter().map(|s| (s.t, s.value)).collect()
    }

    #[test]
    fn hand_values() {
        let bent = of(&[0.0, 1.0, 2.0, 3.0, 3.0, 3.0]);
        assert_eq!(points(&swinging_door(&bent, 0.1, 1e9)), [(0.0, 0.0), (3.0, 3.0), (5.0, 3.0)]);
        assert_eq!(points(&swinging_door(&bent, 9.0, 2.0)), [(0.0, 0.0), (2.0, 2.0), (4.0, 3.0), (5.0, 3.0)]);
        let slow = of(&[0.0, 0.4, 0.8, 1.2, 1.2, 2.5]);
        assert_eq!(points(&exception(&slow, 1.0, 1e9, false)), [(0.0, 0.0), (3.0, 1.2), (5.0, 2.5)]);
        let both = [(0.0, 0.0), (2.0, 0.8), (3.0, 1.2), (4.0, 1.2), (5.0, 2.5)];
        assert_eq!(points(&exception(&slow, 1.0, 1e9, true)), both);
        assert_eq!(points(&averaged(&of(&[1.0, 3.0, 5.0, 7.0, 9.0]), 2)), [(1.0, 2.0), (3.0, 6.0)]);
        assert_eq!(points(&moving_average(&of(&[1.0, 3.0, 5.0]), 2)), [(1.0, 2.0), (2.0, 4.0)]);
        assert_eq!(points(&held(&of(&[1.0, 3.0, 5.0]), 2)), [(0.0, 1.0), (1.0, 1.0), (2.0, 5.0)]);
        let line = [Sample::good(0.0, 0.0), Sample::good(2.0, 2.0), Sample::good(3.0, 0.0)];
        assert_eq!(points(&interpolated(&line, 1.0)), [(0.0, 0.0), (1.0, 1.0), (2.0, 2.0), (3.0, 0.0)]);
    }

    #[test]
    fn a_line_through_what_was_kept_stays_within_the_deviation() {
        let wave: Vec<f64> =
            (0..500).map(|k| (f64::from(k) * 0.1).sin() + (f64::from(k) * 1.7).cos() * 0.05).collect();
        let raw = of(&wave);
        let kept = swinging_door(&raw, 0.1, 1e9);
        assert!(kept.len() < 150, "{}", kept.len());
        // A door's line ends at a recorded value, so that it may be off by up to twice the deviation.
        for (a, b) in raw.iter().zip(interpolated(&kept, 1.0)) {
            assert!((a.value - b.value).abs() <= 0.2 + 1e-9, "{a:?} {b:?}");
        }
    }
}
