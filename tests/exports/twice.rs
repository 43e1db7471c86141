//! Times that are recorded twice in one file, and files in another order than that of time: the first are refused, the others are one
//! record. `diagnose` and an import into a store say the same.

use super::clocks::civil;
use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::{Record, Sample};
use stictiond::table::{Options, Source, Table, TableError, Tag, stream};

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S%.3f", t)
}

/// What an import of a table says: how many samples it takes of how many, or why none.
pub fn imported(text: &str, options: &Options) -> Result<usize, String> {
    let options = Options { of_loop: Some("FIC101".into()), ..options.clone() };
    let mut taken = 0;
    let mut take = |_: &Tag, _: Sample| {
        taken += 1;
        Ok::<(), TableError>(())
    };
    stream(Source::Bytes(text.as_bytes()), &options, &mut take).map_err(|error| error.to_string())?;
    Ok(taken)
}

/// Both refuse a table for the same reason, and an import takes nothing of it.
fn refused(rows: &[String], by: &str) {
    let text = format!("Time,OP,PV\n{}\n", rows.join("\n"));
    let said = of_bytes(text.as_bytes(), &Options::default()).map(|table| table.found.read_as);
    assert!(said.as_ref().is_err_and(|said| said.contains(by)), "{said:?} has no {by:?}");
    let options = Options { of_loop: Some("FIC101".into()), ..Options::default() };
    let mut take =
        |_: &Tag, sample: Sample| Err::<(), _>(TableError::Refused(format!("{sample:?} is taken")));
    let taken = stream(Source::Bytes(text.as_bytes()), &options, &mut take).map(|found| found.read_as);
    assert_eq!(taken.map_err(|error| error.to_string()), said);
}

/// Both read a table as the example, whatever the order of its rows.
fn is_example(what: &str, rows: &[String]) -> Table {
    let table = read("Time,OP,PV", rows, &Options::default()).unwrap_or_else(|said| panic!("{what}: {said}"));
    let mut sorted = table.record.clone();
    for series in [&mut sorted.op, &mut sorted.pv] {
        series.sort_by(|a, b| a.t.total_cmp(&b.t));
        series.dedup();
    }
    assert!(bits(&sorted) == bits(&example()), "{what}: {}", table.found.read_as);
    let text = format!("Time,OP,PV\n{}\n", rows.join("\n"));
    assert_eq!(imported(&text, &Options::default()), Ok(2 * rows.len()), "{what}");
    table
}

/// Another record, which is later by some seconds.
fn other(by: f64) -> Record {
    let moved = |series: &[Sample], of: fn(f64) -> f64| -> Vec<Sample> {
        series.iter().map(|own| Sample { t: own.t + by, value: of(own.value), ..*own }).collect()
    };
    let example = example();
    Record {
        op: moved(&example.op, |value| 100.0 - value),
        pv: moved(&example.pv, |value| value + 20.0),
        ..example
    }
}

#[test]
fn two_loops_below_each_other_are_refused_whatever_their_stamps() {
    let first = rows(&example(), ',', iso);
    for by in [0.7, 0.0] {
        let second = rows(&other(by), ',', iso);
        refused(&[first.clone(), second.clone()].concat(), "line 1202: times go back over 2");
        let turned = |rows: &[String]| rows.iter().rev().cloned().collect::<Vec<String>>();
        refused(&turned(&[first.clone(), second].concat()), "times go forward over 2");
    }
    // One behind the other is no contradiction.
    let last = example().op.last().map_or(0.0, |own| own.t);
    let both = [first, rows(&other(last + 2.0), ',', iso)].concat();
    assert!(read("Time,OP,PV", &both, &Options::default()).is_ok());
}

#[test]
fn a_clock_that_is_set_back_is_refused_with_the_line() {
    for (by, said) in [(900.0, "over 898 s"), (300.0, "over 298 s"), (60.0, "over 58 s")] {
        let mut moved = example();
        for series in [&mut moved.op, &mut moved.pv] {
            series.iter_mut().skip(600).for_each(|own| own.t -= by);
        }
        refused(
            &rows(&moved, ',', iso),
            &format!("line 602: times go back {said} that are recorded already"),
        );
    }
}

#[test]
fn rows_of_one_record_may_stand_in_any_order() {
    let whole = rows(&example(), ',', iso);
    let blocks = |order: [usize; 6]| -> Vec<String> {
        order.iter().flat_map(|at| whole[200 * at..200 * (at + 1)].iter().cloned()).collect()
    };
    is_example("newest first", &whole.iter().rev().cloned().collect::<Vec<String>>());
    let table = is_example("blocks by their names", &blocks([3, 1, 0, 5, 4, 2]));
    assert!(table.found.read_as.contains("rows are sorted"), "{}", table.found.read_as);
    is_example("the last block first", &blocks([5, 4, 3, 2, 1, 0]));
    is_example("overlapping exports", &[&whole[..700], &whole[500..]].concat());
    let mut late = whole.clone();
    for at in (0..1100).step_by(40) {
        let row = late.remove(at);
        late.insert(at + 30, row);
    }
    is_example("late rows", &late);
    let buffered = [&whole[..300], &whole[310..400], &whole[300..310], &whole[400..]].concat();
    let table = is_example("a buffer that came late", &buffered);
    assert!(table.found.read_as.contains("times go back over"), "{}", table.found.read_as);
}

