//! A record of any sampling as a window on an equal grid. PV, OP and stem are interpolated; set point and mode are held.
//!
//! A record with more samples than rows is *thinned*. Single values of it would alias a fast cycle, so that it is low-passed first
//! (`points::low_passed`). The filter also removes the quantum of PV and the travel within a row: both are computed from the samples
//! before ([`Raw`], [`Work`]).
//!
//! Unlike the gate of the diagnosis, it keeps the whole record with its gaps, because oscillations are searched for over all of its time.
//! Rows that good samples of PV and OP do not cover are marked as missing. Stem, mode and set point are known as long as they were
//! sampled. A source that sends changes only never repeats a value: while it is silent its value is unchanged, until a sample that is
//! not good. OP from such a source stands still until its next change.

pub(super) mod points;
mod tag;

use super::signs::held;
use super::{PlantLoop, is_moved};
use crate::indicators::noise::{self, Spread};
use crate::indicators::travel::{Travel, path};
use crate::signal::{Record, Row, Sample, Window};
use crate::sysid::stats::sd;
use points::{Grid, Points, THINNED, interval, low_passed, mean_interval, picked, stepped, values};
use tag::{Tag, Zero};

/// Fewest good samples.
const LEAST: usize = 60;
/// Share of the standard deviation of OP or PV that its rows must keep (-): below it, most of its movement is too fast for them. The
/// filter keeps half of a cycle of 3.2 rows where a row has 1.4 samples, and of 2.9 rows where it has many.
const BLURRED: f64 = 0.5;

/// Properties of the samples of PV and OP that thinning removes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Raw {
    /// Quantum of PV (PV unit); 0 where it has none.
    pub step: f64,
    /// Longest stretch in which PV does not change, as a share of the samples (0..1).
    pub held: f64,
    /// Spread of PV.
    pub pv: Spread,
    /// Spread of OP.
    pub op: Spread,
}

/// Travel and reversals of a valve from row to row, by the samples of the stem or of OP.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Work {
    /// Travel up to the beginning of each row, and up to the end of the last (OP unit).
    way: Vec<f64>,
    /// Number of reversals up to then.
    turns: Vec<f64>,
}

impl Work {
    /// The work by the samples. `edges`: the beginning of each row, and the end of the last (s).
    fn of(points: &Points, edges: impl Iterator<Item = f64> + Clone) -> Self {
        let (mut way, mut turns, mut gone) = (Vec::new(), Vec::new(), 0.0);
        let mut before = points[0].1;
        for (count, (at, value)) in path(&values(points), mean_interval(points)).into_iter().enumerate() {
            let t = points[at].0;
            gone += (value - before).abs();
            before = value;
            way.push((t, gone));
            turns.push((t, count as f64));
        }
        // The last point is the end of the samples, and not a reversal.
        turns.pop();
        Self { way: picked(&way, edges.clone(), false), turns: picked(&turns, edges, true) }
    }

    /// Travel and reversals in a day. `seen_s`: time for which the valve was observed (s).
    pub fn travel(&self, seen_s: f64) -> Travel {
        let over = |x: &[f64]| x.first().zip(x.last()).map_or(0.0, |(first, last)| last - first);
        Travel::new(over(&self.way), over(&self.turns), seen_s)
    }

    /// The work from row `from` on.
    fn tail(&self, from: usize) -> Self {
        let last = |x: &[f64]| x.get(from..).unwrap_or_default().to_vec();
        Self { way: last(&self.way), turns: last(&self.turns) }
    }
}

/// The loop of a record over all of its time.
///
/// * `most`: number of rows where there are more samples than that by a fifth; otherwise the rows are the samples.
///
/// # Errors
/// The record has too few good samples of PV, or none of OP.
pub fn of_record(name: &str, record: &Record, most: usize) -> Result<PlantLoop, String> {
    let tags = Tags::of(record)?;
    let (from, to) = tags.span();
    let ts = row_period(interval(&tags.pv.points), to - from, most);
    let (op_limits, op_span) = (record.op_limits, record.known_span());
    Ok(PlantLoop { name: name.into(), op_limits, op_span, ..tags.rows(ts, usize::MAX) })
}

/// The loop of the latest part of a record: its latest `most` samples, or the latest `hour_s` (s) in about as many rows where the
/// samples do not cover that time. Where such rows remove most of the movement of PV, it is the latest samples after all. The rows do
/// not depend on how long the record is, once it is long enough.
///
/// # Errors
/// The record has too few good samples of PV, or none of OP.
pub fn recent(name: &str, record: &Record, hour_s: f64, most: usize) -> Result<PlantLoop, String> {
    let tags = Tags::of(record)?;
    let (from, to) = tags.span();
    let length_s = hour_s.min(to - from);
    let ts = row_period(interval(&tags.pv.points), length_s, most);
    let mut of = tags.rows(ts, most.max((length_s / ts).ceil() as usize));
    if of.pv_blurred {
        of = tags.rows(interval(&tags.pv.points), most);
    }
    let (op_limits, op_span) = (record.op_limits, record.known_span());
    Ok(PlantLoop { name: name.into(), op_limits, op_span, ..of })
}

