//! Columns that say whether a value is good: whatever they are called and wherever they stand, a bad value is never used.

use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::collect::table::{Options, Table};
use stictiond::signal::Record;

/// Whether the PV of row k is bad.
fn is_bad(k: usize) -> bool {
    k % 3 == 1
}

/// The example with every third PV replaced by nonsense; `row` puts time, OP, PV and PV's quality into a line.
fn spoilt(header: &str, words: [&str; 2], row: impl Fn(f64, f64, f64, &str) -> String) -> Vec<u8> {
    let example = example();
    let rows = example.op.iter().zip(&example.pv).enumerate().map(|(k, (op, pv))| {
        let (value, word) = if is_bad(k) { (99.0, words[1]) } else { (pv.value, words[0]) };
        row(BEGIN as f64 + op.t, op.value, value, word)
    });
    (header.to_string() + &rows.collect::<String>()).into_bytes()
}

/// Checks that exactly the spoilt values of PV are bad, and those of OP only where the quality is the row's.
fn assert_left_out(name: &str, table: Result<Table, String>, of_row: bool) {
    let Record { op, pv, .. } = table.unwrap_or_else(|error| panic!("{name}: {error}")).record;
    assert_eq!(pv.len(), example().pv.len(), "{name}");
    for (k, (op, pv)) in op.iter().zip(&pv).enumerate() {
        assert_eq!(pv.quality.is_good(), !is_bad(k), "{name}: PV of row {k}");
        assert_eq!(op.quality.is_good(), !(of_row && is_bad(k)), "{name}: OP of row {k}");
    }
}

#[test]
fn a_column_that_tells_good_from_bad_is_known_by_what_stands_in_it() {
    let words = ["Good", "Bad CommFailure"];
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    for (header, of_row) in [
        ("Time,FC101.OP,FC101.PV,FC101.PV.STS\n", false),
        ("Time,FC101.OP,FC101.PV,PV State\n", false),
        ("Time,FC101.OP,FC101.PV,FC101.PV_FLAG\n", false),
        ("Time,FC101.OP,FC101.PV,\n", false),
        ("Time,FC101.OP,FC101.PV,DataQuality\n", true),
        ("Time,FC101.OP,FC101.PV,Güte\n", true),
        ("Time,FC101.OP,FC101.PV,Remark\n", true),
    ] {
        let table = of_bytes(&spoilt(header, words, own), &Options::default());
        assert_left_out(header, table, of_row);
    }
    // In the numbers of OPC.
    for words in [["192", "0"], ["216", "24"], ["0", "2147483648"]] {
        let table = of_bytes(&spoilt("Time,OP,PV,PV code\n", words, own), &Options::default());
        assert_left_out(words[1], table, false);
    }
    for words in [["OK", "BAD"], ["NR", "Bad"]] {
        let table = of_bytes(&spoilt("Time,OP,PV,PV state\n", words, own), &Options::default());
        assert_left_out(words[0], table, false);
    }
    // A flag that is set where the value is bad.
    for (header, words) in [("PV_BAD", ["0", "1"]), ("pv questionable", ["False", "True"])] {
        let header = format!("Time,OP,PV,{header}\n");
        assert_left_out(&header, of_bytes(&spoilt(&header, words, own), &Options::default()), false);
    }
    // What is told is looked for in every column.
    let told = Options { good_values: Some("x7".into()), ..Options::default() };
    let table = of_bytes(&spoilt("Time,OP,PV,PV code\n", ["x7", "x9"], own), &told);
    assert_left_out("told", table, false);
    // Where a column is known by its name, what is told is not looked for among measurements.
    let told = Options { good_values: Some("192".into()), ..Options::default() };
    let with_tag =
        |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said},{}\n", 190 + (t as u64) % 3);
    let table = of_bytes(&spoilt("Time,OP,PV,pv_status,TI5\n", ["192", "0"], with_tag), &told);
    assert_left_out("measurements", table, false);
    // What is measured is no quality.
    let table = of_bytes(&spoilt("Time,OP,PV,TI5\n", ["192", "193"], own), &Options::default());
    assert!(table.expect("read").record.pv.iter().all(|sample| sample.quality.is_good()));
}

