//! What historians and control systems write beside OP and PV, and times that only the rows of one tag can tell.

use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example};
use stictiond::table::{Options, Table};

fn civil(t: f64) -> String {
    let moment = jiff::Timestamp::from_second(t.floor() as i64).expect("a time of ours");
    jiff::tz::Offset::UTC.to_datetime(moment).strftime("%Y-%m-%d %H:%M:%S").to_string()
}

fn refused(table: Result<Table, String>, by: &str) {
    let said = table.err().unwrap_or_default();
    assert!(said.contains(by), "{said:?} has no {by:?}");
}

fn plain() -> Options {
    Options::default()
}

fn of_loop(id: &str) -> Options {
    Options { of_loop: Some(id.into()), ..Options::default() }
}

/// The example's rows, with what `mark` says of each behind it.
fn marked(mark: impl Fn(usize) -> &'static str) -> Vec<String> {
    let all = rows(&example(), ',', civil);
    all.into_iter().enumerate().map(|(at, row)| format!("{row},{}", mark(at))).collect()
}

/// How many samples of PV are not good.
fn not_good(table: &Table) -> usize {
    table.record.pv.iter().filter(|sample| !sample.quality.is_good()).count()
}

#[test]
fn a_flag_of_good_values_and_a_confidence_leave_the_others_out() {
    let bad = example().pv.len().div_ceil(9);
    for (name, good, other) in [
        ("Good", "True", "False"),
        ("Is Good", "1", "0"),
        ("IsValid", "yes", "no"),
        ("PV_GOOD", "1", "0"),
        ("Confidence", "100", "0"),
        ("Conf", "100", "-1"),
        ("BADPV", "0", "1"),
        ("FIC101.BADPV", "OFF", "ON"),
        ("PV_OK", "1", "0"),
        ("PV_FAULT", "FALSE", "TRUE"),
        ("PV_ALRM", "NR", "IOP"),
        ("Kalite", "İyi", "Kötü"),
        ("Kvalita", "Dobrá", "Špatná"),
        ("PV Confidence", "100", "-1"),
    ] {
        let marked = marked(|at| if at % 9 == 0 { other } else { good });
        let table = read(&format!("Time,OP,PV,{name}"), &marked, &plain()).expect(name);
        assert_eq!(not_good(&table), bad, "{name}: {}", table.found.read_as);
    }
    let pump = marked(|at| if at % 9 == 0 { "1" } else { "0" });
    let table = read("Time,OP,PV,Pump fault", &pump, &plain()).expect("of the pump");
    assert_eq!(not_good(&table), 0, "{}", table.found.read_as);
    for (name, on, off) in [("AutAct", "1", "0"), ("AutoMode", "TRUE", "FALSE"), ("A/M", "A", "M")] {
        let rows = marked(|at| if at % 9 == 0 { off } else { on });
        let table = read(&format!("Time,OP,PV,{name}"), &rows, &plain()).expect(name);
        assert!(table.record.mode.is_some(), "{name}: {}", table.found.read_as);
    }
    let batch = marked(|at| if at % 9 == 0 { "0" } else { "1" });
    let table = read("Time,OP,PV,Batch valid", &batch, &plain()).expect("of the batch");
    assert_eq!(not_good(&table), 0, "{}", table.found.read_as);
    let partly = marked(|at| if at % 9 == 0 { "60" } else { "100" });
    refused(read("Time,OP,PV,Confidence", &partly, &plain()), "--good-values");
}

#[test]
fn numbers_of_ignition_are_no_bits_of_opc() {
    let marked = marked(|at| if at % 9 == 0 { "500" } else { "192" });
    refused(read("Time,OP,PV,dataintegrity", &marked, &plain()), "\"500\" (134 rows)");
    let told = Options { good_values: Some("192".into()), ..Options::default() };
    let table = read("Time,OP,PV,dataintegrity", &marked, &told).expect("told");
    assert_eq!(not_good(&table), 134);
}

