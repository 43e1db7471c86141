//! Clocks that are shown in part, turn, or have twelve hours.

use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::twice::imported;
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

fn berlin() -> Options {
    Options { tz: Some("Europe/Berlin".into()), ..Options::default() }
}

/// The last Sunday of March and of October 2026 at 01:00 UTC, when clocks are changed in Central Europe.
const SPRING: f64 = 1_774_746_000.0;
const AUTUMN: f64 = 1_792_890_000.0;

/// The example with its first sample at a time (s since 1970), on the clock of Central Europe, or on its standard time throughout.
fn central(first: f64, is_changed: bool) -> Vec<String> {
    slower(1.0, first, is_changed)
}

/// The same, so many times as slow.
fn slower(times: f64, first: f64, is_changed: bool) -> Vec<String> {
    let zone = if is_changed { "Europe/Berlin" } else { "Etc/GMT-1" };
    let zone = jiff::tz::TimeZone::get(zone).expect("a zone");
    rows(&example(), ',', |t| {
        let ms = ((times * (t - BEGIN as f64) + first) * 1e3).round() as i64;
        let moment = jiff::Timestamp::from_millisecond(ms).expect("a time of ours");
        zone.to_datetime(moment).strftime("%Y-%m-%d %H:%M:%S%.3f").to_string()
    })
}

/// Reads a table on the clock of Central Europe, whose first sample is at a time (s since 1970).
fn is_at(rows: &[String], first: f64) {
    let table = read("Time,OP,PV", rows, &berlin()).unwrap_or_else(|said| panic!("{}: {said}", rows[0]));
    assert!(bits(&table.record) == bits(&example()) && off(&table) < 2e-3, "{}", table.found.read_as);
    assert!((table.record.op[0].t - first).abs() < 2e-3, "{}", table.found.read_as);
}

/// Refuses it, in the words that decide, as an import does.
fn refused(rows: &[String], by: &str) {
    let said = read("Time,OP,PV", rows, &berlin()).map(|table| table.found.read_as);
    assert!(said.as_ref().is_err_and(|said| said.contains(by)), "{said:?} has no {by:?}");
    let text = format!("Time,OP,PV\n{}\n", rows.join("\n"));
    assert_eq!(imported(&text, &berlin()).err(), said.err());
}

#[test]
fn times_that_the_clock_of_the_zone_never_showed_are_refused() {
    is_at(&central(SPRING - 1200.0, true), SPRING - 1200.0);
    let by = "02:40:00 does not exist in Europe/Berlin on 2026-03-29; say --tz +01:00 if the clock is never changed";
    let own = central(SPRING + 2400.0, false);
    refused(&own, &format!("line 2: {by}"));
    let told = Options { tz: Some("+01:00".into()), ..Options::default() };
    let table = read("Time,OP,PV", &own, &told).unwrap_or_else(|said| panic!("{said}"));
    assert!(off(&table) < 2e-3 && (table.record.op[0].t - SPRING - 2400.0).abs() < 2e-3);
    // From the time before.
    let said = read("Time,OP,PV", &central(SPRING - 1200.0, false), &berlin()).err().unwrap_or_default();
    assert!(said.contains("does not exist in Europe/Berlin") && said.contains("02:00:0"), "{said}");
    // The zone may stand in the header, too.
    let said = read("Time (Europe/Berlin),OP,PV", &own, &Options::default()).err().unwrap_or_default();
    assert!(said.contains(by), "{said}");
}

#[test]
fn the_hour_that_comes_twice_is_the_one_that_the_rows_around_it_tell() {
    // From the time before, from within the first hour and beyond it, and from within the second one to the time behind.
    for first in [AUTUMN - 4000.0, AUTUMN - 1200.0, AUTUMN + 2400.0] {
        let own = central(first, true);
        is_at(&own, first);
        let turned: Vec<String> = own.iter().rev().cloned().collect();
        let table = read("Time,OP,PV", &turned, &berlin()).unwrap_or_else(|said| panic!("{first}: {said}"));
        let last = table.record.op.last().map_or(0.0, |own| own.t);
        assert!((last - first).abs() < 2e-3, "{first}: {}", table.found.read_as);
    }
    // A row that came late within the hour is in no other one.
    let mut late = central(AUTUMN - 4000.0, true);
    late.swap(500, 501);
    let table = read("Time,OP,PV", &late, &berlin()).unwrap_or_else(|said| panic!("{said}"));
    let straight = read("Time,OP,PV", &central(AUTUMN - 4000.0, true), &berlin()).expect("read");
    assert_eq!(
        [table.record.op[500].t, table.record.op[501].t],
        [501, 500].map(|at| straight.record.op[at].t)
    );
    // Within one of the two hours, and nothing beside.
    refused(
        &central(AUTUMN + 60.0, true),
        "line 2: 02:01:00 comes twice in Europe/Berlin on 2026-10-25, and nothing tells which it is; say --tz +02:00 for the first, \
         or +01:00 for the second",
    );
    for (tz, first) in [("+02:00", AUTUMN - 3540.0), ("+01:00", AUTUMN + 60.0)] {
        let told = Options { tz: Some(tz.into()), ..Options::default() };
        let table = read("Time,OP,PV", &central(AUTUMN + 60.0, true), &told).expect("told");
        assert!((table.record.op[0].t - first).abs() < 2e-3, "{tz}: {}", table.found.read_as);
    }
    // A clock that is never changed shows the hour once.
    assert!(read("Time,OP,PV", &slower(3.0, AUTUMN - 5400.0, true), &berlin()).is_ok());
    refused(
        &slower(3.0, AUTUMN - 1800.0, false),
        "is there once; say --tz +01:00 if the clock is never changed",
    );
}

