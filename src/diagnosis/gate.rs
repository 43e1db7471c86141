//! The gate: from a raw record to a window on an equal grid, or the reason why there is none.
//!
//! Sorts and de-duplicates each tag, drops what is not good (quality, not finite, drop-outs to 0, not in
//! automatic), finds the stretches where OP and PV are both there without a long hole, resamples the longest
//! by linear interpolation between neighbouring good samples, and refuses what says nothing about a valve.

use super::history_kind::recognise;
use super::{NotIdentifiable, Preparation, Settings};
use crate::signal::{Quality, Record, Sample, Window};
use crate::sysid::stats::{mean, median, quantile, range};

/// A hole of more than this many sample periods ends a stretch.
const LONGEST_HOLE: f64 = 6.0;
/// A bracket wider than this many sample periods means that a sample is missing there.
const MISSING: f64 = 1.6;
/// Values beyond this are no measurement and would overflow the sums.
const LARGEST_VALUE: f64 = 1e30;
/// Share of samples at an OP limit above which the valve is not being moved.
const SATURATED_SHARE: f64 = 0.3;
/// Share of the window that one unchanging PV value may cover.
const FROZEN_SHARE: f64 = 0.5;
/// Most points of the equal grid for each sample there is; more would be invented.
const MOST_POINTS: usize = 20;

/// What the gate passes on, or why it does not; the preparation is told either way.
pub type Gated = Result<(Window, Preparation), (NotIdentifiable, Preparation)>;

/// Makes a window of a record.
///
/// # Errors
/// The reason why the record says nothing about the valve, with what was learned of it on the way.
pub fn gate(record: &Record, settings: &Settings) -> Gated {
    let mut preparation = Preparation { decimation: 1, ..Preparation::default() };
    let op = clean(&record.op, &mut preparation);
    let pv = clean(&record.pv, &mut preparation);
    preparation.history = recognise(&op.kept, &pv.kept).map(Box::new);
    let need = settings.min_samples;
    let stop = |reason: NotIdentifiable, preparation: &Preparation| Err((reason, preparation.clone()));
    if op.kept.len() < need || pv.kept.len() < need {
        let n = op.kept.len().min(pv.kept.len());
        return stop(shortage(&op, &pv, n, need), &preparation);
    }
    let Some(ts) = settings.ts.or_else(|| sample_period(&pv.kept)) else {
        return stop(NotIdentifiable::NoTimeBase, &preparation);
    };
    if !(ts.is_finite() && ts > 0.0) {
        return stop(NotIdentifiable::NoTimeBase, &preparation);
    }
    // A tag polled more slowly than the grid is held in between, not torn into stretches.
    let op_ts = sample_period(&op.kept).unwrap_or(ts).max(ts);
    let mut stretches = intersect(&runs(&op.kept, op_ts), &runs(&pv.kept, ts));
    let longest_of = |stretches: &[(f64, f64)]| stretches.iter().map(|s| s.1 - s.0).fold(0.0, f64::max);
    let unbroken = longest_of(&stretches);
    if let Some(mode) = &record.mode {
        let (auto, share_auto) = automatic(mode, ts);
        stretches = intersect(&stretches, &auto);
        if longest_of(&stretches) < (need - 1) as f64 * ts && unbroken >= (need - 1) as f64 * ts {
            return stop(NotIdentifiable::Manual { share_auto }, &preparation);
        }
    }
    let Some(&(from, to)) = stretches.iter().rev().max_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0))) else {
        return stop(NotIdentifiable::Gaps { share: 1.0 }, &preparation);
    };
    let points = ((to - from) / ts * (1.0 + 1e-9)).floor();
    if points > (MOST_POINTS * (op.kept.len() + pv.kept.len())) as f64 {
        return stop(NotIdentifiable::Gaps { share: 1.0 }, &preparation);
    }
    let n = points as usize + 1;
    if n < need {
        let share = missing_share(&pv.kept, ts).max(missing_share(&op.kept, op_ts));
        let reason = if share > 0.01 {
            NotIdentifiable::Gaps { share }
        } else {
            NotIdentifiable::TooShort { n, need }
        };
        return stop(reason, &preparation);
    }
    let (op_grid, op_missing) = resample(&op.kept, from, ts, n, op_ts);
    let (pv_grid, pv_missing) = resample(&pv.kept, from, ts, n, ts);
    let missing = op_missing.iter().zip(&pv_missing).filter(|(a, b)| **a || **b).count();
    preparation.gap_share = missing as f64 / n as f64;
    preparation.worst_skew = worst_skew(&op.kept, &pv.kept, from, to);
    let other = |series: &Option<Vec<Sample>>| -> Option<Vec<f64>> {
        series.as_ref().and_then(|s| covering(s, from, ts, n))
    };
    let window = Window {
        t0: from,
        ts,
        op: op_grid,
        pv: pv_grid,
        sp: other(&record.sp),
        mv: other(&record.mv),
        tags: record
            .tags
            .iter()
            .filter_map(|(name, s)| Some((name.clone(), covering(s, from, ts, n)?)))
            .collect(),
    };
    describe(&window, &mut preparation);
    match refuse(&window, record, settings, &preparation) {
        Some(reason) => Err((reason, preparation)),
        None => Ok((window, preparation)),
    }
}

