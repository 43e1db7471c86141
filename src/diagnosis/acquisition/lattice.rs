//! Equal rows in time from stamps: their period, their phase, and the jitter of the stamps. Whether a source reports only changes.

use super::limits::ReadingLimits;
use crate::signal::Sample;
use crate::sysid::stats::{mean, median};

/// Largest deviation of stamps that are the controller's own (share of its period).
pub(super) const EXACT: f64 = 1e-3;

/// Equal rows in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Time of row 0 (s).
    pub t0: f64,
    /// Period (s).
    pub period: f64,
    /// Standard deviation of the stamps about their rows (s).
    pub jitter: f64,
}

impl Lattice {
    /// The rows of a tag's stamps; `None` where they give no period.
    ///
    /// The mean of the steps near the median step assigns the stamps to rows. The straight line of the stamps over their rows, by
    /// least squares, then gives period and phase.
    pub fn of(series: &[Sample]) -> Option<Self> {
        Self::with(series, period(series)?)
    }

    /// The same, from a first estimate of the period (s).
    fn with(series: &[Sample], period: f64) -> Option<Self> {
        let t0 = series.first()?.t;
        let mut rows: Vec<f64> = Vec::with_capacity(series.len());
        let (mut row, mut last) = (0.0, t0);
        for s in series {
            row += ((s.t - last) / period).round();
            last = s.t;
            rows.push(row);
        }
        let fitted = Self { t0, period, jitter: 0.0 }.fitted(series, &rows)?;
        let rows: Vec<f64> = series.iter().map(|s| fitted.row(s.t).round()).collect();
        let fitted = fitted.fitted(series, &rows)?;
        // Equal stamps keep their exact period; a straight line through them differs from it by rounding.
        let exact = Self { t0, period, jitter: 0.0 };
        let same = (exact.period - fitted.period).abs() <= 1e-6 * exact.period
            && fitted.jitter <= 1e-6 * fitted.period;
        Some(if same { exact } else { fitted })
    }

    /// The straight line of the stamps over these rows, by least squares.
    fn fitted(&self, series: &[Sample], rows: &[f64]) -> Option<Self> {
        let off: Vec<f64> =
            series.iter().zip(rows).map(|(s, row)| s.t - self.t0 - row * self.period).collect();
        let (middle, centre) = (mean(&off), mean(rows));
        let power: f64 = rows.iter().map(|row| (row - centre).powi(2)).sum();
        let slope = if power > 0.0 {
            off.iter().zip(rows).map(|(off, row)| (off - middle) * (row - centre)).sum::<f64>() / power
        } else {
            0.0
        };
        let left = off.iter().zip(rows).map(|(off, row)| (off - middle - slope * (row - centre)).powi(2));
        let jitter = (left.sum::<f64>() / rows.len().max(1) as f64).sqrt();
        let (period, t0) = (self.period + slope, self.t0 + middle - slope * centre);
        (period.is_finite() && period > 0.0 && t0.is_finite()).then_some(Self { t0, period, jitter })
    }

    /// The row, with a fraction, of a time (s).
    pub fn row(&self, t: f64) -> f64 {
        (t - self.t0) / self.period
    }

    /// The time of a row (s).
    pub fn time(&self, row: f64) -> f64 {
        self.t0 + row * self.period
    }
}

/// The steps in time between samples (s), without those of repeated stamps.
fn steps(series: &[Sample]) -> Vec<f64> {
    series.windows(2).map(|w| w[1].t - w[0].t).filter(|d| *d > 0.0).collect()
}

fn period_of_median(series: &[Sample]) -> Option<f64> {
    let period = median(&steps(series));
    (period.is_finite() && period > 0.0).then_some(period)
}

/// The mean of the steps near the median step (s).
pub fn period(series: &[Sample]) -> Option<f64> {
    let steps = steps(series);
    let middle = period_of_median(series)?;
    let near: Vec<f64> = steps.into_iter().filter(|d| (d - middle).abs() <= 0.5 * middle).collect();
    let period = mean(&near);
    // Equal stamps keep their exact period; the mean of many differs from it by rounding.
    let period = if (period - middle).abs() <= 1e-6 * middle { middle } else { period };
    (period.is_finite() && period > 0.0).then_some(period)
}

/// The scans of a source that reports only changes, with the stamps of its own clock; `None` where OP and PV do not come from one.
///
/// Conditions: all stamps lie on equal rows exactly; no sample of a tag repeats the one before; at least one tag leaves rows out;
/// the tags were not polled, in turns or at a slower pace; and changes that are small are left out.
pub fn of_source(op: &[Sample], pv: &[Sample], limits: ReadingLimits) -> Option<Lattice> {
    let mut both: Vec<Sample> = op.iter().chain(pv).copied().collect();
    both.sort_by(|a, b| a.t.total_cmp(&b.t));
    both.dedup_by(|later, earlier| later.t == earlier.t);
    // Steps are multiples of the scan, so the shortest one is tried, and parts of it.
    let shortest = steps(&both).into_iter().fold(f64::INFINITY, f64::min);
    let far = |lattice: &Lattice| {
        both.iter().any(|s| {
            let row = lattice.row(s.t);
            (row - row.round()).abs() > EXACT
        })
    };
    let mut tried = (1..=4).filter_map(|part| Lattice::with(&both, shortest / f64::from(part)));
    let lattice = tried.find(|lattice| !far(lattice))?;
    let thinned = |series: &[Sample]| series.len() as f64 <= ON_CHANGE * both.len() as f64;
    let is_source = of_changes(op) && of_changes(pv) && (thinned(op) || thinned(pv));
    let polled =
        in_turns(op, pv, both.len(), &lattice) || [op, pv].iter().any(|tag| in_step(tag, &lattice, limits));
    let leave_out_small = leaves_out_small(op, &lattice) && leaves_out_small(pv, &lattice);
    (is_source && !polled && leave_out_small).then_some(lattice)
}

