//! Every oscillation of a signal: period, regularity, how it lasts, and its share of the variance.
//!
//! ```text
//! B(f)  = sum of |X|² over f 2^(±1/4)                    a candidate is a maximum of B over log f
//! a(l)  = autocovariance of x in the band f / W … f W    by the masked spectrum
//! r     = mean(T) / (3 sd(T))                            T: intervals between the first zero crossings of a
//! R     = (a2 - (a1 + a3)/2) / ((a(0) + a2)/2 - a1)      a1, a3: its first two minima, a2: its first maximum
//! period = 2 mean(T)
//! share = sum of |X|² over the band / sum over all f > 0
//! ```
//!
//! It oscillates where r > 1 and p > 1/2, the probability that it is no chance in its band:
//!
//! ```text
//! ln (p / (1 - p)) = w · (ln r, R, share of what is as fast as f/2 or faster, steadiness, 1 / sqrt(periods), 1)
//! ```
//!
//! Intervals of white noise in the same band are irregular, and an answer that dies away, as of a loop that is tuned well, has a
//! small R; R alone decides nothing. The weights w are a logit fitted on simulated loops (`calibrate oscillation`). The largest
//! oscillation is taken first; what is a multiple of its frequency belongs to it.
//!
//! Source: Thornhill, Huang & Zhang, J. Process Control 2003, 13, 91 (r, and its threshold); Miao & Seborg, Control Eng.
//! Practice 1999, 7, 577 (R). Chosen here: the bands are set by the signal and not by hand, and R has no threshold of its own.

use crate::sysid::spectrum::{Spectrum, Transforms};
use crate::sysid::stats::{mean, median, sd};
use std::f64::consts::PI;

/// r from which intervals are regular (-): three standard deviations are less than their mean.
pub const REGULAR: f64 = 1.0;
/// How many numbers it is judged by.
const SIGNS: usize = 5;
/// Weights of ln r, R, share of what is fast, steadiness, 1/√periods, and 1.
const WEIGHTS: [f64; SIGNS + 1] = [1.536, 14.638, 4.740, 11.010, -6.532, -22.960];
/// Intervals between zero crossings that are judged, and fewest of them: two periods.
const INTERVALS: usize = 10;
const LEAST_INTERVALS: usize = 4;
/// Part of the record that the lags may reach.
const REACH: f64 = 2.0 / 3.0;
/// Shortest period (samples).
const SHORTEST: f64 = 2.5;
/// Fewest periods in a record.
const LEAST_PERIODS: f64 = 3.0;
/// Candidates an octave, and how far B reaches to either side (octaves).
const STEPS: f64 = 8.0;
const REACH_OCTAVES: f64 = 0.25;
/// Half width of the band as a factor of the frequency, W, and of the edges beyond it.
const WIDTH: f64 = 1.6;
const EDGE: f64 = 1.25;
/// Most oscillations of one signal, and most candidates that are judged.
const MOST: usize = 3;
const CANDIDATES: usize = 6;
/// Part of the record's ends that is tapered: a jump from the end to the start is no oscillation.
const TAPER: f64 = 0.05;
/// Largest value in a band, in medians of its size: a sine's crest is 1.4 of them.
const LIMIT: f64 = 2.0;
/// Least distance of two candidates (octaves): nearer ones are of one peak.
const APART: f64 = 0.5;
/// Fewest samples.
const LEAST_SAMPLES: usize = 60;

/// One oscillation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Period (s).
    pub period_s: f64,
    /// r (-).
    pub regularity: f64,
    /// R (-).
    pub lasting: f64,
    /// Share of the signal's variance (0..1).
    pub share: f64,
    /// Share of the variance of what is as fast as f/2 or faster (0..1).
    pub share_of_fast: f64,
    /// Median of |x| over its root mean square in the band: 1 for a sine, 0.67 for noise, less for a burst (-).
    pub steadiness: f64,
    /// Periods in the record (-).
    pub periods: f64,
    /// Amplitude of the sine with the power of the band (the signal's unit).
    pub amplitude: f64,
}