/// Notes the window's extent.
pub fn describe(window: &Window, preparation: &mut Preparation) {
    preparation.n = window.len();
    preparation.ts = window.ts;
    preparation.start = window.t0;
    preparation.end = window.t0 + window.len().saturating_sub(1) as f64 * window.ts;
}

/// What disqualifies an otherwise complete window.
fn refuse(w: &Window, record: &Record, settings: &Settings, p: &Preparation) -> Option<NotIdentifiable> {
    if p.gap_share > settings.max_gap_share {
        return Some(NotIdentifiable::Gaps { share: p.gap_share });
    }
    let share = saturated_share(&w.op, record.op_limits);
    let saturated = NotIdentifiable::Saturated { share };
    // At a limit all the time OP is flat too; that it is at its stop says more.
    if is_flat(&w.op) {
        let at_limit = record.op_limits.is_some() && share > SATURATED_SHARE;
        return Some(if at_limit { saturated } else { NotIdentifiable::FlatOp });
    }
    if is_flat(&w.pv) || longest_constant_run(&w.pv) as f64 > FROZEN_SHARE * w.len() as f64 {
        return Some(NotIdentifiable::FlatPv);
    }
    (share > SATURATED_SHARE).then_some(saturated)
}

/// One tag's good samples in order of time.
struct Clean {
    kept: Vec<Sample>,
    /// Before those with the same stamp were taken for one.
    good: usize,
    offered: usize,
    stale: usize,
    too_large: usize,
}

/// Sorts, de-duplicates and drops what is not good.
fn clean(series: &[Sample], preparation: &mut Preparation) -> Clean {
    let usable = |s: &&Sample| {
        s.quality.is_good() && s.t.is_finite() && s.value.is_finite() && s.value.abs() <= LARGEST_VALUE
    };
    let mut kept: Vec<Sample> = series.iter().filter(usable).copied().collect();
    let disorder = kept.windows(2).filter(|w| w[1].t < w[0].t).count();
    if disorder > 0 {
        kept.sort_by(|a, b| a.t.total_cmp(&b.t));
    }
    let before = kept.len();
    kept.dedup_by(|later, earlier| later.t == earlier.t);
    preparation.out_of_order += disorder;
    preparation.duplicates += before - kept.len();
    drop_zero_runs(&mut kept);
    Clean {
        kept,
        good: before,
        offered: series.len(),
        stale: series.iter().filter(|s| s.quality == Quality::Stale).count(),
        too_large: series.iter().filter(|s| s.value.abs() > LARGEST_VALUE).count(),
    }
}

