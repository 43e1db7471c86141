//! The measured records beside the project, where they are.

use std::fs::{self, File};
use std::path::Path;
use stictiond::collect::csv;
use stictiond::signal::Record;

/// From the package root, where cargo runs the tests.
const FOLDER: &str = "../shared/data";

/// A measured loop and what its owners say of it.
pub struct Measured {
    /// The set it belongs to: `isdb` or `plant`.
    pub set: String,
    /// The loop.
    pub name: String,
    /// `stiction` or `no stiction`.
    pub label: String,
    /// OP, PV, SP.
    pub record: Record,
}

/// Every record of the index in its order; none, and a line that says so, where the folder is missing.
pub fn measured() -> Vec<Measured> {
    let index = Path::new(FOLDER).join("index.csv");
    let Ok(text) = fs::read_to_string(&index) else {
        eprintln!("SKIPPED: no measured records, {} is missing", index.display());
        return Vec::new();
    };
    text.lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let [set, name, file, _, _, _, label, ..] = cells[..] else {
                panic!("{}: too few cells in {line:?}", index.display());
            };
            let path = Path::new(FOLDER).join(file);
            let open = File::open(&path).expect("the index names files that exist");
            let record = csv::read(open).expect("the measured records are readable");
            Measured { set: set.into(), name: name.into(), label: label.into(), record }
        })
        .filter(|m| m.set == "isdb" || m.set == "plant")
        .collect()
}
