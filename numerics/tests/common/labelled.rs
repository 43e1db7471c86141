//! The labelled records beside the project, where they are.

use std::fs;
use std::path::Path;

/// Each record of the sets `isdb` and `plant`, as `read` gives it, behind its row of the index
/// (`set,loop,file,type,Ts_s,n,label,…`), in the index's order; none, and a line that says so, where the folder is missing.
pub fn labelled<R>(folder: &str, read: impl Fn(&Path) -> R) -> Vec<(Vec<String>, R)> {
    let index = Path::new(folder).join("index.csv");
    let Ok(text) = fs::read_to_string(&index) else {
        eprintln!("SKIPPED: no measured records, {} is missing", index.display());
        return Vec::new();
    };
    text.lines()
        .filter(|line| line.starts_with("isdb,") || line.starts_with("plant,"))
        .map(|line| {
            let row: Vec<String> = line.split(',').map(str::to_owned).collect();
            let record = read(&Path::new(folder).join(&row[2]));
            (row, record)
        })
        .collect()
}
