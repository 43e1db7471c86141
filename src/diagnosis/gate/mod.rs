//! The gate: from a raw record to a window on equal rows, or the reason why there is none.
//!
//! Sorts and de-duplicates each tag, drops what is not good (quality, not finite, drop-outs, not in automatic), asks
//! how the record was acquired ([`super::acquisition`]) and puts the longest stretch on the controller's ticks, else on the
//! polls. What was not measured is missing and does not count: OP and PV are there what the loop makes likeliest
//! ([`crate::sysid::missing`]).

mod clean;
mod refuse;
mod stretches;

use super::acquisition::{self, Acquisition, Answer, Placed};
use super::history_kind::{HistoryKind, recognise};
use super::{NotIdentifiable, Preparation, Settings};
use crate::signal::{Limits, Record, Row, Sample, Window, is_limit};
use crate::sysid::missing::likeliest;
use clean::{Zero, clean, missing_share, shortage};
use refuse::refuse;
use stretches::{Modes, intersect, lasting, longest, runs};

/// Most rows for each sample there is; more would be invented.
const MOST_POINTS: usize = 20;
/// Rows that a slope of OP beside a hole is taken from: an error of the first or the last moves it by a quarter of itself.
const SLOPE: usize = 5;
/// Missing share from which a record that is too short is one with gaps: fewer samples would hardly make it long enough.
const FEW_MISSING: f64 = 0.01;

/// What the gate passes on, or why it does not; the preparation is told either way.
pub type Gated = Result<(Window, Preparation), Box<(NotIdentifiable, Preparation)>>;

/// Makes a window of a record.
///
/// # Errors
/// The reason why the record says nothing about the valve, with what was learned of it on the way.
pub fn gate(record: &Record, settings: &Settings) -> Gated {
    let mut preparation = Preparation { decimation: 1, reading: settings.reading, ..Preparation::default() };
    let op = clean(&record.input(), Zero::DropOut, record.limits(), &mut preparation);
    let pv = clean(&record.pv, Zero::DropOut, None, &mut preparation);
    preparation.history = recognise(&op.kept, &pv.kept).map(Box::new);
    let need = settings.min_samples;
    let stop =
        |reason: NotIdentifiable, preparation: &Preparation| Err(Box::new((reason, preparation.clone())));
    if op.kept.len() < need || pv.kept.len() < need {
        let n = op.kept.len().min(pv.kept.len());
        return stop(shortage(&op, &pv, n, need), &preparation);
    }
    let given = settings.ts.filter(|ts| !(ts.is_finite() && *ts > 0.0));
    let history = preparation.history.as_deref();
    let Some((acquired, mut placed)) =
        acquisition::recognise(&op.kept, &pv.kept, settings.ts, history, settings.reading)
            .filter(|_| given.is_none())
    else {
        return stop(NotIdentifiable::NoTimeBase, &preparation);
    };
    if acquired.recovered && history.is_some_and(|found| found.kind == HistoryKind::Held) {
        // Values held between scans are no archive's doing, and are one sample a scan now.
        preparation.history = None;
    }
    let ts = placed.rows.period;
    preparation.acquisition = Some(Box::new(acquired));
    // A reading that several rows repeat would count as several, unless one fitted row has them all.
    preparation.carried = settings.ts.and_then(|_| placed.coarser_readings(&op.kept, &pv.kept));
    let stretches = match stretches_of(record, &placed, &op.kept, &pv.kept, need) {
        Ok(stretches) => stretches,
        Err(reason) => return stop(reason, &preparation),
    };
    let Some(&(from, to)) = stretches.iter().rev().max_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0))) else {
        let share = 1.0;
        let by_mode = record.mode.is_some();
        let reason =
            if by_mode { NotIdentifiable::Gaps { share } } else { NotIdentifiable::ReadApart { share } };
        return stop(reason, &preparation);
    };
    let rows = placed.row_of(to) - placed.row_of(from) + 1.0;
    let most = (MOST_POINTS * (op.kept.len() + pv.kept.len())) as f64;
    if rows.is_nan() || rows > most {
        return stop(preparation.too_close().unwrap_or(NotIdentifiable::Gaps { share: 1.0 }), &preparation);
    }
    let there = (within(&op.kept, from, to), within(&pv.kept, from, to));
    let (first, rows) = (placed.row_of(from) as i64, rows.max(0.0) as usize);
    let told = answer(record, &placed, there, first, rows);
    (placed.pv_late, placed.of_one_scan) = (told.pv_late, told.of_one_scan);
    let pv_late_s = placed.pv_late as f64 * ts;
    preparation.acquisition = Some(Box::new(Acquisition { pv_late_s, ..acquired }));
    preparation.read_apart = placed.read_apart(there.0, there.1, first, rows);
    let turns = in_turns(&placed, there, first, rows).map(|share| NotIdentifiable::ReadApart { share });
    let mut window = fill(record, &placed, there, first, rows);
    let n = window.len();
    preparation.gap_share = window.missing();
    if n < need {
        let share = missing_share(&pv.kept, ts).max(missing_share(&op.kept, ts)).max(preparation.gap_share);
        let gaps = share > FEW_MISSING;
        let reason =
            if gaps { NotIdentifiable::Gaps { share } } else { NotIdentifiable::TooShort { n, need } };
        return stop(turns.unwrap_or(reason), &preparation);
    }
    preparation.worst_skew = worst_skew(&op.kept, &pv.kept, from, to);
    describe(&window, &mut preparation);
    match refuse(&mut window, record, settings, &preparation) {
        Some(NotIdentifiable::Gaps { share }) => {
            Err(Box::new((turns.unwrap_or(NotIdentifiable::Gaps { share }), preparation)))
        }
        Some(reason) => Err(Box::new((reason, preparation))),
        None => Ok((window, preparation)),
    }
}

