//! The oscillation of OP: its large extrema, its regularity r, the most regular stretch, and its swing.
//!
//! ```text
//! h = OP - (upper + lower) / 2      natural cubic splines through the large maxima and minima
//! r = mean(T) / (3 sd(T))           T: periods between zero crossings of h; r > 1 is regular
//! swing = mean(maxima) - mean(minima)
//! ```
//!
//! Source: Ivan & Lakshminarayanan 2009, sections 3.2 and 3.3.1; Thornhill et al., J. Process Control 2003, 13, 91.

use super::denoise::{denoise, noise_sd};
use super::friction::Start;
use super::result::Oscillation;
use crate::sysid::stats::{mean, median, quantile, sd};

/// Noise of OP, as a share of its standard deviation, above which its extrema are sought in denoised OP: less makes no large
/// extrema.
const NOISY: f64 = 0.05;
/// Least swings of a large extremum that are tried, as shares of the 5..95 % range of OP: a set-point change or a drift widens that
/// range beyond the oscillation.
const LARGE_SWINGS: [f64; 4] = [0.25, 0.12, 0.06, 0.03];
/// Number of extrema at which no smaller swing is tried: those of six periods.
const ENOUGH_EXTREMA: usize = 12;
/// Least swing of an extremum, in standard deviations of the noise: noise alone seldom swings so far.
const OVER_NOISE: f64 = 4.0;

/// One large extremum of OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremum {
    /// Sample of the record.
    pub index: usize,
    /// OP there, denoised where it was (OP unit).
    pub value: f64,
    /// True for a maximum.
    pub is_max: bool,
}

/// The oscillation of one OP record.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// The large extrema; maxima and minima alternate.
    pub extrema: Vec<Extremum>,
    /// Times of the zero crossings of OP less the mean of its envelopes (samples).
    pub crossings: Vec<f64>,
    /// Noise of OP as a share of its standard deviation (-).
    pub noise_share: f64,
    /// Whether OP was denoised for this analysis.
    pub denoised: bool,
}

/// Finds the large extrema and the zero crossings of OP.
pub fn analyse(op: &[f64]) -> Region {
    let spread = sd(op);
    let noise = noise_sd(op);
    let noise_share = if spread > 0.0 { noise / spread } else { 0.0 };
    let denoised = noise_share > NOISY;
    let smooth = if denoised { denoise(op) } else { op.to_vec() };
    let extrema = select_extrema(&smooth, quantile(&smooth, 0.95) - quantile(&smooth, 0.05), noise);
    let crossings = crossings(&mean_shift(&smooth, &extrema));
    Region { extrema, crossings, noise_share, denoised }
}

impl Region {
    /// The oscillation between the samples `from` and `to`; `None` with fewer than three periods.
    ///
    /// * `ts`: sample period (s).
    pub fn oscillation(&self, from: usize, to: usize, ts: f64) -> Option<Oscillation> {
        let inside = |t: &&f64| **t >= from as f64 && **t < to as f64;
        let times: Vec<f64> = self.crossings.iter().filter(inside).copied().collect();
        let periods: Vec<f64> = times.windows(3).map(|w| w[2] - w[0]).collect();
        if periods.len() < 5 {
            return None;
        }
        Some(Oscillation {
            period: mean(&periods) * ts,
            regularity_r: regularity(&periods),
            op_amplitude: 0.5 * self.swing(from, to),
        })
    }

    /// The median period of the whole record (samples); `None` with fewer than two periods.
    pub fn typical_period(&self) -> Option<f64> {
        let periods: Vec<f64> = self.crossings.windows(3).map(|w| w[2] - w[0]).collect();
        (periods.len() >= 2).then(|| median(&periods))
    }

    /// The mean of the large maxima less that of the large minima between `from` and `to` (OP unit); 0 without both.
    pub fn swing(&self, from: usize, to: usize) -> f64 {
        let of = |is_max: bool| -> Vec<f64> {
            let wanted = |e: &&Extremum| e.is_max == is_max && e.index >= from && e.index < to;
            self.extrema.iter().filter(wanted).map(|e| e.value).collect()
        };
        let (maxima, minima) = (of(true), of(false));
        if maxima.is_empty() || minima.is_empty() { 0.0 } else { (mean(&maxima) - mean(&minima)).max(0.0) }
    }

    /// The number of large extrema between `from` and `to`: the reversals of OP.
    pub fn reversals(&self, from: usize, to: usize) -> usize {
        self.extrema.iter().filter(|e| e.index >= from && e.index < to).count()
    }

