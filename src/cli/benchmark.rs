//! `stictiond benchmark DIR`: the published methods and the program on labelled records.

use super::format::Format;
use super::{Failure, output, print, table};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;
use stictiond::detectors::integration::told_by_name;
use stictiond::detectors::tally::Tally;
use stictiond::detectors::{Facts, Method, Opinion, Says, agreement, opinion};
use stictiond::diagnosis::{Settings, Verdict, diagnose};
use stictiond::residual::{self, trace_record};
use stictiond::results::Judged;
use stictiond::serve::dto::benchmark::{BenchmarkJudge, BenchmarkRecord, BenchmarkReport};
use stictiond::serve::report::{mark, of_benchmark, share};
use stictiond::signal::{Record, Window};
use stictiond::table::Table;

#[derive(clap::Args)]
pub struct Args {
    /// The folder: index.csv with columns loop, file, label (stiction, no stiction), and where known type (LC integrates, FC does not)
    folder: PathBuf,
    /// How to print the table [default: text on a terminal, else json]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write it as one HTML page too
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    #[command(flatten)]
    table: table::TableArgs,
}

/// A line of the index.
struct Listed {
    name: String,
    file: PathBuf,
    sticks: bool,
    integrates: Option<bool>,
}

/// What everybody said of one record, the program last, and how long each took (ms).
struct Heard {
    says: Vec<Says>,
    ms: Vec<f64>,
    doubtful: bool,
}

/// Reads, judges, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    output::may_be_made(args.html.as_deref(), output::PAGE)?;
    let listed = index(&args.folder)?;
    let mut tallies = vec![Tally::default(); Method::ALL.len() + 1];
    let mut times = vec![Vec::new(); tallies.len()];
    let mut records = Vec::with_capacity(listed.len());
    for own in listed {
        let Table { mut record, found: read } = args.table.read(&own.file, None)?;
        table::scale_one_of_many(&own.file, &mut record, read.op_unit.as_deref())?;
        let heard = hear(&record, own.integrates);
        for (at, (says, ms)) in heard.says.iter().zip(&heard.ms).enumerate() {
            tallies[at].add(own.sticks, *says);
            times[at].push(*ms);
        }
        let says = heard.says.into_iter().map(Into::into).collect();
        records.push(BenchmarkRecord {
            r#loop: own.name,
            sticks: own.sticks,
            says,
            doubtful: heard.doubtful,
        });
    }
    let names = Method::ALL.map(|method| (method.as_str(), method.title()));
    let names = names.into_iter().chain([("program", "The program")]);
    let counted = names.zip(tallies.iter().zip(&times));
    let judges = counted.map(|((name, title), (tally, ms))| BenchmarkJudge::new(name, title, tally, ms));
    let judges = judges.collect();
    let found = BenchmarkReport { folder: args.folder.display().to_string(), judges, records };
    match args.format.unwrap_or_else(Format::usual) {
        Format::Text => print(&page(&found))?,
        Format::Json => {
            let mut json = serde_json::to_string_pretty(&found)
                .map_err(|error| Failure::Failed(format!("cannot write the benchmark: {error}")))?;
            json.push('\n');
            print(&json)?;
        }
    }
    match &args.html {
        Some(to) => output::write(to, &of_benchmark(&found)),
        None => Ok(()),
    }
}

/// The records that the folder's index.csv names.
fn index(folder: &Path) -> Result<Vec<Listed>, Failure> {
    let path = folder.join("index.csv");
    let text = fs::read_to_string(&path).map_err(|error| {
        let what = "it is to list the records with their labels, in the columns loop, file and label";
        Failure::in_file(&path, format!("{error}: {what}"))
    })?;
    // A spreadsheet writes a mark of UTF-8 before it.
    let mut lines = text.strip_prefix('\u{feff}').unwrap_or(&text).lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
    let column = |name: &str| head.iter().position(|own| *own == name);
    let needed = |name: &str| {
        column(name).ok_or_else(|| Failure::in_file(&path, format!("line 1: it has no column {name}")))
    };
    let (name, file, label, kind) = (needed("loop")?, needed("file")?, needed("label")?, column("type"));
    let mut listed = Vec::new();
    for (number, line) in lines.enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let wrong = |what: String| Failure::in_file(&path, format!("line {}: {what}", number + 2));
        let cell =
            |at: usize| cells.get(at).copied().ok_or_else(|| wrong(format!("it has {} cells", cells.len())));
        let sticks = match cell(label)? {
            "stiction" => true,
            "no stiction" => false,
            other => return Err(wrong(format!("label '{other}' is neither 'stiction' nor 'no stiction'"))),
        };
        let name = cell(name)?.to_string();
        let by_type = kind.and_then(|at| told_by_name(cells.get(at)?));
        let integrates = by_type.or_else(|| told_by_name(&name));
        listed.push(Listed { file: folder.join(cell(file)?), sticks, integrates, name });
    }
    if listed.is_empty() {
        return Err(Failure::in_file(&path, "it names no record"));
    }
    Ok(listed)
}