impl Oscillation {
    /// What it is judged by.
    pub fn signs(&self) -> [f64; SIGNS] {
        [
            self.regularity.clamp(0.1, 10.0).ln(),
            self.lasting.clamp(-1.0, 1.5),
            self.share_of_fast,
            self.steadiness,
            1.0 / self.periods.sqrt(),
        ]
    }

    /// The probability that it is one, and not chance in a band (0..1).
    pub fn probability(&self) -> f64 {
        let signs = self.signs();
        let log_odds = WEIGHTS[SIGNS] + signs.iter().zip(&WEIGHTS).map(|(x, w)| x * w).sum::<f64>();
        1.0 / (1.0 + (-log_odds).exp())
    }

    /// Whether it is one.
    pub fn counts(&self) -> bool {
        self.regularity > REGULAR && self.probability() > 0.5
    }
}

/// Whether a signal can be asked: it is long enough, all of it is finite, and it moves.
pub fn can_tell(x: &[f64]) -> bool {
    prepared(x).is_some()
}

/// The oscillations of `x`, the largest first; none where values are not finite, too few, or do not move.
pub fn oscillations(x: &[f64], ts: f64, transforms: &mut Transforms) -> Vec<Oscillation> {
    let mut found: Vec<Oscillation> = Vec::new();
    for candidate in candidates(x, ts, transforms) {
        let multiple = |of: &Oscillation| {
            let ratio = of.period_s / candidate.period_s;
            let whole = ratio.round().max(1.0);
            (ratio / whole - 1.0).abs() < 0.5 * (WIDTH - 1.0) / whole.max(2.0) || (0.7..1.4).contains(&ratio)
        };
        if candidate.counts() && !found.iter().any(multiple) && found.len() < MOST {
            found.push(candidate);
        }
    }
    found
}

/// Every maximum of B, judged, the largest share first.
pub fn candidates(x: &[f64], ts: f64, transforms: &mut Transforms) -> Vec<Oscillation> {
    let Some(x) = prepared(x) else { return Vec::new() };
    let spectrum = transforms.spectrum(&x);
    let power: Vec<f64> = spectrum.bins.iter().map(|x| x.norm_sqr()).collect();
    let whole: f64 = power[1..].iter().sum();
    let variance = x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64;
    let mut peaks = peaks(&power, &spectrum);
    peaks.truncate(CANDIDATES);
    let judged = peaks.into_iter().filter_map(|f| {
        let weight = |at: f64| band(at, f);
        let mut inside = transforms.filtered(&spectrum, |at| weight(at).sqrt());
        let steadiness = limit(&mut inside);
        let limited = transforms.spectrum(&inside);
        let a = transforms.autocovariance(&limited, weight);
        let (period, regularity, lasting) = judge(&a)?;
        let inside: f64 =
            power.iter().enumerate().map(|(j, p)| p * weight(j as f64 / spectrum.m as f64)).sum();
        let share = inside / whole;
        let slow = (0.5 * f * spectrum.m as f64) as usize + 1;
        let share_of_fast = inside / power[slow..].iter().sum::<f64>();
        let amplitude = (2.0 * share * variance).sqrt();
        Some(Oscillation {
            period_s: period * ts,
            regularity,
            lasting,
            share,
            share_of_fast,
            steadiness,
            periods: x.len() as f64 / period,
            amplitude,
        })
    });
    let mut judged: Vec<Oscillation> = judged.collect();
    judged.sort_by(|a, b| b.share.total_cmp(&a.share));
    judged
}

