//! `stictiond reproduce`: the paper's tables and figures, ours beside theirs, as files.

use super::{Failure, output, print};
use std::fs;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;
use stictiond::reproduce::{Measured, json, page, reproduce};
use stictiond::table;

#[derive(clap::Args)]
pub struct Args {
    /// Where to write reproduction.html and reproduction.json
    #[arg(long, value_name = "DIR", default_value = ".")]
    out: PathBuf,
    /// Measured records to analyse in place of Table 6: a folder of CSV files, its index.csv telling which
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

/// Computes, then writes both files.
pub fn run(args: &Args) -> Result<(), Failure> {
    let records = match &args.data {
        Some(dir) => measured(dir)?,
        None => Vec::new(),
    };
    // A folder that cannot be written is known before the work, not after it.
    fs::create_dir_all(&args.out).map_err(|error| Failure::in_file(&args.out, error))?;
    let began = Instant::now();
    let shown = io::stderr().is_terminal();
    let report = reproduce(&records, |at, of, name| {
        if shown {
            let bar = format!("{}{}", "#".repeat(at), ".".repeat(of - at));
            // Progress is a courtesy: a closed stderr stops nothing.
            let _ = write!(io::stderr(), "\r\x1b[K[{bar}] {:3} % {name}", 100 * at / of);
        }
    })
    .map_err(|error| Failure::Failed(error.to_string()))?;
    if shown {
        let _ = write!(io::stderr(), "\r\x1b[K");
    }
    let text = serde_json::to_string(&json(&report))
        .map_err(|error| Failure::Failed(format!("cannot write the report: {error}")))?;
    for (name, content) in [("reproduction.html", page(&report)), ("reproduction.json", text + "\n")] {
        let path = args.out.join(name);
        output::write(&path, &content)?;
        print(&format!("{}\n", path.display()))?;
    }
    print(&format!("{} parts in {:.1} s\n", report.sections.len(), began.elapsed().as_secs_f64()))
}

/// The records that `index.csv` names (columns loop, file, label, published_cause), or every CSV file of the folder.
fn measured(dir: &Path) -> Result<Vec<Measured>, Failure> {
    let index = dir.join("index.csv");
    let listed = if index.is_file() { from_index(dir, &index)? } else { from_folder(dir)? };
    if listed.is_empty() {
        return Err(Failure::in_file(dir, "no records: neither an index.csv that names any nor CSV files"));
    }
    listed
        .into_iter()
        .map(|(name, label, path)| {
            let record = table::record(&path).map_err(|error| Failure::in_file(&path, error))?;
            Ok(Measured { name, label, record })
        })
        .collect()
}

type Listed = Vec<(String, String, PathBuf)>;

fn from_index(dir: &Path, index: &Path) -> Result<Listed, Failure> {
    let bad = |error: &dyn std::fmt::Display| Failure::in_file(index, error);
    let mut reader = csv::Reader::from_path(index).map_err(|error| bad(&error))?;
    let headers = reader.headers().map_err(|error| bad(&error))?.clone();
    let column = |name: &str| headers.iter().position(|header| header == name);
    let Some(file) = column("file") else {
        return Err(bad(&"no column \"file\""));
    };
    let optional = ["loop", "label", "published_cause"].map(column);
    let mut listed = Listed::new();
    for row in reader.records() {
        let row = row.map_err(|error| bad(&error))?;
        let text = |at: usize| row.get(at).unwrap_or_default().to_owned();
        let [name, label, cause] = optional.map(|at| at.map(text).unwrap_or_default());
        let label = if cause.is_empty() || cause == label { label } else { format!("{label} ({cause})") };
        let path = text(file);
        listed.push((if name.is_empty() { path.clone() } else { name }, label, dir.join(path)));
    }
    Ok(listed)
}

fn from_folder(dir: &Path) -> Result<Listed, Failure> {
    let entries = fs::read_dir(dir).map_err(|error| Failure::in_file(dir, error))?;
    let mut listed: Listed = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")))
        .map(|path| {
            let name = path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
            (name, String::new(), path)
        })
        .collect();
    listed.sort();
    Ok(listed)
}
