//! On which rows the samples of a record lie.

use super::lattice::{Lattice, period, reports_changes, scan_of_steps};
use super::limits::ReadingLimits;
use super::scan::Scan;
use crate::signal::Sample;

/// Share of a scan about its instant within which a poll may be of the scan before or after.
const NEAR_SCAN: f64 = 0.06;
/// Periods of a tag by which its own differs from the rows' and is no longer one sample a row.
const OWN_PERIOD: f64 = 0.1;
/// Own periods for which a slower tag is held.
const HELD_FOR: f64 = 1.6;

/// How far apart OP and PV of the rows were read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Apart {
    /// Share of the rows with OP and PV that are no reading of both at one time (0..1).
    pub share: f64,
    /// Distance that so many of these rows reach as a record may have that says no (rows).
    pub rows: f64,
}

impl Apart {
    /// Whether they are too far for a record that says no, of which each fitted row has so many: readings that are far apart for a
    /// fast poll are near each other in a row of many polls.
    pub fn is_too_far(&self, decimation: usize, limits: ReadingLimits) -> bool {
        self.rows >= limits.apart * decimation.max(1) as f64
    }
}

/// Rows of a given period that are closer than the samples of PV, so that one reading fills several.
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
    /// Whether too many fitted rows, each of so many, repeat a reading: rows that each have a reading of their own are evidence,
    /// whatever the others are.
    pub fn is_too_much(&self, decimation: usize, limits: ReadingLimits) -> bool {
        let share = 1.0 - decimation.max(1) as f64 * self.ts / self.pv_s;
        share > limits.most_read_apart
    }
}

/// How a tag's samples become rows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    /// Each on the row next to it, after so much is taken from its stamp (s).
    Nearest(f64),
    /// Each on the scan it was read in; scans begin so much later than the rows (s).
    Scan(f64),
    /// Held until the next, and so long at most (s).
    Held(f64),
}

/// The rows of a record, and how its tags come on them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// The rows.
    pub rows: Lattice,
    op: Way,
    pv: Way,
    /// Rows by which PV is recorded later than the controller read it.
    pub pv_late: usize,
    /// Whether OP of each row was computed from PV of that row, whenever the two were read.
    pub of_one_scan: bool,
    limits: ReadingLimits,
}

impl Placed {
    /// On the rows of the polls, or of a period that was given.
    pub fn on(rows: Lattice, op: &[Sample], pv: &[Sample], limits: ReadingLimits) -> Self {
        Self::by([way(&rows, op), way(&rows, pv)], rows, limits)
    }

    /// On the controller's ticks.
    pub fn on_ticks(scan: &Scan, limits: ReadingLimits) -> Self {
        let rows = Lattice { t0: scan.phases[0], period: scan.period, jitter: 0.0 };
        Self::by([Way::Scan(0.0), Way::Scan(scan.phases[1] - scan.phases[0])], rows, limits)
    }

    /// On the scans whose stamps the samples carry: what is not reported has not changed.
    pub fn on_source(rows: Lattice, limits: ReadingLimits) -> Self {
        Self::by([Way::Held(f64::INFINITY); 2], rows, limits)
    }

    /// OP's way and PV's.
    fn by([op, pv]: [Way; 2], rows: Lattice, limits: ReadingLimits) -> Self {
        Self { rows, op, pv, pv_late: 0, of_one_scan: false, limits }
    }

    /// OP's value on `n` rows from row `from` on; `None` where it is missing.
    pub fn op(&self, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        self.placed(self.op, kept, from, n)
    }

    /// PV's, moved back by as many rows as it is late.
    pub fn pv(&self, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        self.placed(self.pv, kept, from + self.pv_late as i64, n)
    }

    /// Another tag's, read as OP is.
    pub fn other(&self, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        let way = if matches!(self.op, Way::Scan(_)) && period(kept).is_some_and(|own| own < self.rows.period)
        {
            self.op
        } else {
            way(&self.rows, kept)
        };
        self.placed(way, kept, from, n)
    }

    /// Whether a tag is read more slowly than the rows: held in between, it stands still there whatever it does.
    pub fn is_slower(&self, kept: &[Sample]) -> bool {
        period(kept).is_some_and(|own| own > (1.0 + OWN_PERIOD) * self.rows.period)
    }

    /// The intervals at which OP and PV were read, where the rows are closer than PV was read: between two readings of a tag
    /// nothing is known of it, unless only its changes are reported.
    pub fn coarser_readings(&self, op: &[Sample], pv: &[Sample]) -> Option<Carried> {
        let scans = self.scans(op, pv);
        let carried = |way: Way, kept: &[Sample]| {
            let held = matches!(way, Way::Held(longest) if longest.is_finite());
            period(kept).filter(|_| held && !reports_changes(kept, &scans, self.limits))
        };
        let pv_s = carried(self.pv, pv)?;
        let samples_s = carried(self.op, op).map_or(pv_s, |of_op| of_op.max(pv_s));
        Some(Carried { ts: self.rows.period, pv_s, samples_s })
    }

    /// The rows, or the scans that stamps show where rows of a given period are closer.
    fn scans(&self, op: &[Sample], pv: &[Sample]) -> Lattice {
        let shown = scan_of_steps(op, pv, self.limits);
        Lattice { period: shown.map_or(self.rows.period, |scan| scan.max(self.rows.period)), ..self.rows }
    }

    fn placed(&self, way: Way, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        match way {
            Way::Nearest(late) => self.nearest(late, kept, from, n),
            Way::Scan(late) => self.on_scans(late, kept, from, n),
            Way::Held(longest) => self.held(longest, kept, from, n),
        }
    }

