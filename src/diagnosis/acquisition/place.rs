//! The assignment of samples to rows: which sample gives the value of a row, and how far apart OP and PV of a row were read.

use super::later::Later;
use super::lattice::{Lattice, period, reports_changes, scan_of_steps};
use super::limits::ReadingLimits;
use super::scan::Scan;
use crate::signal::Sample;

/// Distance from the instant of a scan (share of the period) within which a poll may belong to the scan before or after.
const NEAR_SCAN: f64 = 0.06;
/// Relative difference between the periods of a tag and of the rows above which it does not have one sample for each row.
const OWN_PERIOD: f64 = 0.1;
/// Time for which the value of a slower tag is held (periods of the tag).
const HELD_FOR: f64 = 1.6;

/// How far apart OP and PV of one row were read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Apart {
    /// Share of the rows with OP and PV whose two readings are apart by [`ReadingLimits::apart`] or more (0..1).
    pub share: f64,
    /// The distance (rows) that is reached by a share [`ReadingLimits::most_read_apart`] of the rows.
    pub rows: f64,
    /// How much later a PV is recorded that OP answers, whatever the stamps say.
    pub later: Later,
}

impl Apart {
    /// Whether the readings are too far apart for the verdict `no_stiction`.
    ///
    /// * `decimation`: number of these rows in one fitted row, by which the distance is divided.
    pub fn is_too_far(&self, decimation: usize, limits: ReadingLimits) -> bool {
        self.rows >= limits.apart * decimation.max(1) as f64
    }
}

/// Rows of a configured period that are closer than the samples of PV, so that one sample fills several rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carried {
    /// Period of the rows (s).
    pub ts: f64,
    /// Interval at which PV was read (s).
    pub pv_s: f64,
    /// The longer of the intervals at which OP and PV were read (s).
    pub samples_s: f64,
}

impl Carried {
    /// Whether too many fitted rows repeat a sample of PV.
    ///
    /// * `decimation`: number of these rows in one fitted row.
    pub fn is_too_much(&self, decimation: usize, limits: ReadingLimits) -> bool {
        let share = 1.0 - decimation.max(1) as f64 * self.ts / self.pv_s;
        share > limits.most_read_apart
    }
}

/// How the samples of a tag are assigned to rows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Assignment {
    /// A sample belongs to the nearest row, after this time (s) is subtracted from its stamp.
    Nearest(f64),
    /// A sample belongs to the scan in which it was read; scans begin this time (s) after the rows.
    Scan(f64),
    /// A sample is held until the next one, for at most this time (s).
    Held(f64),
}

/// The rows of a record, and how OP and PV are assigned to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// The rows.
    pub rows: Lattice,
    op: Assignment,
    pv: Assignment,
    /// Rows by which PV is recorded later than the controller read it.
    pub pv_late: usize,
    /// Whether OP of each row was computed from PV of that row, whenever the two were read.
    pub of_one_scan: bool,
    limits: ReadingLimits,
}

impl Placed {
    /// The rows of the polls, or of a configured period.
    pub fn on(rows: Lattice, op: &[Sample], pv: &[Sample], limits: ReadingLimits) -> Self {
        Self::by([assignment(&rows, op), assignment(&rows, pv)], rows, limits)
    }

    /// Rows at the controller's scans.
    pub fn on_ticks(scan: &Scan, limits: ReadingLimits) -> Self {
        let rows = Lattice { t0: scan.phases[0], period: scan.period, jitter: 0.0 };
        let later = scan.phases[1] - scan.phases[0];
        Self::by([Assignment::Scan(0.0), Assignment::Scan(later)], rows, limits)
    }

    /// Rows at the scans whose stamps the samples have; only changes are reported, so a value holds until the next one.
    pub fn on_source(rows: Lattice, limits: ReadingLimits) -> Self {
        Self::by([Assignment::Held(f64::INFINITY); 2], rows, limits)
    }

    /// The rows with the assignments of OP and PV.
    fn by([op, pv]: [Assignment; 2], rows: Lattice, limits: ReadingLimits) -> Self {
        Self { rows, op, pv, pv_late: 0, of_one_scan: false, limits }
    }

    /// OP on `n` rows from row `from` on; `None` where it is missing.
    pub fn op(&self, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        self.assign(self.op, kept, from, n)
    }

    /// PV on `n` rows from row `from` on, moved back by [`Placed::pv_late`] rows; `None` where it is missing.
    pub fn pv(&self, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        self.assign(self.pv, kept, from + self.pv_late as i64, n)
    }

