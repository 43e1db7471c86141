//! The points (times and values) of a tag, brought to an equal grid: interpolated, held, or low-passed.

use crate::sysid::least_squares::{dot, total};
use crate::sysid::stats::{median, range};
use std::f64::consts::PI;
use std::ops::Range;

/// Samples in a row from which a record is low-passed; with fewer it is interpolated.
pub const THINNED: f64 = 1.2;
/// Median intervals after which a change is late, so that OP stood still before it. The jitter of a poll is less than half an interval; a
/// scan at which OP did not change is a whole one.
const LATE: f64 = 1.5;
/// Half the length of the filter (rows): a shorter one would let aliases pass, or attenuate a cycle of five rows.
const REACH: usize = 4;
/// Frequency at which the filter keeps half of the amplitude (cycles/row). It is below 0.6, which is aliased to the shortest period
/// that is searched for (2.5 rows), by the width of the filter's transition.
const HALF: f64 = 0.35;
/// Most parts of a row over which means are taken before the filter. A cycle about as long as a part is aliased, too: the means leave a
/// hundredth of it.
const PARTS: f64 = 64.0;

/// Times (s) and values, in order.
pub type Points = [(f64, f64)];

/// An equal grid, and the rows of it that are wanted.
pub struct Grid {
    /// Time of row 0 (s).
    pub from: f64,
    /// Period of the rows (s).
    pub ts: f64,
    /// The wanted rows.
    pub rows: Range<usize>,
}

impl Grid {
    /// Times of the wanted rows (s).
    pub fn times(&self) -> impl Iterator<Item = f64> + Clone {
        let (from, ts) = (self.from, self.ts);
        self.rows.clone().map(move |k| from + k as f64 * ts)
    }

    /// The beginning of each wanted row, and the end of the last (s).
    pub fn edges(&self) -> impl Iterator<Item = f64> + Clone {
        let (from, ts) = (self.from, self.ts);
        (self.rows.start..=self.rows.end).map(move |k| from + (k as f64 - 0.5) * ts)
    }
}

/// The values alone.
pub fn values(points: &Points) -> Vec<f64> {
    points.iter().map(|point| point.1).collect()
}

/// Median time between two points (s); 0 for fewer than two.
pub fn interval(points: &Points) -> f64 {
    median(&points.windows(2).map(|w| w[1].0 - w[0].0).collect::<Vec<f64>>())
}

/// Mean time between two points (s); 0 for fewer than two.
pub fn mean_interval(points: &Points) -> f64 {
    let length = points.first().zip(points.last()).map_or(0.0, |(first, last)| last.0 - first.0);
    length / points.len().saturating_sub(1).max(1) as f64
}

/// The points with a corner at each late change: the value before it holds until then.
pub fn stepped(points: &Points) -> Vec<(f64, f64)> {
    let late = LATE * interval(points);
    let mut out = Vec::with_capacity(2 * points.len());
    let mut last: Option<(f64, f64)> = None;
    for &point in points {
        let corner = last.filter(|last| point.0 - last.0 > late).map(|last| (point.0, last.1));
        out.extend(corner.into_iter().chain([point]));
        last = Some(point);
    }
    out
}

