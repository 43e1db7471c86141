//! `stictiond plant DIR`: which loops of a folder of records swing together, who started it, and what to repair first.

mod html;
mod json;

use super::format::Format;
use super::{Failure, print, table};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use stictiond::app::{App, friction_of};
use stictiond::diagnosis::Settings;
use stictiond::plantwide::cause::period;
use stictiond::plantwide::window::of_record;
use stictiond::plantwide::{Analysis, Friction, PlantLoop, Task, analyse, tasks};
use stictiond::results::words::percent;
use stictiond::results::{Outcome, Run, Trigger};
use stictiond::signal::{LoopId, Record};
use stictiond::table::Table;

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
    /// Diagnose the valves of at most so many loops that swing; 0 for none
    #[arg(long, value_name = "N", default_value_t = 200)]
    diagnose: usize,
    /// Loops whose stream enters another: `TIC3=FIC101,FIC102`, once for each that is entered
    #[arg(long, value_name = "LOOP=FROM,…", value_parser = upstream)]
    upstream: Vec<(String, Vec<String>)>,
    #[command(flatten)]
    table: table::TableArgs,
}

fn upstream(text: &str) -> Result<(String, Vec<String>), String> {
    let (into, from) = text.split_once('=').ok_or("write it as LOOP=FROM,FROM")?;
    Ok((into.trim().to_string(), from.split(',').map(|one| one.trim().to_string()).collect()))
}

/// Reads, analyses, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    let (mut plant, files, skipped) = read(args)?;
    if plant.is_empty() {
        return Err(Failure::in_file(
            &args.folder,
            format!("no record could be used, {} skipped", skipped.len()),
        ));
    }
    let known = |id: &String| {
        let of_skipped = format!("{id}: ");
        plant.iter().any(|of| of.name == *id) || skipped.iter().any(|why| why.starts_with(&of_skipped))
    };
    let mut named = args.upstream.iter().flat_map(|(into, from)| std::iter::once(into).chain(from));
    if let Some(strange) = named.find(|id| !known(id)) {
        return Err(Failure::in_file(&args.folder, format!("--upstream: no record is called {strange:?}")));
    }
    for of in &mut plant {
        of.op_limits = args.op_limits.or(of.op_limits);
        let from = args.upstream.iter().filter(|(into, _)| *into == of.name);
        of.upstream = from.flat_map(|(_, from)| from.clone()).collect();
    }
    let mut found = analyse(&plant);
    let swinging = swinging(&found, args.diagnose);
    for at in &swinging {
        plant[*at].friction = friction(args, &files[*at], &plant[*at].name);
    }
    if !swinging.is_empty() {
        found = analyse(&plant);
    }
    let work = tasks(&found);
    match args.format.unwrap_or_else(Format::usual) {
        Format::Text => print(&text(&found, &work, &skipped))?,
        Format::Json => print(&json::text(&found, &work, &skipped)?)?,
    }
    if let Some(to) = &args.html {
        let title = args
            .folder
            .file_name()
            .map_or_else(|| "plant".into(), |name| name.to_string_lossy().into_owned());
        fs::write(to, html::page(&title, &plant, &found, &work, &skipped))
            .map_err(|error| Failure::Failed(format!("{}: {error}", to.display())))?;
    }
    Ok(())
}

/// Loops that swing in a group or by themselves, those that swing most first.
fn swinging(found: &Analysis, most: usize) -> Vec<usize> {
    let share = |at: usize| found.loops[at].oscillations.first().map_or(0.0, |own| own.share);
    let mut all: Vec<usize> =
        (0..found.loops.len()).filter(|at| found.loops[*at].group.is_some() || share(*at) > 0.0).collect();
    all.sort_by(|a, b| share(*b).total_cmp(&share(*a)));
    all.truncate(most);
    all
}

/// What a diagnosis says of a loop's valve. The record is read again: all of them at once would not fit.
fn friction(args: &Args, file: &Path, name: &str) -> Option<Friction> {
    // It could be read before, and its OP contradicts nothing.
    let record = scaled(args, file).ok()?;
    let judged = App::diagnosis()(&record, &Settings::default(), None);
    let run = Run {
        id: LoopId::new(name),
        started: 0.0,
        finished: 0.0,
        took_s: 0.0,
        trigger: Trigger::OnDemand,
        op_span: record.op_span,
        basis: None,
        outcome: Outcome::Diagnosed(Box::new(judged)),
    };
    friction_of(&run.summary())
}

/// The record of a file, and the span of its OP.
fn scaled(args: &Args, file: &Path) -> Result<Record, Failure> {
    let Table { mut record, found } = table::read(file, &args.table.options(None))?;
    record.op_limits = args.op_limits.or(record.op_limits);
    table::scale_one_of_many(file, &mut record, found.op_unit.as_deref())?;
    Ok(record)
}

/// The loops of the folder and their files, and what could not be read.
type Folder = (Vec<PlantLoop>, Vec<PathBuf>, Vec<String>);

fn read(args: &Args) -> Result<Folder, Failure> {
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
    let (mut plant, mut used, mut skipped) = (Vec::new(), Vec::new(), Vec::new());
    for file in files {
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let of = match scaled(args, &file) {
            Ok(record) => of_record(&name, &record, MOST_SAMPLES),
            Err(Failure::BadInput(why) | Failure::Failed(why)) => Err(why),
            Err(Failure::BadConfig(_)) => Err("the options contradict each other".into()),
        };
        match of {
            Ok(of) => {
                plant.push(of);
                used.push(file);
            }
            Err(why) => skipped.push(format!("{name}: {why}")),
        }
    }
    Ok((plant, used, skipped))
}

/// How sure a cause is; of none there is nothing to be sure of.
fn sure(task: &Task) -> String {
    task.probability.map_or_else(|| "–".into(), percent)
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
            let what = match place {
                0 if suspect.probability >= 0.5 => "suspected source",
                0 => "likeliest source",
                _ => "runner-up",
            };
            let evidence = suspect.evidence.iter().take(3).cloned().collect::<Vec<_>>().join("; ");
            let probability = percent(suspect.probability);
            let _ = writeln!(out, "  {what}: {} ({probability}) {evidence}", name(suspect.at));
        }
    }
    let _ = writeln!(out, "\nWhat to do first");
    if work.is_empty() {
        let _ = writeln!(out, "  nothing: no loop that could be judged needs work");
    }
    for line in work {
        let victims: Vec<&str> = line.victims.iter().map(|i| name(*i)).collect();
        let calm = if victims.is_empty() {
            String::new()
        } else {
            format!(" — may calm down with it: {}", victims.join(" "))
        };
        let _ =
            writeln!(out, "  {} {} ({}): {}{calm}", name(line.at), line.cause.as_str(), sure(line), line.why);
    }
    for why in skipped {
        let _ = writeln!(out, "skipped {why}");
    }
    out
}
