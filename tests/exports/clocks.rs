//! Clocks that are shown in part, turn, or have twelve hours.

use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example};
use stictiond::table::{Options, Table};

/// A moment in jiff's words.
pub fn civil(format: &str, t: f64) -> String {
    let moment = jiff::Timestamp::from_millisecond((t * 1e3).round() as i64).expect("a time of ours");
    jiff::tz::Offset::UTC.to_datetime(moment).strftime(format).to_string()
}

/// The largest error of OP's times from the first on (s).
fn off(table: &Table) -> f64 {
    let example = example();
    let (read, own) = (&table.record.op, &example.op);
    let off = |(a, b): (&stictiond::signal::Sample, &stictiond::signal::Sample)| {
        (a.t - read[0].t - (b.t - own[0].t)).abs()
    };
    read.iter().zip(own).map(off).fold(0.0, f64::max)
}

#[test]
fn minutes_and_seconds_with_a_fraction_are_what_a_spreadsheet_shows() {
    let example = example();
    for decimal in ['.', ','] {
        // Half past, so that the hour ends within the record.
        let shown = |t: f64| civil("%M:%S%.1f", t + 1800.0).replace('.', &decimal.to_string());
        let rows = rows(&example, ';', shown);
        let table = read("Time;OP;PV", &rows, &Options::default()).expect("read");
        assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
        assert!(off(&table) < 0.11, "{}", table.found.read_as);
        assert!(table.found.read_as.contains("minutes and seconds"), "{}", table.found.read_as);
    }
    // Without a fraction it may be hours and minutes.
    let short = rows(&example, ';', |t| civil("%M:%S", t));
    let said = read("Time;OP;PV", &short, &Options::default()).expect_err("either");
    assert!(said.contains("hours and minutes or minutes and seconds"), "{said}");
}

#[test]
fn a_clock_of_twelve_hours_without_a_date_is_refused() {
    let example = example();
    // The record goes past one o'clock, where such a clock begins again.
    let past = 13.0 * 3600.0 - (BEGIN as f64 + 600.0) % 86_400.0;
    let shown = |t: f64| civil("%I:%M:%S", t + past);
    let said = read("Time,OP,PV", &rows(&example, ',', shown), &Options::default()).expect_err("half a day");
    assert!(said.contains("twelve hours"), "{said}");
    // A clock of 24 hours goes back by twelve from one day shift to the next.
    let shifts = |t: f64| {
        let since = t - BEGIN as f64;
        let of_day = if since < 600.0 { 18.0 * 3600.0 - 600.0 + since } else { 6.0 * 3600.0 + since - 600.0 };
        civil("%H:%M:%S", of_day)
    };
    assert!(read("Time,OP,PV", &rows(&example, ',', shifts), &Options::default()).is_ok());
    let whole = |t: f64| civil("%H:%M:%S", t + past);
    let table = read("Time,OP,PV", &rows(&example, ',', whole), &Options::default()).expect("read");
    assert!(off(&table) < 1.0, "{}", table.found.read_as);
}

#[test]
fn an_hour_that_is_missing_is_told_with_what_may_be_the_reason() {
    let example = example();
    let spring = |t: f64| civil("%d.%m.%Y %H:%M:%S", if t - BEGIN as f64 > 600.0 { t + 3600.0 } else { t });
    let rows = rows(&example, ';', spring);
    let table = read("Zeit;OP;PV", &rows, &Options::default()).expect("read");
    assert!(table.found.read_as.contains("an hour is missing"), "{}", table.found.read_as);
    let told = Options { tz: Some("UTC".into()), ..Options::default() };
    let table = read("Zeit;OP;PV", &rows, &told).expect("read");
    assert!(!table.found.read_as.contains("an hour is missing"), "{}", table.found.read_as);
}

#[test]
fn studio_5000_writes_milliseconds_behind_a_semicolon() {
    let example = example();
    let shown = |t: f64| format!("{};{:03}", civil("%m/%d/%Y,%H:%M:%S", t), (t * 1e3).round() as i64 % 1000);
    let told = Options { time_format: Some("mdy".into()), ..Options::default() };
    let table = read("Date,Time,OP,PV", &rows(&example, ',', shown), &told).expect("read");
    assert!(bits(&table.record) == bits(&example) && off(&table) < 2e-3, "{}", table.found.read_as);
}
