//! Exports as products write them that were once refused, or of which something was lost.

use super::clocks::civil;
use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::Sample;
use stictiond::table::{Options, Table};

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S%.3f", t)
}

fn said(table: Result<Table, String>) -> String {
    table.map_or_else(|said| said, |table| table.found.read_as)
}

fn refused(table: Result<Table, String>, by: &[&str]) {
    assert!(table.is_err(), "read: {}", said(table));
    let said = said(table);
    by.iter().for_each(|by| assert!(said.contains(by), "{said:?} has no {by:?}"));
}

/// Refuses a table that is not the whole example; what it says.
fn is_whole(table: Result<Table, String>, what: &str) -> String {
    let table = table.unwrap_or_else(|said| panic!("{what}: {said}"));
    assert!(bits(&table.record) == bits(&example()), "{what}: {}", table.found.read_as);
    table.found.read_as
}

/// Samples of OP and PV, side by side.
fn pairs() -> Vec<(Sample, Sample)> {
    let example = example();
    example.op.iter().copied().zip(example.pv.iter().copied()).collect()
}

/// A row for each pair of samples, with its number from 0 and its time.
fn made(row: impl Fn(usize, String, f64, f64) -> String) -> Vec<String> {
    let one =
        |(at, (op, pv)): (usize, &(Sample, Sample))| row(at, iso(BEGIN as f64 + op.t), op.value, pv.value);
    pairs().iter().enumerate().map(one).collect()
}

fn bad(series: &[Sample]) -> usize {
    series.iter().filter(|sample| !sample.quality.is_good()).count()
}

#[test]
fn letters_behind_values_that_have_no_name_are_their_quality() {
    let letter = |at: usize| if at % 100 == 7 { "B" } else { "G" };
    let own = made(|at, t, op, pv| format!("{t},{op},G,{pv},{}", letter(at)));
    let table = read("Time,FIC101.OP,,FIC101.PV,", &own, &Options::default()).expect("read");
    assert_eq!(bad(&table.record.op), 0, "{}", table.found.read_as);
    assert_eq!(bad(&table.record.pv), own.len().div_ceil(100), "{}", table.found.read_as);
}

#[test]
fn confidence_behind_values_with_their_own_times_is_their_quality() {
    let later = |op: &Sample| iso(BEGIN as f64 + op.t + 0.5);
    let row = |(at, (op, pv)): (usize, &(Sample, Sample))| {
        let confidence = if at % 100 == 7 { 0 } else { 100 };
        format!("{},{},100,{},{},{confidence}", iso(BEGIN as f64 + op.t), op.value, later(op), pv.value)
    };
    let own: Vec<String> = pairs().iter().enumerate().map(row).collect();
    for header in [
        "FIC101.OP,,,FIC101.PV,,\nTimestamp,Value,Confidence,Timestamp,Value,Confidence",
        "FIC101.OP,FIC101.OP,FIC101.OP,FIC101.PV,FIC101.PV,FIC101.PV\nTimestamp,Value,Confidence,Timestamp,Value,Confidence",
    ] {
        let table = read(header, &own, &Options::default()).expect(header);
        assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
        assert_eq!((bad(&table.record.op), bad(&table.record.pv)), (0, own.len().div_ceil(100)));
        assert!((table.record.pv[0].t - table.record.op[0].t - 0.5).abs() < 1e-3);
    }
}

#[test]
fn a_list_of_good_values_leaves_flags_of_other_columns_as_they_are() {
    let row = |at: usize, t: &str, tag: &str, value: f64| {
        let status = if at % 100 == 7 { "-254" } else { "0" };
        format!("FIC101.{tag},{t},{value},{status},{},False", if at % 100 == 8 { "True" } else { "False" })
    };
    let own = made(|at, t, op, pv| format!("{}\n{}", row(at, &t, "OP", op), row(at, &t, "PV", pv)));
    let header = "tag,time,value,status,questionable,substituted";
    refused(read(header, &own, &Options::default()), &["column status", "--good-values"]);
    let options = Options { good_values: Some("0".into()), ..Options::default() };
    let table = read(header, &own, &options).expect("read");
    let expected = own.len().div_ceil(100) * 2;
    assert_eq!(bad(&table.record.pv), expected, "{}", table.found.read_as);
}

