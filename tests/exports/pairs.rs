//! Tables in which each tag has times of its own beside it.

use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::{Record, Sample};
use stictiond::table::{Options, Table};

/// The example's rows with its PV held back: each third one is missing, as where a historian keeps what has changed.
fn compressed(example: &Record) -> Record {
    let mut out = example.clone();
    let kept = example.pv.iter().enumerate().filter(|(at, _)| at % 3 != 1).map(|(_, sample)| *sample);
    out.pv = kept.collect();
    out.sp = None;
    out
}

/// Columns of OP and PV side by side under these lines, each with its own times, which may have a quality behind their value.
fn side_by_side(header: &str, record: &Record, stamp: impl Fn(f64) -> String, quality: &str) -> String {
    let cell = |sample: Option<&Sample>| match sample {
        Some(sample) => format!("{},{:?}{quality}", stamp(BEGIN as f64 + sample.t), sample.value),
        None => format!(",{}", if quality.is_empty() { "" } else { "," }),
    };
    let rows =
        (0..record.op.len()).map(|at| format!("{},{}\n", cell(record.op.get(at)), cell(record.pv.get(at))));
    format!("{header}\n{}", rows.collect::<String>())
}

fn iso(t: f64) -> String {
    let moment = jiff::Timestamp::from_millisecond((t * 1e3).round() as i64).expect("a time of ours");
    format!("{moment:.3}")
}

fn read(table: &str, options: &Options) -> Result<Table, String> {
    of_bytes(table.as_bytes(), options)
}

/// Refuses a table that has other values than the record, or at other times.
fn is_record(table: &Table, record: &Record, what: &str) {
    let said = &table.found.read_as;
    assert!(bits(&table.record) == bits(record), "{what}: {said}");
    let pairs = [(&table.record.op, &record.op), (&table.record.pv, &record.pv)];
    let off = |(read, own): (&Vec<_>, &Vec<_>)| -> f64 {
        let off = |(a, b): (&Sample, &Sample)| (a.t - BEGIN as f64 - b.t).abs();
        read.iter().zip(own).map(off).fold(0.0, f64::max)
    };
    assert!(pairs.into_iter().map(off).fold(0.0, f64::max) < 2e-3, "{what}: {said}");
}

#[test]
fn each_tag_is_read_by_its_own_times_wherever_its_name_stands() {
    let own = compressed(&example());
    for header in [
        "Time,FIC101.OP,Time,FIC101.PV",
        "Time1,FIC101.OP,Time2,FIC101.PV",
        "Timestamp,FIC101.OP,Timestamp.1,FIC101.PV",
        "OP date,OP,PV date,PV",
        "FIC101.OP,,FIC101.PV,",
        "FIC101.OP,,FIC101.PV,\nTimestamp,Value,Timestamp,Value",
        ",FIC101.OP,,FIC101.PV\nZeitstempel,Wert,Zeitstempel,Wert",
        "Trend of FIC101\nTime,OP,Time,PV",
    ] {
        let table = read(&side_by_side(header, &own, iso, ""), &Options::default()).expect(header);
        is_record(&table, &own, header);
        assert!(table.found.read_as.contains("each tag by its own times"), "{}", table.found.read_as);
    }
}

#[test]
fn numbers_are_times_where_the_header_says_so() {
    let own = compressed(&example());
    let epoch = |t: f64| format!("{:.0}", t * 1e3);
    for header in ["Time,OP,Time,PV", "OP time,OP,PV time,PV", "t1,OP,t2,PV", "OP_ts,OP,PV_ts,PV"] {
        let table = read(&side_by_side(header, &own, epoch, ""), &Options::default()).expect(header);
        is_record(&table, &own, header);
    }
}

#[test]
fn a_quality_may_stand_behind_each_value() {
    let own = compressed(&example());
    let header = "Time,OP,Quality,Time,PV,Quality";
    let written = side_by_side(header, &own, iso, ",Good").replacen(",Good", ",Bad", 1);
    let table = read(&written, &Options::default()).expect("read");
    let good = |series: &[Sample]| series.iter().filter(|s| s.quality.is_good()).count();
    assert_eq!([good(&table.record.op), good(&table.record.pv)], [own.op.len() - 1, own.pv.len()]);
}

