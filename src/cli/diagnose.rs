//! `stictiond diagnose FILE.csv`: one record to one report on stdout.

use super::format::Format;
use super::{Failure, output, plot, print, table, text};
use std::io::{self, Write};
use std::path::PathBuf;
use stictiond::detectors::integration::told_by_name;
use stictiond::diagnosis::{Settings, diagnose};
use stictiond::residual::{self, trace_record};
use stictiond::results::Judged;
use stictiond::serve::dto::Report;
use stictiond::table::Table;

#[derive(clap::Args)]
pub struct Args {
    /// The record: CSV of any dialect, an Excel or ODS workbook, Parquet; columns by name
    file: PathBuf,
    /// How to print the report [default: text on a terminal, else json]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Sample period to resample to (s); when left out, the controller's scan where the record shows it, else the period of the
    /// stamps
    #[arg(long, value_name = "SECONDS", value_parser = above_zero)]
    ts: Option<f64>,
    /// Span of OP in its own unit, 100 for per cent: f is then told in % of it
    #[arg(long, value_name = "SPAN", value_parser = above_zero)]
    op_span: Option<f64>,
    /// The controller's output limits (OP unit): saturation is judged against them
    #[arg(long, value_name = "LOW,HIGH", value_parser = limits, allow_hyphen_values = true)]
    op_limits: Option<(f64, f64)>,
    /// Draw PV, the models before and after the effects, and what both leave, as an SVG
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// Which loop of a table of several
    #[arg(long = "loop", value_name = "ID")]
    of_loop: Option<String>,
    #[command(flatten)]
    table: table::TableArgs,
}

pub fn above_zero(text: &str) -> Result<f64, String> {
    text.parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0).ok_or("not a number above 0".into())
}

pub fn limits(text: &str) -> Result<(f64, f64), String> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite());
    let pair = text.split_once(',').and_then(|(low, high)| Some((number(low)?, number(high)?)));
    pair.filter(|(low, high)| low < high).ok_or("the lower, a comma, the upper limit: 0,100".into())
}

/// Reads, diagnoses, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    output::may_be_made(args.plot.as_deref(), output::PICTURE)?;
    let Table { mut record, found: read } = args.table.read(&args.file, args.of_loop.as_deref())?;
    record.op_limits = args.op_limits;
    table::scale(&args.file, &mut record, args.op_span, read.op_unit.as_deref())?;
    let settings = Settings { ts: args.ts, ..Settings::default() };
    let diagnosis = diagnose(&record, &settings);
    let stem = args.file.file_stem().unwrap_or(args.file.as_os_str()).to_string_lossy();
    let name = args.of_loop.as_deref().unwrap_or(&stem);
    let findings = trace_record(&record, &diagnosis, &settings, &residual::Settings::default());
    let drawn = args.plot.as_ref().map(|to| (to, findings.as_ref().map(|found| plot::picture(name, found))));
    let judged = Judged { findings, ..diagnosis.into() }.with_opinions(told_by_name(name));
    let mut report = Report::judged(name, (record.op_span, record.op_span_source), &judged);
    report.read_as = Some(read.read_as);
    match args.format.unwrap_or_else(Format::usual) {
        Format::Text => print(&text::page(&report))?,
        Format::Json => {
            let mut json = serde_json::to_string_pretty(&report)
                .map_err(|error| Failure::Failed(format!("cannot write the report: {error}")))?;
            json.push('\n');
            print(&json)?;
        }
    }
    // The report comes first: a picture that cannot be made takes nothing away from it.
    match drawn {
        None => Ok(()),
        Some((to, Some(svg))) => output::write(to, &svg),
        Some((to, None)) => {
            // Nobody is left to tell when stderr is closed.
            let _ = writeln!(
                io::stderr(),
                "stictiond: {}: nothing to draw: the record does not hold a window that can be fitted",
                to.display()
            );
            Ok(())
        }
    }
}
