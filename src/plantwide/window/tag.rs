//! The good samples of one tag of a record, and for how long each of them stands.

use super::points::{Points, mean_interval, stepped};
use crate::signal::{LARGEST_VALUE, Limits, Sample, are_measured, outages};
use std::borrow::Cow;

/// Sampling intervals without a good sample from which on a tag is silent.
const SILENT: f64 = 10.0;

/// What a zero far from a tag's other values is.
#[derive(Clone, Copy, PartialEq)]
pub enum Zero {
    /// No measurement: that of a signal which was lost, as OP, PV and the stem are.
    DropOut,
    /// A value like any other, as those of set point and mode are.
    Value,
}

/// The good samples of a tag, and what tells for how long each of them stands.
pub struct Tag {
    pub points: Vec<(f64, f64)>,
    /// Times of the samples that are not good, in order (s).
    marks: Vec<f64>,
    /// Whether its source sends changes only.
    pub by_changes: bool,
    /// The longest time between two good samples that is no silence (s). By the mean interval: of an archive, which leaves out
    /// what is on a line, the median is far shorter than most of the time.
    pub longest: f64,
}

/// The times of samples that have one, in order (s).
fn times<'a>(samples: impl Iterator<Item = &'a Sample>) -> Vec<f64> {
    let mut times: Vec<f64> = samples.map(|s| s.t).filter(|t| t.is_finite()).collect();
    times.sort_by(f64::total_cmp);
    times
}

impl Tag {
    /// Of a series; `limits`: those of OP, for a tag that has them.
    pub fn of(series: &[Sample], zero: Zero, limits: Option<Limits>) -> Self {
        let is_number = |s: &Sample| {
            s.quality.is_good() && s.t.is_finite() && s.value.is_finite() && s.value.abs() < LARGEST_VALUE
        };
        let numbers: Vec<Sample> = series.iter().filter(|s| is_number(s)).copied().collect();
        // What is written where nothing was measured, as the gate of the diagnosis drops it.
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
        // After a mark the same value counts again, also where changes only are sent.
        let repeats = |w: &[Sample]| w[0].value == w[1].value && w[0].t < w[1].t;
        let by_changes =
            !series.windows(2).zip(good.windows(2)).any(|(w, good)| good[0] && good[1] && repeats(w));
        let longest = SILENT * mean_interval(&points);
        Self { points, marks, by_changes, longest }
    }

    /// The points of the line that its values are on: one that is sent by changes stood still until a late one.
    pub fn corners(&self) -> Cow<'_, Points> {
        if self.by_changes { Cow::Owned(stepped(&self.points)) } else { Cow::Borrowed(&self.points) }
    }

    /// Of each time whether `holds` does, for it and the times of the good samples before and after it, the last of which is
    /// `end`; of a time before all of them for it and the first.
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

    /// Which of the times lie between good samples that are near each other.
    pub fn near(&self, times: impl Iterator<Item = f64>, end: f64) -> Vec<bool> {
        self.around(times, end, |t, before, after| {
            let silence = if t < before { before - t } else { after - before };
            t == before || silence <= self.longest
        })
    }

    /// At which of the times a value that is held is known.
    pub fn known(&self, times: impl Iterator<Item = f64>, end: f64) -> Vec<bool> {
        self.around(times, end, |t, before, after| {
            // What changed first may have been anything before.
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

    /// Until when a value of the time `before` stands, of which the next comes at `after` (s).
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
