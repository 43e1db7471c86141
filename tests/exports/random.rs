//! Random dialects and random bytes: what is read is what was written, or it is refused; never other numbers. Where nothing is
//! in doubt it has to be read: a reader that refuses everything would be right in all the rest.

use super::dress::{Beside, Date, Extra, Form, Names, dressed, with};
use super::of_bytes;
use jiff::tz::{AmbiguousOffset, TimeZone};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::TestRunner;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use stictiond::signal::{Record, Sample};
use stictiond::table::{Options, Source, TableError, Tag, stream};

/// Least share that is read of the inputs in which decimals prove the sign. Nearly all are; some may leave another doubt.
const READ: f64 = 0.8;

/// What a property finds of an input: whether it was read, where that counts.
type Found = Result<Option<bool>, TestCaseError>;

/// Holds a property against many inputs; which share of those that count was read.
fn share_read<S: Strategy>(inputs: S, property: impl Fn(S::Value) -> Found) -> f64 {
    let counted = Cell::new([0u32; 2]);
    let config = ProptestConfig { cases: 250, source_file: Some(file!()), ..ProptestConfig::default() };
    let held = TestRunner::new(config).run(&inputs, |input| {
        if let Some(is_read) = property(input)? {
            let [read, all] = counted.get();
            counted.set([read + u32::from(is_read), all + 1]);
        }
        Ok(())
    });
    held.unwrap_or_else(|error| panic!("{error}"));
    let [read, all] = counted.get();
    assert!(all > 100, "only {all} of the inputs count");
    f64::from(read) / f64::from(all)
}

fn pick<T: Copy + std::fmt::Debug>(all: &'static [T]) -> impl Strategy<Value = T> {
    (0..all.len()).prop_map(|at| all[at])
}

/// A record of random values with so many digits.
fn records() -> impl Strategy<Value = Record> {
    let value = || {
        (any::<i32>(), 0..4u32).prop_map(|(n, digits)| f64::from(n % 3_000_000) / 10f64.powi(digits as i32))
    };
    prop::collection::vec((value(), value(), value()), 3..90).prop_map(|rows| {
        let series = |of: fn(&(f64, f64, f64)) -> f64| -> Vec<Sample> {
            rows.iter().enumerate().map(|(k, row)| Sample::good(2.5 * k as f64, of(row))).collect()
        };
        Record { op: series(|r| r.0), pv: series(|r| r.1), sp: Some(series(|r| r.2)), ..Record::default() }
    })
}

/// Whether a value of a record has a sign that can only be a decimal one: three digits behind it may be thousands.
fn has_proof(record: &Record) -> bool {
    let all = [Some(&record.op), Some(&record.pv), record.sp.as_ref()];
    let is_proof = |sample: &Sample| {
        sample.value.to_string().split_once('.').is_some_and(|(_, digits)| digits.len() != 3)
    };
    all.into_iter().flatten().flatten().any(is_proof)
}

/// Ways to write dates that a short record leaves in no doubt: in 06/01/2026 a midnight would have to tell the day from the month.
fn dates() -> impl Strategy<Value = Date> {
    pick(&Date::ALL).prop_filter("a date in doubt", |date| *date != Date::UsProved)
}

/// What is drawn beside a form: rows of the mode, the quality and a bad stamp, a trailer, units, and the order of columns.
type Drawn = (Option<Index>, Option<Index>, Option<Index>, [bool; 2], Vec<usize>);

fn drawn() -> impl Strategy<Value = Drawn> {
    let row = || prop::option::of(any::<Index>());
    let order: Vec<usize> = (0..6).collect();
    (row(), row(), row(), any::<[bool; 2]>(), Just(order).prop_shuffle())
}

/// The same for a record of so many rows.
fn beside((manual_from, bad_quality, bad_stamp, [trailer, units], order): Drawn, rows: usize) -> Beside {
    let at = |row: Option<Index>| row.map(|row| row.index(rows));
    Beside {
        manual_from: at(manual_from),
        bad_quality: at(bad_quality),
        // One in fifty may have none; the first could be a row of descriptions.
        bad_stamp: at(bad_stamp).filter(|row| rows >= 60 && *row > 0),
        // Of a few rows a trailer of two is too much.
        trailer: trailer && rows >= 20,
        units,
        order,
    }
}

