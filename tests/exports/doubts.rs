//! Exports in which something is not what it seems: it is read right, told, or refused with what decides.

use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::collect::table::{Options, Table};
use stictiond::signal::Record;

/// A row for each sample: the time by a function of seconds since 1970, then OP and PV.
fn rows(record: &Record, separator: char, time: impl Fn(f64) -> String) -> Vec<String> {
    let pair = record.op.iter().zip(&record.pv);
    let row = |t: f64, op: f64, pv: f64| format!("{}{separator}{op:.3}{separator}{pv:.3}", time(t));
    pair.map(|(op, pv)| row(BEGIN as f64 + op.t, op.value, pv.value)).collect()
}

fn read(header: &str, rows: &[String], options: &Options) -> Result<Table, String> {
    of_bytes(format!("{header}\n{}\n", rows.join("\n")).as_bytes(), options)
}

/// Seconds since the file's first moment.
fn since(table: &Table) -> Vec<f64> {
    table.record.op.iter().map(|sample| sample.t - table.record.op[0].t).collect()
}

/// `2026-06-01 08:00:01` of seconds since 1970.
fn civil(t: f64) -> String {
    let moment = jiff::Timestamp::from_second(t.floor() as i64).expect("a time of ours");
    jiff::tz::Offset::UTC.to_datetime(moment).strftime("%Y-%m-%d %H:%M:%S").to_string()
}

#[test]
fn counts_of_net_and_matlab_are_the_same_times() {
    let example = example();
    let plain = Options::default();
    let ticks = rows(&example, ',', |t| format!("{:.0}0000", (t + 62_135_596_800.0) * 1e3));
    let days = rows(&example, ',', |t| format!("{:.9}", t / 86_400.0 + 719_529.0));
    for (rows, word) in [(ticks, ".NET"), (days, "MATLAB")] {
        let table = read("Time,OP,PV", &rows, &plain).expect("read");
        assert!(table.found.read_as.contains(word), "{}", table.found.read_as);
        assert!(bits(&table.record) == bits(&example));
        let off = table.record.op.iter().zip(&example.op).map(|(a, b)| (a.t - BEGIN as f64 - b.t).abs());
        assert!(off.fold(0.0, f64::max) < 2e-3, "{word}");
    }
}

#[test]
fn rows_under_one_stamp_are_spread_in_either_direction() {
    let example = example();
    let minute = |t: f64| civil(t)[..16].to_string();
    let forward = rows(&example, ',', minute);
    let backward: Vec<String> = forward.iter().rev().cloned().collect();
    let plain = Options::default();
    let first = read("Time,OP,PV", &forward, &plain).expect("read");
    let second = read("Time,OP,PV", &backward, &plain).expect("read");
    assert!(first.found.read_as.contains("30 rows a stamp"), "{}", first.found.read_as);
    assert!(second.found.read_as.contains("30 rows a stamp"), "{}", second.found.read_as);
    let mut turned = second.record.op.clone();
    turned.reverse();
    assert_eq!(first.record.op, turned);
}

#[test]
fn times_that_a_spreadsheet_has_cut_are_asked_for() {
    let example = example();
    let cut = rows(&example, ',', |t| format!("1.78{}E+12", (t as i64 / 5000) % 10));
    let said = read("Time,OP,PV", &cut, &Options::default()).expect_err("refused");
    assert!(said.contains("column 1 (Time)") && said.contains("the times were cut"), "{said}");

    let minutes = rows(&example, ',', |t| civil(t)[14..].to_string() + ".0");
    let said = read("Time,OP,PV", &minutes, &Options::default()).expect_err("refused");
    assert!(said.contains("--time-format %H:%M or %M:%S"), "{said}");
    let told = Options { time_format: Some("%M:%S.%f".into()), ..Options::default() };
    let table = read("Time,OP,PV", &minutes, &told).expect("told");
    let right: Vec<f64> = example.op.iter().map(|s| (BEGIN as f64 + s.t).floor() - BEGIN as f64).collect();
    assert_eq!(since(&table), right);

    let told = Options { time_format: Some("%d.%m.%Y".into()), ..Options::default() };
    let said = read("Time,OP,PV", &minutes, &told).expect_err("refused");
    assert!(
        said.starts_with("line 2, column 1 (Time): \"") && said.ends_with("--time-format %d.%m.%Y"),
        "{said}"
    );
}

