//! The line that the document of tables shows is one that the reader says.

use super::{read, root};
use std::fs;
use stictiond::table::{self, Options, Source};

const DOCUMENT: &str = "docs/tables.md";
/// What stands before the line.
const BEFORE: &str = "One line says what was read:\n\n    read as: ";

/// A table as a DCS in Germany exports it: a row of units, one stamp that cannot be read, and an average and a count at the end.
fn sample() -> String {
    let row = |k: u32| {
        let stamp =
            if k == 697 { "no time".into() } else { format!("01.06.2026 06:{:02}:{:02}", k / 60, k % 60) };
        format!("{stamp};{},{};{},{}5\n", 50 + k % 7, k % 10, 20 + k % 5, k % 9)
    };
    let rows: String = (0..1200).map(row).collect();
    format!("Time;FIC101.OP;FIC101.PV\n;%;m3/h\n{rows}Average;50,1;20,2\nTotal samples: 1200\n")
}

#[test]
fn the_line_that_says_what_was_read_is_the_readers() {
    let found = table::read(Source::Bytes(sample().as_bytes()), &Options::default()).expect("a record");
    let line = found.found.read_as;
    let document = read(DOCUMENT);
    let (before, rest) = document.split_once(BEFORE).expect("where the line begins");
    let (shown, after) = rest.split_once('\n').expect("where it ends");
    if std::env::var_os("STICTIOND_WRITE_DOCS").is_some() {
        fs::write(root().join(DOCUMENT), format!("{before}{BEFORE}{line}\n{after}")).expect("writable");
    } else {
        assert_eq!(shown, line, "STICTIOND_WRITE_DOCS=1 cargo test --test docs makes it");
    }
}