/// Values, times, qualities and modes are those that were written.
fn same(read: &Record, written: &Record, beside: &Beside, times: &[f64]) -> Result<(), TestCaseError> {
    let rows: Vec<usize> = (0..written.op.len()).filter(|row| beside.bad_stamp != Some(*row)).collect();
    let sp = [read, written].map(|record| record.sp.clone().unwrap_or_default());
    for (read, written) in [(&read.op, &written.op), (&read.pv, &written.pv), (&sp[0], &sp[1])] {
        prop_assert_eq!(read.len(), rows.len());
        for ((read, row), t) in read.iter().zip(&rows).zip(times) {
            prop_assert_eq!(read.value, written[*row].value, "row {}", row);
            prop_assert_eq!(read.quality.is_good(), beside.bad_quality != Some(*row), "row {}", row);
            prop_assert!((read.t - t).abs() < 1e-3, "row {}: {} and {}", row, read.t, t);
        }
    }
    let modes = |from: usize| rows.iter().map(|row| f64::from(u8::from(*row < from))).collect::<Vec<_>>();
    let read: Option<Vec<f64>> = read.mode.as_ref().map(|mode| mode.iter().map(|s| s.value).collect());
    prop_assert_eq!(read, beside.manual_from.map(modes));
    Ok(())
}

/// What an import takes of a table, by the names of its tags.
fn imported(bytes: &[u8], options: &Options) -> Result<BTreeMap<String, Vec<Sample>>, String> {
    let mut all: BTreeMap<String, Vec<Sample>> = BTreeMap::new();
    let mut take = |tag: &Tag, sample: Sample| {
        all.entry(tag.name.clone()).or_default().push(sample);
        Ok::<(), TableError>(())
    };
    stream(Source::Bytes(bytes), options, &mut take).map_err(|error| error.to_string())?;
    Ok(all)
}

/// An import takes what a diagnosis reads, and nothing of what that refuses.
fn same_imported(
    read: &Result<stictiond::table::Table, String>,
    imported: &Result<BTreeMap<String, Vec<Sample>>, String>,
) -> Result<(), TestCaseError> {
    let (table, tags) = match (read, imported) {
        (Ok(table), Ok(tags)) => (table, tags),
        (Err(_), Err(_)) => return Ok(()),
        (Ok(_), Err(said)) => return Err(TestCaseError::fail(format!("only the import refuses: {said}"))),
        // Of OP alone there is no record, and a store takes it.
        (Err(_), Ok(tags)) if !["op", "pv"].iter().all(|name| tags.contains_key(*name)) => return Ok(()),
        (Err(said), Ok(_)) => {
            return Err(TestCaseError::fail(format!("the import takes what is none: {said}")));
        }
    };
    let exact = |series: &[Sample]| -> Vec<(u64, u64, bool)> {
        series.iter().map(|own| (own.t.to_bits(), own.value.to_bits(), own.quality.is_good())).collect()
    };
    let record = &table.record;
    for (name, series) in [("op", Some(&record.op)), ("pv", Some(&record.pv)), ("sp", record.sp.as_ref())] {
        let Some(series) = series else { continue };
        let own = tags.get(name).map(|own| exact(own));
        prop_assert_eq!(own, Some(exact(series)), "{}: {}", name, table.found.read_as);
    }
    Ok(())
}

/// Zones whose clocks are changed, and moments at which they are set forward and back (s since 1970).
const ZONES: [(&str, [i64; 2]); 3] = [
    ("Europe/Berlin", [1_774_746_000, 1_792_890_000]),
    ("America/New_York", [1_772_953_200, 1_793_512_800]),
    ("Australia/Lord_Howe", [1_791_041_400, 1_775_314_800]),
];

/// A time on the written clock, and whether it may be either of two.
fn on_the_clock(zone: &TimeZone, second: i64) -> (String, bool) {
    let civil = zone.to_datetime(jiff::Timestamp::from_second(second).expect("a time of ours"));
    let is_twice = matches!(zone.to_ambiguous_timestamp(civil).offset(), AmbiguousOffset::Fold { .. });
    (civil.strftime("%Y-%m-%d %H:%M:%S").to_string(), is_twice)
}