/// Whether no sample of a tag repeats the value of the one before.
fn of_changes(series: &[Sample]) -> bool {
    series.windows(2).all(|w| w[0].value != w[1].value)
}

/// Whether only the changes of a tag were reported, so that it kept its value at rows without a sample.
///
/// Conditions: no sample repeats the one before, small changes are left out, and the samples come at no pace of their own.
///
/// * `lattice`: rows no closer than the scans that the stamps show ([`scan_of_steps`]), because every step is a multiple of a row
///   that is close enough.
pub fn reports_changes(series: &[Sample], lattice: &Lattice, limits: ReadingLimits) -> bool {
    let own = period(series).map_or(1.0, |own| own / lattice.period);
    // Every step is a multiple of one row. So a tag with that pace was polled only if hardly a row is without a sample.
    let at_own = if (own - 1.0).abs() <= EXACT {
        at_every_row(series, lattice)
    } else {
        at_pace(&row_steps(series, lattice), own, limits)
    };
    of_changes(series) && !at_own && !in_step(series, lattice, limits) && leaves_out_small(series, lattice)
}

/// The longest period (s) of which the steps of OP and PV are multiples: the scan of the controller where only changes are
/// reported; `None` where there is none.
pub fn scan_of_steps(op: &[Sample], pv: &[Sample], limits: ReadingLimits) -> Option<f64> {
    let mut steps = self::steps(op);
    steps.extend(self::steps(pv));
    let shortest = steps.iter().copied().fold(f64::INFINITY, f64::min);
    let holds = |scan: &f64| {
        let multiples = steps.iter().filter(|step| {
            let rows = **step / scan;
            (rows - rows.round()).abs() <= EXACT
        });
        multiples.count() as f64 >= limits.in_step * steps.len() as f64
    };
    (1..=4).map(|part| shortest / f64::from(part)).filter(|scan| scan.is_finite()).find(holds)
}

/// Whether hardly a row between a tag's first sample and its last is without one.
fn at_every_row(series: &[Sample], lattice: &Lattice) -> bool {
    let (Some(first), Some(last)) = (series.first(), series.last()) else { return false };
    let rows = (lattice.row(last.t) - lattice.row(first.t)).round() + 1.0;
    series.len() as f64 > ON_CHANGE * rows
}

/// Whether OP and PV share a stamp more seldom than by chance. A source whose OP and PV change at one scan reports both; a poll
/// that reads them in turns never does.
///
/// * `stamps`: number of different stamps of both tags.
fn in_turns(op: &[Sample], pv: &[Sample], stamps: usize, lattice: &Lattice) -> bool {
    let ends = [op.first(), pv.first(), op.last(), pv.last()].map(|s| s.map_or(0.0, |s| lattice.row(s.t)));
    let scans = ends[2].max(ends[3]) - ends[0].min(ends[1]) + 1.0;
    let by_chance = op.len() as f64 * pv.len() as f64 / scans;
    let common = (op.len() + pv.len()).saturating_sub(stamps) as f64;
    common < by_chance - SELDOM * by_chance.sqrt()
}

/// Whether a tag has samples only at every second, third, … scan. Then it was read at that pace, and may have changed in between.
fn in_step(series: &[Sample], lattice: &Lattice, limits: ReadingLimits) -> bool {
    let steps = row_steps(series, lattice);
    (2..=SLOWEST).any(|pace| at_pace(&steps, f64::from(pace), limits))
}

/// Whether nearly all steps are multiples of a pace, rounded to rows (rows).
fn at_pace(steps: &[f64], pace: f64, limits: ReadingLimits) -> bool {
    let multiples = steps.iter().filter(|step| (**step - (**step / pace).round() * pace).abs() < 0.5).count();
    multiples as f64 >= limits.in_step * steps.len() as f64
}

/// The steps in time between samples (rows).
fn row_steps(series: &[Sample], lattice: &Lattice) -> Vec<f64> {
    series.windows(2).map(|w| (w[1].t - w[0].t) / lattice.period).collect()
}

/// Number of standard deviations by which common stamps are fewer than by chance, where tags are read in turns.
const SELDOM: f64 = 3.0;
/// Slowest pace that is tried for a tag that is read more slowly than the controller scans (scans).
const SLOWEST: i32 = 60;

/// Largest share of the scans at which a tag has a sample, where only its changes were reported.
const ON_CHANGE: f64 = 0.95;
/// Share of the median change below which a change is small: one normally distributed change in eight is.
const NEAR_NONE: f64 = 0.25;
/// Largest share of small changes where small ones are not reported.
const FEW_NEAR_NONE: f64 = 0.02;

/// Whether a tag has hardly any small changes, because the source does not report them, or has a sample at every scan.
///
/// Where samples are lost instead, small changes are among those that are left.
fn leaves_out_small(series: &[Sample], lattice: &Lattice) -> bool {
    if series.is_empty() || at_every_row(series, lattice) {
        return !series.is_empty();
    }
    let sizes: Vec<f64> = series.windows(2).map(|w| (w[1].value - w[0].value).abs()).collect();
    let limit = NEAR_NONE * median(&sizes);
    let near = sizes.iter().filter(|size| **size < limit).count();
    near as f64 <= FEW_NEAR_NONE * sizes.len() as f64
}
