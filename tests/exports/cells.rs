//! Cells, columns and rows that are not what they seem: they are read as they were written, or refused with what decides.

use super::clocks::civil;
use super::doubts::{read, rows};
use super::dress::BEGIN;
use super::{bits, example};
use stictiond::signal::Sample;
use stictiond::table::{Options, Source, Table, TableError, stream};

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S%.3f", t)
}

fn whole_seconds(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S", t)
}

fn plain() -> Options {
    Options::default()
}

/// Options by their names.
fn told(pairs: &[(&str, &str)]) -> Options {
    let mut options = Options::default();
    for (name, value) in pairs {
        assert!(options.set(name, (*value).to_string()), "{name}");
    }
    options
}

fn refused(table: Result<Table, String>, by: &[&str]) {
    let said = table.map_or_else(|said| said, |table| panic!("read as {}", table.found.read_as));
    by.iter().for_each(|by| assert!(said.contains(by), "{said:?} has no {by:?}"));
}

/// What is said of a table that has to be the whole example.
fn is_whole(table: Result<Table, String>, what: &str) -> String {
    let table = table.unwrap_or_else(|said| panic!("{what}: {said}"));
    assert!(bits(&table.record) == bits(&example()), "{what}: {}", table.found.read_as);
    table.found.read_as
}

fn bad(series: &[Sample]) -> usize {
    series.iter().filter(|sample| !sample.quality.is_good()).count()
}

/// The example's rows with a word behind each.
fn beside(word: impl Fn(usize) -> &'static str) -> Vec<String> {
    rows(&example(), ',', iso).iter().enumerate().map(|(at, row)| format!("{row},{}", word(at))).collect()
}

#[test]
fn values_of_the_mode_without_a_mode_are_refused() {
    let own = beside(|at| if at < 700 { "2" } else { "1" });
    for name in ["Md", "FIC101_STATE", "MD_ACT", "Regler 1"] {
        let header = format!("Time,OP,PV,{name}");
        let auto = told(&[("auto_values", "2")]);
        refused(read(&header, &own, &auto), &["--auto-values: no column is the mode", "--mode"]);
        let both = told(&[("auto_values", "2"), ("mode", name)]);
        let table = read(&header, &own, &both).unwrap_or_else(|said| panic!("{name}: {said}"));
        let on = table.record.mode.iter().flatten().filter(|mode| mode.value == 1.0).count();
        assert_eq!(on, 700, "{name}: {}", table.found.read_as);
    }
}

#[test]
fn a_few_cells_with_the_other_decimal_sign_are_refused() {
    let number = |value: f64, digits: usize, sign: &str| format!("{value:.digits$}").replace('.', sign);
    let made = |usual: &str, odd: &str, in_op: bool| -> Vec<String> {
        let all = example();
        let row = |(at, (op, pv)): (usize, (&Sample, &Sample))| {
            let other = |of_op: bool| at % 300 == 0 && of_op == in_op;
            let cell = |value: f64, of_op: bool| match other(of_op) {
                true => number(value, 3, odd),
                false => number(value, 2, usual),
            };
            format!(
                "{};{};{}",
                whole_seconds(BEGIN as f64 + op.t),
                cell(op.value, true),
                cell(pv.value, false)
            )
        };
        all.op.iter().zip(&all.pv).enumerate().map(row).collect()
    };
    for (usual, odd, word) in
        [(",", ".", "has a point before three digits"), (".", ",", "has a comma before")]
    {
        for in_op in [true, false] {
            let own = made(usual, odd, in_op);
            refused(read("Time;OP;PV", &own, &plain()), &["line 2", word, "--decimal"]);
            let table = read("Time;OP;PV", &own, &told(&[("decimal", usual)])).expect("told");
            let odd = if in_op { table.record.op[0].value } else { table.record.pv[0].value };
            assert!(odd > 10_000.0, "the other sign marks thousands, as was told: {odd}");
        }
    }
    // Thousands with decimals behind them prove both signs.
    let all = example();
    let grouped = |value: f64| format!("{}.{:03}", (value / 1000.0).floor(), value % 1000.0);
    let row = |(at, (op, pv)): (usize, (&Sample, &Sample))| {
        let pv = (pv.value * 40.0).round();
        let pv = if at % 3 == 0 { grouped(pv) + ",5" } else { grouped(pv) };
        format!("{};{};{pv}", whole_seconds(op.t + BEGIN as f64), number(op.value, 2, ","))
    };
    let own: Vec<String> = all.op.iter().zip(&all.pv).enumerate().map(row).collect();
    let table = read("Time;OP;PV", &own, &plain()).expect("thousands");
    assert!(table.record.pv.iter().all(|own| (1000.0..4000.0).contains(&own.value)));
}