/// The period of the rows (s), at most `most` of them over `length_s` (s). It is that of the samples, `interval` (s), where there are
/// not many more samples: rows a little further apart would lie between samples, and interpolation would reduce the noise.
fn row_period(interval: f64, length_s: f64, most: usize) -> f64 {
    let ts = length_s / most.max(2) as f64;
    if ts > THINNED * interval { ts } else { interval }
}

/// The tags of a record.
struct Tags {
    op: Tag,
    pv: Tag,
    sp: Option<Tag>,
    mode: Option<Tag>,
    stem: Option<Tag>,
}

impl Tags {
    fn of(record: &Record) -> Result<Self, String> {
        let (pv, op) = measured(record);
        if pv.points.len() < LEAST || op.points.is_empty() {
            let (pv, op) = (pv.points.len(), op.points.len());
            return Err(format!("{pv} good samples of PV and {op} of OP, {LEAST} are needed"));
        }
        let kept = |tag: Option<Tag>, least: usize| tag.filter(|tag| tag.points.len() >= least);
        let held = |series: &Option<Vec<Sample>>| {
            kept(series.as_deref().map(|series| Tag::of(series, Zero::Value, None)), 1)
        };
        let stem = record.mv.as_deref().map(|series| Tag::of(series, Zero::DropOut, record.limits()));
        // A stem with too few samples is left out, because its travel is not known.
        Ok(Self { op, pv, sp: held(&record.sp), mode: held(&record.mode), stem: kept(stem, LEAST) })
    }

    /// The times of the first and the last sample of PV (s).
    fn span(&self) -> (f64, f64) {
        let ends = self.pv.points.first().zip(self.pv.points.last());
        ends.map_or((0.0, 0.0), |(first, last)| (first.0, last.0))
    }

    /// The properties that thinning removes, from the time `from` on (s). OP is interpolated at the samples of PV.
    fn raw(&self, from: f64) -> Raw {
        let points = &self.pv.points;
        let points = &points[points.partition_point(|point| point.0 < from)..];
        let pv = values(points);
        let op = picked(&self.op.corners(), points.iter().map(|point| point.0), false);
        Raw { step: noise::step(&pv), held: held(&pv), pv: Spread::of(&pv), op: Spread::of(&op) }
    }

    /// The last rows, at most `most`, of a grid with the period `ts` (s) that begins at the first sample of PV.
    fn rows(&self, ts: f64, most: usize) -> PlantLoop {
        let (from, to) = self.span();
        let n = ((to - from) / ts) as usize + 1;
        let grid = Grid { from, ts, rows: n.saturating_sub(most)..n };
        let is_thinned = |tag: &Tag| ts > THINNED * interval(&tag.points);
        let through = |tag: &Tag, points: &Points| -> Vec<f64> {
            if is_thinned(tag) {
                low_passed(points, &grid, interval(&tag.points))
            } else {
                picked(points, grid.times(), false)
            }
        };
        let drawn = |tag: &Tag| through(tag, &tag.points);
        let output = |tag: &Tag| through(tag, &tag.corners());
        let set_point = |tag: &Tag| {
            // A set point from a master is treated like its OP, so that both stay the same; a step by hand stays a step.
            let is_output = tag.points.len() > n && is_moved(&values(&tag.points));
            if is_output { output(tag) } else { picked(&tag.points, grid.times(), true) }
        };
        let near = |tag: &Tag| tag.near(grid.times(), to);
        let known = |tag: &Tag| tag.known(grid.times(), to);
        // None where all rows are known.
        let unless_all = |known: Vec<bool>| known.contains(&false).then_some(known);
        // An OP that is sent by changes stands still in manual and at a limit; a PV hardly ever does.
        let covered = if self.op.by_changes { known(&self.op) } else { near(&self.op) };
        let covered = near(&self.pv).into_iter().zip(covered);
        let rows: Vec<Row> =
            covered.map(|(pv, op)| if pv && op { Row::Counts } else { Row::Missing }).collect();
        let window = Window {
            t0: from + grid.rows.start as f64 * ts,
            ts,
            op: output(&self.op),
            pv: drawn(&self.pv),
            sp: self.sp.as_ref().map(set_point),
            mv: self.stem.as_ref().map(drawn),
            // Empty where all count.
            rows: if rows.contains(&Row::Missing) { rows } else { Vec::new() },
            ..Window::default()
        };
        let raw = is_thinned(&self.pv).then(|| self.raw(window.t0));
        let moved = self.stem.as_ref().unwrap_or(&self.op);
        let work = is_thinned(moved).then(|| Work::of(&moved.points, grid.edges()));
        // Single values alias a fast cycle, but have its standard deviation.
        let is_blurred = |tag: &Tag, rows: &[f64]| {
            is_thinned(tag) && sd(rows) < BLURRED * sd(&picked(&stepped(&tag.points), grid.times(), false))
        };
        let (pv_blurred, op_blurred) = (is_blurred(&self.pv, &window.pv), is_blurred(&self.op, &window.op));
        let mode = self.mode.as_ref().map(|mode| {
            let held = picked(&mode.points, grid.times(), true).into_iter().zip(known(mode));
            held.map(|(mode, is_known)| if is_known { mode } else { f64::NAN }).collect()
        });
        let sp_known = self.sp.as_ref().and_then(|sp| unless_all(known(sp)));
        let stem_known = self.stem.as_ref().and_then(|stem| unless_all(near(stem)));
        let of = PlantLoop { window, mode, sp_known, stem_known, raw, work, ..PlantLoop::default() };
        PlantLoop { pv_blurred, op_blurred, ..of }
    }
}