fn drop_zero_runs(kept: &mut Vec<Sample>) {
    if zeros_are_outages(kept) {
        kept.retain(|s| s.value != 0.0);
    }
}

/// Whether exact zeros among good samples are no measurements: the tag otherwise lives far away from zero, so that a
/// transmitter or a link was off.
pub fn zeros_are_outages(samples: &[Sample]) -> bool {
    let zeros = samples.iter().filter(|s| s.value == 0.0).count();
    if zeros == 0 || zeros * 2 > samples.len() {
        return false;
    }
    let others: Vec<f64> = samples.iter().filter(|s| s.value != 0.0).map(|s| s.value).collect();
    let (low, high) = (quantile(&others, 0.02), quantile(&others, 0.98));
    let spread = high - low;
    low > spread || high < -spread
}

/// The share of the samples that a period of `ts` asks for and that are not there.
fn missing_share(kept: &[Sample], ts: f64) -> f64 {
    let (Some(first), Some(last)) = (kept.first(), kept.last()) else { return 1.0 };
    let asked = (last.t - first.t) / ts + 1.0;
    (1.0 - kept.len() as f64 / asked).clamp(0.0, 1.0)
}

/// Why too few good samples are left.
fn shortage(op: &Clean, pv: &Clean, n: usize, need: usize) -> NotIdentifiable {
    let worst = if op.kept.len() < pv.kept.len() { op } else { pv };
    if worst.offered < need {
        return NotIdentifiable::TooShort { n, need };
    }
    if pv.stale * 2 > pv.offered {
        return NotIdentifiable::FlatPv;
    }
    if worst.too_large * 2 > worst.offered {
        return NotIdentifiable::OutOfScale;
    }
    // Good samples whose stamps all coincide leave one after de-duplication.
    if worst.kept.len() <= 1 && worst.good * 2 > worst.offered {
        return NotIdentifiable::NoTimeBase;
    }
    NotIdentifiable::Gaps { share: 1.0 - worst.kept.len() as f64 / worst.offered as f64 }
}

/// The sampling period: the mean of the steps near the median step (s).
fn sample_period(kept: &[Sample]) -> Option<f64> {
    let steps: Vec<f64> = kept.windows(2).map(|w| w[1].t - w[0].t).filter(|d| *d > 0.0).collect();
    if steps.is_empty() {
        return None;
    }
    let middle = median(&steps);
    let near: Vec<f64> = steps.into_iter().filter(|d| (d - middle).abs() <= 0.5 * middle).collect();
    let ts = mean(&near);
    // Equal stamps keep their exact period; the mean of many differs from it by rounding.
    let ts = if (ts - middle).abs() <= 1e-6 * middle { middle } else { ts };
    (ts.is_finite() && ts > 0.0).then_some(ts)
}

/// Stretches `[from, to]` of samples without a long hole (s).
fn runs(kept: &[Sample], ts: f64) -> Vec<(f64, f64)> {
    let mut found: Vec<(f64, f64)> = Vec::new();
    for s in kept {
        match found.last_mut() {
            Some(last) if s.t - last.1 <= LONGEST_HOLE * ts => last.1 = s.t,
            _ => found.push((s.t, s.t)),
        }
    }
    found
}