#[test]
fn an_open_input_is_bad_and_a_limit_that_is_passed_is_not() {
    let alarms = marked(|at| ["IOP", "HI", "NR"][at % 3]);
    let count = example().pv.len().div_ceil(3);
    let table = read("Time,FIC1.MV,FIC1.PV,FIC1.ALRM", &alarms, &plain()).expect("CENTUM");
    assert_eq!(not_good(&table), count, "{}", table.found.read_as);
    let table = read("Time,FIC1.MV,FIC1.PV,FIC2.ALRM", &alarms, &plain()).expect("another loop's");
    assert_eq!(not_good(&table), 0, "{}", table.found.read_as);
    let limits = marked(|at| ["LO", "HI", "NR"][at % 3]);
    let table = read("Time,FIC1.MV,FIC1.PV,FIC1.ALRM", &limits, &plain()).expect("limits");
    assert_eq!(not_good(&table), 0, "{}", table.found.read_as);
}

/// The example as rows of one tag each, OP and PV in turn or one after the other; `behind` says what stands behind a value.
fn long(
    in_turn: bool,
    time: impl Fn(f64) -> String,
    behind: impl Fn(usize, bool) -> &'static str,
) -> Vec<String> {
    let example = example();
    let of = |at: usize, is_pv: bool| {
        let (sample, name) = if is_pv { (&example.pv[at], "PV") } else { (&example.op[at], "OP") };
        format!("{},FIC1.{name},{}{}", time(BEGIN as f64 + sample.t), sample.value, behind(at, is_pv))
    };
    let all = 0..example.op.len();
    if in_turn {
        all.flat_map(|at| [of(at, false), of(at, true)]).collect()
    } else {
        all.clone().map(|at| of(at, false)).chain(all.map(|at| of(at, true))).collect()
    }
}

#[test]
fn where_opc_numbers_stand_beside_others_they_decide() {
    for (header, good, bad) in [
        ("Time,TagName,Value,Quality,QualityDetail", ",0,192", ",1,24"),
        ("Time,TagName,Value,Quality,QualityDetail,OPCQuality", ",0,192,192", ",133,4140,64"),
    ] {
        let spoilt = long(true, civil, |at, is_pv| if is_pv && at % 9 == 0 { bad } else { good });
        let table = read(header, &spoilt, &plain()).expect(header);
        assert_eq!(not_good(&table), 134, "{header}: {}", table.found.read_as);
        assert!(table.record.op.iter().all(|sample| sample.quality.is_good()), "{header}");
    }
}

#[test]
fn clocks_turn_back_for_each_tag_by_itself() {
    let begin: jiff::Timestamp = "2026-10-25T00:40:00Z".parse().expect("a moment");
    let zone = jiff::tz::TimeZone::get("Europe/Berlin").expect("known");
    let local = |t: f64| {
        let moment = begin + jiff::SignedDuration::from_secs(t as i64 - BEGIN);
        moment.to_zoned(zone.clone()).strftime("%Y-%m-%d %H:%M:%S").to_string()
    };
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    for in_turn in [true, false] {
        let rows = long(in_turn, local, |_, _| "");
        refused(read("Time,Tag,Value", &rows, &plain()), "daylight saving time");
        let table = read("Time,Tag,Value", &rows, &told).expect("told");
        let example = example();
        for (read, own) in [(&table.record.op, &example.op), (&table.record.pv, &example.pv)] {
            let off = read.iter().zip(own).map(|(a, b)| (a.t - begin.as_second() as f64 - b.t).abs());
            assert!(off.fold(0.0, f64::max) < 1.0, "in turn {in_turn}: {}", table.found.read_as);
        }
    }
}

#[test]
fn rows_that_share_a_stamp_of_the_hour_that_comes_twice_stay_in_it() {
    let begin: jiff::Timestamp = "2026-10-24T23:40:00Z".parse().expect("a moment");
    let zone = jiff::tz::TimeZone::get("Europe/Berlin").expect("known");
    // Two rows a stamp: the example twice as fast.
    let first = rows(&example(), ',', |t| {
        let step = ((t - BEGIN as f64) / 4.0).floor() * 2.0;
        let moment = begin + jiff::SignedDuration::from_secs(step as i64 + 600);
        moment.to_zoned(zone.clone()).strftime("%Y-%m-%d %H:%M:%S").to_string()
    });
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let table = read("Time,OP,PV", &first, &told).expect("read");
    let steps = table.record.op.windows(2).map(|pair| pair[1].t - pair[0].t);
    assert!(steps.fold(0.0, f64::max) < 4.0, "{}", table.found.read_as);
}

