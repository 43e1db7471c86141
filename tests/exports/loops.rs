//! Which loop each tag belongs to, and what it is to it, where a store takes every tag of a table.

use super::clocks::civil;
use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use std::collections::BTreeMap;
use stictiond::signal::Record;
use stictiond::table::{Options, Source, TableError, stream};

fn of_loop(id: &str) -> Options {
    Options { of_loop: Some(id.into()), ..Options::default() }
}

/// A table of the example, `row` putting number, time, OP and PV into one or more lines.
fn made(header: &str, row: impl Fn(usize, &str, f64, f64) -> String) -> Vec<u8> {
    let Record { op, pv, .. } = example();
    let rows = op.iter().zip(&pv).enumerate().map(|(at, (op, pv))| {
        let time = civil("%Y-%m-%d %H:%M:%S%.3f", BEGIN as f64 + op.t);
        row(at, &time, op.value, pv.value) + "\n"
    });
    (header.to_string() + "\n" + &rows.collect::<String>()).into_bytes()
}

/// The value of a tag in a row, by its number, OP and PV.
type Value<'v> = &'v dyn Fn(usize, f64, f64) -> String;

/// Rows of one tag each, with values that need not be numbers.
fn long(tags: &[(&str, Value<'_>)]) -> Vec<u8> {
    made("Time,Tag,Value", |at, t, op, pv| {
        let rows: Vec<String> =
            tags.iter().map(|(tag, value)| format!("{t},{tag},\"{}\"", value(at, op, pv))).collect();
        rows.join("\n")
    })
}

/// What a store takes: how many samples of each tag of each loop are good, and the last value of them.
fn taken(table: &[u8], options: &Options) -> Result<BTreeMap<String, (usize, f64)>, String> {
    let mut all: BTreeMap<String, (usize, f64)> = BTreeMap::new();
    let read = stream::<TableError>(Source::Bytes(table), options, &mut |tag, sample| {
        let own = all.entry(format!("{} {}", tag.owner, tag.name)).or_default();
        if sample.quality.is_good() {
            *own = (own.0 + 1, sample.value);
        }
        Ok(())
    });
    read.map(|_| all).map_err(|error| error.to_string())
}

/// Names of loops and tags alone.
fn names(table: &[u8], options: &Options) -> Vec<String> {
    let taken = taken(table, options).unwrap_or_else(|said| panic!("{said}"));
    assert!(taken.values().all(|(good, _)| *good > 0), "{taken:?}");
    taken.into_keys().collect()
}

fn refused(table: &[u8], options: &Options, by: &[&str]) {
    let said = taken(table, options).map_or_else(|said| said, |taken| format!("{taken:?}"));
    by.iter().for_each(|by| assert!(said.contains(by), "{said:?} has no {by:?}"));
}

fn op(_: usize, op: f64, _: f64) -> String {
    op.to_string()
}

fn pv(_: usize, _: f64, pv: f64) -> String {
    pv.to_string()
}

fn always(value: &'static str) -> impl Fn(usize, f64, f64) -> String {
    move |_, _, _| value.to_string()
}

#[test]
fn the_tags_of_another_loop_are_never_those_of_the_loop_that_is_wanted() {
    let (held, sp, man) = (always("30.5"), always("77.7"), always("MAN"));
    let rows = long(&[
        ("FIC101.OP", &op),
        ("FIC101.PV", &pv),
        ("FIC102.OP", &held),
        ("FIC102.PV", &held),
        ("FIC102.SP", &sp),
        ("FIC102.MODE", &man),
        ("TI205.PV", &held),
        ("Flow", &held),
    ]);
    let taken = taken(&rows, &of_loop("FIC101")).expect("read");
    let keys: Vec<&str> = taken.keys().map(String::as_str).collect();
    let expected = [
        "FIC101 Flow",
        "FIC101 TI205.PV",
        "FIC101 op",
        "FIC101 pv",
        "FIC102 mode",
        "FIC102 op",
        "FIC102 pv",
        "FIC102 sp",
    ];
    assert_eq!(keys, expected);
    assert_eq!(taken["FIC101 op"], (1200, example().op[1199].value));
    assert_eq!(taken["FIC102 mode"], (1200, 0.0));
    refused(&rows, &of_loop("TIC7"), &["--loop \"TIC7\": no tag is of this loop", "--op and --pv"]);
    let told = Options { op: Some("FIC101.OP".into()), pv: Some("FIC101.PV".into()), ..of_loop("north") };
    let own = names(&long(&[("FIC101.OP", &op), ("FIC101.PV", &pv), ("FIC101.SP", &sp)]), &told);
    assert_eq!(own, ["FIC101 sp", "north op", "north pv"]);
}

#[test]
fn a_column_that_is_no_role_does_not_become_one() {
    let wide = made("Time,FIC101.OP,FIC101.PV,FIC102.OP,FIC102.PV,FIC102.SP,FIC102.MODE", |_, t, op, pv| {
        format!("{t},{op},{pv},30.5,20.1,77.7,MAN")
    });
    let own = names(&wide, &of_loop("FIC101"));
    let others = ["FIC101 FIC102.OP", "FIC101 FIC102.PV", "FIC101 FIC102.SP", "FIC101 op", "FIC101 pv"];
    assert_eq!(own, others);
    // Words of which no sample can be used are no mode, whatever they are called.
    let remark = made("Time,FIC101.OP,FIC101.PV,Modus 7", |_, t, op, pv| format!("{t},{op},{pv},x7"));
    assert_eq!(names(&remark, &Options::default()), ["FIC101 op", "FIC101 pv"]);
    let manual = made("Time,FIC101.OP,FIC101.PV,Manual mode", |at, t, op, pv| {
        format!("{t},{op},{pv},{}", if at < 600 { "No" } else { "Yes" })
    });
    let taken = taken(&manual, &of_loop("FIC101")).expect("read");
    assert_eq!(taken["FIC101 mode"], (1200, 0.0), "the last ones are in manual: {taken:?}");
}

#[test]
fn a_loop_is_called_as_its_tags_are_written() {
    for (op, pv, own) in [
        ("FIC101.OP", "FIC101.PV (m³/h)", "FIC101"),
        ("FIC-101/PID1/OUT.CV", "FIC-101/PID1/PV.CV", "FIC-101/PID1"),
        ("Root.Plant.FIC101.MV.Value", "Root.Plant.FIC101.PV.Value", "Root.Plant.FIC101"),
        ("SCADA1.FIC101_OP.F_CV", "SCADA1.FIC101_PV.F_CV", "SCADA1.FIC101"),
        ("FIC101_OP", "FIC101_PV", "FIC101"),
        ("FIC101OP", "FIC101PV", "FIC101"),
        ("FIC101.OP - Valve of the feed", "FIC101.PV - Flow", "FIC101"),
    ] {
        let wide = made(&format!("Time,{op},{pv},TI205"), |_, t, op, pv| format!("{t},{op},{pv},20.5"));
        let tags = ["TI205", "op", "pv"].map(|tag| format!("{own} {tag}"));
        assert_eq!(names(&wide, &Options::default()), tags, "{op}");
        let rows = long(&[(op, &self::op), (pv, &self::pv)]);
        assert_eq!(names(&rows, &Options::default()), tags[1..], "{op}");
    }
    let bare = made("Time,OP,PV", |_, t, op, pv| format!("{t},{op},{pv}"));
    refused(&bare, &Options::default(), &["names no loop; say which with --loop"]);
}

#[test]
fn each_loop_of_a_long_table_is_decided_with_all_its_tags() {
    let mode = |at: usize, _: f64, _: f64| if at < 300 { "AUTO" } else { "MAN" }.to_string();
    let centum = long(&[
        ("FIC101.MV", &op),
        ("FIC101.PV", &pv),
        ("FIC101.SV", &always("51")),
        ("FIC101.Betrieb", &mode),
        ("FIC102.OP", &op),
        ("FIC102.MV", &pv),
        ("FIC103.MV", &pv),
    ]);
    let taken = taken(&centum, &Options::default()).expect("read");
    let keys: Vec<&str> = taken.keys().map(String::as_str).collect();
    let expected =
        ["FIC101 mode", "FIC101 op", "FIC101 pv", "FIC101 sp", "FIC102 mv", "FIC102 op", "FIC103 mv"];
    assert_eq!(keys, expected, "an MV alone may be a position");
    assert_eq!(taken["FIC101 mode"], (1200, 0.0));
    // Three digits behind the sign in every cell of OP are decimals.
    let comma = |value: f64| format!("{value:.3}").replace('.', ",");
    let rows = made("Time;Tag;Value", |_, t, op, pv| {
        let (op, pv) = (comma(op.max(10.001)), comma(pv.max(10.001)));
        format!("{t};FIC101.OP;{op}\n{t};FIC101.PV;{pv}")
    });
    let taken = self::taken(&rows, &Options::default()).expect("decided by OP");
    assert!(taken["FIC101 op"].1 < 100.0, "{taken:?}");
}

#[test]
fn two_tags_for_one_role_of_a_loop_and_a_tag_that_is_not_there_are_asked_about() {
    let two = long(&[("FIC101.OP", &op), ("FIC101.OUT", &op), ("FIC101.PV", &pv)]);
    refused(&two, &Options::default(), &["\"FIC101.OP\", \"FIC101.OUT\" may each be op", "--op"]);
    let told = |op: &str| Options { op: Some(op.into()), ..Options::default() };
    let tags = ["FIC101 FIC101.OUT", "FIC101 op", "FIC101 pv"];
    assert_eq!(names(&two, &told("FIC101.OP")), tags);
    refused(&two, &told("FIC9.OP"), &["--op \"FIC9.OP\": no column is called so"]);
}

#[test]
fn a_column_of_assets_names_the_loop_of_bare_tags() {
    for header in
        ["Element,Attribute,Timestamp,Value", "Asset,Tag,Timestamp,Value", "device,metric,time,value"]
    {
        let rows = made(header, |_, t, op, pv| {
            format!("FIC101,OP,{t},{op}\nFIC101,PV,{t},{pv}\nFIC102,OP,{t},50\nFIC102,PV,{t},30")
        });
        let table = of_bytes(&rows, &of_loop("FIC101")).expect(header);
        assert!(bits(&table.record) == bits(&example()), "{header}: {}", table.found.read_as);
        let said = of_bytes(&rows, &Options::default()).err().unwrap_or_default();
        assert!(said.contains("several loops, \"FIC101\", \"FIC102\": say which with --loop"), "{said}");
        assert_eq!(names(&rows, &Options::default()), ["FIC101 op", "FIC101 pv", "FIC102 op", "FIC102 pv"]);
        // Tags that name their loops need no other column, and a plant that all rows have says nothing of the loop.
        let full = made(header, |_, t, op, pv| format!("North,FIC101.OP,{t},{op}\nSouth,FIC101.PV,{t},{pv}"));
        let one = made(header, |_, t, op, pv| format!("North,OP,{t},{op}\nNorth,PV,{t},{pv}"));
        for rows in [full, one] {
            let table = of_bytes(&rows, &of_loop("FIC101")).expect(header);
            assert!(bits(&table.record) == bits(&example()), "{header}: {}", table.found.read_as);
        }
    }
}

#[test]
fn columns_of_a_long_table_that_nothing_is_made_of_are_told() {
    let rows = made("Time,Tag,Value,Annotation,Empty,Batch", |_, t, op, pv| {
        format!("{t},FIC101.OP,{op},,,x\n{t},FIC101.PV,{pv},note,,y")
    });
    let table = of_bytes(&rows, &Options::default()).expect("read");
    let said = &table.found.read_as;
    assert!(said.contains("not used \"Annotation\", \"Batch\"") && !said.contains("Empty"), "{said}");
}

#[test]
fn a_letter_behind_op_and_pv_is_their_loop_and_two_loops_are_asked_about() {
    for [one, other] in [["B", "C"], ["A", "B"]] {
        let header = format!("Time,OP_{one},PV_{one},OP_{other},PV_{other}");
        let wide = made(&header, |_, t, op, pv| format!("{t},{op},{pv},30.5,20.1"));
        let said = of_bytes(&wide, &Options::default()).err().unwrap_or_default();
        let both = format!("\"OP_{one}\", \"OP_{other}\" may each be op");
        assert!(said.contains(&both) && said.contains("which loop with --loop"), "{said}");
        let table = of_bytes(&wide, &of_loop(one)).unwrap_or_else(|said| panic!("{header}: {said}"));
        assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
        let tags = ["OP", "PV"].map(|tag| [one, other].map(|letter| format!("{tag}_{letter}")));
        let [[op_one, op_other], [pv_one, pv_other]] = &tags;
        let rows = long(&[
            (op_one.as_str(), &op),
            (pv_one.as_str(), &pv),
            (op_other.as_str(), &pv),
            (pv_other.as_str(), &op),
        ]);
        let expected = [one, other].map(|own| ["op", "pv"].map(|tag| format!("{own} {tag}"))).concat();
        assert_eq!(names(&rows, &Options::default()), expected);
    }
    // One loop of this name is read, and has no unit by it.
    let single = made("Time,OP_A,PV_A", |_, t, op, pv| format!("{t},{op},{pv}"));
    let table = of_bytes(&single, &Options::default()).expect("one loop");
    assert!(bits(&table.record) == bits(&example()), "{}", table.found.read_as);
    assert!(table.found.read_as.contains("op from \"OP_A\", pv from \"PV_A\""), "{}", table.found.read_as);
    assert_eq!(table.record.op_span, Some(100.0));
    // Volts, or a loop that PV is not of.
    let volts = made("Time,OP V,PV", |_, t, op, pv| format!("{t},{op},{pv}"));
    let said = of_bytes(&volts, &Options::default()).err().unwrap_or_default();
    assert!(said.contains("\"OP V\"") && said.contains("--op and --pv"), "{said}");
}

#[test]
fn a_letter_behind_the_pv_of_a_named_controller_leaves_it_in_its_loop() {
    let wide =
        made("Time,TIC101.OP %,TIC101.PV C,TIC101.PV_status", |_, t, op, pv| format!("{t},{op},{pv},Good"));
    assert_eq!(names(&wide, &Options::default()), ["TIC101 op", "TIC101 pv"]);
    let rows = long(&[("TIC101.OP", &op), ("TIC101.PV C", &pv), ("FIC102.OP", &op), ("FIC102.PV", &pv)]);
    assert_eq!(names(&rows, &Options::default()), ["FIC102 op", "FIC102 pv", "TIC101 op", "TIC101 pv"]);
}
