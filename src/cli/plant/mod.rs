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
use stictiond::plantwide::{Analysis, Cause, PlantLoop, analyse};

/// Most records of a folder.
const MOST: usize = 20_000;

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

/// One line of the work list: what to do, and whose trouble it is expected to end.
struct Work {
    at: usize,
    cause: Cause,
    probability: f64,
    why: String,
    /// Loops that are expected to calm down with it.
    victims: Vec<usize>,
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
    let work = work(&found);
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
            Ok(read) => of_record(&name, &read.record),
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

/// What to do: sources before victims, the surest and those with the most victims first.
fn work(found: &Analysis) -> Vec<Work> {
    let mut work: Vec<Work> = Vec::new();
    for (at, of) in found.loops.iter().enumerate() {
        let Some(reason) = &of.reason else { continue };
        if reason.cause == Cause::Neighbour {
            continue;
        }
        let victims = (0..found.loops.len())
            .filter(|i| found.loops[*i].reason.as_ref().is_some_and(|r| r.neighbour == Some(at)))
            .collect();
        let (cause, probability, why) = (reason.cause, reason.probability, reason.why.clone());
        work.push(Work { at, cause, probability, why, victims });
    }
    // A suspect whose members are less sure of themselves than of it is a line of its own all the same.
    for (at, _) in found.loops.iter().enumerate() {
        let victims: Vec<usize> = (0..found.loops.len())
            .filter(|i| found.loops[*i].reason.as_ref().is_some_and(|r| r.neighbour == Some(at)))
            .collect();
        if !victims.is_empty() && work.iter().all(|line| line.at != at) {
            let why = "it is the likeliest source of its group, but not by enough to be sure".to_string();
            work.push(Work { at, cause: Cause::Unknown, probability: 0.5, why, victims });
        }
    }
    let worth = |w: &Work| w.probability * (1 + w.victims.len()) as f64;
    work.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
    work
}

/// How sure a cause is; of none there is nothing to be sure of.
fn sure(line: &Work) -> String {
    if line.cause == Cause::Unknown { "–".into() } else { format!("{:.0} %", 100.0 * line.probability) }
}

fn text(found: &Analysis, work: &[Work], skipped: &[String]) -> String {
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
