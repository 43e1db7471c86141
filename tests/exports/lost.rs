//! Exports of which rows or columns were once lost without a word, and headers in which a name is missing.

use super::clocks::civil;
use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::Sample;
use stictiond::table::{Options, Table};

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S%.3f", t)
}

fn refused(table: Result<Table, String>, by: &[&str]) {
    let said = table.map_or_else(|said| said, |table| table.found.read_as);
    by.iter().for_each(|by| assert!(said.contains(by), "{said:?} has no {by:?}"));
}

fn is_whole(table: Result<Table, String>) {
    let table = table.unwrap_or_else(|said| panic!("{said}"));
    assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
}

/// Samples of OP and PV, side by side.
fn pairs() -> Vec<(Sample, Sample)> {
    let example = example();
    example.op.iter().copied().zip(example.pv.iter().copied()).collect()
}

#[test]
fn a_quote_that_is_never_closed_is_refused_and_a_remark_of_two_lines_is_none() {
    let rows = rows(&example(), ',', iso);
    for last in [400, rows.len()] {
        let own: Vec<String> = rows.iter().take(last).map(|row| format!("{row},")).collect();
        let with = |at: usize, remark: &str| {
            let mut own = own.clone();
            own[at] += remark;
            own
        };
        let opened = with(100, "\"sticky again");
        refused(
            read("Time,OP,PV,Remark", &opened, &Options::default()),
            &["line 102", "quote", "whole rows"],
        );
        // Closed by the quote of another remark.
        let mut closed = opened.clone();
        closed[last - 20] += "5\" pipe";
        refused(read("Time,OP,PV,Remark", &closed, &Options::default()), &["line 102", "quote"]);
    }
    let remark: Vec<String> = rows.iter().map(|row| format!("{row},\"sticky,\nsays Ann, again\"")).collect();
    is_whole(read("Time,OP,PV,Remark", &remark, &Options::default()));
}

#[test]
fn a_header_in_two_rows_tells_values_from_what_is_said_of_them() {
    let bad = |at: usize| (100..200).contains(&at);
    let said = |at: usize| if bad(at) { 0 } else { 100 };
    let phd: Vec<String> = pairs()
        .iter()
        .enumerate()
        .map(|(at, (op, pv))| {
            format!("{},,{},{},{},{}", iso(BEGIN as f64 + op.t), op.value, said(at), pv.value, said(at))
        })
        .collect();
    let header =
        "Uniformance PHD,,,,,\nTagname,,FIC101.OP,,FIC101.PV,\nTimestamp,,Value,Confidence,Value,Confidence";
    let table = read(header, &phd, &Options::default()).unwrap_or_else(|said| panic!("{said}"));
    assert!(table.found.read_as.contains("200 samples not good"), "{}", table.found.read_as);
    let good: Vec<u64> =
        table.record.op.iter().filter(|own| own.quality.is_good()).map(|own| own.value.to_bits()).collect();
    let own: Vec<u64> =
        pairs().iter().enumerate().filter(|own| !bad(own.0)).map(|(_, (op, _))| op.value.to_bits()).collect();
    assert!(good == own, "{}", table.found.read_as);

    // The least of many is no output.
    let of_many: Vec<String> = pairs()
        .iter()
        .map(|(op, pv)| {
            let three = |v: f64| format!("{},{},{v}", v - 1.0, v + 1.0);
            format!("{},{},{}", iso(BEGIN as f64 + op.t), three(op.value), three(pv.value))
        })
        .collect();
    let header = "Timestamp,FIC101.OP,,,FIC101.PV,,\n,Min,Max,Avg,Min,Max,Avg";
    refused(read(header, &of_many, &Options::default()), &["two rows", "FIC101.OP.Min"]);
    let told =
        Options { time: Some("1".into()), op: Some("4".into()), pv: Some("7".into()), ..Options::default() };
    is_whole(read(header, &of_many, &told));

    // What stands above a header and is none of it.
    let above = "Exported by,admin,,\nTime,OP,PV,Remark";
    let plain: Vec<String> = rows(&example(), ',', iso).into_iter().map(|row| row + ",ok").collect();
    is_whole(read(above, &plain, &Options::default()));
}

#[test]
fn two_values_at_the_same_times_are_two_tables() {
    let first = rows(&example(), ';', iso);
    let second: Vec<String> = pairs()
        .iter()
        .map(|(op, pv)| format!("{};{};{}", iso(BEGIN as f64 + op.t), op.value + 7.5, pv.value - 3.0))
        .collect();
    let both = [first.clone(), vec!["Time;OP;PV".into()], second].concat();
    refused(read("Time;OP;PV", &both, &Options::default()), &["two tables"]);
    // The same rows twice are one table.
    is_whole(read("Time;OP;PV", &[first.clone(), first].concat(), &Options::default()).map(|mut table| {
        for series in [&mut table.record.op, &mut table.record.pv] {
            series.truncate(series.len() / 2);
        }
        table
    }));
}

#[test]
fn samples_that_share_a_cut_time_are_told() {
    let cut = rows(&example(), ';', |t| iso((t / 10.0).floor() * 10.0));
    refused(
        read("Time;OP;PV", &cut, &Options::default()),
        &["have the time of the one before and do not count"],
    );
}

