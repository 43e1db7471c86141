//! How an archive (historian) has changed a record: compression, report by exception, interpolation, held values, a running mean.
//!
//! Each biases f, because friction shows in small movements and flat stretches.
//! Every rule tests for something that measurements do not show:
//!
//! | kind | test |
//! |---|---|
//! | report by exception | irregular stamps, and hardly any change near zero |
//! | swinging door | irregular stamps, and hardly any sample near the line through its neighbours |
//! | interpolated | samples of PV on straight lines to the last digit, with sharp ends, from which OP was not computed ([`super::lines`]) |
//! | held | values change at every k-th sample only |
//! | averaged | differences correlate by -1/2 at lag k, and not before |
//!
//! Means over blocks that do not overlap leave no trace, and are not recognised.

use super::lines::Lines;
use crate::signal::{Role, Sample, share};
use crate::sysid::stats::{median, quantile};
use std::fmt;

/// Fewest samples that are tested: [`HOLE`] of them are about one.
const LEAST: usize = 60;
/// Share of steps in time off their median by more than a quarter, above which stamps are irregular: a few lost polls make fewer.
const IRREGULAR: f64 = 0.2;
/// Share of the median below which a size is near zero: one normally distributed change in eight is.
const NEAR_ZERO: f64 = 0.25;
/// Largest share of changes near zero where a dead band left them out; without a dead band it is 0.13 and more.
const HOLE: f64 = 0.02;
/// Share of samples near the line through their neighbours where nothing was left out, for normally distributed distances; after
/// compression it is significantly less.
const USUAL_NEAR: f64 = 0.13;
/// Number of standard errors by which it is less: one chance in thirty thousand.
const SIGNIFICANT: f64 = 4.0;
/// Largest distance of a step in time from a multiple of the scan, as a share of the scan, and the least share of steps that keep
/// it: a clock jitters, and now and then a stamp is late.
const ON_SCAN: [f64; 2] = [0.12, 0.95];
/// Fewest runs of held values: by chance there are a few.
const RUNS: usize = 12;
/// Longest run of held values, and longest running mean, that is tried (samples): a usual window has few longer ones.
const LONGEST: usize = 60;
/// Least share of changes that are at every k-th sample, and of these samples that change, for held values: now and then a sample
/// is late, and a value may repeat itself.
const IN_STEP: [f64; 2] = [0.97, 0.6];
/// Shortest running mean that is tried (samples): below it the differences correlate by themselves.
const SHORTEST_MEAN: usize = 6;

/// How an archive changed a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HistoryKind {
    /// Swinging-door or boxcar compression: samples that a line replaces were dropped.
    SwingingDoor,
    /// Report by exception: changes within a dead band were dropped.
    Exception,
    /// Straight lines were drawn between the samples that were kept.
    Interpolated,
    /// Every k-th value was kept, and repeated.
    Held,
    /// A running mean was taken.
    Averaged,
}

impl HistoryKind {
    /// Every kind.
    pub const ALL: [Self; 5] =
        [Self::SwingingDoor, Self::Exception, Self::Interpolated, Self::Held, Self::Averaged];

    /// The stable, machine-readable name.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::SwingingDoor => "swinging_door",
            Self::Exception => "exception",
            Self::Interpolated => "interpolated",
            Self::Held => "held",
            Self::Averaged => "averaged",
        }
    }

    /// What it means for f, as the end of a reason.
    pub fn effect(self) -> &'static str {
        match self {
            Self::Interpolated => "only the ends of straight lines were measured, and only they count",
            Self::SwingingDoor => "small movements are lost, and f may be wrong",
            Self::Exception | Self::Held | Self::Averaged => "f reads low, and sticking may go unseen",
        }
    }

    /// What it means for f, as an operator reads it.
    pub fn note(self) -> &'static str {
        match self {
            Self::SwingingDoor => {
                "An archive kept only the samples that a straight line does not replace: small movements are lost, and f may be wrong. Ask for raw values."
            }
            Self::Exception => {
                "Only changes beyond a dead band were kept: small movements are lost, f reads low, and sticking may go unseen. Ask for raw values."
            }
            Self::Interpolated => {
                "An archive drew lines between the few samples it kept: only the ends of lines were measured, and only they count. Ask for raw values."
            }
            Self::Held => "PV is measured only every few samples: use the period at which it is measured.",
            Self::Averaged => "PV is a running mean: it comes later and smoother than it was measured.",
        }
    }
}

