//! `stictiond plant SOURCE`: which loops of a plant swing together, who started it, and what to repair first.

mod files;
mod html;
mod json;
mod skipped;
mod source;
mod stored;

use super::format::Format;
use super::{Failure, output, print, table};
use skipped::Skipped;
use source::{OneLoop, Source};
use std::borrow::Cow;
use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use stictiond::app::{App, DeadTime, friction_of, margins_of, untold_of};
use stictiond::plantwide::cause::period;
use stictiond::plantwide::window::{of_record, recent};
use stictiond::plantwide::{Analysis, HOUR_S, Part, Plant, PlantLoop, Task, analyse, tasks};
use stictiond::results::words::percent;
use stictiond::results::{Outcome, Run, Summary, Trigger};
use stictiond::signal::{LoopId, Record, many};

/// Most rows of a loop's window; a longer record is thinned.
const MOST_ROWS: usize = 200_000;
/// Rows of all windows together, as long as each has [`LEAST_ROWS`]: 200 MB with OP, PV and a set point.
const ALL_ROWS: usize = 1 << 23;
/// Rows that a window of a longer record has at least: as many as in the daemon.
const LEAST_ROWS: usize = 4096;
/// Samples of the latest part of a record that is thinned, as in the daemon.
const RECENT_SAMPLES: usize = 3600;
/// Reasons why something was skipped that are printed in full.
const FIRST: usize = 20;
/// The same where they are one line.
const FIRST_OF_LINE: usize = 3;

#[derive(clap::Args)]
pub struct Args {
    /// A folder of records, one loop each (CSV of any dialect, Excel or ODS workbooks, Parquet); a table with columns of several
    /// loops; the folder of a store; a configuration (.toml) with `[store]`; or the address of a store in PostgreSQL,
    /// postgres://user@host/database, whose password is in `PGPASSWORD`
    #[arg(value_name = "DIR|STORE|FILE")]
    source: PathBuf,
    /// Which columns of a table are which loop's: a list with the columns loop, op, pv and, as far as there are, sp, mode, mv, or with
    /// loop, role and tag [default: as the columns are called, FIC101.OP, FIC101.PV]
    #[arg(long, value_name = "LIST")]
    loops: Option<PathBuf>,
    /// From this time on: RFC 3339, or seconds on the record's clock [default: all of a file; the latest week of a store]
    #[arg(long, value_parser = super::store::time)]
    from: Option<f64>,
    /// Up to this time
    #[arg(long, value_parser = super::store::time)]
    to_time: Option<f64>,
    /// How to print what was found [default: text on a terminal, else json]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write one HTML page that stands alone
    #[arg(long, value_name = "FILE.html")]
    html: Option<PathBuf>,
    /// The controllers' output limits (OP unit): saturation is judged against them
    #[arg(long, value_name = "LOW,HIGH", value_parser = super::diagnose::limits, allow_hyphen_values = true)]
    op_limits: Option<(f64, f64)>,
    /// Diagnose the valves of at most so many loops that are not at rest, those that swing most first; 0 for none
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

/// The windows of the loops, which fit into memory together.
#[derive(Default)]
struct Windows {
    loops: Vec<PlantLoop>,
    /// The latest part of each loop whose window is thinned.
    recent: Vec<Option<PlantLoop>>,
}

impl Plant for Windows {
    fn count(&self) -> usize {
        self.loops.len()
    }

    fn get(&self, at: usize) -> Cow<'_, PlantLoop> {
        Cow::Borrowed(&self.loops[at])
    }

    fn recent(&self, at: usize, _hour_s: f64) -> Option<PlantLoop> {
        self.recent.get(at)?.clone()
    }
}

/// Reads, analyses, prints.
pub fn run(args: &Args) -> Result<(), Failure> {
    output::may_be_made(args.html.as_deref(), output::PAGE)?;
    if args.from.zip(args.to_time).is_some_and(|(from, to)| from > to) {
        return Err(Failure::BadInput("--from is later than --to-time".to_string()));
    }
    let mut source = Source::open(args)?;
    let (mut plant, skipped) = read(args, &mut source)?;
    if plant.loops.is_empty() {
        return Err(Failure::in_file(&args.source, none(&source, &skipped)));
    }
    let known =
        |id: &String| plant.loops.iter().any(|of| of.name == *id) || skipped.iter().any(|of| of.name == *id);
    let mut named = args.upstream.iter().flat_map(|(into, from)| std::iter::once(into).chain(from));
    if let Some(strange) = named.find(|id| !known(id)) {
        return Err(Failure::in_file(&args.source, format!("--upstream: no record is called {strange:?}")));
    }
    for of in &mut plant.loops {
        of.op_limits = args.op_limits.or(of.op_limits);
        of.upstream = source.configured(&of.name).map(|own| own.upstream.clone()).unwrap_or_default();
        let from = args.upstream.iter().filter(|(into, _)| *into == of.name);
        of.upstream.extend(from.flat_map(|(_, from)| from.clone()));
    }
    let mut found = analyse(&plant);
    let swinging = swinging(&found, args.diagnose);
    if !swinging.is_empty() {
        diagnose(args, &mut source, &swinging, &mut plant)?;
        found = analyse(&plant);
    }
    let work = tasks(&found);
    match args.format.unwrap_or_else(Format::usual) {
        Format::Text => print(&text(&found, &work, &skipped))?,
        Format::Json => print(&json::text(&found, &work, &skipped)?)?,
    }
    if let Some(to) = &args.html {
        let title = args
            .source
            .file_name()
            .map_or_else(|| "plant".into(), |name| name.to_string_lossy().into_owned());
        output::write(to, &html::page(&title, &plant, &found, &work, &skipped::lines(&skipped, FIRST)))?;
    }
    Ok(())
}

