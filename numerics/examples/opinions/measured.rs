//! A folder of labelled records.

use super::judged::{Judged, judge};
use super::{parallel, tables};
use std::collections::BTreeMap;
use std::path::Path;
use stictiond_numerics::signal::{Record, Sample};

/// Reads, judges and prints.
pub fn print(folder: &str, each: bool, threads: usize) {
    let sets = sets(folder, threads);
    for (set, of) in &sets {
        let of: Vec<&Judged> = of.iter().collect();
        println!("\n### Measured: {set}\n");
        tables::methods(&of, false);
        println!("\nTold whether the process integrates (levels do):\n");
        tables::methods(&of, true);
        tables::loops(&of);
    }
    if each {
        sets.iter().flat_map(|(_, of)| of).for_each(tables::one);
    }
}

/// The records of a folder, judged, by set.
pub fn sets(folder: &str, threads: usize) -> Vec<(String, Vec<Judged>)> {
    let folder = Path::new(folder);
    let index = std::fs::read_to_string(folder.join("index.csv")).expect("DIR/index.csv");
    let mut lines = index.lines();
    let head: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let column =
        |name: &str| head.iter().position(|h| *h == name).expect("index.csv: set, loop, file, label");
    let (set, name, file) = (column("set"), column("loop"), column("file"));
    let (kind, label) = (column("type"), column("label"));
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let judged: Vec<Judged> = parallel::on(threads, &rows, |row| {
        let record = read(&folder.join(row[file]));
        let sticky = match row[label] {
            "stiction" => true,
            "no stiction" => false,
            other => panic!("label {other}?"),
        };
        let mut judged = judge(row[name].to_owned(), sticky, row[kind].starts_with('L'), &record);
        judged.scenarios.push(row[set].to_owned());
        judged
    });
    let mut sets: BTreeMap<String, Vec<Judged>> = BTreeMap::new();
    for of in judged {
        sets.entry(of.scenarios[0].clone()).or_default().push(of);
    }
    sets.into_iter().collect()
}

/// Columns t, op, pv, sp, and mv or mv_stem, by their header; a blank is no sample.
fn read(file: &Path) -> Record {
    let text = std::fs::read_to_string(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|c| c.trim().parse().unwrap_or(f64::NAN)).collect()).collect();
    let series = |names: &[&str]| -> Vec<Sample> {
        let Some(at) = head.iter().position(|h| names.contains(h)) else { return Vec::new() };
        let samples = rows.iter().filter_map(|row| Some(Sample::good(row[0], *row.get(at)?)));
        samples.filter(|s| s.value.is_finite()).collect()
    };
    let some = |v: Vec<Sample>| (!v.is_empty()).then_some(v);
    Record {
        op: series(&["op"]),
        pv: series(&["pv"]),
        sp: some(series(&["sp"])),
        mv: some(series(&["mv", "mv_stem"])),
        ..Record::default()
    }
}
