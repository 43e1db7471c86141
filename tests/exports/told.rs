//! Tables that only who exported them can explain: an option says it, and without it they are refused by that option's name.

use super::dress::BEGIN;
use super::{bits, example, of_bytes};
use stictiond::table::Options;

/// Options by their names.
fn told(pairs: &[(&str, &str)]) -> Options {
    let mut options = Options::default();
    for (name, value) in pairs {
        assert!(options.set(name, (*value).to_string()), "{name}");
    }
    options
}

/// The example as two rows a sample, of OP and of PV, with these names of tags.
fn long(header: &str, op: &str, pv: &str) -> String {
    let example = example();
    let row = |tag: &str, t: f64, value: f64| format!("{:.1};{tag};{value:.3}\n", BEGIN as f64 + t);
    let both = example.op.iter().zip(&example.pv);
    let rows = both.map(|(o, p)| row(op, o.t, o.value) + &row(pv, p.t, p.value));
    header.to_string() + &rows.collect::<String>()
}

#[test]
fn letters_of_an_encoding_that_cannot_be_guessed_are_told() {
    let example = example();
    for (encoding, time, op, pv) in [
        ("shift_jis", "時刻", "弁開度", "流量"),
        ("windows-1250", "Čas", "Výkon řízení", "Průtok"),
        ("windows-1254", "Zaman", "Çıkış", "Akış"),
        ("gb18030", "时间", "阀位", "流量"),
    ] {
        let rows = super::doubts::rows(&example, ';', |t| format!("{t:.1}"));
        let text = format!("{time};{op};{pv}\n{}\n", rows.join("\n"));
        let own = encoding_rs::Encoding::for_label(encoding.as_bytes()).expect("a label");
        let (bytes, _, lost) = own.encode(&text);
        assert!(!lost, "{encoding} has all letters");
        let columns = [("time", time), ("op", op), ("pv", pv)];
        let table = of_bytes(&bytes, &told(&[&columns[..], &[("encoding", encoding)]].concat()));
        let table = table.expect(encoding);
        assert!(bits(&table.record) == bits(&example), "{}", table.found.read_as);
        let name = own.name();
        assert!(table.found.read_as.starts_with(name), "{}", table.found.read_as);
        let wrong = of_bytes(&bytes, &told(&[&columns[..], &[("encoding", "windows-1253")]].concat()));
        let said = wrong.err().unwrap_or_default();
        assert!(said.contains("no column is called so"), "{said}");
    }
}

#[test]
fn columns_of_tags_and_values_are_told_by_name_or_number() {
    let example = example();
    let tags = [("op", "10LAB01AA001"), ("pv", "10LAB01CF001")];
    let text = |header| long(header, tags[0].1, tags[1].1).into_bytes();
    let said = of_bytes(&text("Ts;Kks;Y\n"), &told(&tags)).err().unwrap_or_default();
    assert!(said.contains("--tag and --value"), "{said}");
    for (header, columns) in [
        ("Ts;Kks;Y\n", [("time", "Ts"), ("tag", "kks"), ("value", "Y")]),
        ("Ts;Kks;Y\n", [("time", "1"), ("tag", "2"), ("value", "3")]),
        ("", [("time", "1"), ("tag", "2"), ("value", "3")]),
        ("Ts;Tag;Y\n", [("time", "Ts"), ("value", "Y"), ("decimal", ".")]),
    ] {
        let table = of_bytes(&text(header), &told(&[&columns[..], &tags].concat())).expect("read");
        assert!(bits(&table.record) == bits(&example), "{header:?}: {}", table.found.read_as);
    }
    for (one, other) in [("tag", "value"), ("value", "tag")] {
        let column = if one == "tag" { "2" } else { "3" };
        let options = told(&[&[("time", "1"), (one, column)], &tags[..]].concat());
        let said = of_bytes(&text("Ts;Kks;Y\n"), &options).err().unwrap_or_default();
        assert!(said.contains(&format!("name the column of {other}s with --{other}")), "{said}");
    }
}
