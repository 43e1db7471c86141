//! The good samples of one tag of a record, and how long each of them is valid.

use super::points::{Points, mean_interval, stepped};
use crate::signal::{LARGEST_VALUE, Limits, Sample, are_measured, outages};
use std::borrow::Cow;

/// Sampling intervals without a good sample after which a tag is silent.
const SILENT: f64 = 10.0;

/// The meaning of a zero that is far from the other values of a tag.
#[derive(Clone, Copy, PartialEq)]
pub enum Zero {
    /// A lost signal, and no measurement: so for OP, PV and the stem.
    DropOut,
    /// A value like any other: so for set point and mode.
    Value,
}

/// The good samples of a tag, with what decides how long each of them is valid.
pub struct Tag {
    /// Times (s) and values of the good samples, in order.
    pub points: Vec<(f64, f64)>,
    /// Times of the samples that are not good, in order (s).
    marks: Vec<f64>,
    /// Whether its source sends changes only.
    pub by_changes: bool,
    /// The longest time between two good samples that is no silence (s). It follows from the mean interval: an archive leaves out samples
    /// on a straight line, so that its median interval is much shorter.
    pub longest: f64,
}

/// The times of samples that have one, in order (s).
fn times<'a>(samples: impl Iterator<Item = &'a Sample>) -> Vec<f64> {
    let mut times: Vec<f64> = samples.map(|s| s.t).filter(|t| t.is_finite()).collect();
    times.sort_by(f64::total_cmp);
    times
}

impl Tag {
    /// The tag of a series. `limits`: the limits of OP, where the tag is OP or the stem.
    pub fn of(series: &[Sample], zero: Zero, limits: Option<Limits>) -> Self {
        let is_number = |s: &Sample| {
            s.quality.is_good() && s.t.is_finite() && s.value.is_finite() && s.value.abs() < LARGEST_VALUE
        };
        let numbers: Vec<Sample> = series.iter().filter(|s| is_number(s)).copied().collect();
        // Outage values are dropped, as by the gate of the diagnosis.
        let mut none = outages(&numbers);
        none.retain(|value| zero == Zero::DropOut || *value != 0.0);
        let lost = times(series.iter().filter(|s| !is_number(s)));
        let mut measured = are_measured(&numbers, &none, limits, &lost).into_iter();
        let good: Vec<bool> =
            series.iter().map(|s| is_number(s) && measured.next().unwrap_or(false)).collect();
        let of = |wanted: bool| {
            series.iter().zip(&good).filter(move |(_, is_good)| **is_good == wanted).map(|(s, _)| s)
        };
        let mut points: Vec<(f64, f64)> = of(true).map(|s| (s.t, s.value)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points.dedup_by(|a, b| a.0 == b.0);
        let marks = times(of(false));
        // A source that sends changes only may repeat a value after a bad sample.
        let repeats = |w: &[Sample]| w[0].value == w[1].value && w[0].t < w[1].t;
        let by_changes =
            !series.windows(2).zip(good.windows(2)).any(|(w, good)| good[0] && good[1] && repeats(w));
        let longest = SILENT * mean_interval(&points);
        Self { points, marks, by_changes, longest }
    }

    /// The corners of the line through its values. A tag that is sent by changes stands still until a late change.
    pub fn corners(&self) -> Cow<'_, Points> {
        if self.by_changes { Cow::Owned(stepped(&self.points)) } else { Cow::Borrowed(&self.points) }
    }

    /// For each time the result of `holds(time, before, after)`, with the times of the good samples before and after it. After the last
    /// sample, `after` is `end`; before the first, `before` is the first.
    fn around(
        &self,
        times: impl Iterator<Item = f64>,
        end: f64,
        holds: impl Fn(f64, f64, f64) -> bool,
    ) -> Vec<bool> {
        let mut at = 0;
        times
            .map(|t| {
                while at + 1 < self.points.len() && self.points[at + 1].0 <= t {
                    at += 1;
                }
                let after = self.points.get(at + 1).map_or(end, |next| next.0);
                holds(t, self.points[at].0, after)
            })
            .collect()
    }

    /// Which of the times lie between good samples without a silence between them.
    pub fn near(&self, times: impl Iterator<Item = f64>, end: f64) -> Vec<bool> {
        self.around(times, end, |t, before, after| {
            let silence = if t < before { before - t } else { after - before };
            t == before || silence <= self.longest
        })
    }

    /// At which of the times a held value is known.
    pub fn known(&self, times: impl Iterator<Item = f64>, end: f64) -> Vec<bool> {
        self.around(times, end, |t, before, after| {
            // Before the first change that a source sends, the value is not known.
            if t < before {
                !self.by_changes && before - t <= self.longest
            } else {
                t <= self.until(before, after)
            }
        })
    }

    /// Whether a sample after the time `t` (s) is not good.
    pub fn is_marked_after(&self, t: f64) -> bool {
        self.marks.last().is_some_and(|mark| *mark > t)
    }

    /// The time until which the value of the sample at `before` is valid; the next sample is at `after` (s).
    pub fn until(&self, before: f64, after: f64) -> f64 {
        if self.by_changes {
            let mark = self.marks.get(self.marks.partition_point(|t| *t <= before));
            mark.copied().unwrap_or(f64::INFINITY)
        } else if after - before <= self.longest {
            f64::INFINITY
        } else {
            before
        }
    }
}