/// Without mean and straight trend, the ends tapered; none where there is nothing to see.
fn prepared(x: &[f64]) -> Option<Vec<f64>> {
    let n = x.len();
    if n < LEAST_SAMPLES || !x.iter().all(|x| x.is_finite()) {
        return None;
    }
    let (middle, level) = (0.5 * (n - 1) as f64, mean(x));
    let slope = x.iter().enumerate().map(|(k, x)| (k as f64 - middle) * (x - level)).sum::<f64>()
        / (0..n).map(|k| (k as f64 - middle).powi(2)).sum::<f64>();
    let mut out: Vec<f64> =
        x.iter().enumerate().map(|(k, x)| x - level - slope * (k as f64 - middle)).collect();
    let spread = sd(&out);
    if !(spread.is_finite() && spread > 1e-12 * level.abs().max(f64::MIN_POSITIVE)) {
        return None;
    }
    let edge = ((TAPER * n as f64) as usize).max(1);
    for k in 0..edge {
        let weight = 0.5 - 0.5 * (PI * (k as f64 + 0.5) / edge as f64).cos();
        out[k] *= weight;
        out[n - 1 - k] *= weight;
    }
    Some(out)
}

/// Cuts what is beyond [`LIMIT`] times the median of |x|: a burst is not the whole record. That median over the root mean
/// square.
fn limit(x: &mut [f64]) -> f64 {
    let sizes: Vec<f64> = x.iter().map(|x| x.abs()).collect();
    let middle = median(&sizes);
    let square = x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64;
    x.iter_mut().for_each(|x| *x = x.clamp(-LIMIT * middle, LIMIT * middle));
    middle / square.sqrt()
}

/// Frequencies (cycles a sample) of the maxima of B, the largest first.
fn peaks(power: &[f64], spectrum: &Spectrum) -> Vec<f64> {
    let m = spectrum.m as f64;
    let mut sums = vec![0.0];
    for p in power {
        sums.push(sums[sums.len() - 1] + p);
    }
    let lowest = LEAST_PERIODS / spectrum.n as f64;
    let octaves = (1.0 / (SHORTEST * lowest)).log2();
    if octaves <= 0.0 {
        return Vec::new();
    }
    let reach = REACH_OCTAVES.exp2();
    let at = |j: f64| -> f64 {
        let inside = j.clamp(0.0, power.len() as f64);
        let whole = (inside as usize).min(power.len() - 1);
        sums[whole] + (inside - whole as f64) * power[whole]
    };
    // One more to either side, so that the ends can be maxima, too.
    let frequency = |i: i32| lowest * (f64::from(i) / STEPS).exp2();
    let last = (octaves * STEPS).ceil() as i32;
    let b: Vec<f64> = (-1..=last + 1)
        .map(|i| at(m * frequency(i) * reach + 0.5) - at(m * frequency(i) / reach + 0.5))
        .collect();
    let mut found: Vec<(f64, f64)> = (1..b.len() - 1)
        .filter(|&i| b[i] > b[i - 1] && b[i] >= b[i + 1])
        .map(|i| {
            let f = frequency(i as i32 - 1);
            let (from, to) = ((m * f / reach).ceil() as usize, (m * f * reach) as usize);
            let inside = (from..=to.min(power.len() - 1)).map(|j| (power[j], power[j] * j as f64));
            let (all, moment) = inside.fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
            (b[i], if all > 0.0 { moment / all / m } else { f })
        })
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut apart: Vec<f64> = Vec::new();
    for (_, f) in found {
        if apart.iter().all(|other| (f / other).log2().abs() >= APART) {
            apart.push(f);
        }
    }
    apart
}

/// 1 in the band around `f`, 0 far from it, half a cosine of log f between.
pub fn band(at: f64, f: f64) -> f64 {
    if at <= 0.0 {
        return 0.0;
    }
    let away = (at / f).ln().abs() - WIDTH.ln();
    if away <= 0.0 {
        1.0
    } else if away >= EDGE.ln() {
        0.0
    } else {
        0.5 + 0.5 * (PI * away / EDGE.ln()).cos()
    }
}