#[test]
fn an_hour_back_and_a_zone_in_the_header_are_times_of_a_zone() {
    let example = example();
    // 2026-10-25: clocks go back from 3 to 2 in Central Europe, at 1 UTC.
    let moved = |t: f64| t - BEGIN as f64 + 1_792_888_800.0 + 600.0;
    let local = rows(&example, ',', |t| {
        let t = moved(t);
        civil(t + if t < 1_792_890_000.0 { 7200.0 } else { 3600.0 })
    });
    let said = read("Time,OP,PV", &local, &Options::default()).expect_err("refused");
    assert!(said.contains("go back by an hour") && said.contains("--tz"), "{said}");
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let table = read("Time,OP,PV", &local, &told).expect("told");
    let right: Vec<f64> = example.op.iter().map(|s| moved(BEGIN as f64 + s.t).floor()).collect();
    assert_eq!(table.record.op.iter().map(|s| s.t).collect::<Vec<_>>(), right);

    let rows = rows(&example, ',', civil);
    let table = read("Time (UTC+02:00),OP,PV", &rows, &Options::default()).expect("an offset");
    assert!(table.found.read_as.contains("(+02:00 by the header)"), "{}", table.found.read_as);
    assert_eq!(table.record.op[0].t, BEGIN as f64 - 7200.0);
    let said = read("Time (CEST),OP,PV", &rows, &Options::default()).expect_err("letters");
    assert!(said.contains("CEST alone is no zone") && said.contains("--tz"), "{said}");
}

#[test]
fn two_signs_or_two_columns_of_times_are_refused() {
    let example = example();
    let plain = Options::default();
    let mixed: Vec<String> = rows(&example, ';', civil)
        .iter()
        .map(|row| {
            let (before, pv) = row.rsplit_once(';').expect("three cells");
            // OP with a comma and three digits, PV with a point and two.
            format!("{};{}", before.replace('.', ","), &pv[..pv.len() - 1])
        })
        .collect();
    let said = read("Zeit;OP;PV", &mixed, &plain).expect_err("refused");
    assert!(said.contains("every cell of OP") && said.contains("--decimal"), "{said}");

    let own: Vec<String> = rows(&example, ',', civil)
        .iter()
        .map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            format!("{},{},{}.500,{}", cells[0], cells[1], cells[0], cells[2])
        })
        .collect();
    let named = Options { time: Some("time1".into()), ..plain };
    let said = read("time1,op,time2,pv", &own, &named).expect_err("refused");
    assert!(said.contains("column 3 (time2) holds other times"), "{said}");
}

#[test]
fn quality_by_other_names_is_used_and_an_option_without_a_column_is_refused() {
    let example = example();
    let plain = Options::default();
    let worded = |good: &str, bad: &str| -> Vec<String> {
        let word = |k: usize| if k % 30 == 7 { bad } else { good };
        rows(&example, ',', civil).iter().enumerate().map(|(k, row)| format!("{row},{}", word(k))).collect()
    };
    for (name, good, bad) in
        [("Qualität", "gut", "schlecht"), ("IsGood", "True", "False"), ("Validity", "good", "bad")]
    {
        let table = read(&format!("Time,OP,PV,{name}"), &worded(good, bad), &plain).expect("read");
        assert!(table.found.read_as.contains(&format!("not good by {name}")), "{}", table.found.read_as);
    }
    let said = read("Time,OP,PV,Validity", &worded("1", "0"), &plain).expect_err("numbers");
    assert!(said.contains("--good-values"), "{said}");
    let told = Options { good_values: Some("1".into()), ..plain };
    assert!(read("Time,OP,PV,Validity", &worded("1", "0"), &told).is_ok());
    let said = read("Time,OP,PV", &rows(&example, ',', civil), &told).expect_err("nothing to decide");
    assert!(said.contains("--good-values: no column says anything of quality"), "{said}");
}
