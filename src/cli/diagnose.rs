//! `stictiond diagnose FILE.csv`: one record to one report on stdout.

use super::{Failure, print, text};
use clap::ValueEnum;
use std::fs::File;
use std::path::PathBuf;
use stictiond::collect::csv;
use stictiond::diagnosis::{Settings, diagnose};
use stictiond::serve::dto::Report;

#[derive(clap::Args)]
pub struct Args {
    /// The record; comma, semicolon or tab, columns by name
    file: PathBuf,
    /// How to print the report
    #[arg(long, value_enum, default_value_t = Format::Json)]
    format: Format,
    /// Sample period to resample to (s); the median of the stamps when left out
    #[arg(long, value_name = "SECONDS", value_parser = period)]
    ts: Option<f64>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Json,
    Text,
}

fn period(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(ts) if ts.is_finite() && ts > 0.0 => Ok(ts),
        _ => Err("a sample period is a number of seconds above 0".into()),
    }
}

/// Reads, diagnoses, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    let bad = |error: &dyn std::fmt::Display| Failure::in_file(&args.file, error);
    let file = File::open(&args.file).map_err(|error| bad(&error))?;
    let record = csv::read(file).map_err(|error| bad(&error))?;
    let settings = Settings { ts: args.ts, ..Settings::default() };
    let diagnosis = diagnose(&record, &settings);
    let name = args.file.file_stem().unwrap_or(args.file.as_os_str());
    let report = Report::new(&name.to_string_lossy(), record.op_span, &diagnosis);
    match args.format {
        Format::Text => print(&text::page(&report)),
        Format::Json => {
            let mut json = serde_json::to_string_pretty(&report)
                .map_err(|error| Failure::Failed(format!("cannot write the report: {error}")))?;
            json.push('\n');
            print(&json)
        }
    }
}
