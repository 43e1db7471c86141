//! Two tables in one file, and two ways to write numbers in one column.

use super::doubts::{read, rows};
use super::{bits, example};
use stictiond::table::{Options, Table};

fn plain() -> Options {
    Options::default()
}

fn seconds(t: f64) -> String {
    t.to_string()
}

fn refused(table: Result<Table, String>, by: &str) {
    let said = table.err().unwrap_or_default();
    assert!(said.contains(by), "{said:?} has no {by:?}");
}

/// The example's rows with a row between its halves.
fn divided(by: &[&str]) -> Vec<String> {
    let mut all = rows(&example(), ',', seconds);
    let half = all.len() / 2;
    all.splice(half..half, by.iter().map(|row| (*row).to_string()));
    all
}

#[test]
fn a_title_of_another_loop_between_samples_is_refused() {
    for title in ["FIC102", "FIC-102,,", "Loop FIC102", "Unit1.FIC102"] {
        for header in ["FIC101\nt,op,pv", "t,op,pv"] {
            refused(read(header, &divided(&[title]), &plain()), "stands alone between samples");
            refused(read(header, &divided(&[title, "t,op,pv"]), &plain()), "stands alone between samples");
        }
    }
    for again in ["FIC101", "Page 2", "FT101", "operator changed: note 12"] {
        let table = read("FIC101\nt,op,pv", &divided(&[again]), &plain()).expect(again);
        assert!(bits(&table.record) == bits(&example()), "{again}");
    }
}

#[test]
fn other_units_between_samples_are_refused() {
    refused(read("t,op,pv\ns,%,m3/h", &divided(&["s,mA,m3/h"]), &plain()), "the unit is \"mA\" from here on");
    refused(
        read("t,op [%],pv [m3/h]", &divided(&["t,op [%],pv [m3/h]", "[s],[%],[l/min]"]), &plain()),
        "column 3: the unit is \"l/min\" from here on, and was \"m3/h\"",
    );
    let table = read("t,op,pv\ns,%,m3/h", &divided(&["t,op,pv", "s,%,M3/H"]), &plain()).expect("the same");
    assert!(bits(&table.record) == bits(&example()));
}

#[test]
fn words_that_differ_in_their_numbers_are_devices() {
    let of = |name: &str, words: [&str; 2]| {
        let all = rows(&example(), ',', seconds);
        let half = all.len() / 2;
        let word = |at: usize| words[usize::from(at >= half)];
        let all: Vec<String> =
            all.iter().enumerate().map(|(at, row)| format!("{row},{}", word(at))).collect();
        read(&format!("t,op,pv,{name}"), &all, &plain())
    };
    refused(
        of("device", ["pump1", "pump2"]),
        "rows of several loops, \"pump1\", \"pump2\": say which with --loop",
    );
    for (name, words) in
        [("valve", ["open", "closed"]), ("source", ["opc1", "opc2"]), ("device", ["pump1", "pump1"])]
    {
        assert!(of(name, words).is_ok_and(|table| bits(&table.record) == bits(&example())), "{name}");
    }
}

#[test]
fn the_digits_of_a_clock_are_no_count_of_seconds() {
    let of = |time: &dyn Fn(usize) -> String, options: &Options| {
        let all = rows(&example(), ',', seconds);
        let row = |(at, row): (usize, &String)| {
            format!("{},{}", time(at), row.split_once(',').map_or("", |(_, rest)| rest))
        };
        read("Time,OP,PV", &all.iter().enumerate().map(row).collect::<Vec<_>>(), options)
    };
    let clock =
        |at: usize| format!("{:02}{:02}{:02}", 9 + (at + 3000) / 3600, (at + 3000) / 60 % 60, at % 60);
    refused(of(&clock, &plain()), "may be the digits of a clock");
    refused(of(&|at| format!("2026166{}", clock(at)), &plain()), "may be the digits of a clock");
    let told = Options { time_format: Some("%H%M%S".into()), ..plain() };
    let table = of(&clock, &told).expect("told");
    assert_eq!(table.record.op[1].t - table.record.op[0].t, 1.0);
    // In seconds 100 is an odd step, and in milliseconds a usual one.
    refused(of(&|at| (at * 100).to_string(), &plain()), "may be seconds or milliseconds");
    for step in [1, 2, 5, 7, 10, 50, 60, 120] {
        assert!(
            of(&|at| (at * step).to_string(), &plain())
                .is_ok_and(|table| bits(&table.record) == bits(&example())),
            "{step}"
        );
    }
}

#[test]
fn two_signs_before_three_digits_are_two_ways_to_write() {
    let all: Vec<String> = rows(&example(), ';', seconds);
    let mixed: Vec<String> = all
        .iter()
        .enumerate()
        .map(|(at, row)| if at % 300 == 7 { row.replace('.', ",") } else { row.clone() })
        .collect();
    refused(read("t;op;pv", &mixed, &plain()), "two ways to write numbers in one column");
    let told = Options { decimal: Some(".".into()), ..plain() };
    assert!(read("t;op;pv", &mixed, &told).is_ok());
}