/// The share of the rows with a sample that have one of the two tags alone, where OP and PV were read in turns: each is missing
/// where the other is there, in more rows than have both.
fn in_turns(placed: &Placed, (op, pv): (&[Sample], &[Sample]), from: i64, n: usize) -> Option<f64> {
    let (op, pv) = (placed.op(op, from, n), placed.pv(pv, from, n));
    let count = |wanted: (bool, bool)| {
        op.iter().zip(&pv).filter(|(op, pv)| (op.is_some(), pv.is_some()) == wanted).count()
    };
    let (both, op_alone, pv_alone) = (count((true, true)), count((true, false)), count((false, true)));
    let alone = op_alone + pv_alone;
    (op_alone.min(pv_alone) > both).then(|| alone as f64 / (alone + both) as f64)
}

/// The samples from one time to another.
fn within(kept: &[Sample], from: f64, to: f64) -> &[Sample] {
    let begin = kept.partition_point(|s| s.t < from);
    let end = kept.partition_point(|s| s.t <= to);
    &kept[begin..end.max(begin)]
}

/// The stretches in which OP and PV are there and the loop is in automatic (s).
fn stretches_of(
    record: &Record,
    placed: &Placed,
    op: &[Sample],
    pv: &[Sample],
    need: usize,
) -> Result<Vec<(f64, f64)>, NotIdentifiable> {
    let ts = placed.rows.period;
    // A tag polled more slowly than the rows is held in between, not torn into stretches; of changes, either tag's tell
    // that the source was there.
    let own = |series: &[Sample]| acquisition::period(series).unwrap_or(ts).max(ts);
    let mut stretches = if placed.of_changes() {
        let mut both: Vec<Sample> = op.iter().chain(pv).copied().collect();
        both.sort_by(|a, b| a.t.total_cmp(&b.t));
        runs(&both, ts)
    } else {
        intersect(&runs(op, own(op)), &runs(pv, own(pv)))
    };
    if let Some(mode) = &record.mode {
        let modes = Modes::of(mode, ts);
        let automatic = intersect(&stretches, &modes.automatic);
        let least = (need - 1) as f64 * ts;
        if longest(&automatic) < least && longest(&stretches) >= least {
            return Err(not_automatic(&stretches, &modes, least));
        }
        stretches = automatic;
    }
    Ok(stretches)
}

/// Why stretches with OP and PV are not in automatic for long enough (s). Of a mode that cannot be read nobody knows whether it was
/// automatic; but of a loop that is known to be in another mode now, and was for most of the time, that is what is to be told.
fn not_automatic(stretches: &[(f64, f64)], modes: &Modes, least: f64) -> NotIdentifiable {
    let time = lasting(stretches);
    let share = |of: &[(f64, f64)]| lasting(&intersect(stretches, of)) / time;
    let share_auto = share(&modes.automatic);
    let unknown = (1.0 - share_auto - share(&modes.other)).max(0.0);
    let end = stretches.last().map_or(f64::NEG_INFINITY, |last| last.1);
    let ends_in_other = modes.other.iter().any(|own| own.0 <= end && end <= own.1);
    let perhaps = intersect(stretches, &modes.perhaps_automatic());
    if longest(&perhaps) < least || ends_in_other && 2.0 * unknown < 1.0 {
        NotIdentifiable::Manual { share_auto }
    } else {
        NotIdentifiable::ModeUnknown { share: unknown }
    }
}