#[test]
fn seconds_in_a_column_of_their_own_are_asked_for() {
    let apart = rows(&example(), ',', |t| civil("%Y-%m-%d %H:%M,%S", t));
    refused(read("Timestamp,Sec,OP,PV", &apart, &Options::default()), &["\"Sec\"", "seconds", "one column"]);
}

#[test]
fn rows_of_tags_may_have_date_and_time_apart_and_need_their_tag() {
    let long = |named: &dyn Fn(usize) -> bool| -> Vec<String> {
        let of = |tag: &'static str, own: Vec<Sample>| -> Vec<String> {
            let row = |(at, own): (usize, &Sample)| {
                let tag = if named(at) { tag } else { "" };
                format!("{},{tag},{}", civil("%Y-%m-%d,%H:%M:%S%.3f", BEGIN as f64 + own.t), own.value)
            };
            own.iter().enumerate().map(row).collect()
        };
        let (op, pv) = pairs().into_iter().unzip();
        [of("FIC101.OP", op), of("FIC101.PV", pv)].concat()
    };
    is_whole(read("Date,Time,Tag,Value", &long(&|_| true), &Options::default()));
    let merged = long(&|at| at == 0);
    refused(read("Date,Time,Tag,Value", &merged, &Options::default()), &["column 3", "no tag"]);
}

#[test]
fn a_colon_may_stand_between_a_year_and_the_time_of_day() {
    for format in ["%d%b%Y:%H:%M:%S%.2f", "%d/%b/%Y:%H:%M:%S"] {
        let own = rows(&example(), ';', |t| civil(format, t));
        is_whole(read("Time;OP;PV", &own, &Options::default()));
    }
}

#[test]
fn an_index_without_a_name_is_the_times() {
    for (header, separator) in [("\"op\",\"pv\"", ','), ("op;pv", ';')] {
        is_whole(read(header, &rows(&example(), separator, iso), &Options::default()));
    }
}

#[test]
fn a_time_that_has_its_date_needs_no_date_beside_it() {
    let both = |t: f64| format!("{},{}", civil("%Y-%m-%d", t), iso(t));
    is_whole(read("Date,Time,OP,PV", &rows(&example(), ',', both), &Options::default()));
}

#[test]
fn carbon_monoxide_is_no_controller_output() {
    let own: Vec<String> = rows(&example(), ',', iso).into_iter().map(|row| row + ",50").collect();
    refused(read("Time,CO [ppm],PV,Damper", &own, &Options::default()), &["no column op"]);
    is_whole(read("Time,CO [%],PV,Damper", &own, &Options::default()));
}

#[test]
fn names_of_more_languages_are_known() {
    for header in
        ["Horodatage;Sortie;Mesure", "Fecha;Salida;Medida", "采集时间;输出;测量值", "Data Hora;Saída;Medição"]
    {
        is_whole(of_bytes(
            format!("{header}\n{}\n", rows(&example(), ';', iso).join("\n")).as_bytes(),
            &Options::default(),
        ));
    }
}

#[test]
fn a_mode_of_0_in_which_op_moves_by_itself_is_asked_for() {
    let held = pairs()[300].0.value;
    let table = |automatic: &str, manual: &str| -> Vec<String> {
        let row = |(at, (op, pv)): (usize, &(Sample, Sample))| {
            let (op, mode) = if at < 300 { (op.value, automatic) } else { (held, manual) };
            format!("{},{op},{},{mode}", iso(pv.t), pv.value)
        };
        pairs().iter().enumerate().map(row).collect()
    };
    let read = |rows: &[String], auto: Option<&str>| {
        let options = Options { auto_values: auto.map(Into::into), ..Options::default() };
        read("Time,OP,PV,A/M", rows, &options)
    };
    for (zero, one) in [("0", "1"), ("FALSE", "TRUE"), ("Off", "On")] {
        refused(
            read(&table(zero, one), None),
            &["column A/M", "OP moves by itself only while the mode is 0", "--auto-values"],
        );
        let modes = |table: Result<Table, String>| -> Vec<f64> {
            let table = table.unwrap_or_else(|said| panic!("{said}"));
            table.record.mode.iter().flatten().map(|mode| mode.value).collect()
        };
        let told = modes(read(&table(zero, one), Some(&zero.to_lowercase())));
        let usual = modes(read(&table(one, zero), None));
        assert!(told == usual && told.iter().filter(|mode| **mode == 1.0).count() == 300);
    }
}

#[test]
fn minutes_under_a_header_that_does_not_say_so_are_asked_for() {
    let minutes = |t: f64| format!("{:.4}", (t - BEGIN as f64) / 60.0);
    let rows = rows(&example(), ',', minutes);
    refused(read("Time,OP,PV", &rows, &Options::default()), &["0.033", "minutes (then 2 s)", "--time-unit"]);
    for (header, unit) in [("Time,OP,PV", Some("min")), ("Time (min),OP,PV", None)] {
        let options = Options { time_unit: unit.map(Into::into), ..Options::default() };
        let table = read(header, &rows, &options).unwrap_or_else(|said| panic!("{said}"));
        let step = table.record.op[2].t - table.record.op[1].t;
        assert!((step - 2.0).abs() < 0.02, "{step}: {}", table.found.read_as);
    }
}