#[test]
fn numbers_that_begin_again_are_refused() {
    let of_day = |t: f64| format!("{:.2}", (t - BEGIN as f64 + 85_000.0) % 86_400.0);
    let restarted = rows(&example(), ',', of_day);
    let newest_first: Vec<String> = restarted.iter().rev().cloned().collect();
    refused(read("Time,OP,PV", &restarted, &plain()), "times begin again");
    refused(read("Time,OP,PV", &newest_first, &plain()), "times begin again");
    // Samples that come late are sorted.
    let mut late = rows(&example(), ',', |t| format!("{:.2}", t - BEGIN as f64));
    late.swap(500, 501);
    let table = read("Time,OP,PV", &late, &plain()).expect("late");
    assert!(bits(&table.record) != bits(&example()) && table.record.op.len() == example().op.len());
}

#[test]
fn times_with_an_offset_and_without_are_refused_unless_a_zone_is_told() {
    let half = BEGIN as f64 + 1200.0;
    let mixed =
        rows(
            &example(),
            ',',
            |t| if t < half { civil(t).replace(' ', "T") + "Z" } else { civil(t + 7200.0) },
        );
    refused(read("Time,OP,PV", &mixed, &plain()), "has no offset, and");
    let told = Options { tz: Some("Europe/Berlin".into()), ..Options::default() };
    let table = read("Time,OP,PV", &mixed, &told).expect("told");
    let steps = table.record.op.windows(2).map(|pair| pair[1].t - pair[0].t);
    assert!(steps.fold(0.0, f64::max) < 4.0, "{}", table.found.read_as);
}

#[test]
fn a_measured_position_a_copy_and_another_loop_are_not_taken_for_op_or_pv() {
    let example = example();
    let own = rows(&example, ',', civil);
    for name in ["Valve Position", "Stem", "Travel"] {
        refused(read(&format!("Time,{name},PV"), &own, &plain()), "no column op");
    }
    let table = read("Time,MV %,PV", &own, &plain()).expect("a vendor's MV");
    assert!(bits(&table.record) == bits(&example));
    let more: Vec<String> = own.iter().map(|row| format!("{row},7.5")).collect();
    refused(read("Time,OP,PV,PV.1", &more, &plain()), "\"PV.1\" is the second column for pv");
    refused(read("Time,CV,PV,MV", &more, &plain()), "is the second column for op");
    refused(read("Time,FIC101.OP,FIC102.PV", &own, &plain()), "name them with --op and --pv");
    let named = Options { op: Some("FIC101.OP".into()), pv: Some("FIC102.PV".into()), ..Options::default() };
    assert!(bits(&read("Time,FIC101.OP,FIC102.PV", &own, &named).expect("told").record) == bits(&example));
}

#[test]
fn loops_may_have_numbers_and_a_counter_is_no_loop() {
    let example = example();
    let both = |row: &String| {
        let (time, values) = row.split_once(',').expect("a time");
        [format!("{time},1,{values}"), format!("{time},2,50.0,30.0")]
    };
    let two: Vec<String> = rows(&example, ',', civil).iter().flat_map(both).collect();
    refused(read("Time,Loop,OP,PV", &two, &plain()), "rows of several loops, \"1\", \"2\": say which");
    let table = read("Time,Loop,OP,PV", &two, &of_loop("1")).expect("told");
    assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
    let counted: Vec<String> =
        rows(&example, ',', civil).iter().enumerate().map(|(at, row)| format!("{row},{at}")).collect();
    assert!(bits(&read("Time,OP,PV,Loop", &counted, &plain()).expect("a counter").record) == bits(&example));
}