/// What the controller computed of which PV: OP without what write-back added to it.
fn answer(record: &Record, placed: &Placed, (op, pv): (&[Sample], &[Sample]), from: i64, n: usize) -> Answer {
    let own = |(k, value): (usize, Option<f64>)| {
        value.map(|value| value - record.term_at(placed.rows.time((from + k as i64) as f64)))
    };
    let op: Vec<Option<f64>> = placed.op(op, from, n).into_iter().enumerate().map(own).collect();
    let sp = record.sp.as_deref().and_then(|sp| set_point(sp, placed, from, &vec![false; n]));
    let sp: Option<Vec<Option<f64>>> = sp.map(|values| values.into_iter().map(Some).collect());
    acquisition::answer(&op, &placed.pv(pv, from, n), sp.as_deref())
}

/// The window of `n` rows from row `from` on, without missing rows at its ends.
fn fill(record: &Record, placed: &Placed, (op, pv): (&[Sample], &[Sample]), from: i64, n: usize) -> Window {
    let pv = placed.pv(pv, from, n);
    let op = without_lost_limits(placed.op(op, from, n), &pv, record.op_limits);
    let there = |k: &usize| op[*k].is_some() && pv[*k].is_some();
    let (Some(first), Some(last)) = ((0..n).find(there), (0..n).rfind(there)) else {
        return Window { ts: placed.rows.period, ..Window::default() };
    };
    let missing: Vec<bool> = (first..=last).map(|k| !there(&k)).collect();
    let worth = |missing: &bool| if *missing { Row::Missing } else { Row::Counts };
    let rows = if missing.contains(&true) { missing.iter().map(worth).collect() } else { Vec::new() };
    let n = missing.len();
    let from = from + first as i64;
    let cleaned = |series: &[Sample], zero: Zero, limits: Option<Limits>| {
        clean(series, zero, limits, &mut Preparation::default()).kept
    };
    let on_rows = |kept: &[Sample]| -> Option<Vec<f64>> {
        let end = placed.rows.time((from + n as i64 - 1) as f64);
        let overlaps = kept.first()?.t <= end && kept.last()?.t >= placed.rows.time(from as f64);
        overlaps.then(|| held(&without_drop_outs(placed.other(kept, from, n), &missing)))
    };
    let other = |series: &[Sample]| on_rows(&cleaned(series, Zero::Value, None));
    // A stem that is read more slowly than the rows would stand between its samples, as one that sticks does. Where OP stays at a
    // limit the stem is there, too.
    let as_fast = |kept: &Vec<Sample>| placed.of_changes() || !placed.is_slower(kept);
    let stem = record.mv.as_deref().map(|stem| cleaned(stem, Zero::DropOut, record.limits()));
    let stem = stem.filter(as_fast);
    let sp = record.sp.as_deref().and_then(|sp| set_point(sp, placed, from, &missing));
    let (op, pv) = (&op[first..=last], &pv[first..=last]);
    let [op, pv] = likeliest(op, pv, [carried_on(op), drawn_through(pv)], sp.as_deref());
    Window {
        t0: placed.rows.time(from as f64),
        ts: placed.rows.period,
        op,
        pv,
        sp,
        mv: stem.and_then(|kept| on_rows(&kept)),
        tags: record.tags.iter().filter_map(|(name, s)| Some((name.clone(), other(s)?))).collect(),
        rows,
    }
}

/// OP on rows, without its limits where PV is missing: a link that was lost may have written zero into both, and zero may be a limit.
fn without_lost_limits(
    op: Vec<Option<f64>>,
    pv: &[Option<f64>],
    limits: Option<(f64, f64)>,
) -> Vec<Option<f64>> {
    let known =
        |(op, pv): (Option<f64>, &Option<f64>)| op.filter(|op| pv.is_some() || !is_limit(limits, *op));
    op.into_iter().zip(pv).map(known).collect()
}

/// A tag's values on rows, without zeros where OP or PV is missing: a link that was lost may have written zero into every tag.
fn without_drop_outs(values: Vec<Option<f64>>, missing: &[bool]) -> Vec<Option<f64>> {
    let kept = |(value, missing): (Option<f64>, &bool)| value.filter(|value| *value != 0.0 || !missing);
    values.into_iter().zip(missing).map(kept).collect()
}