/// How an archive changed a record, with the evidence for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HistoryFound {
    /// The kind of change.
    pub kind: HistoryKind,
    /// The tag that shows it.
    pub role: Role,
    /// The two numbers of its display, which depend on the kind.
    pub evidence: [f64; 2],
}

impl fmt::Display for HistoryFound {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tag = if self.role == Role::Op { "OP" } else { "PV" };
        let [a, b] = self.evidence;
        match self.kind {
            HistoryKind::SwingingDoor => write!(
                out,
                "{tag}: stamps irregular for {} of the samples, and only {} of them near the line through their neighbours",
                share(a, 0),
                share(b, 1)
            ),
            HistoryKind::Exception => write!(
                out,
                "{tag}: stamps irregular for {} of the samples, and no change below {b:.3}",
                share(a, 0)
            ),
            HistoryKind::Interpolated => {
                write!(out, "{tag}: {} of the samples on {b:.0} straight lines", share(a, 0))
            }
            HistoryKind::Held => {
                write!(out, "{tag}: {} of the changes at every {b:.0}th sample", share(a, 0))
            }
            HistoryKind::Averaged => {
                write!(
                    out,
                    "{tag}: each value leaves the mean {b:.0} samples after it entered (correlation {a:.2})"
                )
            }
        }
    }
}

/// [`recognise_beside`] without a set point.
pub fn recognise(op: &[Sample], pv: &[Sample]) -> Option<HistoryFound> {
    recognise_beside(op, pv, None)
}

/// How an archive changed a record; `None` where nothing shows it.
///
/// * `op`, `pv`: good samples in the order of time, no stamp twice.
/// * `set_point`: its samples, where it is recorded.
pub fn recognise_beside(op: &[Sample], pv: &[Sample], set_point: Option<&[Sample]>) -> Option<HistoryFound> {
    let of = |role, found: Option<(HistoryKind, [f64; 2])>| {
        found.map(|(kind, evidence)| HistoryFound { kind, role, evidence })
    };
    let thinned = |role, series| of(role, thinned(series));
    let equal = |series: &[Sample]| -> Option<Vec<f64>> {
        let even = series.len() >= LEAST && irregular(series) < 0.02;
        even.then(|| series.iter().map(|s| s.value).collect())
    };
    // A controller that acts at every k-th sample holds OP, and a stuck valve makes OP a straight line. So PV decides.
    thinned(Role::Pv, pv)
        .or_else(|| thinned(Role::Op, op))
        .or_else(|| of(Role::Pv, interpolated(op, pv, set_point)))
        .or_else(|| {
            let values = equal(pv)?;
            of(Role::Pv, held(&values).or_else(|| averaged(&values)))
        })
}

/// The share of steps in time off their median by more than a quarter.
fn irregular(series: &[Sample]) -> f64 {
    let steps: Vec<f64> = series.windows(2).map(|w| w[1].t - w[0].t).collect();
    let middle = median(&steps);
    let off = steps.iter().filter(|d| (*d - middle).abs() > 0.25 * middle).count();
    off as f64 / steps.len().max(1) as f64
}

/// Whether the steps in time are multiples of one scan, as in a thinned record.
fn on_scan(series: &[Sample]) -> bool {
    let steps: Vec<f64> = series.windows(2).map(|w| w[1].t - w[0].t).collect();
    let shortest = quantile(&steps, 0.02);
    (1..=4).any(|part| {
        let scan = shortest / f64::from(part);
        let near = |d: &&f64| (*d / scan - (*d / scan).round()).abs() < ON_SCAN[0];
        steps.iter().filter(near).count() as f64 >= ON_SCAN[1] * steps.len() as f64
    })
}

