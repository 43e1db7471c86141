//! Files as they were met, beside the project.

use super::{bits, example};
use std::fs;
use std::path::Path;
use stictiond::diagnosis::{Settings, Verdict, diagnose};
use stictiond::table::{Options, Source, Table, read};

const FOLDER: &str = "../shared/cases/exports";

fn file(name: &str, options: &Options) -> Result<Table, String> {
    let path = Path::new(FOLDER).join(name);
    read(Source::File(&path), options).map_err(|error| error.to_string())
}

/// The names of all files; none, and a line that says so, where the folder is missing.
fn names() -> Vec<String> {
    let Ok(entries) = fs::read_dir(FOLDER) else {
        eprintln!("SKIPPED: no exports, {FOLDER} is missing");
        return Vec::new();
    };
    let name = |entry: fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
    let mut names: Vec<String> = entries.flatten().map(name).collect();
    names.sort();
    names
}

#[test]
fn every_export_is_read_right_or_refused_with_the_option_that_decides() {
    let values = bits(&example());
    for name in names() {
        let mut read = file(&name, &Options::default());
        if name == "dates-us_ampm.csv" {
            // One morning of the sixth of January, or of the first of June.
            let said = read.expect_err("day and month can be told in two ways");
            assert!(
                said.contains("06/01/2026 06:00:00 AM") && said.contains("--time-format dmy or mdy"),
                "{said}"
            );
            read = file(&name, &Options { time_format: Some("mdy".into()), ..Options::default() });
        }
        let found = read.unwrap_or_else(|error| panic!("{name}: {error}"));
        let record = found.record;
        assert_eq!(record.op.len(), 1200, "{name}");
        let diagnosis = diagnose(&record, &Settings::default());
        if name.starts_with("quality-col") {
            // Bad samples are zeros, and none of them is used.
            assert!(record.pv.iter().all(|s| s.quality.is_good() == (s.value != 0.0)), "{name}");
        }
        assert_eq!(diagnosis.verdict, Verdict::Stiction, "{name}: {}", found.found.read_as);
        let f = diagnosis.estimate.expect("stiction has an estimate").f;
        assert!((f - 0.5).abs() < 0.02, "{name}: {f}");
        assert!((diagnosis.preparation.ts - 2.0).abs() < 0.01, "{name}: {}", diagnosis.preparation.ts);
        // All but those with other values or qualities of PV are the example itself.
        if !name.starts_with("thousands") && !name.starts_with("quality-col") {
            assert!(bits(&record) == values, "{name}");
        }
    }
}

#[test]
fn thousands_are_those_of_the_file_without_them() {
    let names = names();
    if names.is_empty() {
        return;
    }
    let plain = file("thousands-ref.csv", &Options::default()).expect("a record").record;
    let tab = file("thousands-tab_en.csv", &Options::default()).expect("a record").record;
    assert!(tab.pv == plain.pv && tab.op == plain.op);
    let quoted = file("thousands-comma_quoted.csv", &Options::default()).expect("a record").record;
    let apart = quoted.pv.iter().zip(&plain.pv).map(|(a, b)| (a.value - b.value).abs()).fold(0.0, f64::max);
    assert!(apart <= 0.5 + 1e-9, "one is rounded to whole numbers: {apart}");
}
