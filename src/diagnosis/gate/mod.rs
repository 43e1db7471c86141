//! The gate: from a raw record to a window on equal rows, or the reason why there is none.
//!
//! 1. `clean`: each tag is sorted. Repeated stamps and samples that are no measurements are dropped.
//! 2. [`super::acquisition`]: how the record was acquired. The rows are the controller's ticks where they show, else the polls.
//! 3. `stretches`: one stretch in automatic without a long hole becomes the window: the longest.
//! 4. [`crate::sysid::missing`]: where OP or PV was not measured, both get their likeliest values. Such a row does not count.
//! 5. `refuse`: the rules that refuse a window.

mod clean;
mod refuse;
mod stretches;

use super::acquisition::{self, Acquisition, Answer, Apart, Later, Placed};
use super::history_kind::{HistoryKind, recognise_beside};
use super::lines::Lines;
use super::not_identifiable::NotIdentifiable;
use super::preparation::Preparation;
use super::settings::Settings;
use crate::signal::{Limits, Record, Row, Sample, Window, is_limit};
use crate::sysid::missing::likeliest;
use clean::{Zero, clean, missing_share, shortage};
use refuse::refuse;
use stretches::{Modes, intersect, lasting, longest, longest_of, runs};

/// Most rows for each sample: more would not be measured.
const MOST_POINTS: usize = 20;
/// Number of rows from which the slope of OP beside a hole is taken: an error of the first or the last moves it by a quarter of
/// itself.
const SLOPE: usize = 5;
/// Share of missing samples above which the reason for too few rows is gaps, and not that the record is too short: fewer missing
/// samples would hardly make it long enough.
const FEW_MISSING: f64 = 0.01;

/// The window and its preparation, or the reason why there is no window, with the preparation so far.
pub type Gated = Result<(Window, Preparation), Box<(NotIdentifiable, Preparation)>>;

/// Makes a window of a record: equal rows, each with OP and PV.
///
/// # Errors
/// The reason why the record says nothing about the valve, and the preparation so far.
pub fn gate(record: &Record, settings: &Settings) -> Gated {
    let mut preparation = Preparation { decimation: 1, reading: settings.reading, ..Preparation::default() };
    let op = clean(&record.input(), Zero::DropOut, record.limits(), &mut preparation);
    let pv = clean(&record.pv, Zero::DropOut, None, &mut preparation);
    let without_term = |s: &Sample| Sample { value: s.value - record.term_at(s.t), ..*s };
    let by_controller: Vec<Sample> = op.kept.iter().map(without_term).collect();
    preparation.history = recognise_beside(&by_controller, &pv.kept, record.sp.as_deref()).map(Box::new);
    let need = settings.min_samples;
    let stop =
        |reason: NotIdentifiable, preparation: &Preparation| Err(Box::new((reason, preparation.clone())));
    if op.kept.len() < need || pv.kept.len() < need {
        let n = op.kept.len().min(pv.kept.len());
        return stop(shortage(&op, &pv, n, need), &preparation);
    }
    let unusable_ts = settings.ts.filter(|ts| !(ts.is_finite() && *ts > 0.0));
    let history = preparation.history.as_deref();
    let Some((acquired, mut placed)) =
        acquisition::recognise(&op.kept, &pv.kept, settings.ts, history, settings.reading)
            .filter(|_| unusable_ts.is_none())
    else {
        return stop(NotIdentifiable::NoTimeBase, &preparation);
    };
    if acquired.recovered && history.is_some_and(|found| found.kind == HistoryKind::Held) {
        // The controller held these values between its scans, not an archive. On its ticks they are one sample for each scan.
        preparation.history = None;
    }
    let ts = placed.rows.period;
    preparation.acquisition = Some(Box::new(acquired));
    // A measurement that several rows repeat would count several times.
    preparation.carried = settings.ts.and_then(|_| placed.coarser_readings(&op.kept, &pv.kept));
    let (from, to) = match stretch_of_window(record, &placed, (&op.kept, &pv.kept), settings) {
        Ok(stretch) => stretch,
        Err(reason) => return stop(preparation.by_archive(reason), &preparation),
    };
    let drawn = preparation.is_drawn().then(|| (measured(&op.kept), measured(&pv.kept)));
    let (op_kept, pv_kept) =
        drawn.as_ref().map_or((&op.kept[..], &pv.kept[..]), |drawn| (&drawn.0[..], &drawn.1[..]));
    let (from, to) = if drawn.is_some() { known((from, to), op_kept, pv_kept, ts) } else { (from, to) };
    let rows = placed.row_of(to) - placed.row_of(from) + 1.0;
    let most = (MOST_POINTS * (op.kept.len() + pv.kept.len())) as f64;
    if rows.is_nan() || rows > most {
        return stop(preparation.too_close().unwrap_or(NotIdentifiable::Gaps { share: 1.0 }), &preparation);
    }
    let there = (within(op_kept, from, to), within(pv_kept, from, to));
    let (first, rows) = (placed.row_of(from) as i64, rows.max(0.0) as usize);
    let turns = in_turns(&placed, there, first, rows).map(|share| NotIdentifiable::ReadApart { share });
    // Where the two were read in turns, a move of PV brings values of different times together.
    let (answered, later) =
        if turns.is_none() { answer(record, &placed, there, first, rows) } else { Default::default() };
    (placed.pv_late, placed.of_one_scan) = (answered.pv_late, answered.of_one_scan);
    let pv_late_s = placed.pv_late as f64 * ts;
    preparation.acquisition = Some(Box::new(Acquisition { pv_late_s, ..acquired }));
    preparation.read_apart = Apart { later, ..placed.read_apart(there.0, there.1, first, rows) };
    let mut window = fill(record, &placed, there, first, rows);
    let n = window.len();
    preparation.gap_share = window.missing();
    if n < need {
        let share = missing_share(pv_kept, ts).max(missing_share(op_kept, ts)).max(preparation.gap_share);
        let gaps = share > FEW_MISSING;
        let reason =
            if gaps { NotIdentifiable::Gaps { share } } else { NotIdentifiable::TooShort { n, need } };
        return stop(preparation.by_archive(turns.unwrap_or(reason)), &preparation);
    }
    preparation.worst_skew = worst_skew(&op.kept, &pv.kept, from, to);
    describe(&window, &mut preparation);
    match refuse(&mut window, record, settings, &preparation) {
        Some(NotIdentifiable::Gaps { share }) => {
            let reason = preparation.by_archive(turns.unwrap_or(NotIdentifiable::Gaps { share }));
            Err(Box::new((reason, preparation)))
        }
        Some(reason) => Err(Box::new((reason, preparation))),
        None => Ok((window, preparation)),
    }
}