#[test]
fn what_stands_in_columns_of_its_own_is_named() {
    let parts = rows(&example(), ',', |t| civil(t).replace(['-', ' ', ':'], ","));
    refused(read("Year,Month,Day,Hour,Minute,Second,OP,PV", &parts, &plain()), "join them into one column");
    let script = |t: f64| {
        let moment = jiff::Timestamp::from_second(t.floor() as i64).expect("a time of ours");
        let local = jiff::tz::Offset::constant(2).to_datetime(moment);
        local.strftime("%a %b %d %Y %H:%M:%S GMT+0200 (CEST)").to_string()
    };
    let table = read("Time,OP,PV", &rows(&example(), ',', script), &plain()).expect("JavaScript");
    assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
    assert_eq!(table.record.op[0].t, BEGIN as f64);
    let index: Vec<String> = long(true, civil, |_, _| "")
        .iter()
        .map(|row| row.replace("FIC1.OP", "0").replace("FIC1.PV", "1"))
        .collect();
    refused(read("DateAndTime,TagIndex,Val", &index, &plain()), "no tag for op, pv");
    let told = Options { op: Some("0".into()), pv: Some("1".into()), ..plain() };
    let table = read("DateAndTime,TagIndex,Val", &index, &told).expect("FactoryTalk");
    assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
}

#[test]
fn values_that_stand_for_none_are_told_and_leave_the_span_alone() {
    let example = example();
    for none in ["-9999.000", "9.96921E+36", "32767.000"] {
        let mut spoilt = rows(&example, ',', civil);
        for row in spoilt.iter_mut().step_by(20) {
            let (time, values) = row.split_once(',').expect("a time");
            *row = format!("{time},{none},{}", values.split_once(',').expect("PV").1);
        }
        let table = read("Time,OP,PV", &spoilt, &plain()).expect(none);
        assert_eq!(table.record.op_span, Some(100.0), "{none}");
        let said = &table.found.read_as;
        assert!(said.contains("60 samples of op are no measurements"), "{none}: {said}");
    }
}

#[test]
fn rows_of_several_devices_and_series_of_one_tag_are_refused() {
    let both = |row: &String| {
        let (time, values) = row.split_once(',').expect("a time");
        [format!("{time},North,{values}"), format!("{time},South,50.0,30.0")]
    };
    let two: Vec<String> = rows(&example(), ',', civil).iter().flat_map(both).collect();
    for name in ["plant", "Device ID", "Regler", "name"] {
        refused(
            read(&format!("Time,{name},OP,PV"), &two, &plain()),
            "rows of several loops, \"north\", \"south\"",
        );
    }
    let kinds = long(true, civil, |_, _| ",avg").into_iter().flat_map(|row| {
        let most = row.replace(",avg", "9,max");
        [row, most]
    });
    let kinds: Vec<String> = kinds.collect();
    refused(read("Time,Tag,Value,Aggregate", &kinds, &plain()), "of several \"Aggregate\": \"avg\", \"max\"");
    let bare: Vec<String> = kinds.iter().map(|row| row.replace(",avg", "").replace(",max", "")).collect();
    refused(read("Time,Tag,Value", &bare, &plain()), "another column tells them apart");
    // What comes twice with the same value is one sample.
    let twice: Vec<String> =
        long(true, civil, |_, _| "").into_iter().flat_map(|row| [row.clone(), row]).collect();
    assert!(read("Time,Tag,Value", &twice, &plain()).is_ok());
}

#[test]
fn a_loop_may_be_named_in_brackets_or_by_its_area() {
    let own = rows(&example(), ',', civil);
    for header in [
        "Time,OP [FIC101],PV [TIC102]",
        "Time,\"op{loop=\"\"FIC101\"\"}\",\"pv{loop=\"\"TIC102\"\"}\"",
        "Time,UNIT1.FIC101.OP,UNIT2.FIC101.PV",
        "Time,Area1/FIC-101/OP,Area2/FIC-101/PV",
    ] {
        refused(read(header, &own, &plain()), "name them with --op and --pv");
    }
    for header in [
        "Time,OP [FIC101],PV [FIC101]",
        "Time,UNIT1.FIC101.OP,UNIT1.FIC101.PV",
        "Time,FIC101.CVEU,FIC101.PV",
        "Time,OP [%],PV [m3/h]",
    ] {
        let table = read(header, &own, &plain()).expect(header);
        assert!(bits(&table.record) == bits(&example()), "{header}");
    }
    refused(read("Time,FIC101/AI1/OUT.CV,FIC101/PID1/PV.CV", &own, &plain()), "no column op");
}

#[test]
fn a_matrix_as_matlab_shows_it_has_a_factor_that_is_not_passed_over() {
    let lines = ["   1.0e+03 *", "", "   1.7803   0.0518   0.0512"].map(String::from);
    refused(read("t   op   pv", &lines, &plain()), "common factor of all numbers");
}