    /// How far the readings of OP and PV of one row are from each other, or PV from its row where it is one that an earlier row has;
    /// nothing where both are of one scan, because registers are held: on the controller's ticks, and where OP tells so.
    ///
    /// Between the two readings the controller may have acted. Where OP was read later, it answers a PV that is not in the
    /// record, so that OP seems to cause PV exactly; where it was read earlier, PV answers within the row.
    pub fn read_apart(&self, op: &[Sample], pv: &[Sample], from: i64, n: usize) -> Apart {
        // A value that is carried on to another row was not read there, whatever it was computed from.
        let each_is_read = matches!((self.op, self.pv), (Way::Nearest(_), Way::Nearest(_)));
        let on_ticks = self.of_changes() || matches!(self.pv, Way::Scan(_));
        if on_ticks || (self.of_one_scan && each_is_read) {
            return Apart::default();
        }
        let (period, scans) = (self.rows.period, self.scans(op, pv));
        let row = |k: usize| self.rows.time(from as f64 + k as f64);
        // A tag that is recorded so many rows late was read so much before its stamp.
        let read = |way: Way, kept: &[Sample], late: usize| -> Vec<Option<f64>> {
            let before = late as f64 * period;
            let stamps: Vec<Sample> = kept.iter().map(|s| Sample { value: s.t - before, ..*s }).collect();
            let placed = self.placed(way, &stamps, from + late as i64, n).into_iter().enumerate();
            // What is reported when it changes is known at every row.
            let known = matches!(way, Way::Held(_)) && reports_changes(kept, &scans, self.limits);
            placed.map(|(k, t)| if known { t.map(|_| row(k)) } else { t }).collect()
        };
        let (op, pv) = (read(self.op, op, 0), read(self.pv, pv, self.pv_late));
        let is_held = matches!(self.pv, Way::Held(_));
        let distance = |(k, op, pv): (usize, f64, f64)| {
            // A PV of an earlier row is as old as it is, whenever OP was read.
            let old = if is_held { row(k) - pv } else { 0.0 };
            (op - pv).abs().max(if old > 0.5 * period { old } else { 0.0 }) / period
        };
        let both = op.iter().zip(&pv).enumerate();
        let mut rows: Vec<f64> =
            both.filter_map(|(k, (op, pv))| Some(distance((k, (*op)?, (*pv)?)))).collect();
        rows.sort_by(f64::total_cmp);
        let apart = rows.len() - rows.partition_point(|rows| *rows < self.limits.apart);
        let most = ((1.0 - self.limits.most_read_apart) * rows.len() as f64) as usize;
        Apart { share: apart as f64 / rows.len().max(1) as f64, rows: rows.get(most).copied().unwrap_or(0.0) }
    }

    /// The row that a sample at this time belongs to.
    pub fn row_of(&self, t: f64) -> f64 {
        let row = self.rows.row(t);
        match self.pv {
            Way::Scan(_) => row.floor(),
            Way::Nearest(late) => ((t - late - self.rows.t0) / self.rows.period).round(),
            Way::Held(_) => (row - 1e-6).ceil(),
        }
    }

    /// Whether there are samples of changes alone.
    pub fn of_changes(&self) -> bool {
        self.pv == Way::Held(f64::INFINITY)
    }

    /// Of several samples at one row the nearest.
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

    /// Of several polls in one scan one; a poll next to a scan's instant belongs where its value says.
    fn on_scans(&self, late: f64, kept: &[Sample], from: i64, n: usize) -> Vec<Option<f64>> {
        let mut out: Vec<Option<f64>> = vec![None; n];
        let mut last: Option<(f64, f64, f64)> = None;
        for s in kept {
            let at = self.rows.row(s.t - late);
            let (mut row, part) = (at.floor(), at - at.floor());
            if let Some((before, of, value)) = last {
                let changed = s.value != value;
                if !changed && row == before + 1.0 && part < NEAR_SCAN {
                    // Nothing new: read before that scan after all.
                    row = before;
                } else if changed && row == before && part > 1.0 - NEAR_SCAN {
                    row += 1.0;
                } else if changed && row == before && of < NEAR_SCAN {
                    // The one before was read before this scan.
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

    /// The last sample at or before each row, as far as it holds.
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

/// The place of a row counted from `from`, where there is one.
fn slot<T>(out: &mut [T], row: f64, from: i64) -> Option<&mut T> {
    let at = row - from as f64;
    if at >= 0.0 && at < out.len() as f64 { out.get_mut(at as usize) } else { None }
}

/// One sample a row, where a tag has about the rows' period: its own lag behind them is taken out. A slower one is held; of
/// a faster one the nearest is taken.
fn way(rows: &Lattice, series: &[Sample]) -> Way {
    let Some(own) = period(series) else { return Way::Held(HELD_FOR * rows.period) };
    if own > (1.0 + OWN_PERIOD) * rows.period {
        return Way::Held(HELD_FOR * own);
    }
    if own < (1.0 - OWN_PERIOD) * rows.period {
        return Way::Nearest(0.0);
    }
    // The mean lag on the circle of one period.
    let (mut x, mut y) = (0.0, 0.0);
    for s in series {
        let (sin, cos) = (std::f64::consts::TAU * rows.row(s.t)).sin_cos();
        (x, y) = (x + cos, y + sin);
    }
    let lag = y.atan2(x) / std::f64::consts::TAU * rows.period;
    // Between two rows the tag belongs to the earlier one: an OP acts on the PV of the next.
    let lag = if lag < (1e-6 - 0.5) * rows.period { -lag } else { lag };
    Way::Nearest(if lag.abs() < 1e-6 * rows.period { 0.0 } else { lag })
}