/// Asks everybody about a record. A measured stem is shown to the method that asks for one alone: the others judge as in
/// nearly all plants, where none is measured.
fn hear(record: &Record, integrates: Option<bool>) -> Heard {
    let settings = Settings::default();
    let (judged, program_ms) = timed(|| {
        let diagnosis = diagnose(record, &settings);
        let findings = trace_record(record, &diagnosis, &settings, &residual::Settings::default());
        Judged { findings, ..diagnosis.into() }
    });
    let sticks = match judged.verdict() {
        Verdict::Stiction => Says::Sticks,
        Verdict::NoStiction => Says::Sound,
        Verdict::NotIdentifiable(_) => Says::CannotTell,
    };
    let found = judged.diagnosis.verdict;
    let window = judged.diagnosis.window.unwrap_or_default();
    let blind = Window { mv: None, ..window.clone() };
    let [facts, seen] = [&blind, &window].map(|window| Facts::new(window, integrates));
    let [facts, seen] = [facts, seen].map(|facts| facts.map(|facts| facts.with_verdict(&found)));
    let one = |method: Method| {
        let facts = if method == Method::StemLoop { &seen } else { &facts };
        timed(|| match facts {
            Ok(facts) => opinion(method, facts),
            Err(why) => Opinion::cannot_tell(method, why.clone()),
        })
    };
    let (opinions, mut ms): (Vec<Opinion>, Vec<f64>) = Method::ALL.into_iter().map(one).unzip();
    ms.push(program_ms);
    let regular = facts.as_ref().is_ok_and(|facts| facts.oscillates().is_ok());
    let verdict = (sticks != Says::CannotTell).then_some(sticks == Says::Sticks);
    let doubtful = agreement(&opinions, verdict, regular).doubtful;
    Heard { says: opinions.iter().map(|own| own.says).chain([sticks]).collect(), ms, doubtful }
}

/// What comes of it, and how long it took (ms).
fn timed<T>(make: impl FnOnce() -> T) -> (T, f64) {
    let began = Instant::now();
    let made = make();
    (made, began.elapsed().as_secs_f64() * 1e3)
}

/// The tables as text.
fn page(found: &BenchmarkReport) -> String {
    let mut out = String::new();
    // Writing into a String cannot fail.
    let _ = writeln!(
        out,
        "{:<22} {:<20} {:>6} {:>11}  {:>7} {:<20} {:>11}  {:<20} ms",
        "method",
        "sticks: found",
        "missed",
        "cannot tell",
        "cleared",
        "false alarms",
        "cannot tell",
        "right where told"
    );
    for judge in &found.judges {
        let _ = writeln!(
            out,
            "{:<22} {:<20} {:>6} {:>11}  {:>7} {:<20} {:>11}  {:<20} {:.1}",
            judge.method,
            share(&judge.found),
            judge.missed,
            judge.cannot_tell_sticky,
            judge.cleared,
            share(&judge.false_alarms),
            judge.cannot_tell_sound,
            share(&judge.right),
            judge.ms_median.unwrap_or(f64::NAN)
        );
    }
    let _ = writeln!(out, "\nrecord by record, in the same order: ✓ right, ✗ wrong, · cannot tell");
    for record in &found.records {
        let marks: Vec<&str> = record.says.iter().map(|says| mark(record.sticks, *says)).collect();
        let label = if record.sticks { "sticks" } else { "sound" };
        let doubt = if record.doubtful { "  doubtful" } else { "" };
        let _ = writeln!(out, "{:<22} {label:<7} {}{doubt}", record.r#loop, marks.join(" "));
    }
    out
}
