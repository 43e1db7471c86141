//! What is said of the same loops in other units, signs, offsets and clocks, over measured and drawn records:
//! `cargo run --release -p stictiond-numerics --example units -- --data ../shared/data --drawn 200`.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/measured.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod measured;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;
#[path = "../tests/common/units.rs"]
mod units;

use clap::Parser;
use generators::{Case, GENERATORS, Size};
use std::path::PathBuf;
use stictiond_numerics::signal::Record;
use units::{CHANGES, Change, Said, judge, off};

/// f counts as the same within this share of it.
const SAME_F: f64 = 0.01;

/// What is said of the same loops in other units, signs, offsets and clocks
#[derive(Parser)]
struct Args {
    /// Folder of folders of measured records
    #[arg(long, value_name = "FOLDER")]
    data: Option<PathBuf>,
    /// Records to draw, of three generators that share no code
    #[arg(long, default_value_t = 0)]
    drawn: u64,
    /// First seed
    #[arg(long, default_value_t = 7000)]
    first_seed: u64,
    /// Records judged at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Stop at the diagnosis
    #[arg(long)]
    untraced: bool,
    /// Print what differs
    #[arg(long)]
    each: bool,
}

fn main() {
    let Args { data, drawn: count, first_seed: first, threads, untraced, each } = Args::parse();
    let (threads, traced) = (threads.max(1), !untraced);
    let mut records = data.as_deref().map_or_else(Vec::new, measured::below);
    let of_plants = records.len();
    records.extend((0..count).map(|i| drawn(i, first + i)));
    println!("{of_plants} measured records, {count} drawn, seeds from {first}\n");
    let own = parallel::on(threads, &records, |(_, record)| judge(record, traced));
    println!(
        "| the same loop elsewhere | span told: same verdict | same f | worst f | not told: same verdict | in per cent, as told |"
    );
    println!("|---|---|---|---|---|---|");
    for change in &CHANGES {
        let jobs = records.iter().zip(&own);
        let said = parallel::on(threads, jobs, |((name, record), own)| {
            let [told, guessed] = [true, false].map(|told| change.of(record, told));
            let told_said = judge(&told, traced);
            // The same record with the same span has nothing else to say.
            let guessed_said = if guessed == told { told_said.clone() } else { judge(&guessed, traced) };
            One { name, own, told: told_said, guessed: guessed_said }
        });
        show(change, &said, each);
    }
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