#[test]
fn who_names_one_column_of_times_is_told_that_there_are_several() {
    let (example, own) = (example(), compressed(&example()));
    let epoch = |t: f64| format!("{:.0}", t * 1e3);
    let told =
        Options { time: Some("1".into()), op: Some("2".into()), pv: Some("4".into()), ..Options::default() };
    let said = read(&side_by_side("Time,OP,Time,PV", &own, epoch, ""), &told).expect_err("other times");
    assert!(said.contains("each tag has its own") && said.contains("--time"), "{said}");
    // The same times twice are one column of times.
    let whole = Record { sp: None, ..example };
    let table = read(&side_by_side("Time,OP,Time,PV", &whole, epoch, ""), &told).expect("the same times");
    is_record(&table, &whole, "table");
}

#[test]
fn other_columns_beside_values_are_no_times() {
    let example = Record { sp: None, ..example() };
    let row = |at: usize, beside: String| {
        format!(
            "{},{:?},{beside},{:?}\n",
            iso(BEGIN as f64 + example.op[at].t),
            example.op[at].value,
            example.pv[at].value
        )
    };
    let table = |header: &str, beside: &dyn Fn(usize) -> String| {
        let rows: String = (0..example.op.len()).map(|at| row(at, beside(at))).collect();
        read(&format!("{header}\n{rows}"), &Options::default())
    };
    // A dead time that an operator sets, counters of hours and of steps, a temperature that rises.
    for (header, from, step) in [
        ("Time,OP,Dead time,PV", 3.0, 0.0),
        ("Time,OP,Run time,PV", 8000.0, 1.0 / 1800.0),
        ("Time,OP,Run time,PV", 1.0, 1.0),
        ("Time,OP,Step time,PV", 0.0, 2.0),
        ("Time,OP,T1,PV", 20.0, 0.01),
        ("Time,OP,x,PV", 0.0, 1.0),
    ] {
        let beside = |at: usize| format!("{:.4}", from + step * at as f64);
        let read = table(header, &beside).unwrap_or_else(|said| panic!("{header}: {said}"));
        is_record(&read, &example, header);
    }
    // One moment in two zones is no time of another tag.
    let local = |at: usize| iso(BEGIN as f64 + example.op[at].t + 7200.0).replace('Z', "");
    for header in ["Time (UTC),OP,Time (local),PV", "Server time,OP,Source time,PV", "Start,OP,End,PV"] {
        let read = table(header, &local);
        assert!(read.is_err_and(|said| said.contains("--time") || said.contains("times")), "{header}");
    }
}

#[test]
fn the_hour_that_comes_twice_is_told_by_each_tag_s_own_times() {
    let example = Record { sp: None, ..example() };
    // OP every 2 s, and PV every third time: it is far ahead in the file.
    let mut own = example.clone();
    own.pv = example.pv.iter().step_by(3).copied().collect();
    let tz = jiff::tz::TimeZone::get("Europe/Berlin").expect("a zone");
    // The record begins 10 minutes before clocks are set back, at 2026-10-25 01:00 UTC.
    let shift = 1_792_889_400.0 - BEGIN as f64;
    let berlin = |t: f64| {
        let moment = jiff::Timestamp::from_millisecond(((t + shift) * 1e3).round() as i64).expect("a time");
        tz.to_datetime(moment).strftime("%d.%m.%Y %H:%M:%S%.3f").to_string()
    };
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let table = read(&side_by_side("Time,OP,Time,PV", &own, berlin, ""), &told).expect("read");
    let moved = |series: &[Sample]| -> Vec<Sample> {
        series.iter().map(|s| Sample { t: s.t + shift, ..*s }).collect()
    };
    is_record(&table, &Record { op: moved(&own.op), pv: moved(&own.pv), ..own.clone() }, "two hours");
}