#[test]
fn columns_told_by_number_need_no_header_and_comments_are_none() {
    let numbers: Vec<String> =
        pairs().iter().map(|(op, pv)| format!(" {:.2} {} {}", op.t, op.value, pv.value)).collect();
    let octave = "# Created by Octave 8.4.0, Mon Jun 15 08:00:00 2026 UTC <user@pc>\n# name: data\n# type: matrix\n# rows: 1000\n\
                  # columns: 3";
    let number = |at: &str| Some(at.to_string());
    let options = Options { time: number("1"), op: number("2"), pv: number("3"), ..Options::default() };
    is_whole(read(octave, &numbers, &options), "Octave");
}

#[test]
fn names_of_loggers_and_of_many_languages_are_known() {
    let plain = rows(&example(), ',', iso);
    for header in [
        "\"Date Time, GMT+00:00\",\"OP, % (LGR S/N: 20123, SEN S/N: 20123, LBL: OP)\",\"PV, m3/h (LGR S/N: 20123, LBL: PV)\"",
        "日時,操作量,測定値",
        "Tid,Utsignal,Ärvärde",
        "Время,Выход,Текущее значение",
        "Time,PLC01\\FIC101_CV,PLC01\\FIC101_PV",
    ] {
        let said = is_whole(read(header, &plain, &Options::default()), header);
        assert!(!header.contains("LGR") || said.contains("[%]") && said.contains("[m3/h]"), "{said}");
    }
    let long = made(|_, t, op, pv| format!("{t},PLC01\\FIC101_CV,{op}\n{t},PLC01\\FIC101_PV,{pv}"));
    is_whole(read("Time,Tagname,Value", &long, &Options::default()), "FactoryTalk View");
    let sided = made(|_, t, op, pv| format!("{t},{op},{t},{pv}"));
    let header = "FIC101_OP Time,FIC101_OP ValueY,FIC101_PV Time,FIC101_PV ValueY";
    is_whole(read(header, &sided, &Options::default()), header);
}

#[test]
fn milliseconds_behind_whole_seconds_belong_to_them() {
    let own = made(|at, t, op, pv| {
        let (seconds, _) = t.split_once('.').expect("a fraction");
        format!("{at},{seconds},{},{op},{pv}", at % 30 * 30)
    });
    let table =
        read("Number,Date&Time,ms,OP,PV\nNO.,Time,ms,%,m3/h", &own, &Options::default()).expect("read");
    assert!(table.found.read_as.contains("milliseconds from \"ms\""), "{}", table.found.read_as);
    assert!((table.record.op[2].t.fract() - 0.06).abs() < 1e-6, "{}", table.record.op[2].t);
}

#[test]
fn time_since_the_start_under_no_name_is_the_time() {
    let start = BEGIN as f64;
    let elapsed = |t: f64| format!("0 days {}", civil("%H:%M:%S%.3f", t - start));
    is_whole(read(",OP,PV", &rows(&example(), ',', elapsed), &Options::default()), "pandas");
}

#[test]
fn a_bit_of_automatic_beside_the_blocks_of_its_controller_is_a_mode() {
    let own = made(|at, t, op, pv| format!("{t},{pv},{op},{}", u8::from(at >= 100)));
    let header = "Time,CP01:FIC101.MEAS,CP01:FIC101.OUT,CP01:FIC101.MA";
    let table = read(header, &own, &Options::default()).expect("read");
    let manual = table.record.mode.iter().flatten().filter(|mode| mode.value == 0.0).count();
    assert_eq!(manual, 100, "{}", table.found.read_as);
}

#[test]
fn what_cannot_be_told_is_refused_by_what_helps() {
    let plain = rows(&example(), ',', iso);
    let told = Options { op: Some("FIC101.OUT".into()), ..Options::default() };
    let cv: Vec<String> = plain.iter().map(|row| format!("{row},1")).collect();
    refused(read("Time,FIC101.OUT,FIC101.CV,FIC101.SP", &cv, &told), &["no column pv", "FIC101.CV"]);

    let twice = made(|_, t, op, pv| format!("{t},{pv},{pv},{op},{op}"));
    let header = "Time,FIC101.PV,FIC101.PV,FIC101.OP,FIC101.OP";
    refused(
        read(header, &twice, &Options::default()),
        &["columns 4, 5 are all called \"FIC101.OP\"", "--op and its number"],
    );

    let rounded = made(|_, _, op, pv| format!("1.7815E+12,{op},{pv}"));
    refused(read("Time,OP,PV", &rounded, &Options::default()), &["rounded", "save them whole"]);

    let none = made(|_, _, op, pv| format!("\t{op}\t{pv}\t")).join("\n");
    let lvm = format!("X_Value\tOP\tPV\tComment\n{none}\n");
    refused(of_bytes(lvm.as_bytes(), &Options::default()), &["each row needs a time"]);
}