    /// The first sample of the stretch of `length` samples, among `n`, with the largest r; of the newest one where nothing
    /// oscillates.
    pub fn most_regular(&self, n: usize, length: usize) -> usize {
        if n <= length {
            return 0;
        }
        let mut best = (0.0, n - length);
        for (i, &from) in self.crossings.iter().enumerate() {
            let start = from.floor() as usize;
            if start + length > n {
                break;
            }
            let end = self.crossings.partition_point(|&t| t < (start + length) as f64);
            let periods: Vec<f64> = self.crossings[i..end].windows(3).map(|w| w[2] - w[0]).collect();
            let r = if periods.len() < 5 { 0.0 } else { regularity(&periods) };
            if r > best.0 {
                best = (r, start);
            }
        }
        best.1
    }
}

/// The extremum at which the friction element starts: the first large one between `from` and `to`, moved to the extremum of the
/// original OP within a few samples; `None` where there is none.
pub fn start_of(region: &Region, op: &[f64], from: usize, to: usize) -> Option<Start> {
    let first = region.extrema.iter().find(|e| e.index >= from && e.index < to)?;
    let reach = if region.denoised { 3 } else { 0 };
    let low = first.index.saturating_sub(reach).max(from);
    let high = (first.index + reach + 1).min(to);
    let sign = if first.is_max { 1.0 } else { -1.0 };
    let index = (low..high).max_by(|&a, &b| (sign * op[a]).total_cmp(&(sign * op[b])))?;
    Some(Start { index, is_max: first.is_max })
}

/// `r = mean(T) / (3 sd(T))`, bounded, so that it is finite for a perfectly regular record.
fn regularity(periods: &[f64]) -> f64 {
    let m = mean(periods);
    m / (3.0 * sd(periods)).max(1e-3 * m)
}

/// The extrema at the largest of [`LARGE_SWINGS`] with at least [`ENOUGH_EXTREMA`] of them; else the most that are above the noise.
fn select_extrema(smooth: &[f64], range: f64, noise: f64) -> Vec<Extremum> {
    let mut most = Vec::new();
    for share in LARGE_SWINGS {
        let swing = share * range;
        if !most.is_empty() && swing < OVER_NOISE * noise {
            break;
        }
        let found = large_extrema(smooth, swing.max(OVER_NOISE * noise));
        if found.len() > most.len() {
            most = found;
        }
        if most.len() >= ENOUGH_EXTREMA {
            break;
        }
    }
    most
}

/// Alternating extrema of `v` with at least `swing` from one to the next (unit of v); a flat top counts once.
pub fn large_extrema(v: &[f64], swing: f64) -> Vec<Extremum> {
    let mut found = Vec::new();
    let Some(&first) = v.first() else { return found };
    if swing <= 0.0 {
        return found;
    }
    let (mut high, mut low) = ((0, first), (0, first));
    let mut rising: Option<bool> = None;
    for (index, &value) in v.iter().enumerate() {
        if value > high.1 {
            high = (index, value);
        }
        if value < low.1 {
            low = (index, value);
        }
        if rising != Some(false) && high.1 - value >= swing {
            // The first swing may start at the edge of the record, which is no extremum.
            if rising.is_some() || high.0 > 0 {
                found.push(Extremum { index: high.0, value: high.1, is_max: true });
            }
            rising = Some(false);
            low = (index, value);
            high = (index, value);
        } else if rising != Some(true) && value - low.1 >= swing {
            if rising.is_some() || low.0 > 0 {
                found.push(Extremum { index: low.0, value: low.1, is_max: false });
            }
            rising = Some(true);
            high = (index, value);
            low = (index, value);
        }
    }
    found
}

/// OP less the mean of its two envelopes (adaptive mean shift); OP less its mean where there are too few extrema.
fn mean_shift(v: &[f64], extrema: &[Extremum]) -> Vec<f64> {
    let knots = |is_max: bool| -> Vec<(f64, f64)> {
        extrema.iter().filter(|e| e.is_max == is_max).map(|e| (e.index as f64, e.value)).collect()
    };
    let (upper, lower) = (knots(true), knots(false));
    if upper.len() < 2 || lower.len() < 2 {
        let m = mean(v);
        return v.iter().map(|x| x - m).collect();
    }
    let (upper, lower) = (spline(&upper, v.len()), spline(&lower, v.len()));
    v.iter().zip(upper.iter().zip(&lower)).map(|(x, (u, l))| x - 0.5 * (u + l)).collect()
}

