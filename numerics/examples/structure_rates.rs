//! What it costs in errors that a structure which still holds is not searched for again, on three generators:
//! `cargo run --release -p stictiond-numerics --example structure_rates -- --records 60 --first-seed 91000`.
//!
//! A record is searched as a whole, and another one is judged twice: by a search, and by what is confirmed of the structure that
//! the first one had. Nothing was tuned on these seeds.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use clap::Parser;
use generators::{Case, GENERATORS, Generator, Size};
use stictiond_numerics::detectors::tally;
use stictiond_numerics::diagnosis::{Settings, Verdict, diagnose};
use stictiond_numerics::residual::{self, Findings, Kind, Structure, confirm, trace_record};
use stictiond_numerics::signal::{Record, Sample};

/// What happens between two windows.
const CHANGES: [&str; 4] = ["nothing", "an effect sets in", "the valve begins to stick", "another friction"];

/// What was said of the second window.
struct Said {
    change: usize,
    name: String,
    /// By a search.
    searched: Findings,
    /// By the structure of the first.
    confirmed: Option<Findings>,
    /// f by a search of the first.
    before: f64,
}

/// What it costs in errors that a structure which still holds is not searched for again
#[derive(Parser)]
struct Args {
    /// Pairs of windows of each generator and change
    #[arg(long, default_value_t = 60)]
    records: u64,
    /// First seed
    #[arg(long, default_value_t = 91_000)]
    first_seed: u64,
    /// Pairs judged at once
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Print the confirmed pairs on which the search says something else
    #[arg(long)]
    each: bool,
}

fn main() {
    let Args { records, first_seed: first, threads, each } = Args::parse();
    println!("{records} pairs of windows a generator and change, seeds from {first}\n");
    println!(
        "| | between the windows | first has a structure | confirmed | verdict as searched | f within 10 % of the search's | \
         the search names an effect: confirmed all the same |"
    );
    println!("|---|---|---|---|---|---|---|");
    for generator in &GENERATORS {
        let jobs = (0..CHANGES.len()).flat_map(|change| (0..records).map(move |i| (change, i)));
        let said = parallel::on(threads, jobs, |(change, i)| judge(generator, change, first, i));
        let said: Vec<Said> = said.into_iter().flatten().collect();
        for (change, name) in CHANGES.iter().enumerate() {
            let own: Vec<&Said> = said.iter().filter(|said| said.change == change).collect();
            println!("| {} | {name} | {} |", generator.name, row(&own));
            own.iter().filter(|said| each && differs(said)).for_each(|said| print(said));
        }
    }
}

/// The cells of one row.
fn row(own: &[&Said]) -> String {
    let confirmed: Vec<(&Said, &Findings)> =
        own.iter().filter_map(|said| Some((*said, said.confirmed.as_ref()?))).collect();
    let same = confirmed.iter().filter(|(said, by)| said.searched.verdict == by.verdict).count();
    let sticking: Vec<_> = confirmed
        .iter()
        .filter(|(said, by)| [&said.searched.verdict, &by.verdict] == [&Verdict::Stiction; 2])
        .collect();
    let near = sticking
        .iter()
        .filter(|(said, by)| (by.friction_after.f / said.searched.friction_after.f - 1.0).abs() < 0.1);
    let named: Vec<&&Said> = own.iter().filter(|said| names(&said.searched)).collect();
    let overlooked = named.iter().filter(|said| said.confirmed.is_some()).count();
    format!(
        "{} | {} | {same} of {} {} | {} of {} | {overlooked} of {} {}",
        own.len(),
        share(confirmed.len(), own.len()),
        confirmed.len(),
        wilson(same, confirmed.len()),
        near.count(),
        sticking.len(),
        named.len(),
        wilson(overlooked, named.len())
    )
}

/// Whether a search names an effect that no structure has.
fn names(found: &Findings) -> bool {
    let carried = [Kind::SlipJump, Kind::QuantisedPv, Kind::OscillatingLoad, Kind::MeasuredDisturbance];
    found.effects.iter().any(|effect| !carried.contains(&effect.kind))
}

fn differs(said: &Said) -> bool {
    said.confirmed.as_ref().is_some_and(|by| by.verdict != said.searched.verdict || names(&said.searched))
}

fn print(said: &Said) {
    let kinds: Vec<&str> = said.searched.effects.iter().map(|effect| effect.kind.as_str()).collect();
    println!("  {}: searched {} {kinds:?}, f before {:.3}", said.name, said.searched.reason, said.before);
    said.confirmed.iter().for_each(|by| println!("    confirmed {}", by.reason));
}

/// Two windows, the second after a change; `None` where the first has no structure.
fn judge(generator: &Generator, change: usize, first: u64, i: u64) -> Option<Said> {
    let case = |effect: Option<Kind>, at: u64| {
        let variants = (generator.variants)(effect) as u64;
        Case {
            effect,
            size: Size::Medium,
            variant: (at % variants) as usize,
            seed: first + at / variants,
            tags: 2,
        }
    };
    let clean = case(None, i);
    let (record, truth) = (generator.record)(&clean);
    let (before, after, name) = match change {
        0 => {
            let (one, other) = halves(&record);
            (one, other, truth.name)
        }
        1 => {
            let kind = Kind::ALL[(i as usize) % Kind::ALL.len()];
            let variants = (generator.variants)(Some(kind));
            let with = Case { effect: Some(kind), variant: clean.variant % variants, ..clean };
            let (other, truth) = (generator.record)(&with);
            (record, other, format!("{} {}", kind.as_str(), truth.name))
        }
        _ => {
            // The next loop whose valve sticks.
            let (other, next) = (i + 1..i + 40)
                .map(|at| (generator.record)(&case(None, at)))
                .find(|(_, other)| other.f > 0.0 && (change == 2) != (truth.f > 0.0))?;
            (record, other, next.name)
        }
    };
    let found = search(&before)?;
    let structure = found.structure.clone()?;
    let confirmed = confirmed(&after, &structure);
    Some(Said { change, name, searched: search(&after)?, confirmed, before: found.friction_after.f })
}

/// The two halves of a record.
fn halves(record: &Record) -> (Record, Record) {
    let middle = record.op[record.op.len() / 2].t;
    let part = |late: bool| {
        let cut = |series: &Vec<Sample>| -> Vec<Sample> {
            series.iter().copied().filter(|sample| (sample.t >= middle) == late).collect()
        };
        Record {
            op: cut(&record.op),
            pv: cut(&record.pv),
            sp: record.sp.as_ref().map(cut),
            mode: record.mode.as_ref().map(cut),
            tags: record.tags.iter().map(|(name, series)| (name.clone(), cut(series))).collect(),
            ..record.clone()
        }
    };
    (part(false), part(true))
}

fn search(record: &Record) -> Option<Findings> {
    let settings = Settings::default();
    let diagnosis = diagnose(record, &settings);
    trace_record(record, &diagnosis, &settings, &residual::Settings::default())
}

fn confirmed(record: &Record, structure: &Structure) -> Option<Findings> {
    let found = confirm(record, &Settings::default(), &residual::Settings::default(), structure);
    found.map(|(_, findings)| findings)
}

fn share(count: usize, of: usize) -> String {
    format!("{count} of {of} {}", wilson(count, of))
}

/// Wilson's 95 % interval in per cent.
fn wilson(count: usize, of: usize) -> String {
    tally::wilson(count, of)
        .map_or_else(String::new, |[low, high]| format!("[{:.0}, {:.0}]", 100.0 * low, 100.0 * high))
}