/// A table of rows at these times on the written clock, each with values of its own.
fn clocked(times: &[String]) -> String {
    let row = |(at, time): (usize, &String)| format!("{time},{}.5,{}.25\n", 40 + at % 7, 50 + at % 11);
    format!("Time,OP,PV\n{}", times.iter().enumerate().map(row).collect::<String>())
}

/// Rows around a moment at which the clock is changed: each is read at its own time, or the table is refused. Where the clock shows
/// nothing twice, it has to be read.
#[test]
fn times_on_days_on_which_the_clock_is_changed_are_read_or_refused() {
    let inputs = (
        pick(&ZONES),
        // Twice forward for each time back, where much may be either.
        pick(&[0_usize, 0, 1]),
        pick(&[1_i64, 2, 5, 30, 60, 600, 1800, 3600]),
        12..90i64,
        (any::<Index>(), -4000..4000i64),
        any::<bool>(),
        prop::option::of(any::<Index>()),
    );
    let share = share_read(inputs, |((name, changes), which, step, rows, (place, by), falls, late)| {
        let zone = TimeZone::get(name).expect("a zone");
        let first = changes[which] - step * place.index(rows as usize) as i64 + by;
        let mut meant: Vec<i64> = (0..rows).map(|at| first + step * at).collect();
        // A row that comes late by one; of rows that are far apart nobody could tell it from one of the other hour.
        if let Some(at) = late.filter(|_| step <= 60).map(|late| late.index(rows as usize - 3) + 1) {
            meant.swap(at, at + 1);
        }
        if falls {
            meant.reverse();
        }
        let shown: Vec<(String, bool)> = meant.iter().map(|second| on_the_clock(&zone, *second)).collect();
        let is_twice = shown.iter().any(|(_, is_twice)| *is_twice);
        let text = clocked(&shown.into_iter().map(|(time, _)| time).collect::<Vec<String>>());
        let options = Options { tz: Some(name.to_string()), ..Options::default() };
        let found = of_bytes(text.as_bytes(), &options);
        let of_loop = Some("FIC101".to_string());
        same_imported(&found, &imported(text.as_bytes(), &Options { of_loop, ..options }))?;
        let Ok(table) = found else { return Ok((!is_twice).then_some(false)) };
        let read: Vec<i64> = table.record.op.iter().map(|own| own.t.round() as i64).collect();
        prop_assert_eq!(&read, &meant, "{}\n{}", table.found.read_as, text);
        Ok((!is_twice).then_some(true))
    });
    assert!(share >= READ, "{share}");
}

/// Two records in one file, of which the second begins within the first: refused, unless they have no more than a few rows in common
/// or say the same. The parts of one record in any order are read.
#[test]
fn records_within_each_other_are_refused_and_parts_of_one_are_read() {
    let inputs = (
        20..200usize,
        pick(&[1.0_f64, 2.0, 10.0, 60.0]),
        any::<Index>(),
        pick(&[0.0_f64, 0.25, 0.5]),
        prop::collection::vec(any::<Index>(), 0..5),
        (prop::bool::weighted(0.7), any::<bool>()),
    );
    let share = share_read(inputs, |(rows, step, begin, by, cuts, (is_one, falls))| {
        let time = |at: f64| super::clocks::civil("%Y-%m-%d %H:%M:%S%.3f", 1_780_293_600.0 + step * at);
        let row = |at: f64, value: usize| format!("{},{}.5,{}.25", time(at), value % 97, value % 89);
        let mut all: Vec<String> = (0..rows).map(|at| row(at as f64, at)).collect();
        let begin = begin.index(rows);
        if is_one {
            let mut cuts: Vec<usize> = cuts.iter().map(|cut| cut.index(rows)).collect();
            cuts.extend([0, rows]);
            cuts.sort_unstable();
            let parts: Vec<Vec<String>> =
                cuts.windows(2).map(|pair| all[pair[0]..pair[1]].to_vec()).rev().collect();
            all = parts.concat();
        } else {
            all.extend((begin..rows + begin).map(|at| row(at as f64 + by, at + 50)));
        }
        if falls {
            all.reverse();
        }
        let text = format!("Time,OP,PV\n{}\n", all.join("\n"));
        let found = of_bytes(text.as_bytes(), &Options::default());
        let of_loop = Some("FIC101".to_string());
        same_imported(&found, &imported(text.as_bytes(), &Options { of_loop, ..Options::default() }))?;
        if !is_one {
            let in_common = rows - begin;
            prop_assert!(found.is_err() || in_common < 12, "{} rows in common\n{}", in_common, text);
            return Ok(None);
        }
        Ok(Some(found.is_ok_and(|table| table.record.op.len() == rows)))
    });
    assert!(share >= READ, "{share}");
}

