//! Rows of two loops in one table, told apart by a column of any name: they are refused, and with `--loop` those of one are read. What
//! changes beside one loop is no loop.

use super::clocks::civil;
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::signal::{Record, Sample};
use stictiond::table::{Options, Source, TableError, stream};

fn of_loop(id: &str) -> Options {
    Options { of_loop: Some(id.into()), ..Options::default() }
}

/// Samples of OP and PV, side by side.
fn pairs() -> Vec<(Sample, Sample)> {
    let Record { op, pv, .. } = example();
    op.into_iter().zip(pv).collect()
}

fn iso(t: f64) -> String {
    civil("%Y-%m-%d %H:%M:%S%.3f", BEGIN as f64 + t)
}

/// The rows of a loop and of a second one: its name, its time, and its values.
type Row = (&'static str, String, f64, f64);

/// The example and a second loop with other values, its rows so much later.
fn two(words: [&'static str; 2], later: f64) -> Vec<[Row; 2]> {
    let row = |(op, pv): &(Sample, Sample)| {
        let second = (words[1], iso(op.t + later), 100.0 - op.value, pv.value + 20.0);
        [(words[0], iso(op.t), op.value, pv.value), second]
    };
    pairs().iter().map(row).collect()
}

fn wide(name: &str, rows: impl Iterator<Item = Row>) -> Vec<u8> {
    let rows = rows.map(|(word, t, op, pv)| format!("{t},{word},{op},{pv}\n"));
    format!("Time,{name},OP,PV\n{}", rows.collect::<String>()).into_bytes()
}

fn long(name: &str, rows: impl Iterator<Item = Row>) -> Vec<u8> {
    let rows = rows.map(|(word, t, op, pv)| format!("{t},OP,{op},{word}\n{t},PV,{pv},{word}\n"));
    format!("Time,Tag,Value,{name}\n{}", rows.collect::<String>()).into_bytes()
}

/// Why a table is neither read nor taken into a store.
fn refused(table: &[u8], options: &Options) -> [String; 2] {
    let read = of_bytes(table, options).map(|table| table.found.read_as);
    let taken = stream::<TableError>(Source::Bytes(table), options, &mut |_, _| Ok(()));
    let taken = taken.map(|found| found.read_as).map_err(|error| error.to_string());
    [read, taken].map(|said| said.map_or_else(|said| said, |read_as| panic!("read as {read_as}")))
}

#[test]
fn two_loops_under_any_name_are_refused_and_one_is_read_by_its_name() {
    let tables = |name: &str, words: [&'static str; 2], later: f64| {
        let rows = &two(words, later);
        let in_turn = || rows.iter().flatten().cloned();
        let stacked = || [0, 1].into_iter().flat_map(move |of| rows.iter().map(move |pair| pair[of].clone()));
        [wide(name, in_turn()), wide(name, stacked()), long(name, in_turn()), long(name, stacked())]
    };
    // Names and offsets are also combined at random, in `random_mixed`.
    for (name, words, later) in [
        ("Train", ["A", "B"], 0.0),
        ("Unit", ["1", "2"], 0.7),
        ("Station", ["North", "South"], 1.0),
        ("Id", ["101", "102"], 0.0),
        ("Serial", ["A1B", "A1C"], 0.7),
        ("x", ["A", "B"], 1.0),
    ] {
        for table in tables(name, words, later) {
            let told = format!("the rows are of several {name:?}: {:?}, {:?}; keep", words[0], words[1]);
            for said in refused(&table, &Options::default()) {
                assert!(said.contains(&told) && said.contains("say which with --loop"), "{said}");
            }
            for said in refused(&table, &of_loop("FIC7")) {
                assert!(said.contains("and none is \"FIC7\" (--loop)"), "{said}");
            }
            let one = of_bytes(&table, &of_loop(words[0])).unwrap_or_else(|said| panic!("{name}: {said}"));
            assert!(bits(&one.record) == bits(&example()), "{name}, {later} s: {}", one.found.read_as);
            let other = of_bytes(&table, &of_loop(words[1])).expect("the other");
            assert_eq!(other.record.op[7].value, 100.0 - example().op[7].value, "{name}, {later} s");
        }
    }
}

#[test]
fn a_store_takes_the_rows_of_the_wanted_loop_alone() {
    let rows = || two(["A", "B"], 1.0).into_iter().flatten();
    for table in [wide("Train", rows()), long("Train", rows())] {
        let mut taken: Vec<(String, String, f64)> = Vec::new();
        stream::<TableError>(Source::Bytes(&table), &of_loop("B"), &mut |tag, sample| {
            taken.push((tag.owner.clone(), tag.name.clone(), sample.value));
            Ok(())
        })
        .expect("told");
        let op = taken.iter().filter(|(owner, name, _)| owner == "B" && name == "op");
        let op: Vec<f64> = op.map(|(.., value)| *value).collect();
        assert_eq!(op, example().op.iter().map(|own| 100.0 - own.value).collect::<Vec<_>>());
        assert!(taken.iter().all(|(owner, ..)| owner == "B"), "{:?}", &taken[..4]);
    }
}

#[test]
fn bits_counters_alarms_and_modes_beside_one_loop_are_none() {
    let every = |n: usize, words: &'static [&'static str]| {
        move |at: usize| words.get(at / n % words.len()).copied().unwrap_or_default()
    };
    type OfRow = Box<dyn Fn(usize) -> &'static str>;
    let columns: [(&str, OfRow); 7] = [
        ("Heartbeat", Box::new(every(1, &["0", "1"]))),
        ("Watchdog", Box::new(every(1, &["tick", "tock"]))),
        ("Cycle", Box::new(every(1, &["1", "2", "3", "4"]))),
        ("Event", Box::new(every(1, &["IOP", "HI", "NR"]))),
        ("Shift", Box::new(every(300, &["early", "late"]))),
        ("Step", Box::new(every(100, &["1", "2", "3"]))),
        ("Plant state", Box::new(every(500, &["running", "waiting"]))),
    ];
    for (name, word) in columns {
        let row = |(at, (op, pv)): (usize, (Sample, Sample))| (word(at), iso(op.t), op.value, pv.value);
        let rows = || pairs().into_iter().enumerate().map(row);
        for table in [wide(name, rows()), long(name, rows())] {
            let read = of_bytes(&table, &Options::default()).unwrap_or_else(|said| panic!("{name}: {said}"));
            assert!(bits(&read.record) == bits(&example()), "{name}: {}", read.found.read_as);
        }
    }
}

#[test]
fn a_title_or_a_second_header_between_samples_is_that_of_another_table() {
    let rows = |at: usize| {
        let row = |(op, pv): &(Sample, Sample)| format!("{},{},{}\n", iso(op.t), op.value, pv.value);
        pairs().iter().skip(600 * at).take(600).map(row).collect::<String>()
    };
    let divided = |first: &str, between: &str| {
        format!("{first}Time,OP,PV\n{}{between}{}", rows(0), rows(1)).into_bytes()
    };
    for (first, between, told) in [
        ("Feed flow\n", "\nReflux flow\nTime,OP,PV\n", "line 604: \"Reflux flow\" stands above the header"),
        ("Loop 1, 15.06.2026\n", "Loop 2, 16.06.2026\nTime,OP,PV\n", "\"Loop 2 16.06.2026\" stands above"),
        ("Loop 1\n", "Loop 2\nTime,OP,PV\n", "\"Loop 2\" stands above the header"),
        ("", "Reflux flow,,\nTime,OP,PV\n", "\"Reflux flow\" stands above the header"),
        ("", "Zeit,Stellgröße,Istwert\n", "\"Zeit Stellgröße Istwert\" is a second header"),
    ] {
        for said in refused(&divided(first, between), &of_loop("FIC1")) {
            assert!(said.contains(told), "{between:?}: {said}");
        }
    }
    let whole = |table: &[u8]| {
        let read = of_bytes(table, &Options::default()).unwrap_or_else(|said| panic!("{said}"));
        assert!(bits(&read.record) == bits(&example()), "{}", read.found.read_as);
    };
    whole(&divided("", "Time,OP,PV\n"));
    whole(&divided("Feed flow\n", "Feed flow\nTime,OP,PV\n"));
    whole(&divided("Trend, page 1\n", "Trend, page 2\nTime,OP,PV\n"));
    whole(&divided("", "Valve was greased\n"));
    // A title for each day, or for each print.
    whole(&divided("Daily report 15.06.2026\n", "Daily report 16.06.2026\nTime,OP,PV\n"));
    whole(&divided("Printed 2026-06-15 06:05 AM\n", "Printed 2026-06-15 06:25 PM\nTime,OP,PV\n"));
    whole(&divided("From 06:00 to 07:00\n", "From 07:00 to 08:00\nTime,OP,PV\n"));
    // A footer comes again, the last time below the samples.
    let mut with_footers = divided("", "Printed by Ann\nTime,OP,PV\n");
    with_footers.extend_from_slice(b"Printed by Ann\n");
    whole(&with_footers);
}

#[test]
fn parts_of_one_record_and_two_hosts_at_the_same_times_are_one_loop() {
    let rows: Vec<(String, f64, f64)> =
        pairs().iter().map(|(op, pv)| (iso(op.t), op.value, pv.value)).collect();
    let is_whole = |what: &str, rows: &[String]| {
        let text = format!("Time,Lot,OP,PV\n{}", rows.concat());
        let read =
            of_bytes(text.as_bytes(), &Options::default()).unwrap_or_else(|said| panic!("{what}: {said}"));
        let mut sorted = read.record.clone();
        sorted.op.sort_by(|a, b| a.t.total_cmp(&b.t));
        sorted.pv.sort_by(|a, b| a.t.total_cmp(&b.t));
        assert!(bits(&sorted) == bits(&example()), "{what}: {}", read.found.read_as);
        let at_one_time = sorted.op.iter().zip(&sorted.pv).all(|(op, pv)| op.t == pv.t);
        assert!(at_one_time, "{what}: {}", read.found.read_as);
    };
    // The newest part first, each in the order of its times.
    let part = |at: usize| rows.iter().skip(400 * at).take(400);
    let parts: Vec<String> = [2, 1, 0]
        .into_iter()
        .flat_map(|at| part(at).map(move |(t, op, pv)| format!("{t},B{at},{op},{pv}\n")))
        .collect();
    is_whole("parts", &parts);
    // A row for each host at each time, with one value.
    let host = |(t, op, pv): &(String, f64, f64)| format!("{t},plc1,{op},\n{t},plc2,,{pv}\n");
    is_whole("hosts", &rows.iter().map(host).collect::<Vec<String>>());
}