#[test]
fn numbers_under_q_are_asked_about_as_letters_are() {
    let own = beside(|at| if at % 40 == 0 { "0" } else { "1" });
    for name in ["Q", "ST"] {
        let header = format!("Time,OP,PV,{name}");
        refused(read(&header, &own, &plain()), &["column 4", "\"1\" (1170 rows)", "--good-values"]);
        let table = read(&header, &own, &told(&[("good_values", "1")])).expect("told");
        assert_eq!((bad(&table.record.op), bad(&table.record.pv)), (30, 30), "{}", table.found.read_as);
    }
    let known = beside(|at| if at % 40 == 0 { "0" } else { "192" });
    assert_eq!(bad(&read("Time,OP,PV,Q", &known, &plain()).expect("OPC").record.pv), 30);
    for (name, word) in [("Q", "1"), ("Q [m3/h]", "7")] {
        is_whole(read(&format!("Time,OP,PV,{name}"), &beside(|_| word), &plain()), name);
    }
    let flow = beside(|at| if at % 40 == 0 { "0" } else { "1" });
    is_whole(read("Time,OP,PV,Q [m3/h]", &flow, &plain()), "a flow");
}

#[test]
fn decimal_commas_that_divide_cells_under_a_header_with_spare_columns_are_refused() {
    let all = example();
    let cells = |value: f64| format!("{value:.1}").replace('.', ",");
    let row = |(op, pv): (&Sample, &Sample)| {
        format!("{},{},{}", whole_seconds(BEGIN as f64 + op.t), cells(op.value), cells(pv.value))
    };
    let own: Vec<String> = all.op.iter().zip(&all.pv).map(row).collect();
    let by = ["column 4", "no name", "decimal commas", "semicolons"];
    refused(read("Time,OP,PV,,", &own, &plain()), &by);
    let timed: Vec<String> =
        own.iter().enumerate().map(|(at, row)| format!("{at},5{}", &row[19..])).collect();
    refused(read("t,OP,PV,,,", &timed, &plain()), &by);
    assert!(read("Time,OP,PV,A,B", &own, &plain()).is_ok(), "columns of their own");
    // Spare columns with nothing in them.
    is_whole(read("Time,OP,PV,,", &beside(|_| ","), &plain()), "spare");
}

#[test]
fn a_blank_behind_the_sign_of_a_comment_is_no_column() {
    let all = example();
    let row = |(at, (op, pv)): (usize, (&Sample, &Sample))| (at, op.t, op.value, pv.value);
    let values: Vec<(usize, f64, f64, f64)> = all.op.iter().zip(&all.pv).enumerate().map(row).collect();
    let numpy: Vec<String> = values.iter().map(|(_, t, op, pv)| format!("{t:.3} {op} {pv}")).collect();
    let said = is_whole(read("# t op pv", &numpy, &plain()), "numpy");
    assert!(said.contains("op from \"op\", pv from \"pv\""), "{said}");
    let longer: Vec<String> = numpy.iter().map(|row| row.clone() + " 50.5").collect();
    is_whole(read("# t op pv sp", &longer, &plain()), "four columns");
    let scientific: Vec<String> =
        values.iter().map(|(_, t, op, pv)| format!("{t:.18e} {op:.18e} {pv:.18e}")).collect();
    is_whole(read("# t op pv", &scientific, &plain()), "as numpy writes numbers");
    // Row numbers under `#`.
    let numbered: Vec<String> =
        values.iter().map(|(at, t, op, pv)| format!("{at},{},{op},{pv}", iso(BEGIN as f64 + t))).collect();
    is_whole(read("#,Time,OP,PV", &numbered, &plain()), "row numbers");
}

