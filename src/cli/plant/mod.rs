//! `stictiond plant DIR`: which loops of a folder of records swing together, who started it, and what to repair first.

mod html;
mod json;

use super::format::Format;
use super::{Failure, print, table};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use stictiond::plantwide::cause::period;
use stictiond::plantwide::window::of_record;
use stictiond::plantwide::{Analysis, PlantLoop, Task, analyse, tasks};

/// Most records of a folder.
const MOST: usize = 20_000;
/// Most samples of a record; a longer one is thinned.
const MOST_SAMPLES: usize = 200_000;

#[derive(clap::Args)]
pub struct Args {
    /// Folder of records, one loop each: CSV of any dialect, Excel or ODS workbooks, Parquet
    folder: PathBuf,
    /// How to print what was found [default: text on a terminal, else json]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write one HTML page that stands alone
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// The controllers' output limits (OP unit): saturation is judged against them
    #[arg(long, value_name = "LOW,HIGH", value_parser = super::diagnose::limits, allow_hyphen_values = true)]
    op_limits: Option<(f64, f64)>,
    #[command(flatten)]
    table: table::TableArgs,
}

/// Reads, analyses, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    let (mut plant, skipped) = read(args)?;
    if plant.is_empty() {
        return Err(Failure::in_file(
            &args.folder,
            format!("no record could be used, {} skipped", skipped.len()),
        ));
    }
    plant.iter_mut().for_each(|of| of.op_limits = args.op_limits.or(of.op_limits));
    let found = analyse(&plant);
    let work = tasks(&found);
    if let Some(to) = &args.html {
        let title = args
            .folder
            .file_name()
            .map_or_else(|| "plant".into(), |name| name.to_string_lossy().into_owned());
        fs::write(to, html::page(&title, &plant, &found, &work, &skipped))
            .map_err(|error| Failure::in_file(to, &error))?;
    }
    match args.format.unwrap_or_else(Format::usual) {
        Format::Text => print(&text(&found, &work, &skipped)),
        Format::Json => print(&json::text(&found, &work, &skipped)?),
    }
}

/// Every record of the folder, and what could not be read.
fn read(args: &Args) -> Result<(Vec<PlantLoop>, Vec<String>), Failure> {
    let entries = fs::read_dir(&args.folder).map_err(|error| Failure::in_file(&args.folder, &error))?;
    let is_table = |path: &Path| {
        let known = ["csv", "txt", "tsv", "xlsx", "xls", "xlsb", "ods", "parquet"];
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
        let index = path.file_stem().is_some_and(|name| name == "index");
        extension.is_some_and(|e| known.contains(&e.as_str())) && !index
    };
    let mut files: Vec<PathBuf> =
        entries.flatten().map(|e| e.path()).filter(|p| p.is_file() && is_table(p)).collect();
    files.sort();
    if files.len() > MOST {
        return Err(Failure::in_file(&args.folder, format!("{} records, {MOST} are the most", files.len())));
    }
    let (mut plant, mut skipped) = (Vec::new(), Vec::new());
    let options = args.table.options(None);
    for file in files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let of = match table::read(&file, &options) {
            Ok(read) => of_record(&name, &read.record, MOST_SAMPLES),
            Err(Failure::BadInput(why) | Failure::Failed(why)) => Err(why),
            Err(Failure::BadConfig(_)) => Err("the options contradict each other".into()),
        };
        match of {
            Ok(of) => plant.push(of),
            Err(why) => skipped.push(format!("{name}: {why}")),
        }
    }
    Ok((plant, skipped))
}

/// How sure a cause is; of none there is nothing to be sure of.
fn sure(task: &Task) -> String {
    task.sure().map_or_else(|| "–".into(), |p| format!("{:.0} %", 100.0 * p))
}

fn text(found: &Analysis, work: &[Task], skipped: &[String]) -> String {
    let name = |i: usize| found.loops[i].name.as_str();
    let mut out = String::new();
    let swinging = found.loops.iter().filter(|of| !of.oscillations.is_empty()).count();
    let _ = writeln!(
        out,
        "{} loops, {swinging} of them oscillate, {} groups",
        found.loops.len(),
        found.groups.len()
    );
    for (k, group) in found.groups.iter().enumerate() {
        let _ =
            writeln!(out, "\nGroup {}: {} loops at {}", k + 1, group.members.len(), period(group.period_s));
        let members: Vec<&str> = group.members.iter().map(|i| name(*i)).collect();
        let _ = writeln!(out, "  {}", members.join(" "));
        for (place, suspect) in group.suspects.iter().take(2).enumerate() {
            let what = if place == 0 { "suspected source" } else { "runner-up" };
            let evidence = suspect.evidence.iter().take(3).cloned().collect::<Vec<_>>().join("; ");
            let _ = writeln!(
                out,
                "  {what}: {} ({:.0} %) {evidence}",
                name(suspect.at),
                100.0 * suspect.probability
            );
        }
    }
    let _ = writeln!(out, "\nWhat to do first");
    for line in work {
        let victims: Vec<&str> = line.victims.iter().map(|i| name(*i)).collect();
        let calm = if victims.is_empty() {
            String::new()
        } else {
            format!(" — expected to calm down with it: {}", victims.join(" "))
        };
        let _ =
            writeln!(out, "  {} {} ({}): {}{calm}", name(line.at), line.cause.as_str(), sure(line), line.why);
    }
    for why in skipped {
        let _ = writeln!(out, "skipped {why}");
    }
    out
}
