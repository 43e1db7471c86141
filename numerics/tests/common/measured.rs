//! The measured records beside the project, where they are.

use std::path::{Path, PathBuf};
use stictiond_numerics::signal::{Record, Sample, Series};

/// From the package's root, where cargo runs the tests.
pub const FOLDER: &str = "../../shared/data";

/// Every record with OP and PV below a folder of data, by its path; columns `t`, `op`, `pv`, `sp`, and `mv_stem`, by their
/// header. Its span is what its values tell. Empty where there is no folder.
pub fn below(folder: &Path) -> Vec<(String, Record)> {
    let mut files: Vec<PathBuf> = Vec::new();
    let inside = |folder: &Path| std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    for path in inside(folder).filter(|path| path.is_dir()) {
        files.extend(inside(&path).filter(|path| path.extension().is_some_and(|own| own == "csv")));
    }
    files.sort();
    let name = |path: &Path| path.strip_prefix(folder).unwrap_or(path).display().to_string();
    files.iter().filter_map(|path| Some((name(path), read(path)?))).collect()
}

/// One file that has OP and PV.
pub fn readable(file: &Path) -> Record {
    read(file).expect("the measured records are readable")
}

/// One file; `None` where OP or PV is missing.
fn read(file: &Path) -> Option<Record> {
    let text = std::fs::read_to_string(file).ok()?;
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next()?.split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|c| c.trim().parse().unwrap_or(f64::NAN)).collect()).collect();
    let series = |name: &str| -> Option<Series> {
        let at = head.iter().position(|own| *own == name)?;
        let samples = rows.iter().filter_map(|row| Some(Sample::good(row[0], *row.get(at)?)));
        let samples: Series = samples.filter(|s| s.value.is_finite()).collect();
        (!samples.is_empty()).then_some(samples)
    };
    let mut record = Record {
        op: series("op")?,
        pv: series("pv")?,
        sp: series("sp"),
        mv: series("mv_stem"),
        ..Record::default()
    };
    record.find_span(None, None);
    Some(record)
}