/// Why there is nothing to analyse.
fn none(source: &Source, skipped: &[Skipped]) -> String {
    if skipped.is_empty() {
        return source.no_loop().into();
    }
    let reasons = skipped::lines(skipped, FIRST_OF_LINE).into_iter().chain(source.span());
    let reasons = reasons.collect::<Vec<String>>().join("; ");
    format!("no record could be used, {} skipped: {reasons}", skipped.len())
}

/// The loops, and what could not be used.
fn read(args: &Args, source: &mut Source) -> Result<(Windows, Vec<Skipped>), Failure> {
    let (mut plant, mut skipped) = (Windows::default(), Vec::new());
    let mut take = |OneLoop { name, of, record }: OneLoop| {
        let rows = (ALL_ROWS / of.max(1)).clamp(LEAST_ROWS, MOST_ROWS);
        let window = |record: Record| -> Result<(PlantLoop, Option<PlantLoop>), String> {
            let window = of_record(&name, &record, rows)?;
            let latest = window.raw.and_then(|_| recent(&name, &record, HOUR_S, RECENT_SAMPLES).ok());
            Ok((window, latest))
        };
        match record.and_then(window) {
            Ok((window, latest)) => {
                plant.loops.push(window);
                plant.recent.push(latest);
                true
            }
            Err(why) => {
                skipped.push(Skipped { name, why });
                false
            }
        }
    };
    source.each(args, false, &|_| true, &mut take)?;
    skipped.extend(source.remark().map(|why| Skipped { name: "store".into(), why }));
    Ok((plant, skipped))
}

/// Loops that swing in a group or by themselves, or that have a cause why they are not at rest; those that swing most first.
fn swinging(found: &Analysis, most: usize) -> Vec<usize> {
    let share = |at: usize| found.loops[at].oscillations.first().map_or(0.0, |own| own.share);
    // What is sampled too slowly does not show its swing, and a diagnosis says so.
    let is_restless = |at: usize| found.loops[at].group.is_some() || found.loops[at].reason.is_some();
    let mut all: Vec<usize> =
        (0..found.loops.len()).filter(|at| is_restless(*at) || share(*at) > 0.0).collect();
    all.sort_by(|a, b| share(*b).total_cmp(&share(*a)));
    all.truncate(most);
    all
}

/// Diagnoses the valves of some loops. Their records are read again: all of them at once would not fit.
fn diagnose(
    args: &Args,
    source: &mut Source,
    swinging: &[usize],
    plant: &mut Windows,
) -> Result<(), Failure> {
    let places: HashMap<String, usize> =
        swinging.iter().filter_map(|at| Some((plant.loops.as_slice().get(*at)?.name.clone(), *at))).collect();
    let (judge, settings) = (App::diagnosis(), source.settings());
    let mut take = |OneLoop { name, record, .. }: OneLoop| {
        let own = places.get(&name).and_then(|at| plant.loops.get_mut(*at));
        let (Some(own), Ok(record)) = (own, record) else { return false };
        let judged = judge(&record, &settings, None);
        let dead_time_s = DeadTime::of_judged(&judged).map(|found| found.own_s);
        own.margins = margins_of(&judged, own.op_limits);
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
        let summary: Summary = run.summary();
        own.friction = friction_of(&summary, own.op_span);
        own.untold = untold_of(&summary);
        own.dead_time_s = dead_time_s;
        let latest = places.get(run.id.as_str()).and_then(|at| plant.recent.get_mut(*at));
        if let Some(Some(latest)) = latest {
            latest.dead_time_s = dead_time_s;
        }
        true
    };
    source.each(args, true, &|name| places.contains_key(name), &mut take)
}

/// How sure a cause is; of none there is nothing to be sure of.
fn sure(task: &Task) -> String {
    task.probability.map_or_else(|| "–".into(), percent)
}

/// How many loops there are, how many oscillate, and in how many groups.
fn counted(found: &Analysis) -> String {
    let swinging = found.loops.iter().filter(|of| !of.oscillations.is_empty()).count();
    let oscillate = if swinging == 1 { "oscillates" } else { "oscillate" };
    let (loops, groups) = (many(found.loops.len(), "loop"), many(found.groups.len(), "group"));
    format!("{loops}, {swinging} of them {oscillate}, {groups}")
}