    /// Another tag on `n` rows from row `from` on, read as OP is; `None` where it is missing.
    pub fn other(&self, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        let is_faster = period(kept).is_some_and(|own| own < self.rows.period);
        let by = match self.op {
            Assignment::Scan(_) if is_faster => self.op,
            _ => assignment(&self.rows, kept),
        };
        self.assign(by, kept, from, n)
    }

    /// Whether a tag is read more slowly than the rows, so that its value is held in between.
    pub fn is_slower(&self, kept: &[Sample]) -> bool {
        period(kept).is_some_and(|own| own > (1.0 + OWN_PERIOD) * self.rows.period)
    }

    /// The intervals at which OP and PV were read, where PV is read more slowly than the rows; else `None`.
    ///
    /// A tag of which only changes are reported is known at every row, and counts as read there.
    pub fn coarser_readings(&self, op: &[Sample], pv: &[Sample]) -> Option<Carried> {
        let scans = self.scans(op, pv);
        let carried = |by: Assignment, kept: &[Sample]| {
            let held = matches!(by, Assignment::Held(longest) if longest.is_finite());
            period(kept).filter(|_| held && !reports_changes(kept, &scans, self.limits))
        };
        let pv_s = carried(self.pv, pv)?;
        let samples_s = carried(self.op, op).map_or(pv_s, |of_op| of_op.max(pv_s));
        Some(Carried { ts: self.rows.period, pv_s, samples_s })
    }

    /// The rows, or the scans that the stamps show, where rows of a configured period are closer than these.
    fn scans(&self, op: &[Sample], pv: &[Sample]) -> Lattice {
        let shown = scan_of_steps(op, pv, self.limits);
        Lattice { period: shown.map_or(self.rows.period, |scan| scan.max(self.rows.period)), ..self.rows }
    }

    /// The values of samples on `n` rows from row `from` on.
    fn assign(&self, by: Assignment, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        match by {
            Assignment::Nearest(late) => self.nearest(late, kept, from, n),
            Assignment::Scan(late) => self.on_scans(late, kept, from, n),
            Assignment::Held(longest) => self.held(longest, kept, from, n),
        }
    }

    /// How far apart OP and PV of one row were read, over `n` rows from row `from` on.
    ///
    /// The distance of a row is the larger of the time between the two readings and the age of a PV that an earlier row has as
    /// well.
    /// It is 0 where both values are of one scan, because registers are held: on the controller's ticks, and where OP shows it
    /// ([`Placed::of_one_scan`]).
    ///
    /// The controller may have acted between the two readings. Where OP was read later, it reacts to a PV that is not in the
    /// record, so that OP seems to cause PV exactly. Where OP was read earlier, PV reacts within the row.
    pub fn read_apart(&self, op: &[Sample], pv: &[Sample], from: i64, n: usize) -> Apart {
        // A value that is held at another row was not read there, whatever it was computed from.
        let each_is_read = matches!((self.op, self.pv), (Assignment::Nearest(_), Assignment::Nearest(_)));
        let on_ticks = self.of_changes() || matches!(self.pv, Assignment::Scan(_));
        if on_ticks || (self.of_one_scan && each_is_read) {
            return Apart::default();
        }
        let (period, scans) = (self.rows.period, self.scans(op, pv));
        let row = |k: usize| self.rows.time(from as f64 + k as f64);
        // The times at which a tag was read, on the rows; one that is recorded `late` rows late was read so long before its stamp.
        let read = |by: Assignment, kept: &[Sample], late: usize| -> Vec<Option<f64>> {
            let before = late as f64 * period;
            let stamps: Vec<Sample> = kept.iter().map(|s| Sample { value: s.t - before, ..*s }).collect();
            let times = self.assign(by, &stamps, from + late as i64, n).into_iter().enumerate();
            // A tag of which only changes are reported is known at every row.
            let known = matches!(by, Assignment::Held(_)) && reports_changes(kept, &scans, self.limits);
            times.map(|(k, t)| if known { t.map(|_| row(k)) } else { t }).collect()
        };
        let (op, pv) = (read(self.op, op, 0), read(self.pv, pv, self.pv_late));
        let is_held = matches!(self.pv, Assignment::Held(_));
        let distance = |(k, op, pv): (usize, f64, f64)| {
            // A PV that an earlier row has as well is this old, whenever OP was read.
            let age = if is_held { row(k) - pv } else { 0.0 };
            (op - pv).abs().max(if age > 0.5 * period { age } else { 0.0 }) / period
        };
        let both = op.iter().zip(&pv).enumerate();
        let mut rows: Vec<f64> =
            both.filter_map(|(k, (op, pv))| Some(distance((k, (*op)?, (*pv)?)))).collect();
        rows.sort_by(f64::total_cmp);
        let apart = rows.len() - rows.partition_point(|rows| *rows < self.limits.apart);
        let most = ((1.0 - self.limits.most_read_apart) * rows.len() as f64) as usize;
        let share = apart as f64 / rows.len().max(1) as f64;
        Apart { share, rows: rows.get(most).copied().unwrap_or(0.0), later: Later::default() }
    }