#[test]
fn modes_are_known_under_the_names_that_people_give_them() {
    for (name, automatic, manual) in [
        ("Control Mode", "Auto", "Manual"),
        ("A/M Status", "AUTO", "MAN"),
        ("Modo", "Automático", "Manual"),
        ("FIC101.AUTO", "1.000", "0.000"),
        ("FIC101.MAN", "0", "1"),
        ("Manual", "No", "Yes"),
    ] {
        let own =
            made(|at, t, op, pv| format!("{t},{op},{pv},{}", if at < 300 { automatic } else { manual }));
        let table = read(&format!("Time,FIC101.OP,FIC101.PV,{name}"), &own, &Options::default()).expect(name);
        let on = table.record.mode.iter().flatten().filter(|mode| mode.value == 1.0).count();
        assert_eq!(on, 300, "{name}: {}", table.found.read_as);
    }
}

#[test]
fn quality_is_known_by_a_header_q_and_by_bad_pv_and_midnight_proves_the_order_of_points() {
    let bad_ones = |table: &Table| bad(&table.record.pv);
    let expected = example().pv.len().div_ceil(100);
    let letter = |at: usize| if at % 100 == 7 { "B" } else { "G" };
    let own = made(|at, t, op, pv| format!("{t},{op},G,{pv},{}", letter(at)));
    let table = read("Time,FIC101.OP,Q,FIC101.PV,Q", &own, &Options::default()).expect("Q");
    assert_eq!(bad_ones(&table), expected, "{}", table.found.read_as);
    let own = made(|at, t, op, pv| format!("{t},{op},{pv},{}", if at % 100 == 7 { "Yes" } else { "No" }));
    let table = read("Time,OP,PV,Bad PV", &own, &Options::default()).expect("Bad PV");
    assert_eq!(bad_ones(&table), expected, "{}", table.found.read_as);

    // The fifteenth and the sixteenth of June 2026.
    let points = |t: f64| civil("%y.%m.%d %H:%M:%S", t - BEGIN as f64 + 1_781_566_800.0);
    let table = read("Time,OP,PV", &rows(&example(), ',', points), &Options::default()).expect("points");
    let [first, last] = [&table.record.op[0], &table.record.op[1199]].map(|sample| sample.t);
    assert!(last - first < 3000.0, "{}", table.found.read_as);
}

#[test]
fn milliseconds_without_leading_zeros_are_refused_and_fractions_without_trailing_ones_are_read() {
    let bare = |t: f64| {
        let ms = (t * 1e3).round() as i64 % 1000;
        format!("{}.{ms}", civil("%Y-%m-%d %H:%M:%S", t))
    };
    let uneven = |t: f64| t + ((t - BEGIN as f64) * 0.237).fract();
    let rows_of = rows(&example(), ',', |t| bare(uneven(t)));
    refused(read("Time,OP,PV", &rows_of, &Options::default()), &["without leading zeros", "three digits"]);
    let trimmed = |t: f64| {
        let text = civil("%Y-%m-%d %H:%M:%S%.3f", (uneven(t) * 8.0).round() / 8.0);
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    };
    is_whole(read("Time,OP,PV", &rows(&example(), ',', trimmed), &Options::default()), "eighths");
}

#[test]
fn the_types_of_ignition_are_no_units() {
    let own = made(|_, t, op, pv| format!("\"{t}\",\"{op}\",\"{pv}\""));
    let header =
        "\"#NAMES\"\n\"t_stamp\",\"op\",\"pv\"\n\"#TYPES\"\n\"date\",\"D\",\"D\"\n\"#ROWS\",\"1200\"";
    let said = is_whole(read(header, &own, &Options::default()), "Ignition");
    assert!(said.contains("op from \"op\", pv from \"pv\"") && !said.contains('['), "{said}");
    // A row of units is one.
    let own = rows(&example(), ',', iso);
    let said = is_whole(read("t_stamp,op,pv\n,%,m", &own, &Options::default()), "units");
    assert!(said.contains("op from \"op\" [%], pv from \"pv\" [m]"), "{said}");
}