#[test]
fn each_tag_of_rows_of_tags_is_looked_at() {
    let long = |record: &Record| -> Vec<String> {
        let of = |tag: &str, series: &[Sample]| -> Vec<String> {
            let row = |own: &Sample| format!("{},{tag},{}", iso(BEGIN as f64 + own.t), own.value);
            series.iter().map(row).collect()
        };
        [of("FIC101.OP", &record.op), of("FIC101.PV", &record.pv)].concat()
    };
    let header = "Time,Tag,Value";
    let (one, two) = (long(&example()), long(&other(0.7)));
    let table = read(header, &one, &Options::default()).unwrap_or_else(|said| panic!("{said}"));
    assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
    let both = [one, two].concat();
    let said = read(header, &both, &Options::default()).map(|table| table.found.read_as);
    let by = "line 2402, tag \"FIC101.OP\": times go back over";
    assert!(said.as_ref().is_err_and(|said| said.starts_with(by)), "{said:?}");
    let text = format!("{header}\n{}\n", both.join("\n"));
    assert_eq!(imported(&text, &Options::default()).err(), said.err());
}

#[test]
fn many_tags_in_many_blocks_with_the_newest_first_are_taken() {
    // More runs than are kept of all tags together.
    let (columns, blocks) = (300, 900);
    let names: Vec<String> = (3..=columns).map(|at| format!("TI{at}")).collect();
    let mut text = format!("Time,OP,PV,{}\n", names.join(","));
    let mut rows = 0;
    for block in (0..blocks).rev() {
        for within in 0..4 {
            let t = BEGIN as f64 + 86_400.0 * f64::from(block) + 60.0 * f64::from(within);
            text += &iso(t);
            for column in 0..columns {
                let value = (rows * 37 + column * 11) % 997;
                text += &format!(",{:.3}", 20.0 + 0.037 * value as f64);
            }
            text.push('\n');
            rows += 1;
        }
    }
    assert_eq!(imported(&text, &Options::default()), Ok(rows * columns));
}

#[test]
fn values_that_came_later_are_no_other_ones() {
    let whole = rows(&example(), ',', iso);
    let with = |own: &[String], word: &str| -> Vec<String> {
        own.iter().map(|row| format!("{row},{word}")).collect()
    };
    let other = |own: &[String], cells: &str| -> Vec<String> {
        own.iter().map(|row| format!("{},{cells}", &row[..row.find(',').unwrap_or(row.len())])).collect()
    };
    let read_as = |header: &str, tail: &[String], rest: &[String]| {
        let rows = [&rest[..500], tail, &rest[500..]].concat();
        read(header, &rows, &Options::default()).map(|table| {
            let of = |series: &[Sample]| series.iter().filter(|own| own.quality.is_good()).copied().collect();
            let record = Record { op: of(&table.record.op), pv: of(&table.record.pv), ..table.record };
            bits(&record) == bits(&example())
        })
    };
    let late = &whole[500..600];
    assert_eq!(read_as("Time,OP,PV", &other(late, "No Data,No Data"), &whole), Ok(true));
    let good = with(&whole, "Good");
    assert_eq!(read_as("Time,OP,PV,Quality", &other(late, "0.1,0.2,Bad"), &good), Ok(true));
    let said = read_as("Time,OP,PV,Quality", &other(late, "0.1,0.2,Good"), &good);
    assert!(said.as_ref().is_err_and(|said| said.contains("with other values")), "{said:?}");
}

#[test]
fn a_clock_that_was_set_right_by_some_seconds_is_told() {
    let mut moved = example();
    for series in [&mut moved.op, &mut moved.pv] {
        series.iter_mut().skip(600).for_each(|own| own.t -= 17.0);
    }
    let rows = rows(&moved, ',', iso);
    let table = read("Time,OP,PV", &rows, &Options::default()).unwrap_or_else(|said| panic!("{said}"));
    let said = &table.found.read_as;
    let told = said.contains("in line 602 that are recorded already")
        && said.contains("of 1200 rows: rows are sorted");
    assert!(told, "{said}");
    let text = format!("Time,OP,PV\n{}\n", rows.join("\n"));
    assert_eq!(imported(&text, &Options::default()), Ok(2 * rows.len()));
}
