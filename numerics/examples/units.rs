//! What is said of the same loops in other units, signs, offsets and clocks, over measured and drawn records:
//! `cargo run --release -p stictiond-numerics --example units -- --data ../shared/data --drawn 200`.
//!
//! Options: `--data FOLDER` of folders of records, `--drawn N` records of three generators that share no code, `--first-seed K`,
//! `--threads T`, `--untraced` stops at the diagnosis, `--each` prints what differs.

#[path = "../../tests/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../../tests/diagnosis_common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;
#[path = "../../tests/diagnosis_common/units.rs"]
mod units;

use generators::{Case, GENERATORS, Size};
use std::path::Path;
use std::process::ExitCode;
use stictiond_numerics::signal::Record;
use units::{CHANGES, Change, Said, judge, measured, off};

/// f counts as the same within this share of it.
const SAME_F: f64 = 0.01;

struct Options {
    data: String,
    drawn: u64,
    first: u64,
    threads: usize,
    traced: bool,
    each: bool,
}

fn main() -> ExitCode {
    let Some(options) = options() else { return ExitCode::from(2) };
    let mut records = measured(Path::new(&options.data));
    let of_plants = records.len();
    records.extend((0..options.drawn).map(|i| drawn(i, options.first + i)));
    println!("{of_plants} measured records, {} drawn, seeds from {}\n", options.drawn, options.first);
    let own = parallel::on(options.threads, &records, |(_, record)| judge(record, options.traced));
    println!(
        "| the same loop elsewhere | span told: same verdict | same f | worst f | not told: same verdict | in per cent, as told |"
    );
    println!("|---|---|---|---|---|---|");
    for change in &CHANGES {
        let jobs = records.iter().zip(&own);
        let said = parallel::on(options.threads, jobs, |((name, record), own)| {
            let [told, guessed] = [true, false].map(|told| change.of(record, told));
            let told_said = judge(&told, options.traced);
            // The same record with the same span has nothing else to say.
            let guessed_said =
                if guessed == told { told_said.clone() } else { judge(&guessed, options.traced) };
            One { name, own, told: told_said, guessed: guessed_said }
        });
        show(change, &said, options.each);
    }
    ExitCode::SUCCESS
}

/// One record elsewhere.
struct One<'a> {
    name: &'a str,
    own: &'a Said,
    told: Said,
    guessed: Said,
}

fn show(change: &Change, all: &[One<'_>], each: bool) {
    let of = all.len();
    let same = all.iter().filter(|one| one.told.verdict == one.own.verdict);
    let count = same.clone().count();
    let offs: Vec<f64> = same.filter_map(|one| off(change, one.own, &one.told)).collect();
    let near = offs.iter().filter(|off| **off < SAME_F).count();
    let worst = offs.iter().copied().fold(0.0, f64::max);
    let guessed = all.iter().filter(|one| one.guessed.verdict == one.own.verdict).count();
    let in_percent = |one: &&One<'_>| {
        let ends = one.guessed.percent.zip(one.own.percent);
        ends.is_some_and(|(a, b)| (a - b).abs() <= SAME_F * b.abs().max(1e-9))
    };
    let percent = all.iter().filter(in_percent).count();
    println!(
        "| {} | {count} of {of} | {near} of {} | {:.1e} | {guessed} of {of} | {percent} of {} |",
        change.name,
        offs.len(),
        worst,
        all.iter().filter(|one| one.own.percent.is_some()).count()
    );
    for one in all.iter().filter(|_| each) {
        for (how, said) in [("told", &one.told), ("not told", &one.guessed)] {
            let off = off(change, one.own, said).unwrap_or(1.0);
            if said.verdict != one.own.verdict || off > SAME_F {
                println!(
                    "    {} {how}: {} ({}) here {} ({})",
                    one.name, one.own.verdict, one.own.reason, said.verdict, said.reason
                );
            }
        }
    }
}

/// The `i`-th loop: the generators in turn, with all their classes and valves.
fn drawn(i: u64, seed: u64) -> (String, Record) {
    let generator = &GENERATORS[i as usize % GENERATORS.len()];
    let variants = (generator.variants)(None);
    // Steps of five meet all variants, but where their number is a multiple of it.
    let step = if variants.is_multiple_of(5) { 7 } else { 5 };
    let variant = i as usize / GENERATORS.len() * step % variants;
    let case = Case { effect: None, size: Size::Medium, variant, seed, tags: 1 };
    let (record, truth) = (generator.record)(&case);
    (format!("{} {seed} {}", generator.name, truth.name), Record { op_span: Some(100.0), ..record })
}

fn options() -> Option<Options> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut out = Options { data: String::new(), drawn: 0, first: 7000, threads, traced: true, each: false };
    let mut args = std::env::args().skip(1);
    while let Some(name) = args.next() {
        match name.as_str() {
            "--each" => out.each = true,
            "--untraced" => out.traced = false,
            _ => {
                let value = args.next().unwrap_or_default();
                match (name.as_str(), value.parse::<u64>()) {
                    ("--data", _) => out.data = value,
                    ("--drawn", Ok(n)) => out.drawn = n,
                    ("--first-seed", Ok(n)) => out.first = n,
                    ("--threads", Ok(n)) => out.threads = n.max(1) as usize,
                    _ => {
                        eprintln!("{name} {value}: not an option, see the first lines of the example");
                        return None;
                    }
                }
            }
        }
    }
    Some(out)
}