/// The value at time `t` of the line from point `at` to the next one; constant before and after all points, and where it `is_held`.
fn on_line(points: &Points, at: usize, t: f64, is_held: bool) -> f64 {
    let (a, b) = (points[at], points[(at + 1).min(points.len() - 1)]);
    let part = if is_held || b.0 <= a.0 { 0.0 } else { ((t - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) };
    a.1 + part * (b.1 - a.1)
}

/// The values at some times: interpolated, or where `is_held` those of the points before.
pub fn picked(points: &Points, times: impl Iterator<Item = f64>, is_held: bool) -> Vec<f64> {
    let mut at = 0;
    times
        .map(|t| {
            while at + 1 < points.len() && points[at + 1].0 <= t {
                at += 1;
            }
            on_line(points, at, t, is_held)
        })
        .collect()
}

/// The line through the points at the rows of a grid, low-passed by a windowed sinc filter.
///
/// ```text
/// x[k] = sum of w(j/m) c[m k + j] over |j| <= 4 m / sum of w      w(τ) = sinc(0.7 τ) (0.42 + 0.5 cos(π τ/4) + 0.08 cos(π τ/2))
/// ```
///
/// c: means of the line over the parts of a row; m: parts in a row, each about as long as the interval of the samples; τ: rows;
/// `sinc(x) = sin(πx)/(πx)`. At the ends of the record the sums are over the parts that there are. Beside a jump the filter overshoots by
/// some per cent; its values are clamped to the range of the samples, because a signal may stay at a limit.
///
/// * `interval`: median interval of the samples (s).
///
/// Source: Oppenheim & Schafer, Discrete-Time Signal Processing, 2010, section 7.5 (windowed sinc, Blackman's window).
pub fn low_passed(points: &Points, grid: &Grid, interval: f64) -> Vec<f64> {
    let (n, level) = (grid.rows.len(), points[0].1);
    // A single sample has no interval: the number of parts is then the largest.
    let m = (grid.ts / interval).ceil().clamp(1.0, PARTS) as usize;
    let first = grid.from + grid.rows.start as f64 * grid.ts;
    let part = grid.ts / m as f64;
    let times = (0..=n.saturating_sub(1) * m).map(|j| first + j as f64 * part);
    // As deviations from the first value, so that a constant signal stays constant to the last digit.
    let parts: Vec<f64> = averaged(points, times, part).into_iter().map(|x| x - level).collect();
    let reach = REACH * m;
    let weights: Vec<f64> = (0..=2 * reach).map(|j| weight((j as f64 - reach as f64) / m as f64)).collect();
    let (low, high) = range(&values(points));
    (0..n)
        .map(|k| {
            let at = k * m;
            let (from, to) = (at.saturating_sub(reach), (at + reach).min(parts.len() - 1));
            let own = &weights[from + reach - at..=to + reach - at];
            (level + dot(&parts[from..=to], own) / total(own)).clamp(low, high)
        })
        .collect()
}

/// The weight w of the filter at a distance of some rows.
fn weight(rows: f64) -> f64 {
    let (x, turn) = (2.0 * PI * HALF * rows, PI * rows / REACH as f64);
    let sinc = if x == 0.0 { 1.0 } else { x.sin() / x };
    sinc * (0.42 + 0.5 * turn.cos() + 0.08 * (2.0 * turn).cos())
}

/// The means of the line through the points over `ts` (s) around each time, as far as the points cover it.
fn averaged(points: &Points, times: impl Iterator<Item = f64>, ts: f64) -> Vec<f64> {
    let (first, last) = (points[0].0, points[points.len() - 1].0);
    let mut at = 0;
    times
        .map(|t| {
            let (mut from, to) = ((t - 0.5 * ts).clamp(first, last), (t + 0.5 * ts).clamp(first, last));
            while at + 1 < points.len() && points[at + 1].0 <= from {
                at += 1;
            }
            let (begin, level, mut sum, mut i) = (from, on_line(points, at, from, false), 0.0, at);
            while from < to && i + 1 < points.len() {
                let until = points[i + 1].0.min(to);
                let ends = [from, until].map(|t| on_line(points, i, t, false) - level);
                sum += 0.5 * (ends[0] + ends[1]) * (until - from);
                (from, i) = (until, i + 1);
            }
            if to > begin { level + sum / (to - begin) } else { level }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sysid::stats::sd;
    use std::f64::consts::{SQRT_2, TAU};

    /// Amplitude that 3,000 rows keep of a cycle of so many rows, without the filter's ends, with so many samples a row.
    fn kept(rows_a_period: f64, samples_a_row: f64) -> f64 {
        let samples = (3000.0 * samples_a_row) as usize;
        let wave = |t: f64| (TAU * t / (rows_a_period * samples_a_row) + 0.4).sin();
        let points: Vec<(f64, f64)> = (0..samples).map(|k| k as f64).map(|t| (t, wave(t))).collect();
        let grid = Grid { from: 0.0, ts: samples_a_row, rows: 0..2990 };
        SQRT_2 * sd(&low_passed(&points, &grid, 1.0)[10..2980])
    }

    #[test]
    fn what_would_fold_is_gone_and_what_is_slow_stays() {
        // Of cycles of 20, 10, 5 and 4 rows, and at how many rows a half is left: the fewer samples a row has, the more is lost where
        // it is drawn between them.
        for (samples_a_row, slow, half) in [
            (1.366, [0.993, 0.968, 0.828, 0.700], 3.20),
            (2.5, [0.997, 0.983, 0.878, 0.768], 2.97),
            (33.3, [0.998, 0.990, 0.903, 0.803], 2.86),
            (150.0, [0.998, 0.990, 0.903, 0.803], 2.86),
        ] {
            for (rows, expected) in [20.0, 10.0, 5.0, 4.0].into_iter().zip(slow).chain([(half, 0.5)]) {
                let kept = kept(rows, samples_a_row);
                assert!((kept - expected).abs() < 0.005, "{samples_a_row} {rows}: {kept}");
            }
            // 1.67 rows fold to 2.5, the shortest period that is looked for; 1.01 to a hundred. Below two samples a period it is the
            // samples that show another cycle.
            let is_sampled = |rows: &f64| rows * samples_a_row > 2.0;
            for rows in [1.66, 1.53, 1.3, 1.01, 0.99, 0.7, 0.51].into_iter().filter(is_sampled) {
                let kept = kept(rows, samples_a_row);
                assert!(kept < 0.015, "{samples_a_row} {rows}: {kept}");
            }
        }
    }

    #[test]
    fn a_level_beside_a_jump_is_not_exceeded() {
        let points: Vec<(f64, f64)> =
            (0..10_000).map(|k| (f64::from(k), if k / 1000 % 2 == 0 { 0.1 } else { 100.0 })).collect();
        let found = low_passed(&points, &Grid { from: 0.0, ts: 20.0, rows: 0..500 }, 1.0);
        assert_eq!(range(&found), (0.1, 100.0));
        // In the middle of each stretch of fifty rows it is there to rounding.
        assert!((0..10).all(|k| (found[50 * k + 25] - points[1000 * k].1).abs() < 1e-9));
        // One sample has no interval.
        let one = low_passed(&[(5.0, 0.1)], &Grid { from: 0.0, ts: 20.0, rows: 0..3 }, 0.0);
        assert_eq!(one, [0.1; 3]);
    }
}