/// Zero crossings, linearly interpolated (samples).
fn crossings(v: &[f64]) -> Vec<f64> {
    let mut times = Vec::new();
    let mut last: Option<(usize, f64)> = None;
    for (k, &x) in v.iter().enumerate() {
        if x == 0.0 {
            continue;
        }
        if let Some((j, before)) = last
            && (before > 0.0) != (x > 0.0)
        {
            times.push(j as f64 + (k - j) as f64 * before / (before - x));
        }
        last = Some((k, x));
    }
    times
}

/// The natural cubic spline through `knots` (at least two, with increasing abscissae) at the samples 0..n; constant outside the
/// knots.
fn spline(knots: &[(f64, f64)], n: usize) -> Vec<f64> {
    let m = knots.len();
    let mut second = vec![0.0; m];
    let mut upper = vec![0.0; m];
    for i in 1..m - 1 {
        let (h0, h1) = (knots[i].0 - knots[i - 1].0, knots[i + 1].0 - knots[i].0);
        let slope0 = (knots[i].1 - knots[i - 1].1) / h0;
        let slope1 = (knots[i + 1].1 - knots[i].1) / h1;
        let pivot = 2.0 * (h0 + h1) - h0 * upper[i - 1];
        upper[i] = h1 / pivot;
        second[i] = (6.0 * (slope1 - slope0) - h0 * second[i - 1]) / pivot;
    }
    for i in (1..m - 1).rev() {
        second[i] -= upper[i] * second[i + 1];
    }
    let mut i = 0;
    (0..n)
        .map(|k| {
            let t = (k as f64).clamp(knots[0].0, knots[m - 1].0);
            while i + 2 < m && t > knots[i + 1].0 {
                i += 1;
            }
            let h = knots[i + 1].0 - knots[i].0;
            let (a, b) = ((knots[i + 1].0 - t) / h, (t - knots[i].0) / h);
            a * knots[i].1
                + b * knots[i + 1].1
                + ((a * a * a - a) * second[i] + (b * b * b - b) * second[i + 1]) * h * h / 6.0
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn sine(n: usize, period: f64) -> Vec<f64> {
        (0..n).map(|k| 2.0 * (TAU * k as f64 / period).sin()).collect()
    }

    #[test]
    fn spline_is_natural_and_goes_through_its_knots() {
        // Through (0,0), (1,1), (2,0) the natural spline has M1 = -3: at 0.5 it is 0.6875.
        let knots = [(0.0, 0.0), (10.0, 1.0), (20.0, 0.0)];
        let v = spline(&knots, 21);
        assert!((v[10] - 1.0).abs() < 1e-12 && v[20].abs() < 1e-12);
        assert!((v[5] - 0.6875).abs() < 1e-12, "{}", v[5]);
    }

    #[test]
    fn a_sine_is_found_exactly() {
        let region = analyse(&sine(400, 40.0));
        let oscillation = region.oscillation(0, 400, 0.5).expect("a sine oscillates");
        // Crossings between samples of a sine with 40 samples a period are linear to 1e-3 of a sample.
        assert!((oscillation.period - 20.0).abs() < 0.01);
        assert!((oscillation.op_amplitude - 2.0).abs() < 0.01);
        assert!(oscillation.regularity_r > 10.0);
        assert_eq!(region.reversals(0, 400), 20);
    }

    #[test]
    fn the_regular_stretch_wins_over_the_irregular() {
        let mut op: Vec<f64> = (0..600)
            .map(|k| {
                let t = k as f64;
                (0.1 * t + 3.0 * (0.013 * t).sin()).sin()
            })
            .collect();
        op.extend(sine(600, 30.0).iter().map(|x| 0.5 * x));
        let from = analyse(&op).most_regular(op.len(), 500);
        assert!((560..=700).contains(&from), "{from}");
    }

    #[test]
    fn a_ramp_does_not_hide_the_oscillation() {
        let op: Vec<f64> = sine(600, 50.0).iter().enumerate().map(|(k, x)| x + 0.01 * k as f64).collect();
        let period = analyse(&op).typical_period().expect("oscillates");
        assert!((period - 50.0).abs() < 1.0, "{period}");
    }

    #[test]
    fn nothing_to_find_is_no_panic() {
        for v in [vec![], vec![1.0], vec![1.0; 50], (0..50).map(f64::from).collect::<Vec<_>>()] {
            let region = analyse(&v);
            assert!(region.oscillation(0, v.len(), 1.0).is_none());
            assert_eq!(region.most_regular(v.len(), 10), v.len().saturating_sub(10));
            assert!(start_of(&region, &v, 0, v.len()).is_none());
        }
    }
}