#[test]
fn qualities_stand_behind_their_values_or_before_them() {
    let words = ["Good", "Bad"];
    for (header, before) in [
        ("Tagname,FC101.OP,,FC101.PV,\nTimestamp,Value,Quality,Value,Quality\n", false),
        ("Timestamp,FC101.OP,,FC101.PV,\n", false),
        ("Timestamp,FC101.OP,Quality,FC101.PV,Quality\n", false),
        ("Time,Status,FC101.OP,Status,FC101.PV\n", true),
        ("Time,,FC101.OP,,FC101.PV\n", true),
    ] {
        let row = |t: f64, op: f64, pv: f64, said: &str| {
            if before {
                format!("{t},Good,{op},{said},{pv}\n")
            } else {
                format!("{t},{op},Good,{pv},{said}\n")
            }
        };
        // Above a row of names stand tags, and nobody knows which of the rows is the header.
        let told = ["1", "2", "4"].map(|number| header.starts_with("Tagname").then(|| number.to_string()));
        let [time, op, pv] = told;
        let options = Options { time, op, pv, ..Options::default() };
        assert_left_out(header, of_bytes(&spoilt(header, words, row), &options), false);
    }
}

#[test]
fn a_second_column_of_times_without_a_name_is_refused() {
    let row = |t: f64, op: f64, pv: f64, _: &str| {
        let civil = |t: f64| jiff::Timestamp::from_millisecond((t * 1e3) as i64).expect("a time").to_string();
        format!("{},{pv},{},{op}\n", civil(t), civil(t + 4.0))
    };
    let said = of_bytes(&spoilt("Time,FC101.PV,,FC101.OP\n", ["", ""], row), &Options::default());
    let said = said.err().unwrap_or_default();
    assert!(said.contains("column 3") && said.contains("holds other times"), "{said}");
}

#[test]
fn quotes_behind_blanks_and_rulers_of_dashes_are_none_of_the_values() {
    let quoted = |t: f64, op: f64, pv: f64, _: &str| format!("\"{t}\", \"{op}\", '{pv}'\n");
    let mut text = spoilt("\"Time\", \"FIC101.OP\", 'FIC101.PV'\n", ["", ""], quoted);
    let table = of_bytes(&text, &Options::default()).expect("quotes");
    assert_eq!(bits(&table.record)[0], bits(&example())[0]);
    let wide = |t: f64, op: f64, pv: f64, _: &str| format!("{t:<22}{op:<22}{pv:<22}\n");
    let ruler = format!("{0:<22}{1:<22}{2:<22}\n{3} {3} {3}\n", "Time", "OP", "PV", "-".repeat(21));
    text = spoilt(&ruler, ["", ""], wide);
    let table = of_bytes(&text, &Options::default()).expect("a ruler");
    assert_eq!(bits(&table.record)[0], bits(&example())[0]);
}

#[test]
fn other_names_and_words_of_quality_are_known_too() {
    let plain = Options::default();
    let own = |t: f64, op: f64, pv: f64, said: &str| format!("{t},{op},{pv},{said}\n");
    for (header, words) in [
        ("Time,OP,PV,PV PercentGood\n", ["100", "0"]),
        ("Time,OP,PV,PV % Good\n", ["100", "37.5"]),
        ("Time,OP,PV,PV Qualità\n", ["Buona", "Cattiva"]),
        ("Time,OP,PV,PV 품질\n", ["양호", "불량"]),
    ] {
        assert_left_out(header, of_bytes(&spoilt(header, words, own), &plain), false);
    }
    let hda = |t: f64, op: f64, pv: f64, said: &str| format!("{t};{op};{pv};{said}\n");
    let table = of_bytes(&spoilt("Time;OP;PV;Quality\n", ["Raw, Good", "Raw, Bad"], hda), &plain);
    assert_left_out("OPC HDA", table, true);
    // The quality codes of PCS 7 are asked for.
    let codes = spoilt("Time,OP,PV,PV.QC\n", ["128", "0"], own);
    assert!(of_bytes(&codes, &plain).is_err_and(|said| said.contains("--good-values")));
    let told = |good: &str| Options { good_values: Some(good.into()), ..Options::default() };
    assert_left_out("128", of_bytes(&codes, &told("128")), false);
    // One that never changes says nothing, and neither does an average of which no part is known to be whole.
    let one = of_bytes(&spoilt("Time,OP,PV,PV.QC\n", ["0", "0"], own), &plain).expect("read").record;
    assert!(one.pv.iter().all(|sample| sample.quality.is_good()));
    let share = spoilt("Time,OP,PV,PV PercentGood\n", ["1", "0.4"], own);
    assert!(of_bytes(&share, &plain).is_err_and(|said| said.contains("--good-values")));
    let nowhere = of_bytes(&codes, &told("129")).expect_err("no such value");
    assert!(nowhere.contains("none of \"129\" is there") && nowhere.contains("128"), "{nowhere}");
}