#[test]
fn a_store_names_the_tag_that_has_no_loop() {
    let all = example();
    let row = |tag: u32, own: &Sample| format!("{tag},{},{:.0}\n", own.value, (BEGIN as f64 + own.t) * 1e3);
    let op: String = all.op.iter().map(|own| row(1, own)).collect();
    let pv: String = all.pv.iter().map(|own| row(2, own)).collect();
    let table = format!("tagid,floatvalue,t_stamp\n{op}{pv}").into_bytes();
    let options = told(&[("op", "1"), ("pv", "2"), ("tag", "tagid"), ("value", "floatvalue")]);
    let taken = |options: &Options| -> Result<usize, String> {
        let mut count = 0;
        let read = stream::<TableError>(Source::Bytes(&table), options, &mut |_, _| {
            count += 1;
            Ok(())
        });
        read.map(|_| count).map_err(|error| error.to_string())
    };
    assert_eq!(taken(&options), Err("\"1\" names no loop; say which with --loop".into()));
    assert_eq!(taken(&Options { of_loop: Some("FIC1".into()), ..options }), Ok(2 * all.op.len()));
}

#[test]
fn a_sample_is_not_shown_as_the_header() {
    let own = rows(&example(), ',', iso);
    let long: Vec<String> = own
        .iter()
        .flat_map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            [format!("FIC101.OP,{},{}", cells[0], cells[1]), format!("FIC101.PV,{},{}", cells[0], cells[2])]
        })
        .collect();
    for header in [
        "PointName,SampleTime,SampleValue",
        "node_id,timestamp,value",
        "Bezeichnung,Zeitstempel,Messwert",
        "Nom,Horodatage,Valeur",
    ] {
        is_whole(read(header, &long, &plain()), header);
    }
    refused(read("Pt,When,What", &long, &plain()), &["line 1", "the header has \"Pt\", \"When\", \"What\""]);
}

#[test]
fn a_row_of_totals_is_left_out_and_told() {
    for word in ["Total", "Summe:", "AVERAGE"] {
        for last in [format!("2026-06-01 06:40:00,{word},61234"), format!("2026-06-01 06:40:00,60000,{word}")]
        {
            let mut own = rows(&example(), ',', iso);
            own.push(last);
            let said = is_whole(read("Time,OP,PV", &own, &plain()), word);
            assert!(said.contains("1 row left out: line 1202"), "{said}");
        }
    }
}

#[test]
fn names_of_times_and_values_that_were_once_unknown_are_read() {
    let own = rows(&example(), ',', iso);
    for header in ["Local time,OP,PV", "UTC time,OP,PV", "StartTime,OP,PV", "Aika,Ohjaus,Mittaus"] {
        is_whole(read(header, &own, &plain()), header);
    }
    let with = |other: f64| -> Vec<String> {
        own.iter()
            .zip(&example().op)
            .map(|(row, op)| format!("{},{row}", iso(BEGIN as f64 + op.t + other)))
            .collect()
    };
    // The time that is in no zone is taken, and that at which an interval begins.
    let table = read("Local time,UTC time,OP,PV", &with(7200.0), &plain()).expect("two times");
    assert_eq!(table.record.op[0].t, BEGIN as f64, "{}", table.found.read_as);
    let ended: Vec<String> = own.iter().map(|row| row.replacen(',', ",2026-06-01 09:00:00,", 1)).collect();
    is_whole(read("StartTime,EndTime,OP,PV", &ended, &plain()), "an interval");
    is_whole(read("Start time,Time,OP,PV", &with(-2.0), &plain()), "a better time");
    let mark = |t: f64| format!("\u{200e}{}", civil("%d.%m.%Y %H:%M:%S", t).replace('.', ".\u{200e}"));
    let marked = rows(&example(), ',', mark);
    is_whole(read("Time,OP,PV", &marked, &plain()), "marks of direction");
}

#[test]
fn a_range_in_the_header_is_the_span_of_op() {
    let all = example();
    for (header, factor, digits, span) in [
        ("Time,OP (0-27648),PV", 276.48, 0, 27_648.0),
        ("Time,OP [0...32767],PV", 327.67, 0, 32_767.0),
        ("Time,OP [0..1],PV", 0.01, 5, 1.0),
        ("Time,OP (0-100),PV", 1.0, 3, 100.0),
    ] {
        let row = |(op, pv): (&Sample, &Sample)| {
            let value = op.value * factor;
            format!("{},{value:.digits$},{:.2}", iso(BEGIN as f64 + op.t), pv.value)
        };
        let own: Vec<String> = all.op.iter().zip(&all.pv).map(row).collect();
        let table = read(header, &own, &plain()).unwrap_or_else(|said| panic!("{header}: {said}"));
        assert_eq!(table.record.op_span, Some(span), "{header}: {}", table.found.read_as);
        assert_eq!(table.record.op_span_source.as_str(), "unit", "{header}");
    }
}