#[test]
fn a_seldom_sample_within_the_hour_that_comes_twice_is_told_and_not_asked_for() {
    // OP and PV in turn from 00:30 on, beyond both hours; set points without other rows at their times.
    let zone = jiff::tz::TimeZone::get("Europe/Berlin").expect("a zone");
    let shown = |t: f64| {
        let moment = jiff::Timestamp::from_second(t as i64).expect("a time of ours");
        zone.to_datetime(moment).strftime("%Y-%m-%d %H:%M:%S").to_string()
    };
    let of_loop = |from: f64, to: f64| -> Vec<String> {
        let (op, pv) = (example().op, example().pv);
        let times = (0..1200).map(|k| AUTUMN + 20.0 * f64::from(k) - 9000.0);
        let rows = times.zip(op.iter().zip(&pv)).filter(|(t, _)| (from..to).contains(t));
        rows.map(|(t, (op, pv))| format!("{0},OP,{1}\n{0},PV,{2}\n", shown(t), op.value, pv.value)).collect()
    };
    let table = |set_point: f64| {
        let around = [of_loop(0.0, set_point), of_loop(set_point, f64::INFINITY)].map(|rows| rows.concat());
        let sp = |t: f64, value: f64| format!("{},SP,{value}\n", shown(t));
        let (before, at, behind) =
            (sp(AUTUMN - 9000.0, 50.0), sp(set_point, 55.0), sp(AUTUMN + 15_000.0, 60.0));
        format!("Time,Tag,Value\n{before}{}{at}{}{behind}", around[0], around[1])
    };
    // The rows of the others tell which hour it is in.
    for set_point in [AUTUMN - 1800.0, AUTUMN + 1800.0] {
        let read =
            super::of_bytes(table(set_point).as_bytes(), &berlin()).unwrap_or_else(|said| panic!("{said}"));
        assert!(
            read.record.sp.as_deref().is_some_and(|sp| sp.iter().any(|own| (own.t - set_point).abs() < 1e-6)),
            "{}",
            read.found.read_as
        );
    }
    // One tag below the other: nothing tells it.
    let sp = [AUTUMN - 9000.0, AUTUMN - 1800.0, AUTUMN + 15_000.0].map(|t| format!("{},SP,50\n", shown(t)));
    let rows = of_loop(0.0, f64::INFINITY).concat();
    let of_tag = |tag: &str| {
        rows.lines().filter(|row| row.contains(tag)).map(|row| format!("{row}\n")).collect::<String>()
    };
    let stacked = format!("Time,Tag,Value\n{}{}{}", of_tag(",OP,"), of_tag(",PV,"), sp.concat());
    let read = super::of_bytes(stacked.as_bytes(), &berlin()).unwrap_or_else(|said| panic!("{said}"));
    let told = "02:30:00 comes twice in Europe/Berlin on 2026-10-25 and is read as the first";
    assert!(read.found.read_as.contains(told), "{}", read.found.read_as);
}

#[test]
fn an_hour_back_in_a_zone_without_a_change_is_told_or_refused() {
    let told = Options { tz: Some("UTC".into()), ..Options::default() };
    // The end of the one hour and the beginning of the other have no times in common.
    let table = read("Time,OP,PV", &central(AUTUMN - 1200.0, true), &told).expect("told");
    assert!(table.found.read_as.contains("times go back once, by up to 3598 s"), "{}", table.found.read_as);
    let said = read("Time,OP,PV", &slower(3.0, AUTUMN - 5400.0, true), &told).err().unwrap_or_default();
    assert!(said.contains("times go back over 1795 s") && said.contains("recorded already"), "{said}");
}