    /// The row to which a sample at this time (s) belongs.
    pub fn row_of(&self, t: f64) -> f64 {
        let row = self.rows.row(t);
        match self.pv {
            Assignment::Scan(_) => row.floor(),
            Assignment::Nearest(late) => ((t - late - self.rows.t0) / self.rows.period).round(),
            Assignment::Held(_) => (row - 1e-6).ceil(),
        }
    }

    /// Whether only changes of value were reported.
    pub fn of_changes(&self) -> bool {
        self.pv == Assignment::Held(f64::INFINITY)
    }

    /// [`Assignment::Nearest`]; of several samples at one row the nearest counts.
    fn nearest(&self, late: f64, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        let mut out: Vec<Option<(f64, f64)>> = vec![None; n];
        for s in kept {
            let row = self.rows.row(s.t - late);
            let off = (row - row.round()).abs();
            if let Some(slot) = slot(&mut out, row.round(), from)
                && slot.is_none_or(|(other, _)| off < other)
            {
                *slot = Some((off, s.value));
            }
        }
        out.into_iter().map(|slot| slot.map(|(_, value)| value)).collect()
    }

    /// [`Assignment::Scan`]; of several polls in one scan the last counts.
    ///
    /// A poll next to the instant of a scan may belong to the scan before or after it. Whether its value changed decides.
    fn on_scans(&self, late: f64, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        let mut out: Vec<Option<f64>> = vec![None; n];
        let mut last: Option<(f64, f64, f64)> = None;
        for s in kept {
            let at = self.rows.row(s.t - late);
            let (mut row, part) = (at.floor(), at - at.floor());
            if let Some((before, of, value)) = last {
                let changed = s.value != value;
                if !changed && row == before + 1.0 && part < NEAR_SCAN {
                    // The value did not change, so it was read before this scan.
                    row = before;
                } else if changed && row == before && part > 1.0 - NEAR_SCAN {
                    row += 1.0;
                } else if changed && row == before && of < NEAR_SCAN {
                    // The value changed, so the poll before was read before this scan.
                    let earlier = slot(&mut out, before - 1.0, from);
                    if let Some(earlier) = earlier.filter(|earlier| earlier.is_none()) {
                        *earlier = Some(value);
                    }
                }
            }
            if let Some(slot) = slot(&mut out, row, from) {
                *slot = Some(s.value);
            }
            last = Some((row, part, s.value));
        }
        out
    }

    /// [`Assignment::Held`]: the last sample at or before each row, as long as it is held.
    fn held(&self, longest: f64, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        let mut at = 0;
        (0..n)
            .map(|k| {
                let t = self.rows.time(from as f64 + k as f64 + 1e-3);
                while at + 1 < kept.len() && kept[at + 1].t <= t {
                    at += 1;
                }
                kept.get(at).filter(|s| s.t <= t && t - s.t <= longest).map(|s| s.value)
            })
            .collect()
    }
}

/// The entry of a row in `out`, whose first row is `from`; `None` outside.
fn slot<T>(out: &mut [T], row: f64, from: i64) -> Option<&mut T> {
    let at = row - from as f64;
    if at >= 0.0 && at < out.len() as f64 { out.get_mut(at as usize) } else { None }
}

/// The assignment of a tag that is polled by its own period.
///
/// * About the period of the rows: the nearest row, after the mean lag of the tag behind the rows is subtracted.
/// * Slower: held. Faster: the nearest row.
fn assignment(rows: &Lattice, series: &[Sample]) -> Assignment {
    let Some(own) = period(series) else { return Assignment::Held(HELD_FOR * rows.period) };
    if own > (1.0 + OWN_PERIOD) * rows.period {
        return Assignment::Held(HELD_FOR * own);
    }
    if own < (1.0 - OWN_PERIOD) * rows.period {
        return Assignment::Nearest(0.0);
    }
    // The mean lag is a circular mean over one period.
    let (mut x, mut y) = (0.0, 0.0);
    for s in series {
        let (sin, cos) = (std::f64::consts::TAU * rows.row(s.t)).sin_cos();
        (x, y) = (x + cos, y + sin);
    }
    let lag = y.atan2(x) / std::f64::consts::TAU * rows.period;
    // Half way between two rows the tag belongs to the earlier one, because OP acts on PV of the next row.
    let lag = if lag < (1e-6 - 0.5) * rows.period { -lag } else { lag };
    Assignment::Nearest(if lag.abs() < 1e-6 * rows.period { 0.0 } else { lag })
}
