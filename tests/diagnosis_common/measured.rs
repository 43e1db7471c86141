//! The measured records beside the project, where they are.

use std::fs;
use std::path::Path;
use stictiond::collect::table;
use stictiond::signal::Record;

/// From the package root, where cargo runs the tests.
const FOLDER: &str = "../shared/data";

/// A measured loop: its row of the index (`set,loop,file,type,Ts_s,n,label,…`) and its OP, PV and SP.
pub type Measured = (Vec<String>, Record);

/// Every record of the sets `isdb` and `plant` in the index's order; none, and a line that says so, where the folder is missing.
pub fn measured() -> Vec<Measured> {
    let index = Path::new(FOLDER).join("index.csv");
    let Ok(text) = fs::read_to_string(&index) else {
        eprintln!("SKIPPED: no measured records, {} is missing", index.display());
        return Vec::new();
    };
    text.lines()
        .filter(|line| line.starts_with("isdb,") || line.starts_with("plant,"))
        .map(|line| {
            let row: Vec<String> = line.split(',').map(str::to_owned).collect();
            let file = Path::new(FOLDER).join(&row[2]);
            (row, table::record(&file).expect("the measured records are readable"))
        })
        .collect()
}
