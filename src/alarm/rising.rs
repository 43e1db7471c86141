//! Whether friction grows: a straight line through points that each have an interval of their own.
//!
//! # Formula
//! Diagnoses within `bucket_s` make one point: f is their mean, its variance the larger of the mean of theirs (their
//! windows overlap, so they are not independent) and the scatter over their number. A line is fitted to the last
//! points with weights `1 / variance`. Its slope has the standard error `s_w * sqrt(max(1, chi2 / (m - 2)))`: where points
//! scatter more than their intervals say, the scatter counts. What neighbours have in common (`r`, the residuals'
//! autocorrelation at lag one, corrected for the number of points, plus two of its standard errors) widens it by
//! `sqrt((1 + r) / (1 - r))`: friction that wanders for days must not pass for friction that grows. The rise over the
//! points, less `t(m - 2, 0.999)` of its standard errors, is what is compared with `min_rise_percent`.

use super::config::RisingConfig;
use super::votes::Observation;
use std::collections::VecDeque;

/// Two-sided 95 % interval of a normal distribution, in standard deviations.
const CI95: f64 = 1.959_964;
/// One-sided 99.9 % quantile of a normal distribution.
const Z: f64 = 3.090_232;
/// Least standard deviation of a point (% of OP span): an interval of no width is no knowledge.
const LEAST_SD: f64 = 1e-3;

/// Friction over a bucket.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Mean time of the diagnoses (s).
    pub t: f64,
    /// Their mean f (% of OP span).
    pub f: f64,
    /// Mean of their variances.
    pub variance: f64,
    /// Sum of squared deviations from the mean.
    pub scatter: f64,
    /// How many there are.
    pub count: u32,
}

impl Point {
    fn add(&mut self, t: f64, f: f64, variance: f64) {
        self.count += 1;
        let share = 1.0 / f64::from(self.count);
        let off = f - self.f;
        self.t += (t - self.t) * share;
        self.f += off * share;
        self.scatter += off * (f - self.f);
        self.variance += (variance - self.variance) * share;
    }

    /// Variance of the mean.
    fn error(&self) -> f64 {
        let n = f64::from(self.count.max(1));
        let scatter = if self.count > 1 { self.scatter / (n - 1.0) / n } else { 0.0 };
        self.variance.max(scatter).max(LEAST_SD * LEAST_SD)
    }
}

/// A line through the points, as far as it matters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Rise from the first point to the last (% of OP span).
    pub rise: f64,
    /// Lower bound of it, one-sided 99.9 %.
    pub low: f64,
    /// Time between the two (s).
    pub span_s: f64,
}

/// f over time, the last points of it; the newest is still being added to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trend(VecDeque<Point>);

impl Trend {
    /// The points as they were saved.
    pub fn restored(points: Vec<Point>) -> Self {
        let sound =
            |p: &Point| [p.t, p.f, p.variance, p.scatter].iter().all(|x| x.is_finite()) && p.count > 0;
        Self(points.into_iter().filter(sound).collect())
    }

    /// Oldest first.
    pub fn saved(&self) -> Vec<Point> {
        self.0.iter().copied().collect()
    }

    /// Takes a diagnosis: f and its interval (% of OP span). Says something only when a bucket is over.
    pub fn take(&mut self, f: f64, interval: [f64; 2], t: f64, config: &RisingConfig) -> Observation {
        let width = interval[1] - interval[0];
        if ![f, width, t].iter().all(|x| x.is_finite()) || width < 0.0 {
            return Observation::Unknown;
        }
        // Stamped by a clock that was ahead: until it is that late again nothing that comes would be a point.
        while self.0.back().is_some_and(|point| point.t > t + config.bucket_s) {
            self.0.pop_back();
        }
        let (bucket, variance) = ((t / config.bucket_s).floor(), (width / (2.0 * CI95)).powi(2));
        let newest = self.0.back().map(|point| (point.t / config.bucket_s).floor());
        if newest.is_some_and(|newest| bucket <= newest) {
            // A clock that was set back by less than a bucket adds to the newest; the line is not disturbed by it.
            if newest == Some(bucket)
                && let Some(point) = self.0.back_mut()
            {
                point.add(t, f, variance);
            }
            return Observation::Unknown;
        }
        let closed = self.line(config);
        self.0.push_back(Point::default());
        if let Some(point) = self.0.back_mut() {
            point.add(t, f, variance);
        }
        while self.0.len() > config.points.max(2) {
            self.0.pop_front();
        }
        match closed {
            None => Observation::Unknown,
            Some(line) if line.low > config.min_rise_percent => Observation::Present,
            Some(line) if line.low <= 0.0 => Observation::Absent,
            Some(_) => Observation::Between,
        }
    }

    /// The line through the points; `None` while there are too few.
    pub fn line(&self, config: &RisingConfig) -> Option<Line> {
        let (points, m) = (&self.0, self.0.len());
        if m < config.min_points.max(6) {
            return None;
        }
        let (first, last) = (points.front()?.t, points.back()?.t);
        let span_s = last - first;
        if span_s <= 0.0 {
            return None;
        }
        let weights: Vec<f64> = points.iter().map(|p| 1.0 / p.error()).collect();
        let times: Vec<f64> = points.iter().map(|p| (p.t - first) / span_s).collect();
        let total: f64 = weights.iter().sum();
        let mean = |x: &dyn Fn(usize) -> f64| (0..m).map(|i| weights[i] * x(i)).sum::<f64>() / total;
        let (t0, f0) = (mean(&|i| times[i]), mean(&|i| points[i].f));
        let sum = |x: &dyn Fn(usize) -> f64| (0..m).map(|i| weights[i] * (times[i] - t0) * x(i)).sum::<f64>();
        let stt = sum(&|i| times[i] - t0);
        if stt <= 0.0 {
            return None;
        }
        let rise = sum(&|i| points[i].f - f0) / stt;
        let e: Vec<f64> =
            (0..m).map(|i| weights[i].sqrt() * (points[i].f - f0 - rise * (times[i] - t0))).collect();
        let free = (m - 2) as f64;
        let chi2: f64 = e.iter().map(|e| e * e).sum();
        let common = if chi2 > 0.0 { e.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / chi2 } else { 0.0 };
        // A line fitted to few points takes some of the autocorrelation with it.
        let r = (m as f64 * common + 1.0) / (m as f64 - 4.0);
        let r = (r + 2.0 * ((1.0 - r * r).max(0.0) / m as f64).sqrt()).clamp(0.0, 0.9);
        let error = (1.0 / stt).sqrt() * (chi2 / free).max(1.0).sqrt() * ((1.0 + r) / (1.0 - r)).sqrt();
        Some(Line { rise, low: rise - student(free) * error, span_s })
    }
}

/// One-sided 99.9 % quantile of Student's t, by Cornish and Fisher's series; within 1 % from four degrees of freedom on.
fn student(free: f64) -> f64 {
    let (z, v) = (Z, free.max(1.0));
    let terms = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
        (79.0 * z.powi(9) + 776.0 * z.powi(7) + 1482.0 * z.powi(5) - 1920.0 * z.powi(3) - 945.0 * z)
            / 92_160.0,
    ];
    z + terms.iter().zip(1..).map(|(term, power)| term / v.powi(power)).sum::<f64>()
}

#[cfg(test)]
mod tests;