/// Period (samples), r and R of an autocovariance.
fn judge(a: &[f64]) -> Option<(f64, f64, f64)> {
    let last = (REACH * a.len() as f64) as usize;
    let mut crossings = Vec::with_capacity(INTERVALS + 1);
    for lag in 1..last {
        if (a[lag] > 0.0) != (a[lag - 1] > 0.0) {
            crossings.push((lag - 1) as f64 + a[lag - 1] / (a[lag - 1] - a[lag]));
        }
        if crossings.len() > INTERVALS {
            break;
        }
    }
    let intervals: Vec<f64> = crossings.windows(2).map(|w| w[1] - w[0]).collect();
    if intervals.len() < LEAST_INTERVALS {
        return None;
    }
    let extreme = |i: usize, sign: f64| -> f64 {
        let (from, to) = (crossings[i] as usize, crossings[i + 1] as usize + 1);
        sign * a[from..=to.min(a.len() - 1)].iter().map(|a| sign * a).fold(f64::NEG_INFINITY, f64::max)
    };
    let (a1, a2, a3) = (extreme(0, -1.0), extreme(1, 1.0), extreme(2, -1.0));
    let lasting = (a2 - 0.5 * (a1 + a3)) / (0.5 * (a[0] + a2) - a1);
    let m = mean(&intervals);
    // A perfectly regular record stays a number.
    Some((2.0 * m, m / (3.0 * sd(&intervals)).max(1e-3 * m), lasting))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    fn noise(n: usize, seed: u64) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(n).collect()
    }

    #[test]
    fn two_waves_on_a_walk_are_both_found_to_a_hundredth() {
        let (mut walk, e) = (0.0, noise(3000, 1));
        let x: Vec<f64> = (0..3000)
            .map(|k| {
                walk += 0.02 * e[k];
                let t = k as f64;
                walk + (TAU * t / 37.0).sin() + 0.6 * (TAU * t / 211.0).sin() + 0.2 * e[(7 * k) % 3000]
            })
            .collect();
        let found = oscillations(&x, 2.0, &mut Transforms::new());
        let mut periods: Vec<f64> = found.iter().map(|o| o.period_s).collect();
        periods.sort_by(f64::total_cmp);
        assert_eq!(periods.len(), 2, "{found:?}");
        // Ten intervals of a(l); noise in the band moves each by a few per cent of a sample.
        assert!(
            (periods[0] / 74.0 - 1.0).abs() < 0.01 && (periods[1] / 422.0 - 1.0).abs() < 0.02,
            "{periods:?}"
        );
        assert!((found[0].amplitude - 1.0).abs() < 0.1, "{found:?}");
    }

    #[test]
    fn noise_oscillates_in_one_record_of_fifty() {
        let mut transforms = Transforms::new();
        let mut alarms = 0;
        for seed in 0..100 {
            let e = noise(1000, 50 + seed);
            let mut x = 0.0;
            let coloured: Vec<f64> = e
                .iter()
                .map(|e| {
                    x = 0.9 * x + e;
                    x
                })
                .collect();
            alarms += usize::from(!oscillations(&e, 1.0, &mut transforms).is_empty());
            alarms += usize::from(!oscillations(&coloured, 1.0, &mut transforms).is_empty());
        }
        // 2 % of 200 is 4; a rate of 2 % gives ten and more once in a hundred.
        assert!(alarms < 10, "{alarms}");
    }

    #[test]
    fn harmonics_belong_to_their_wave() {
        let square: Vec<f64> = (0..2000).map(|k| if (k / 25) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let found = oscillations(&square, 1.0, &mut Transforms::new());
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].period_s - 50.0).abs() < 0.1);
        // 8/pi² of a square wave's power is its first harmonic.
        assert!((found[0].share - 0.81).abs() < 0.03, "{found:?}");
    }

    #[test]
    fn rubbish_is_nothing() {
        let mut transforms = Transforms::new();
        for x in [vec![], vec![1.0; 500], vec![f64::NAN; 500], vec![f64::INFINITY; 70], noise(20, 1)] {
            assert_eq!(oscillations(&x, 1.0, &mut transforms), []);
            assert!(!can_tell(&x));
        }
        assert!(can_tell(&noise(60, 1)));
    }
}