#[test]
fn what_is_read_is_what_was_written_and_most_is_read() {
    const AROUND: [Extra; 7] = [
        Extra::None,
        Extra::Preamble,
        Extra::Comments,
        Extra::Bom,
        Extra::Utf16,
        Extra::Latin1,
        Extra::SepLine,
    ];
    let signs = (pick(&[',', ';', '\t', '|']), pick(&['.', ',']));
    let forms = (signs, dates(), pick(&Names::ALL), pick(&AROUND));
    let share = share_read((records(), forms, drawn()), |(record, form, drawn)| {
        let ((separator, decimal), date, names, extra) = form;
        let form = Form { separator, decimal, date, names, extra };
        let beside = beside(drawn, record.op.len());
        let (bytes, times) = with(&record, &form, &beside);
        let counts = has_proof(&record);
        let found = of_bytes(&bytes, &Options::default());
        // Names with a tag say their loop themselves.
        let of_loop = (!matches!(names, Names::Tags | Names::DeltaV)).then(|| "FIC101".to_string());
        same_imported(&found, &imported(&bytes, &Options { of_loop, ..Options::default() }))?;
        // Refused is right, too: three decimals everywhere may be thousands.
        let Ok(found) = found else { return Ok(counts.then_some(false)) };
        let is_same = same(&found.record, &record, &beside, &times);
        is_same.map_err(|error| TestCaseError::fail(format!("{error}; read as {}", found.found.read_as)))?;
        Ok(counts.then_some(true))
    });
    assert!(share >= READ, "{share}");
}

/// OP is written as controllers have it, in 0 to 100; PV with thousands, or with decimals in every cell.
#[test]
fn thousands_are_read_or_refused() {
    let inputs = (
        prop::collection::vec((0..100_000i32, any::<i32>()), 3..30),
        pick(&[';', '\t', '|', ',']),
        pick(&['.', ',']),
        pick(&[None, Some('.'), Some(','), Some(' '), Some('\'')]),
        pick(&[None, Some(0), Some(1), Some(3)]),
        pick(&[None, Some(0), Some(2), Some(3)]),
        pick(&[1.0, 10.0, 1000.0]),
    );
    let share = share_read(inputs, |(rows, separator, decimal, thousands, op_digits, pv_digits, scale)| {
        let thousands = thousands.filter(|sign| *sign != decimal);
        let mut text = format!("t{separator}op{separator}pv\n");
        let mut meant = Vec::new();
        for (k, (op, pv)) in rows.iter().enumerate() {
            let (op, pv) = (f64::from(*op) / 1000.0, f64::from(pv % 5_000_000) / scale);
            let op_cell = written(op, decimal, None, op_digits);
            let cells = [k.to_string(), op_cell, written(pv, decimal, thousands, pv_digits)];
            text += &(cells.map(|cell| format!("\"{cell}\"")).join(&separator.to_string()) + "\n");
            // As it was rounded when it was written.
            let rounded = |value: f64, digits: Option<usize>| -> f64 {
                digits.map_or(value, |digits| format!("{value:.digits$}").parse().expect("a number"))
            };
            meant.push((rounded(op, op_digits), rounded(pv, pv_digits)));
        }
        // One or two digits behind the sign are no thousands.
        let counts = op_digits == Some(1) || pv_digits == Some(2);
        let found = of_bytes(text.as_bytes(), &Options::default());
        if let Ok(found) = &found {
            prop_assert_eq!(found.record.op.len(), meant.len());
            for ((op, pv), meant) in found.record.op.iter().zip(&found.record.pv).zip(&meant) {
                prop_assert_eq!((op.value, pv.value), *meant, "{}\n{}", found.found.read_as, text);
            }
        }
        Ok(counts.then_some(found.is_ok()))
    });
    assert!(share >= READ, "{share}");
}