/// PV, and the signal that the valve received: OP plus the term of write-back in force. An OP that stays at a configured limit is
/// measured, even where the limit is an outage value.
fn measured(record: &Record) -> (Tag, Tag) {
    let op = Tag::of(&record.input(), Zero::DropOut, record.limits());
    (Tag::of(&record.pv, Zero::DropOut, None), op)
}

/// Whether PV or OP has been silent for too long, so that the loop cannot be analysed as it is now: the name of the tag, and the time of
/// its last good sample (s). Too long is more than one period of the analysis, and more than ten of its sampling intervals. OP that is
/// sent by changes is silent only once a sample of it is bad.
///
/// * `now`: the present time (s).
/// * `period_s`: the period of the analysis (s).
pub fn silent_since(record: &Record, now: f64, period_s: f64) -> Option<(&'static str, f64)> {
    silent_of(record, period_s, [Source { now, is_there: false }; 2])
}

/// What is known of the source of a tag beside its samples.
#[derive(Clone, Copy, Debug)]
pub struct Source {
    /// The present time by the clock that stamps its samples (s).
    pub now: f64,
    /// Whether it is connected and sends every change, so that its last good value holds.
    pub is_there: bool,
}

/// The same as [`silent_since`] with the sources of PV and of OP. A zero is a value here: a PV that stays at 0 while the unit is down is
/// not silent. A tag with fewer than two samples has no interval, and is not silent.
pub fn silent_of(record: &Record, period_s: f64, sources: [Source; 2]) -> Option<(&'static str, f64)> {
    let [of_pv, of_op] = sources;
    let op = Tag::of(&record.input(), Zero::Value, record.limits());
    let pv = Tag::of(&record.pv, Zero::Value, None);
    [("PV", pv, of_pv, false), ("OP", op, of_op, true)].into_iter().find_map(|(name, tag, of, holds)| {
        let last = tag.points.last().filter(|_| tag.points.len() > 1)?.0;
        let stands = (of.is_there || holds && tag.by_changes) && !tag.is_marked_after(last);
        (!stands && of.now - last > period_s.max(tag.longest)).then_some((name, last))
    })
}

/// The last `length_s` (s) of a loop up to the present time: less than that of its window, where the window ended earlier.
pub fn tail(of: &PlantLoop, length_s: f64) -> PlantLoop {
    let n = of.window.pv.len();
    let from = n.saturating_sub(((length_s - of.silent_s) / of.window.ts).ceil().max(1.0) as usize);
    let last = |x: &Vec<f64>| x.get(from..).unwrap_or_default().to_vec();
    let known = |x: &Vec<bool>| x.get(from..).unwrap_or_default().to_vec();
    let w = &of.window;
    let window = Window {
        t0: w.t0 + from as f64 * w.ts,
        ts: w.ts,
        op: last(&w.op),
        pv: last(&w.pv),
        sp: w.sp.as_ref().map(last),
        mv: w.mv.as_ref().map(last),
        rows: w.rows.get(from..).unwrap_or_default().to_vec(),
        ..Window::default()
    };
    let (name, mode) = (of.name.clone(), of.mode.as_ref().map(last));
    let (op_limits, raw, silent_s) = (of.op_limits, of.raw, of.silent_s);
    let (sp_known, stem_known) = (of.sp_known.as_ref().map(known), of.stem_known.as_ref().map(known));
    let work = of.work.as_ref().map(|work| work.tail(from));
    let (pv_blurred, op_blurred) = (of.pv_blurred, of.op_blurred);
    PlantLoop {
        name,
        window,
        mode,
        sp_known,
        stem_known,
        silent_s,
        op_limits,
        op_span: of.op_span,
        raw,
        work,
        pv_blurred,
        op_blurred,
        dead_time_s: of.dead_time_s,
        ..PlantLoop::default()
    }
}

#[cfg(test)]
mod tests;