/// The stretch that becomes the window (s), or the reason why there is none.
fn stretch_of_window(
    record: &Record,
    placed: &Placed,
    (op, pv): (&[Sample], &[Sample]),
    settings: &Settings,
) -> Result<(f64, f64), NotIdentifiable> {
    let stretches = stretches_of(record, placed, op, pv, settings.min_samples)?;
    longest_of(&stretches).ok_or_else(|| {
        let share = 1.0;
        let by_mode = record.mode.is_some();
        if by_mode { NotIdentifiable::Gaps { share } } else { NotIdentifiable::ReadApart { share } }
    })
}

/// The samples of a tag that were measured: the ends of the lines that an archive drew, or all where it drew none.
fn measured(kept: &[Sample]) -> Vec<Sample> {
    let lines = Lines::of(kept).filter(Lines::look_drawn);
    lines.map_or_else(|| kept.to_vec(), |lines| lines.measured(kept))
}

/// The longest part of a stretch without a long hole between the measured samples of OP and of PV (s); its begin where there is none.
fn known(stretch: (f64, f64), op: &[Sample], pv: &[Sample], ts: f64) -> (f64, f64) {
    let both = intersect(&runs(op, ts), &runs(pv, ts));
    longest_of(&intersect(&[stretch], &both)).unwrap_or((stretch.0, stretch.0))
}

/// The share of rows with only one of OP and PV, among the rows with a sample, where the two were read in turns; else `None`.
///
/// They were read in turns where each is alone in more rows than have both.
fn in_turns(placed: &Placed, (op, pv): (&[Sample], &[Sample]), from: i64, n: usize) -> Option<f64> {
    let (op, pv) = (placed.op(op, from, n), placed.pv(pv, from, n));
    let count = |wanted: (bool, bool)| {
        op.iter().zip(&pv).filter(|(op, pv)| (op.is_some(), pv.is_some()) == wanted).count()
    };
    let (both, op_alone, pv_alone) = (count((true, true)), count((true, false)), count((false, true)));
    let alone = op_alone + pv_alone;
    (op_alone.min(pv_alone) > both).then(|| alone as f64 / (alone + both) as f64)
}

/// The samples from one time to another (s).
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
    // A tag that is polled more slowly than the rows is held in between, so its own period decides what a hole is. Where only
    // changes are reported, a sample of either tag shows that the source was there.
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

/// The reason where no stretch with OP and PV is known to be in automatic for `least` seconds.
///
/// It is an unknown mode where the loop may have been in automatic for long enough while its mode could not be read. But where the
/// loop is known to be in another mode at the end, and the mode was known for most of the time, it is that mode.
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