/// A number, now and then a word, or signs that are no number.
fn cell() -> impl Strategy<Value = String> {
    prop_oneof![
        10 => (-10_000..10_000i32, 0..3i32).prop_map(|(n, digits)| (f64::from(n) / 10f64.powi(digits)).to_string()),
        1 => pick(&["", "Bad", "NaN", "x", "inf", "1e400"]).prop_map(str::to_string),
        1 => "[0-9.:/+%-]{0,3}",
        1 => "[a-zN ]{0,4}",
    ]
}

/// Rows of numbers get further than any bytes.
#[test]
fn rows_with_odd_cells_give_judged_samples() {
    let inputs = (prop::collection::vec([cell(), cell(), cell()], 1..30), pick(&[';', ',']));
    let share = share_read(inputs, |(rows, separator)| {
        let mut text = ["t", "op", "pv", "x\n"].join(&separator.to_string());
        for (k, [op, pv, x]) in rows.iter().enumerate() {
            text += &format!("{k}{separator}{op}{separator}{pv}{separator}{x}\n");
        }
        let Ok(found) = of_bytes(text.as_bytes(), &Options::default()) else { return Ok(Some(false)) };
        let tags = found.record.tags.iter().map(|(_, series)| series);
        for series in [&found.record.op, &found.record.pv].into_iter().chain(tags) {
            prop_assert!(series.len() <= rows.len());
            for sample in series {
                prop_assert!(sample.t.is_finite());
                // A value that a column calls bad stays as it was written.
                prop_assert!(sample.value.is_finite() || !sample.quality.is_good());
            }
        }
        Ok(Some(true))
    });
    // Those are refused in which a number has a unit that others have not, or a column has no number.
    assert!(share >= 0.5, "{share}");
}

/// A number as a plant may write it: with thousands, with fixed decimals.
fn written(value: f64, decimal: char, thousands: Option<char>, digits: Option<usize>) -> String {
    let text = digits.map_or_else(|| value.to_string(), |digits| format!("{value:.digits$}"));
    let (whole, fraction) = text.split_once('.').map_or((text.as_str(), None), |(a, b)| (a, Some(b)));
    let (sign, whole) = whole.strip_prefix('-').map_or(("", whole), |rest| ("-", rest));
    let mut grouped = String::new();
    for (at, digit) in whole.chars().enumerate() {
        if let Some(thousands) = thousands.filter(|_| at > 0 && (whole.len() - at) % 3 == 0) {
            grouped.push(thousands);
        }
        grouped.push(digit);
    }
    let fraction = fraction.map(|f| format!("{decimal}{f}")).unwrap_or_default();
    format!("{sign}{grouped}{fraction}")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 250, ..ProptestConfig::default() })]

    /// Bytes changed, cut out and put in: a record, or a refusal in one line, soon.
    #[test]
    fn a_damaged_table_is_read_or_refused(
        record in records(),
        separator in pick(&[',', ';', '\t', '|']),
        date in pick(&Date::ALL),
        extra in pick(&Extra::ALL),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 0..12),
    ) {
        let form = Form { separator, decimal: '.', date, names: Names::Tags, extra };
        let (mut bytes, _) = dressed(&record, &form);
        for (at, byte, how) in damage {
            let at = at.index(bytes.len());
            match how {
                0 => bytes[at] = byte,
                1 => bytes.insert(at, byte),
                _ => drop(bytes.remove(at)),
            }
        }
        let began = Instant::now();
        match of_bytes(&bytes, &Options::default()) {
            Ok(found) => {
                let series = [&found.record.op, &found.record.pv];
                for sample in series.into_iter().flatten() {
                    prop_assert!(sample.t.is_finite());
                    prop_assert!(sample.value.is_finite() || !sample.quality.is_good());
                }
                prop_assert_eq!(found.found.read_as.lines().count(), 1);
            }
            Err(error) => prop_assert_eq!(error.lines().count(), 1, "{}", error),
        }
        prop_assert!(began.elapsed() < Duration::from_secs(20));
    }

    #[test]
    fn any_bytes_are_a_record_or_a_refusal(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = of_bytes(&bytes, &Options::default());
    }
}