fn text(found: &Analysis, work: &[Task], skipped: &[Skipped]) -> String {
    let name = |i: usize| found.loops[i].name.as_str();
    let mut out = counted(found) + "\n";
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
    for part in Part::ALL {
        list(&mut out, part, found, work);
    }
    for why in skipped::lines(skipped, FIRST) {
        let _ = writeln!(out, "skipped {why}");
    }
    out
}

/// What is said where there is nothing to do first.
fn nothing(work: &[Task]) -> &'static str {
    match work.first().map(Task::part) {
        None => "Nothing: no loop that could be judged needs work",
        Some(Part::Unknown) => "Nothing: no cause is known",
        // Such a cause may be as good as sure.
        Some(_) if work.iter().any(|line| line.gains_nothing) => {
            "Nothing: no cause is both likely enough and worth removing"
        }
        Some(_) => "Nothing: no cause is likely enough",
    }
}

/// One part of the list of tasks; nothing of an empty one but the first.
fn list(out: &mut String, part: Part, found: &Analysis, work: &[Task]) {
    let lines: Vec<&Task> = work.iter().filter(|line| line.part() == part).collect();
    if lines.is_empty() && part != Part::First {
        return;
    }
    let note = part.note().map(|note| format!(" ({note})")).unwrap_or_default();
    let _ = writeln!(out, "\n{}{note}", part.heading());
    if lines.is_empty() {
        let _ = writeln!(out, "  {}", nothing(work));
    }
    for line in lines {
        let name = |i: usize| found.loops[i].name.as_str();
        let cause = match part {
            Part::Unknown => String::new(),
            _ => format!(" {} ({})", line.cause.as_str(), sure(line)),
        };
        let victims: Vec<&str> = line.victims.iter().map(|i| name(*i)).collect();
        let calm = if victims.is_empty() {
            String::new()
        } else {
            format!(" — may calm down with it: {}", victims.join(" "))
        };
        let _ = writeln!(out, "  {}{cause}: {}{calm}", name(line.at), line.why);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use stictiond::plantwide::{Cause, Group, LoopFound};

    fn told(work: &[(Cause, Option<f64>)]) -> String {
        let task = |(at, (cause, probability)): (usize, &(Cause, Option<f64>))| Task {
            at,
            cause: *cause,
            probability: *probability,
            worth: 1.0,
            why: format!("why {at}"),
            gains_nothing: false,
            victims: if at == 0 { vec![2] } else { Vec::new() },
        };
        let loops =
            ["FIC1", "LIC2", "TIC3"].map(|name| LoopFound { name: name.into(), ..LoopFound::default() });
        let found = Analysis { loops: loops.into(), groups: Vec::new() };
        let work: Vec<Task> = work.iter().enumerate().map(task).collect();
        text(&found, &work, &[])
    }

    #[test]
    fn the_list_has_three_parts_and_what_is_not_known_is_no_work() {
        let all = told(&[(Cause::Valve, Some(0.9)), (Cause::Tuning, Some(0.6)), (Cause::Unknown, None)]);
        assert_eq!(
            all,
            "3 loops, 0 of them oscillate, 0 groups\n\n\
             What to do first\n  FIC1 valve (90 %): why 0 — may calm down with it: TIC3\n\n\
             Perhaps (less likely than 80 %, or nothing to gain: look before you order work)\n  LIC2 tuning (60 %): why 1\n\n\
             Not at rest, cause unknown (nothing to order yet)\n  TIC3: why 2\n"
        );
        for (work, nothing) in [
            (&[][..], "What to do first\n  Nothing: no loop that could be judged needs work\n"),
            (&[(Cause::Unknown, None)][..], "What to do first\n  Nothing: no cause is known\n"),
            (&[(Cause::Load, Some(0.5))][..], "What to do first\n  Nothing: no cause is likely enough\n"),
        ] {
            assert!(told(work).contains(nothing), "{}", told(work));
        }
        assert!(!told(&[]).contains("Perhaps"));
        let sure = Task {
            at: 0,
            cause: Cause::Sensor,
            probability: Some(0.99),
            worth: 1.0,
            why: String::new(),
            gains_nothing: true,
            victims: Vec::new(),
        };
        assert_eq!(nothing(&[sure]), "Nothing: no cause is both likely enough and worth removing");
    }

    #[test]
    fn one_is_not_told_as_many() {
        let of = |loops: usize, groups: usize| {
            counted(&Analysis {
                loops: vec![LoopFound::default(); loops],
                groups: vec![Group::default(); groups],
            })
        };
        assert_eq!(of(1, 0), "1 loop, 0 of them oscillate, 0 groups");
        assert_eq!(of(2, 1), "2 loops, 0 of them oscillate, 1 group");
    }
}
