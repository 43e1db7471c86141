//! What it costs in errors that a structure which still holds is not searched for again, on three generators:
//! `cargo run --release -p stictiond-numerics --example structure_rates -- --records 60 --first-seed 91000`.
//!
//! The first half of a record is searched, and the second half is judged twice: by a search, and by what is confirmed of the
//! structure that the first half had. Between the halves something happens to the loop, which is the same otherwise: process,
//! controller, loads and noise go on. An effect that has a time of its own may have it in either half; where a search of the
//! second half does not name it, nothing is counted as overlooked. Nothing was tuned on these seeds.

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

/// What happens between two windows, and how much friction there is before, as a share of that after.
const CHANGES: [(&str, f64); 4] = [
    ("nothing", 1.0),
    ("an effect sets in", 1.0),
    ("the valve begins to stick", 0.0),
    ("friction becomes twice as large", 0.5),
];

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
        let sticking = sticking(generator, first);
        let jobs = (0..CHANGES.len()).flat_map(|change| (0..records).map(move |i| (change, i)));
        let said = parallel::on(threads, jobs, |(change, i)| {
            judge(generator, &case(generator, &sticking, change, first, i), change)
        });
        let said: Vec<Said> = said.into_iter().flatten().collect();
        for (change, (name, _)) in CHANGES.iter().enumerate() {
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

/// The variants of a generator whose valve sticks, effect or none.
fn sticking(generator: &Generator, seed: u64) -> Vec<usize> {
    let sticks = |variant: &usize| {
        let case = Case { effect: None, size: Size::Medium, variant: *variant, seed, tags: 0 };
        (generator.record)(&case).1.f > 0.0
    };
    (0..(generator.variants)(None)).filter(sticks).collect()
}

/// The `i`-th loop to which a change happens.
fn case(generator: &Generator, sticking: &[usize], change: usize, first: u64, i: u64) -> Case {
    let at = i as usize;
    let effect = (change == 1).then(|| Kind::ALL[at % Kind::ALL.len()]);
    let variants = (generator.variants)(effect);
    let variant = match change {
        0 => at % variants,
        // Consecutive loops of one kind differ in class and in valve.
        1 => (at + 4 * (at / Kind::ALL.len())) % variants,
        _ => sticking[at % sticking.len()],
    };
    Case { effect, size: Size::Medium, variant, seed: first + i, tags: 2 }
}

/// What is said of the half after a change; `None` where the half before has no structure.
fn judge(generator: &Generator, case: &Case, change: usize) -> Option<Said> {
    let (record, truth) = (generator.record)(case);
    let (before, _) = halves(&(generator.before)(case, CHANGES[change].1));
    let (_, after) = halves(&record);
    let kind = case.effect.map_or("clean", Kind::as_str);
    let name = format!("{kind} v{} seed {} {}", case.variant, case.seed, truth.name);
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
