//! How late PV is recorded, over drawn and measured loops: by as many rows as it is, or nothing is told.

#[path = "common/acquired.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod acquired;
#[path = "common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "common/measured.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod measured;
#[path = "common/parallel.rs"]
mod parallel;

use acquired::{draw, judge};
use measured::FOLDER;
use std::path::Path;
use stictiond_numerics::diagnosis::{Settings, gate};
use stictiond_numerics::signal::{Record, Sample};

/// Loops drawn; the first seeds of those that the method was developed on.
const LOOPS: u64 = 60;
const FIRST: u64 = 6100;

/// The record with each PV stamped so many rows later.
fn later(record: &Record, rows: usize) -> Record {
    let moved = |series: &[Sample]| -> Vec<Sample> {
        series.iter().zip(series.iter().skip(rows)).map(|(own, then)| Sample { t: then.t, ..*own }).collect()
    };
    Record { pv: moved(&record.pv), ..record.clone() }
}

/// The record with PV that is recorded ever later, by so many rows at its end: held from row to row, or interpolated.
fn drifting(record: &Record, rows: f64, held: bool) -> Record {
    let n = record.pv.len();
    let value = |k: usize| {
        let at = k as f64 - rows * k as f64 / n as f64;
        let (before, share) = (at as usize, if held { 0.0 } else { at.fract() });
        let [own, next] = [before, (before + 1).min(n - 1)].map(|k| record.pv[k].value);
        own + share * (next - own)
    };
    let pv = record.pv.iter().enumerate().map(|(k, s)| Sample { value: value(k), ..*s }).collect();
    Record { pv, ..record.clone() }
}

/// The record as most historians write it: OP and PV in thousandths of their ranges.
fn rounded(record: &Record) -> Record {
    let written = |series: &[Sample]| -> Vec<Sample> {
        let range = series
            .iter()
            .map(|s| s.value)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
        let step = 10f64.powi(((range[1] - range[0]).log10() - 3.0).floor() as i32);
        series.iter().map(|s| Sample { value: (s.value / step).round() * step, ..*s }).collect()
    };
    Record { op: written(&record.op), pv: written(&record.pv), ..record.clone() }
}

/// Rows by which the gate finds PV late; `None` where it refuses the record before.
fn found(record: &Record) -> Option<usize> {
    let (window, told) = gate::gate(record, &Settings::default()).ok()?;
    Some((told.acquisition?.pv_late_s / window.ts).round() as usize)
}

/// How often the gate finds `rows`, fewer, and more. Fewer are right where OP is late, too.
fn counts(records: &[Record], rows: usize) -> [usize; 3] {
    let mut out = [0; 3];
    for told in parallel::each(records, |record| found(&later(record, rows))).into_iter().flatten() {
        let at = [told == rows, told < rows, told > rows];
        out.iter_mut().zip(at).for_each(|(count, own)| *count += usize::from(own));
    }
    out
}

#[test]
fn no_loop_is_late_that_is_not_and_most_that_are_are_known() {
    let drawn: Vec<Record> = (0..LOOPS).map(|i| draw(i, FIRST + i).record).collect();
    let measured: Vec<Record> =
        measured::below(Path::new(FOLDER)).into_iter().map(|(_, record)| record).collect();
    for (kind, records) in [("drawn", drawn), ("measured", measured)] {
        for rows in [0, 1, 2, 3, 6] {
            let [right, fewer, more] = counts(&records, rows);
            println!("{kind}, {rows} rows late: {right} right, {fewer} fewer, {more} more");
            assert_eq!(more, 0, "{kind}, {rows} rows late");
            // Measured controllers are faster than their records, or filter PV: half of them tell nothing.
            let most = kind == "drawn" && rows > 0;
            assert!(!most || right > 9 * fewer, "{kind}, {rows} rows late: {right} of {}", right + fewer);
        }
    }
}

#[test]
fn a_sticking_valve_is_not_called_sound_because_pv_is_late() {
    let clear = |i: &u64| {
        let own = draw(*i, FIRST + i);
        let at_ticks = judge(&own, &own.record);
        (at_ticks.sticks() && at_ticks.evidence > 40.0).then_some((own, at_ticks))
    };
    let loops: Vec<_> =
        parallel::each((0..18).collect::<Vec<_>>().iter(), clear).into_iter().flatten().collect();
    assert!(loops.len() >= 4, "too few loops are clear: {}", loops.len());
    for (own, at_ticks) in &loops {
        let written = rounded(&own.record);
        for rows in [1, 6] {
            let said = judge(own, &later(&written, rows));
            let told = format!("{}, {rows} rows: {} {}", own.name, said.verdict, said.reason);
            assert!(said.sticks() && said.near(at_ticks.f), "{told}");
        }
        for (rows, held) in [(8.0, true), (8.0, false), (5.0, false)] {
            let said = judge(own, &drifting(&written, rows, held));
            let told = format!("{}, up to {rows} rows, {held}: {} {}", own.name, said.verdict, said.reason);
            assert!(said.verdict != "no_stiction" || said.covers(own.f), "{told}");
        }
    }
}