/// Report by exception or swinging-door compression: irregular stamps, and hardly any changes, or distances from the line through
/// the neighbours, near zero. With its evidence: the share of irregular steps, and the dead band or the share near the line.
fn thinned(series: &[Sample]) -> Option<(HistoryKind, [f64; 2])> {
    if series.len() < LEAST {
        return None;
    }
    let uneven = irregular(series);
    if uneven < IRREGULAR || !on_scan(series) {
        return None;
    }
    let resolution = resolution(series);
    let reports = without_previous(series);
    let changes =
        |kept: &[Sample]| -> Vec<f64> { kept.windows(2).map(|w| (w[1].value - w[0].value).abs()).collect() };
    for kept in [series, &reports] {
        let sizes = changes(kept);
        let band = quantile(&sizes, HOLE);
        // Values in steps of their resolution have no changes near zero either; that is the measurement's own. Nor has a steady
        // ramp, but its changes are proportional to the time between them.
        let in_steps = band <= 5.0 * resolution;
        if kept.len() >= LEAST && !in_steps && near_zero(&sizes) < HOLE && !ramps(kept) {
            return Some((HistoryKind::Exception, [uneven, band]));
        }
    }
    let off: Vec<f64> = series
        .windows(3)
        .map(|w| {
            let part = (w[1].t - w[0].t) / (w[2].t - w[0].t);
            (w[0].value + part * (w[2].value - w[0].value) - w[1].value).abs()
        })
        .collect();
    let near = near_zero(&off);
    let chance = (USUAL_NEAR * (1.0 - USUAL_NEAR) / off.len() as f64).sqrt();
    (near < USUAL_NEAR - SIGNIFICANT * chance && quantile(&off, 0.1) > 5.0 * resolution)
        .then_some((HistoryKind::SwingingDoor, [uneven, near]))
}

/// Whether the changes of value are rather proportional to the time between them than of one size.
fn ramps(kept: &[Sample]) -> bool {
    let spread = |of: &dyn Fn(&[Sample]) -> f64| {
        let logs: Vec<f64> = kept.windows(2).map(of).filter(|x| *x > 0.0).map(f64::ln).collect();
        quantile(&logs, 0.9) - quantile(&logs, 0.1)
    };
    let change = |w: &[Sample]| (w[1].value - w[0].value).abs();
    spread(&change) > 0.8 * spread(&|w| change(w) / (w[1].t - w[0].t))
}

/// The share of sizes that are near zero.
fn near_zero(sizes: &[f64]) -> f64 {
    let limit = NEAR_ZERO * median(sizes);
    sizes.iter().filter(|size| **size < limit).count() as f64 / sizes.len().max(1) as f64
}

/// The resolution of the values: the lower quartile of the differences between neighbours in size.
fn resolution(series: &[Sample]) -> f64 {
    let mut values: Vec<f64> = series.iter().map(|s| s.value).collect();
    values.sort_unstable_by(f64::total_cmp);
    let steps: Vec<f64> = values.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).collect();
    quantile(&steps, 0.25)
}

/// The samples without those that were kept only because the next one was reported: they lie one scan before it.
fn without_previous(series: &[Sample]) -> Vec<Sample> {
    let steps: Vec<f64> = series.windows(2).map(|w| w[1].t - w[0].t).collect();
    let scan = quantile(&steps, 0.02) * 1.25;
    let is_previous = |i: usize| i > 0 && i < steps.len() && steps[i] <= scan && steps[i - 1] > scan;
    series.iter().enumerate().filter(|(i, _)| !is_previous(*i)).map(|(_, s)| *s).collect()
}

/// Interpolation: PV on straight lines to its last digit, with sharp ends, from which OP was not computed. With its evidence: the
/// share of samples on such lines, and their number.
fn interpolated(
    op: &[Sample],
    pv: &[Sample],
    set_point: Option<&[Sample]>,
) -> Option<(HistoryKind, [f64; 2])> {
    if pv.len() < LEAST || irregular(pv) >= IRREGULAR {
        return None;
    }
    let lines = Lines::of(pv).filter(|lines| lines.are_drawn(op, pv, set_point))?;
    Some((HistoryKind::Interpolated, [lines.share, lines.count as f64]))
}