/// From which PV the controller computed OP ([`acquisition::answer`]), on the rows, and whether OP answers a later PV once PV is moved
/// back by that. OP is taken without the term of write-back.
fn answer(
    record: &Record,
    placed: &Placed,
    (op, pv): (&[Sample], &[Sample]),
    from: i64,
    n: usize,
) -> (Answer, Later) {
    let own = |(k, value): (usize, Option<f64>)| {
        value.map(|value| value - record.term_at(placed.rows.time((from + k as i64) as f64)))
    };
    let op: Vec<Option<f64>> = placed.op(op, from, n).into_iter().enumerate().map(own).collect();
    let sp = record.sp.as_deref().and_then(|sp| set_point(sp, placed, from, &vec![false; n]));
    let sp: Option<Vec<Option<f64>>> = sp.map(|values| values.into_iter().map(Some).collect());
    let pv = placed.pv(pv, from, n);
    let found = acquisition::answer(&op, &pv, sp.as_deref());
    let moved = found.pv_late.min(n);
    (found, Later::of(&op, &pv[moved..], sp.as_deref()))
}

/// The window of `n` rows from row `from` on, without the missing rows at its ends.
///
/// Where OP or PV is missing inside, both have the likeliest values ([`likeliest`]), and the row does not count.
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
    // A stem that is read more slowly than the rows is left out: between its samples it would stand still, as one that sticks does.
    // Its values at the limits of OP are kept, because a stem may be there.
    let as_fast = |kept: &Vec<Sample>| placed.of_changes() || !placed.is_slower(kept);
    let stem = record.mv.as_deref().map(|stem| cleaned(stem, Zero::DropOut, record.limits()));
    let stem = stem.filter(as_fast);
    let sp = record.sp.as_deref().and_then(|sp| set_point(sp, placed, from, &missing));
    let (op, pv) = (&op[first..=last], &pv[first..=last]);
    let [op, pv] = likeliest(op, pv, [filled_by_cubic(op), filled_by_line(pv)], sp.as_deref());
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

/// OP on rows, without values at its limits where PV is missing: a lost link may write zero into both, and zero may be a limit.
fn without_lost_limits(
    op: Vec<Option<f64>>,
    pv: &[Option<f64>],
    limits: Option<(f64, f64)>,
) -> Vec<Option<f64>> {
    let known =
        |(op, pv): (Option<f64>, &Option<f64>)| op.filter(|op| pv.is_some() || !is_limit(limits, *op));
    op.into_iter().zip(pv).map(known).collect()
}

/// A tag's values on rows, without zeros where OP or PV is missing: a lost link may write zero into every tag.
fn without_drop_outs(values: Vec<Option<f64>>, missing: &[bool]) -> Vec<Option<f64>> {
    let kept = |(value, missing): (Option<f64>, &bool)| value.filter(|value| *value != 0.0 || !missing);
    values.into_iter().zip(missing).map(kept).collect()
}

/// The set point on the rows from row `from` on; `missing` says where OP or PV is missing.
///
/// It holds until its next sample, also where its last sample is before the window. `None` where it could not be read since then.
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

/// The last value where one is missing, and the first one before it.
fn held(values: &[Option<f64>]) -> Vec<f64> {
    held_from(None, values)
}

/// The last value where one is missing; `before`: the value before the first row, where it is known.
fn held_from(before: Option<f64>, values: &[Option<f64>]) -> Vec<f64> {
    let mut last = before.or_else(|| values.iter().copied().flatten().next()).unwrap_or(0.0);
    let mut next = |value: &Option<f64>| {
        last = value.unwrap_or(last);
        last
    };
    values.iter().map(&mut next).collect()
}

/// The last value where one row is missing, and a cubic through a hole of several rows, with the slopes at both of its ends.
///
/// OP did not stand still through such a hole. With the cubic the stem does not miss a turn of OP inside.
fn filled_by_cubic(values: &[Option<f64>]) -> Vec<f64> {
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
                // The cubic of Hermite, by the values and the slopes at both ends.
                *out = s * s * ((1.0 + 2.0 * t) * before + t * came)
                    + t2 * ((1.0 + 2.0 * s) * after - s * leaves);
            }
        }
        at = end;
    }
    out
}

/// A straight line where values are missing: the first guess of PV.
fn filled_by_line(values: &[Option<f64>]) -> Vec<f64> {
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

/// Notes the extent of the window.
pub fn describe(window: &Window, preparation: &mut Preparation) {
    preparation.n = window.len();
    preparation.ts = window.ts;
    preparation.start = window.t0;
    preparation.end = window.t0 + window.len().saturating_sub(1) as f64 * window.ts;
    preparation.missing = window.missing();
}

/// The largest distance between the stamp of a PV sample and the nearest stamp of OP (s).
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
