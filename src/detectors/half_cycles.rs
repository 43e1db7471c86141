//! Half cycles of a signal whose period is known, and shapes that are fitted to them.
//!
//! ```text
//! c[k] = v[k] - mean of v over one period around k       removes a trend, and keeps the cycle with its harmonics
//! s = (k - from) / (to - from)                           0 at one zero crossing of c, 1 at the next
//! ```

use crate::diagnosis::denoise::{denoise, noise_sd};
use crate::sysid::stats::sd;

/// Hysteresis of a zero crossing: a centred signal must then pass this share of its rms.
const HYSTERESIS: f64 = 0.4;
/// Factor by which a half cycle may be shorter or longer than half a period.
const UNEQUAL: f64 = 2.0;
/// Fewest samples of a half cycle whose shape can be recognised.
pub const LEAST_SAMPLES: usize = 5;
/// Standard deviation of the noise, as a share of the signal's, above which zero crossings are searched for in the denoised signal.
const NOISY: f64 = 0.05;

/// The cycles of a signal without its trend, cut into half cycles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cycles {
    /// The centred signal, in the signal's unit.
    pub centred: Vec<f64>,
    /// Its half cycles in order.
    pub halves: Vec<HalfCycle>,
}

/// A half cycle: the stretch from one zero crossing to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfCycle {
    /// The first crossing (samples).
    pub from: f64,
    /// The second (samples).
    pub to: f64,
    /// Whether the signal is above zero in it.
    pub above: bool,
}

impl Cycles {
    /// The cycles of a signal. `period`: in samples.
    pub fn new(v: &[f64], period: f64) -> Self {
        let centred = centre(v, period);
        let noisy = noise_sd(v) > NOISY * sd(v);
        let halves =
            if noisy { halves(&centre(&denoise(v), period), period) } else { halves(&centred, period) };
        Self { centred, halves }
    }

    /// Position `s` in the half cycle (0..1) and height of each of its samples. Heights are positive on either side of zero.
    pub fn samples(&self, half: &HalfCycle) -> impl Iterator<Item = (f64, f64)> + Clone {
        let sign = if half.above { 1.0 } else { -1.0 };
        let (from, length) = (half.from, half.to - half.from);
        let range = (half.from.ceil() as usize)..(half.to.floor() as usize + 1).min(self.centred.len());
        range
            .clone()
            .zip(self.centred.get(range).unwrap_or_default())
            .map(move |(k, c)| ((k as f64 - from) / length, sign * c))
    }
}

/// The signal `v` less its mean over one period around each sample. In the first and the last half period it is the mean of the
/// nearest whole period. `period`: in samples.
pub fn centre(v: &[f64], period: f64) -> Vec<f64> {
    let n = v.len();
    let mut sums = Vec::with_capacity(n + 1);
    sums.push(0.0);
    for x in v {
        sums.push(sums.last().copied().unwrap_or(0.0) + x);
    }
    // The sum of v from the left edge of sample 0 to `at` sample widths on.
    let until = |at: f64| -> f64 {
        let whole = (at.floor() as usize).min(n);
        sums[whole] + (at - whole as f64) * v.get(whole).copied().unwrap_or(0.0)
    };
    let width = period.clamp(1.0, n.max(1) as f64);
    (0..n)
        .map(|k| {
            let from = (k as f64 + 0.5 - 0.5 * width).clamp(0.0, n as f64 - width);
            v[k] - (until(from + width) - until(from)) / width
        })
        .collect()
}

/// The half cycles of a centred signal: between zero crossings after which the signal passes the hysteresis.
fn halves(c: &[f64], period: f64) -> Vec<HalfCycle> {
    let clear = HYSTERESIS * sd(c);
    let mut found = Vec::new();
    let mut side: Option<bool> = None;
    let mut crossing: Option<f64> = None;
    let mut last_crossing: Option<f64> = None;
    for k in 1..c.len() {
        if (c[k - 1] > 0.0) != (c[k] > 0.0) {
            crossing = Some((k - 1) as f64 + c[k - 1] / (c[k - 1] - c[k]));
        }
        let now = c[k] > 0.0;
        if c[k].abs() <= clear || side == Some(now) {
            continue;
        }
        if let (Some(before), Some(from), Some(to)) = (side, last_crossing, crossing) {
            let ratio = (to - from) / (0.5 * period);
            if ratio > 1.0 / UNEQUAL && ratio < UNEQUAL {
                found.push(HalfCycle { from, to, above: before });
            }
        }
        // The record's first half cycle has no beginning.
        last_crossing = crossing.filter(|_| side.is_some());
        side = Some(now);
    }
    found
}

/// Least-squares fit of a multiple of `shape` to the samples: the sum of squared errors, and the multiple.
pub fn fit(samples: impl Iterator<Item = (f64, f64)> + Clone, shape: impl Fn(f64) -> f64) -> (f64, f64) {
    let (mut sv, mut ss, mut vv) = (0.0, 0.0, 0.0);
    for (s, v) in samples {
        let shape = shape(s);
        sv += shape * v;
        ss += shape * shape;
        vv += v * v;
    }
    let height = if ss > 0.0 { sv / ss } else { 0.0 };
    ((vv - height * sv).max(0.0), height)
}

/// Half a sine.
pub fn sine(s: f64) -> f64 {
    (std::f64::consts::PI * s).sin()
}

/// A triangle with its peak at `at` (0..1).
pub fn triangle(s: f64, at: f64) -> f64 {
    if s < at { s / at } else { (1.0 - s) / (1.0 - at) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_sine_on_a_ramp_is_cut_at_its_crossings() {
        let v: Vec<f64> = (0..400).map(|k| (TAU * f64::from(k) / 40.0).sin() + 0.02 * f64::from(k)).collect();
        let cycles = Cycles::new(&v, 40.0);
        assert!(cycles.halves.len() >= 15, "{}", cycles.halves.len());
        // Away from the edges, where the mean is that of another period, the ramp is gone.
        for half in cycles.halves.iter().filter(|half| half.from > 25.0 && half.to < 375.0) {
            assert!((half.to - half.from - 20.0).abs() < 0.05, "{half:?}");
            let (sse, height) = fit(cycles.samples(half), sine);
            assert!(sse < 1e-3 && (height - 1.0).abs() < 0.01, "{sse} {height}");
        }
    }

    #[test]
    fn by_hand() {
        let shape = [(0.0, 0.0), (0.25, 1.0), (0.5, 2.0), (0.75, 1.0), (1.0, 0.0)];
        let (sse, height) = fit(shape.into_iter(), |s| triangle(s, 0.5));
        assert!(sse < 1e-12 && (height - 2.0).abs() < 1e-12);
        assert_eq!(centre(&[1.0, 1.0, 1.0], 2.0), vec![0.0; 3]);
        assert!(centre(&[], 2.0).is_empty());
    }
}