/// Held values: changes at every k-th sample only, and at most of these samples; the longest k counts.
fn held(values: &[f64]) -> Option<(HistoryKind, [f64; 2])> {
    let changes: Vec<usize> = (1..values.len()).filter(|i| values[*i] != values[i - 1]).collect();
    (2..=LONGEST).rev().find_map(|k| {
        let blocks = values.len() / k;
        if blocks < RUNS || (changes.len() as f64) < IN_STEP[1] * blocks as f64 {
            return None;
        }
        let mut by_phase = vec![0_usize; k];
        changes.iter().for_each(|i| by_phase[i % k] += 1);
        let most = by_phase.into_iter().max().unwrap_or(0);
        let share = most as f64 / changes.len() as f64;
        (share >= IN_STEP[0]).then_some((HistoryKind::Held, [share, k as f64]))
    })
}

/// A running mean: a sample that enters a mean over k leaves it k samples later. So the differences, made whiter by differencing
/// twice more, correlate by -1/2 at lag k, and at no lag in between.
fn averaged(values: &[f64]) -> Option<(HistoryKind, [f64; 2])> {
    let mut d: Vec<f64> = values.to_vec();
    for _ in 0..3 {
        d = d.windows(2).map(|w| w[1] - w[0]).collect();
    }
    let power: f64 = d.iter().map(|x| x * x).sum();
    let longest = LONGEST.min(d.len() / 8);
    if power.is_nan() || power <= 0.0 || longest <= SHORTEST_MEAN {
        return None;
    }
    let r = |lag: usize| d.iter().zip(&d[lag..]).map(|(a, b)| a * b).sum::<f64>() / power;
    let all: Vec<f64> = (0..=longest + 3).map(r).collect();
    let k = (SHORTEST_MEAN..=longest).min_by(|a, b| all[*a].total_cmp(&all[*b]))?;
    let quiet = (4..=longest).filter(|lag| lag.abs_diff(k) > 2).all(|lag| all[lag].abs() < 0.2);
    let beside = |lag: usize| (0.15..0.5).contains(&all[lag]);
    // The slips of a valve correlate at lags of a period as well. They are few and large, so the fourth moment is large.
    let fourth = d.iter().map(|x| x.powi(4)).sum::<f64>() * d.len() as f64 / (power * power);
    (all[k] < -0.35 && all[k] > -0.65 && beside(k - 1) && beside(k + 1) && quiet && fourth < 5.0)
        .then_some((HistoryKind::Averaged, [all[k], k as f64]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(points: &[(f64, f64)]) -> Vec<Sample> {
        points.iter().map(|(t, v)| Sample::good(*t, *v)).collect()
    }

    #[test]
    fn hand_values() {
        // Two of five steps in time are off their median of 1 s.
        assert_eq!(
            irregular(&of(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (4.0, 0.0), (5.0, 0.0), (8.0, 0.0)])),
            0.4
        );
        assert_eq!(near_zero(&[0.1, 1.0, 1.0, 1.0]), 0.25);
        let steps: Vec<f64> = (0..100).map(|k| f64::from(k / 4)).collect();
        assert_eq!(held(&steps), Some((HistoryKind::Held, [1.0, 4.0])));
    }

    #[test]
    fn nothing_and_rubbish_are_nothing() {
        let flat = of(&(0..500).map(|k| (f64::from(k), 1.0)).collect::<Vec<_>>());
        let wild =
            of(&(0..500).map(|k| (f64::from(k % 7) * 1e300, 1e300 * f64::from(k % 3))).collect::<Vec<_>>());
        assert_eq!(recognise(&[], &[]), None);
        assert_eq!(recognise(&flat, &flat), None);
        // Whatever it says of such stamps, it is an answer and no panic.
        let _ = recognise(&wild, &wild);
        for kind in HistoryKind::ALL {
            assert!(kind.note().ends_with('.') && !kind.as_str().contains(' '));
        }
    }
}