/// The set point on the rows from row `from` on, at some of which OP or PV is missing. It holds until something else is known of
/// it, also where it was reported before the window and did not change since; one that could not be read since is not known.
fn set_point(series: &[Sample], placed: &Placed, from: i64, missing: &[bool]) -> Option<Vec<f64>> {
    let n = missing.len();
    let kept = clean(series, Zero::Value, None, &mut Preparation::default()).kept;
    let (begin, end) = (placed.rows.time(from as f64), placed.rows.time((from + n as i64 - 1) as f64));
    let (first, last) = (kept.first()?, kept.last()?);
    let lost = |s: &Sample| !(s.quality.is_good() && s.value.is_finite()) && s.t > last.t && s.t <= end;
    if first.t > end || (last.t < begin && series.iter().any(lost)) {
        return None;
    }
    let before = kept[..kept.partition_point(|s| s.t <= begin)].last().map(|s| s.value);
    Some(held_from(before, &without_drop_outs(placed.other(&kept, from, n), missing)))
}

/// The last known value where one is missing, and the first where none is known yet.
fn held(values: &[Option<f64>]) -> Vec<f64> {
    held_from(None, values)
}

/// The last known value where one is missing, beginning with that of before where there is one.
fn held_from(before: Option<f64>, values: &[Option<f64>]) -> Vec<f64> {
    let mut last = before.or_else(|| values.iter().copied().flatten().next()).unwrap_or(0.0);
    let mut next = |value: &Option<f64>| {
        last = value.unwrap_or(last);
        last
    };
    values.iter().map(&mut next).collect()
}

/// The last known value where one is missing. Through a hole of several OP did not stand still: there it goes on as it came and
/// as it leaves, a cubic with the slopes at both ends, so that a turn inside is not lost to the stem.
fn carried_on(values: &[Option<f64>]) -> Vec<f64> {
    let mut out = held(values);
    let slope = |rows: &mut dyn Iterator<Item = usize>| -> f64 {
        let known: Vec<f64> = rows.map_while(|k| *values.get(k)?).collect();
        let steps = known.len().saturating_sub(1).max(1) as f64;
        known.last().zip(known.first()).map_or(0.0, |(last, first)| (last - first) / steps)
    };
    let mut at = 0;
    for run in values.chunk_by(|a, b| a.is_some() == b.is_some()) {
        let end = at + run.len();
        if run[0].is_none() && run.len() > 1 && at > 0 && end < values.len() {
            let (before, after) = (out[at - 1], out[end]);
            let width = (run.len() + 1) as f64;
            let came = -slope(&mut (at.saturating_sub(SLOPE)..at).rev()) * width;
            let leaves = slope(&mut (end..end + SLOPE)) * width;
            for (i, out) in out[at..end].iter_mut().enumerate() {
                let t = (i + 1) as f64 / width;
                let (s, t2) = (1.0 - t, t * t);
                // Hermite's cubic: values and slopes at 0 and 1.
                *out = s * s * ((1.0 + 2.0 * t) * before + t * came)
                    + t2 * ((1.0 + 2.0 * s) * after - s * leaves);
            }
        }
        at = end;
    }
    out
}

/// A straight line where values are missing: where PV begins to look for its prediction.
fn drawn_through(values: &[Option<f64>]) -> Vec<f64> {
    let mut out = held(values);
    let mut last: Option<usize> = None;
    for (k, value) in values.iter().enumerate() {
        let Some(value) = value else { continue };
        if let Some(from) = last {
            let (before, width) = (out[from], (k - from) as f64);
            for (i, out) in out[from + 1..k].iter_mut().enumerate() {
                *out = before + (value - before) * (i + 1) as f64 / width;
            }
        }
        last = Some(k);
    }
    out
}

/// Notes the window's extent.
pub fn describe(window: &Window, preparation: &mut Preparation) {
    preparation.n = window.len();
    preparation.ts = window.ts;
    preparation.start = window.t0;
    preparation.end = window.t0 + window.len().saturating_sub(1) as f64 * window.ts;
    preparation.missing = window.missing();
}

/// Worst distance between a PV stamp and its nearest OP stamp (s).
fn worst_skew(op: &[Sample], pv: &[Sample], from: f64, to: f64) -> f64 {
    let mut worst = 0.0_f64;
    let mut i = 0;
    for s in pv.iter().filter(|s| s.t >= from && s.t <= to) {
        while i + 1 < op.len() && (op[i + 1].t - s.t).abs() <= (op[i].t - s.t).abs() {
            i += 1;
        }
        worst = worst.max((op[i].t - s.t).abs());
    }
    worst
}

#[cfg(test)]
mod tests;