/// Stretches in automatic, and the share of samples in automatic. A change of mode takes effect at its stamp; a mode that
/// cannot be read is the last known one for no longer than a hole may be.
fn automatic(mode: &[Sample], ts: f64) -> (Vec<(f64, f64)>, f64) {
    let mut samples: Vec<Sample> = mode.iter().filter(|s| s.t.is_finite()).copied().collect();
    samples.sort_by(|a, b| a.t.total_cmp(&b.t));
    let known = |s: &Sample| s.quality.is_good() && s.value.is_finite();
    let mut found = Vec::new();
    let mut open: Option<f64> = None;
    let mut lost: Option<f64> = None;
    for s in &samples {
        if !known(s) {
            lost.get_or_insert(s.t);
        }
        let overdue = lost.filter(|since| s.t - since > LONGEST_HOLE * ts);
        let until = if known(s) && s.value < 0.5 { Some(overdue.unwrap_or(s.t)) } else { overdue };
        if let (Some(from), Some(until)) = (open, until) {
            found.push((from, until - 1e-3 * ts));
            open = None;
        }
        if known(s) {
            lost = None;
            if s.value >= 0.5 {
                open = open.or(Some(s.t));
            }
        }
    }
    if let Some(from) = open {
        // The last known mode holds until something else is known.
        found.push((from, f64::INFINITY));
    }
    let in_automatic = samples.iter().filter(|s| known(s) && s.value >= 0.5).count();
    (found, in_automatic as f64 / samples.len().max(1) as f64)
}

/// The overlaps of two ordered lists of stretches.
fn intersect(a: &[(f64, f64)], b: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let (mut i, mut j) = (0, 0);
    let mut found = Vec::new();
    while i < a.len() && j < b.len() {
        let (from, to) = (a[i].0.max(b[j].0), a[i].1.min(b[j].1));
        if from <= to {
            found.push((from, to));
        }
        if a[i].1 < b[j].1 { i += 1 } else { j += 1 }
    }
    found
}

/// Linear interpolation on the grid `from + k ts`, and where a sample of a tag with period `own_ts` is missing.
fn resample(kept: &[Sample], from: f64, ts: f64, n: usize, own_ts: f64) -> (Vec<f64>, Vec<bool>) {
    let mut values = Vec::with_capacity(n);
    let mut missing = Vec::with_capacity(n);
    let mut i = kept.partition_point(|s| s.t < from).saturating_sub(1);
    for k in 0..n {
        let t = from + k as f64 * ts;
        while i + 1 < kept.len() && kept[i + 1].t <= t {
            i += 1;
        }
        let (a, b) = (kept[i], kept[(i + 1).min(kept.len() - 1)]);
        let width = b.t - a.t;
        let part = if width > 0.0 { ((t - a.t) / width).clamp(0.0, 1.0) } else { 0.0 };
        // Stamps off the grid by rounding alone must give the recorded value itself.
        let part = if part < 1e-6 {
            0.0
        } else if part > 1.0 - 1e-6 {
            1.0
        } else {
            part
        };
        values.push(a.value + part * (b.value - a.value));
        missing.push(width > MISSING * own_ts && part != 0.0 && part != 1.0);
    }
    (values, missing)
}

