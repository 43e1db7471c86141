//! Exports in which something is not what it seems: it is read right, told, or refused with what decides.

use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::Record;
use stictiond::table::{Options, Table};

/// A row for each sample: the time by a function of seconds since 1970, then OP and PV.
pub fn rows(record: &Record, separator: char, time: impl Fn(f64) -> String) -> Vec<String> {
    let pair = record.op.iter().zip(&record.pv);
    let row = |t: f64, op: f64, pv: f64| format!("{}{separator}{op:.3}{separator}{pv:.3}", time(t));
    pair.map(|(op, pv)| row(BEGIN as f64 + op.t, op.value, pv.value)).collect()
}

/// A table of this header and these rows.
pub fn read(header: &str, rows: &[String], options: &Options) -> Result<Table, String> {
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
fn counts_of_net_matlab_and_labview_are_the_same_times() {
    let example = example();
    let plain = Options::default();
    let ticks = rows(&example, ',', |t| format!("{:.0}0000", (t + 62_135_596_800.0) * 1e3));
    let days = rows(&example, ',', |t| format!("{:.9}", t / 86_400.0 + 719_529.0));
    let since_1904 = rows(&example, ',', |t| format!("{:.3}", t + 2_082_844_800.0));
    for (rows, word) in [(ticks, ".NET"), (days, "MATLAB"), (since_1904, "LabVIEW")] {
        let header = if word == "LabVIEW" { "Time (s),OP,PV" } else { "Time,OP,PV" };
        let table = read(header, &rows, &plain).expect("read");
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
    let whole: Vec<String> = minutes.iter().map(|row| row.replacen(".0,", ",", 1)).collect();
    let said = read("Time,OP,PV", &whole, &Options::default()).expect_err("refused");
    assert!(said.contains("--time-format %H:%M or %M:%S"), "{said}");
    let right: Vec<f64> = example.op.iter().map(|s| (BEGIN as f64 + s.t).floor() - BEGIN as f64).collect();
    for time_format in [None, Some("%M:%S.%f".into())] {
        let told = Options { time_format, ..Options::default() };
        let table = read("Time,OP,PV", &minutes, &told).expect("a fraction, or told");
        assert_eq!(since(&table), right);
    }

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
    assert!(said.contains("save the rows before and after it apart"), "{said}");
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
    assert!(said.contains("columns 1 and 3 hold other times"), "{said}");
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

#[test]
fn milliseconds_may_stand_in_a_column_of_their_own() {
    let example = example();
    let row = |at: usize, op: f64, pv: f64| {
        let t = 0.4 * at as f64;
        format!("{};{:.0};{op:.3};{pv:.3}", civil(BEGIN as f64 + t), (t - t.floor()) * 1e3)
    };
    let pairs = example.op.iter().zip(&example.pv).enumerate();
    let rows: Vec<String> = pairs.map(|(at, (op, pv))| row(at, op.value, pv.value)).collect();
    let table = read("DateTime;Millitm;OP;PV", &rows, &Options::default()).expect("read");
    for (at, t) in since(&table).into_iter().enumerate() {
        assert!((t - 0.4 * at as f64).abs() < 1e-6, "row {at}: {t}");
    }
    assert!(table.record.tags.is_empty());
    // A column of that name with anything else is a tag.
    let rows: Vec<String> = rows.iter().map(|row| row.replacen(";0;", ";1500;", 1)).collect();
    let table = read("DateTime;Millitm;OP;PV", &rows, &Options::default());
    assert!(table.is_err() || table.is_ok_and(|table| table.record.tags.len() == 1));
}

#[test]
fn a_table_without_a_header_loses_no_row_where_numbers_name_its_columns() {
    let example = example();
    let rows = rows(&example, ',', civil);
    let by_number =
        Options { time: Some("1".into()), op: Some("2".into()), pv: Some("3".into()), ..Options::default() };
    let table = read(&rows[0], &rows[1..], &by_number).expect("read");
    assert_eq!(table.record.op.len(), example.op.len());
    assert!(bits(&table.record) == bits(&example));
}

#[test]
fn blanks_divide_where_no_sign_does() {
    let example = example();
    let plain = Options::default();
    let wide = |t: f64| format!("{}    ", civil(t));
    let table = read(
        "Time                   OP      PV",
        &rows(&example, ' ', wide)
            .iter()
            .map(|row| row.replace(' ', "   ").replace("01   0", "01 0"))
            .collect::<Vec<_>>(),
        &plain,
    );
    let table = table.expect("read");
    assert!(table.found.read_as.contains("separated by blanks"), "{}", table.found.read_as);
    assert!(bits(&table.record) == bits(&example));
    let single = rows(&example, ' ', |t| format!("{t}"));
    let table = read("t op pv", &single, &plain).expect("read");
    assert!(bits(&table.record) == bits(&example));
    let date_and_time = rows(&example, ' ', civil);
    let table = read("Date Time OP PV", &date_and_time, &plain).expect("read");
    assert!(bits(&table.record) == bits(&example));
}

#[test]
fn a_table_packed_by_gzip_is_the_table() {
    use std::io::Write;
    let example = example();
    let text = format!("t,op,pv\n{}\n", rows(&example, ',', |t| format!("{t}")).join("\n"));
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(text.as_bytes()).expect("memory");
    let table = of_bytes(&packed.finish().expect("memory"), &Options::default()).expect("read");
    assert!(bits(&table.record) == bits(&example));
}

#[test]
fn elapsed_times_go_on_beyond_a_day() {
    let example = example();
    let plain = Options::default();
    let clock = |s: i64| format!("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60);
    let elapsed = |t: f64| clock(86_400 - 600 + t as i64 - BEGIN);
    let days =
        |t: f64| format!("{} days {:0>8}", (t as i64 - BEGIN) / 86_400, clock((t as i64 - BEGIN) % 86_400));
    let seconds = |t: f64| format!("{:.2} sec", t - BEGIN as f64);
    for rows in [rows(&example, ',', elapsed), rows(&example, ',', days), rows(&example, ',', seconds)] {
        let table = read("Time,OP,PV", &rows, &plain).expect("read");
        assert!(bits(&table.record) == bits(&example));
        let last = example.op.last().expect("samples").t - example.op[0].t;
        assert!((since(&table).last().expect("samples") - last).abs() < 1.0, "{}", rows[1]);
    }
}

#[test]
fn an_empty_cell_has_no_place_between_blanks() {
    let plain = Options::default();
    let even: Vec<String> = (0..60).map(|k| format!("{k}  {}.5  51.2  50.0", 40 + k % 7)).collect();
    assert!(read("t  op  pv  sp", &even, &plain).is_ok());
    let mut gap = even.clone();
    gap[30] = "30          51.2  50.0".into();
    for (header, rows) in [("t  op  pv  sp", &gap), ("t OP % PV % SP %", &even)] {
        let refused = read(header, rows, &plain).expect_err("refused");
        assert!(refused.contains("cells where the header has"), "{refused}");
    }
}

#[test]
fn an_hour_that_starts_again_is_told() {
    let run = |k: usize| format!("{}:{:02}:{:02},{}.5,51.2", k / 60, k % 60, 0, 40 + k % 7);
    let rows: Vec<String> = (0..2000).chain(0..2000).map(run).collect();
    let table = read("Time,OP,PV", &rows, &Options::default()).expect("read");
    assert!(
        table.found.read_as.contains("time since the start, times go back once"),
        "{}",
        table.found.read_as
    );
}

#[test]
fn dates_of_one_day_with_points_and_two_digits_of_the_year_are_asked_about() {
    let example = example();
    // The first of June 2026, or the 26th of June 2001.
    for (year_first, cell, ways) in [
        (true, "26.06.01 06:00:00", "dd.mm.yy (2001-06-26) or yy.mm.dd (2026-06-01)"),
        (false, "01.06.26 06:00:00", "dd.mm.yy (2026-06-01) or yy.mm.dd (2001-06-26)"),
    ] {
        let rows = rows(&example, ';', |t| {
            let civil = civil(t);
            let (year, month, day) = (&civil[2..4], &civil[5..7], &civil[8..10]);
            let [first, last] = if year_first { [year, day] } else { [day, year] };
            format!("{first}.{month}.{last}{}", &civil[10..])
        });
        let said = read("Time;OP;PV", &rows, &Options::default()).expect_err("two ways");
        let expected =
            format!("line 2, column 1 (Time): {cell:?} may be {ways}; say --time-format dmy or ymd");
        assert_eq!(said, expected);
        let (own, format) =
            if year_first { ("ymd", "yy.mm.dd hh:mm:ss") } else { ("dmy", "dd.mm.yy hh:mm:ss") };
        let told = Options { time_format: Some(own.into()), ..Options::default() };
        for (header, options) in
            [("Time;OP;PV".to_string(), &told), (format!("Time ({format});OP;PV"), &Options::default())]
        {
            let table = read(&header, &rows, options).unwrap_or_else(|said| panic!("{header}: {said}"));
            assert_eq!(table.record.op[0].t, BEGIN as f64, "{header}");
            assert!(
                table.found.read_as.contains(&format!("time {}", &format[..8])),
                "{}",
                table.found.read_as
            );
        }
    }
}

#[test]
fn modified_julian_days_are_asked_for_as_a_spreadsheet_would_put_them_after_2051() {
    let example = example();
    let days = rows(&example, ',', |t| format!("{:.9}", t / 86_400.0 + 40_587.0));
    let said = read("Time,OP,PV", &days, &Options::default()).expect_err("a doubt");
    assert!(said.contains("2051 or later, or modified Julian days; say --time-unit"), "{said}");
    let told = Options { time_unit: Some("mjd".into()), ..Options::default() };
    let table = read("Time,OP,PV", &days, &told).expect("told");
    assert!(bits(&table.record) == bits(&example));
    let off = table.record.op.iter().zip(&example.op).map(|(a, b)| (a.t - BEGIN as f64 - b.t).abs());
    assert!(off.fold(0.0, f64::max) < 2e-3);
}

#[test]
fn minutes_since_1970_are_no_seconds_and_days_cut_to_four_decimals_are_spread() {
    let example = example();
    let minutes = rows(&example, ',', |t| format!("{:.4}", t / 60.0));
    let said = read("Time,OP,PV", &minutes, &Options::default()).expect_err("a doubt");
    assert!(said.contains("may be seconds or minutes since 1970; say --time-unit"), "{said}");
    let told = Options { time_unit: Some("min".into()), ..Options::default() };
    let step = |table: &super::Table| table.record.op[200].t - table.record.op[0].t;
    let table = read("Time,OP,PV", &minutes, &told).expect("told");
    assert!((step(&table) - example.op[200].t + example.op[0].t).abs() < 0.1);

    let days = rows(&example, ';', |t| format!("{:.4}", (t / 8.64).floor() * 8.64 / 86_400.0 + 25_569.0));
    let table = read("Time;OP;PV", &days, &Options::default()).expect("spread");
    assert!(table.found.read_as.contains("rows a stamp spread over its 8.64 s"), "{}", table.found.read_as);
    assert!((step(&table) - example.op[200].t + example.op[0].t).abs() < 9.0);
}