/// A further tag on the grid, or `None` when it has no good sample over the window.
fn covering(series: &[Sample], from: f64, ts: f64, n: usize) -> Option<Vec<f64>> {
    let kept = clean(series, &mut Preparation::default()).kept;
    let end = from + (n - 1) as f64 * ts;
    let overlaps = kept.first()?.t <= end && kept.last()?.t >= from;
    overlaps.then(|| resample(&kept, from, ts, n, ts).0)
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

/// True when the values differ by no more than rounding.
fn is_flat(v: &[f64]) -> bool {
    let (low, high) = range(v);
    high - low <= 1e-9 * low.abs().max(high.abs())
}

/// Length of the longest run of one unchanging value.
fn longest_constant_run(v: &[f64]) -> usize {
    v.chunk_by(|a, b| a == b).map(<[f64]>::len).max().unwrap_or(0)
}

/// Share of samples at an output limit: the given limits, or else flat stretches at the record's own extremes.
fn saturated_share(op: &[f64], limits: Option<(f64, f64)>) -> f64 {
    let n = op.len().max(1) as f64;
    if let Some((low, high)) = limits {
        let margin = 1e-3 * (high - low).abs();
        return op.iter().filter(|u| **u <= low + margin || **u >= high - margin).count() as f64 / n;
    }
    let (low, high) = range(op);
    let margin = 1e-6 * (high - low);
    let at = |u: f64| u <= low + margin || u >= high - margin;
    // A coarse recording resolution repeats its extremes too, but not for five samples on end.
    let held = op.chunk_by(|a, b| at(*a) && at(*b) && (a - b).abs() <= margin).map(<[f64]>::len);
    held.filter(|len| *len >= 5).sum::<usize>() as f64 / n
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::BadReason;

    fn wave(n: usize, ts: f64) -> Record {
        let at = |k: usize, phase: f64| Sample::good(k as f64 * ts, 50.0 + (k as f64 * 0.2 + phase).sin());
        Record {
            op: (0..n).map(|k| at(k, 0.0)).collect(),
            pv: (0..n).map(|k| at(k, 1.0)).collect(),
            ..Record::default()
        }
    }

    fn reason(record: &Record) -> NotIdentifiable {
        gate(record, &Settings::default()).expect_err("refused").0
    }

    #[test]
    fn a_clean_record_passes_unchanged() {
        let record = wave(300, 2.0);
        let (w, p) = gate(&record, &Settings::default()).expect("passes");
        assert_eq!((w.ts, w.len(), p.gap_share, p.worst_skew), (2.0, 300, 0.0, 0.0));
        assert!(w.op.iter().zip(&record.op).all(|(a, s)| *a == s.value));
    }

    #[test]
    fn order_and_duplicates_are_repaired_and_counted() {
        let record = wave(300, 1.0);
        let mut shuffled = record.clone();
        shuffled.op.swap(10, 11);
        shuffled.pv.push(record.pv[299]);
        let (w, p) = gate(&shuffled, &Settings::default()).expect("passes");
        assert_eq!((p.out_of_order, p.duplicates), (1, 1));
        assert_eq!(w, gate(&record, &Settings::default()).expect("passes").0);
    }

    #[test]
    fn jitter_and_skew_are_resampled_and_reported() {
        let mut record = wave(300, 1.0);
        for (k, s) in record.op.iter_mut().enumerate() {
            s.t += 0.4 + 0.05 * (k as f64).sin();
            s.value = 50.0 + (s.t * 0.2).sin();
        }
        let (w, p) = gate(&record, &Settings::default()).expect("passes");
        assert!((p.worst_skew - 0.45).abs() < 0.01, "{}", p.worst_skew);
        // Linear interpolation of a sine of 0.2 rad a sample errs by at most 0.2²/8.
        for (k, u) in w.op.iter().enumerate() {
            assert!((u - (50.0 + ((w.t0 + k as f64) * 0.2).sin())).abs() < 0.006);
        }
    }

    #[test]
    fn small_holes_are_filled_and_many_are_refused() {
        let mut record = wave(400, 1.0);
        for k in (20..380).step_by(10) {
            record.pv[k].quality = Quality::Bad(BadReason::Timeout);
        }
        let (_, p) = gate(&record, &Settings::default()).expect("passes");
        assert!((p.gap_share - 36.0 / 400.0).abs() < 1e-12);
        for k in (20..380).step_by(3) {
            record.pv[k].quality = Quality::Bad(BadReason::Timeout);
        }
        assert!(matches!(reason(&record), NotIdentifiable::Gaps { .. }));
    }

    #[test]
    fn a_long_hole_leaves_the_longer_side() {
        let mut record = wave(700, 1.0);
        record.op.drain(300..350);
        let (w, _) = gate(&record, &Settings::default()).expect("passes");
        assert_eq!((w.t0, w.len()), (350.0, 350));
    }

    #[test]
    fn drop_outs_to_zero_are_not_measurements() {
        let mut record = wave(500, 1.0);
        for s in &mut record.pv[100..103] {
            s.value = 0.0;
        }
        let (w, p) = gate(&record, &Settings::default()).expect("passes");
        assert!(w.pv.iter().all(|v| *v > 40.0));
        assert!((p.gap_share - 3.0 / 500.0).abs() < 1e-12);
    }

    #[test]
    fn every_reason_is_reached() {
        let record = wave(300, 1.0);
        let settings = |change: &dyn Fn(&mut Record)| {
            let mut r = record.clone();
            change(&mut r);
            reason(&r)
        };
        assert_eq!(reason(&wave(50, 1.0)), NotIdentifiable::TooShort { n: 50, need: 200 });
        assert_eq!(reason(&Record::default()), NotIdentifiable::TooShort { n: 0, need: 200 });
        let flat = |series: &mut Vec<Sample>| series.iter_mut().for_each(|s| s.value = 7.0);
        assert_eq!(settings(&|r| flat(&mut r.op)), NotIdentifiable::FlatOp);
        assert_eq!(settings(&|r| flat(&mut r.pv)), NotIdentifiable::FlatPv);
        assert_eq!(settings(&|r| r.pv.iter_mut().for_each(|s| s.t = 5.0)), NotIdentifiable::NoTimeBase);
        assert_eq!(settings(&|r| r.pv.iter_mut().for_each(|s| s.value = 1e308)), NotIdentifiable::OutOfScale);
        assert_eq!(
            settings(&|r| r.pv.iter_mut().for_each(|s| s.quality = Quality::Stale)),
            NotIdentifiable::FlatPv
        );
        let top = |r: &mut Record| r.op.iter_mut().for_each(|s| s.value = s.value.min(50.3));
        assert!(matches!(settings(&top), NotIdentifiable::Saturated { share } if share > 0.3));
        let manual = |r: &mut Record| {
            r.mode = Some(r.op.iter().map(|s| Sample::good(s.t, f64::from(u8::from(s.t < 60.0)))).collect());
        };
        assert!(
            matches!(settings(&manual), NotIdentifiable::Manual { share_auto } if (share_auto - 0.2).abs() < 1e-9)
        );
    }

    #[test]
    fn a_valve_at_its_stop_is_saturated_and_not_merely_flat() {
        let mut record = wave(300, 1.0);
        record.op.iter_mut().for_each(|s| s.value = 100.0);
        record.op_limits = Some((0.0, 100.0));
        assert_eq!(reason(&record), NotIdentifiable::Saturated { share: 1.0 });
        record.op_limits = Some((0.0, 120.0));
        assert_eq!(reason(&record), NotIdentifiable::FlatOp);
    }

    #[test]
    fn a_mode_that_is_lost_for_a_moment_cuts_no_stretch() {
        let unknown = |at: &[usize]| {
            let mut record = wave(600, 1.0);
            let mut mode: Vec<Sample> = record.op.iter().map(|s| Sample::good(s.t, 1.0)).collect();
            for &k in at {
                mode[k] = Sample { value: f64::NAN, quality: Quality::Bad(BadReason::Timeout), ..mode[k] };
            }
            record.mode = Some(mode);
            record
        };
        // One poll in fifty without an answer, as OP and PV may be.
        let lost: Vec<usize> = (25..600).step_by(50).collect();
        assert_eq!(gate(&unknown(&lost), &Settings::default()).expect("passes").0.len(), 600);
        // Unknown for longer than a hole may be, it is no longer known to be automatic.
        let lost: Vec<usize> = (300..310).collect();
        let (w, _) = gate(&unknown(&lost), &Settings::default()).expect("passes");
        assert_eq!((w.t0, w.len()), (0.0, 300));
        let lost: Vec<usize> = (300..600).collect();
        assert_eq!(gate(&unknown(&lost), &Settings::default()).expect("passes").0.len(), 300);
    }

    #[test]
    fn one_stamp_far_away_does_not_make_a_huge_grid() {
        let mut record = wave(300, 1.0);
        record.op.push(Sample::good(1e18, 1.0));
        record.pv.push(Sample::good(1e18, 1.0));
        assert_eq!(gate(&record, &Settings::default()).expect("passes").0.len(), 300);
    }
}
