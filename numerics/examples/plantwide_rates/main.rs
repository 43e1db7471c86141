//! How often groups, sources and causes are right on simulated plants, with Wilson intervals.
//!
//! `cargo run --release -p stictiond-numerics --example plantwide_rates -- --first 9000 --diagnose`.

mod friction;

use clap::Parser;
use std::collections::BTreeMap;
use stictiond_numerics::detectors::tally;
use stictiond_numerics::plantwide::{Analysis, PlantLoop, analyse};
use stictiond_numerics::signal::Window;
use stictiond_numerics::sim::units::{Plant, Source, plant};

/// Share of PV's variance from which a loop is a source's victim, and below which it is not; between them nobody can say.
const VICTIM: [f64; 2] = [0.08, 0.3];

/// How often groups, sources and causes are right on simulated plants
#[derive(Parser)]
struct Args {
    /// Seed of the first plant
    #[arg(long, default_value_t = 5000)]
    first: u64,
    /// Plants to draw
    #[arg(long, default_value_t = 100)]
    plants: u64,
    /// Length of the records (h)
    #[arg(long, default_value_t = 24.0)]
    hours: f64,
    /// Tell each loop which loops are upstream of it
    #[arg(long)]
    upstream: bool,
    /// Print the signs of every suspect, for `calibrate rank`
    #[arg(long)]
    signs: bool,
    /// Diagnose loops that swing together and look at the plant again, as in the daemon
    #[arg(long)]
    diagnose: bool,
}

/// One to three sources by the seed; every fifth plant has none.
fn sources(seed: u64) -> Vec<(Source, Option<usize>)> {
    let kinds = [Source::Valve, Source::Tight, Source::Load];
    let count = [0, 1, 1, 2, 3][(seed % 5) as usize];
    (0..count).map(|i| (kinds[((seed / 5 + i) % 3) as usize], None)).collect()
}

fn loops(of: &Plant, runs: &[stictiond_numerics::sim::Run], upstream: bool) -> Vec<PlantLoop> {
    let window = |run: &stictiond_numerics::sim::Run| Window {
        ts: run.ts,
        op: run.op.clone(),
        pv: run.pv.clone(),
        sp: Some(run.sp.clone()),
        ..Window::default()
    };
    (0..runs.len())
        .map(|i| {
            let up = of.streams.iter().filter(|s| s.to == i).map(|s| of.loops[s.from].name.clone());
            PlantLoop {
                name: of.loops[i].name.clone(),
                window: window(&runs[i]),
                op_limits: Some((0.0, 100.0)),
                upstream: if upstream { up.collect() } else { Vec::new() },
                ..PlantLoop::default()
            }
        })
        .collect()
}

/// Adjusted Rand index (Hubert & Arabie 1985) of two labellings.
fn rand_index(a: &[usize], b: &[usize]) -> f64 {
    let pairs = |n: f64| 0.5 * n * (n - 1.0);
    let (mut cells, mut rows, mut columns) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    for (a, b) in a.iter().zip(b) {
        *cells.entry((*a, *b)).or_insert(0.0) += 1.0;
        *rows.entry(*a).or_insert(0.0) += 1.0;
        *columns.entry(*b).or_insert(0.0) += 1.0;
    }
    let both: f64 = cells.values().map(|n| pairs(*n)).sum();
    let (r, c): (f64, f64) =
        (rows.values().map(|n| pairs(*n)).sum(), columns.values().map(|n| pairs(*n)).sum());
    let chance = r * c / pairs(a.len() as f64).max(1.0);
    let most = 0.5 * (r + c);
    if (most - chance).abs() < 1e-12 { 1.0 } else { (both - chance) / (most - chance) }
}

fn wilson(right: usize, all: usize) -> String {
    let Some([low, high]) = tally::wilson(right, all) else { return "none".into() };
    let share = right as f64 / all as f64;
    format!("{right} of {all}, {:.0} % ({:.0} to {:.0})", 100.0 * share, 100.0 * low, 100.0 * high)
}

#[derive(Default)]
struct Counts {
    rand: Vec<f64>,
    quiet: (usize, usize),
    first: BTreeMap<&'static str, (usize, usize, usize)>,
    /// Sources in no group: those that swing nobody else, and the others.
    outside: BTreeMap<&'static str, (usize, usize)>,
    causes: BTreeMap<(&'static str, &'static str), usize>,
    doubtful: usize,
    loops: usize,
}

fn main() {
    let args = Args::parse();
    let mut counts = Counts::default();
    for seed in args.first..args.first + args.plants {
        let of = plant(seed, 5, &sources(seed));
        let (runs, shares) = of.truth(args.hours);
        let mut plant = loops(&of, &runs, args.upstream);
        let mut found = analyse(&plant);
        if args.diagnose {
            found.groups.iter().flat_map(|group| &group.members).for_each(|at| {
                plant[*at].friction = friction::friction(&runs[*at]);
            });
            found = analyse(&plant);
        }
        count(&of, &shares, &found, args.signs, &mut counts);
    }
    println!("causes of sources (is, said): {:?}", counts.causes);
    counts.rand.sort_by(f64::total_cmp);
    let mean = counts.rand.iter().sum::<f64>() / counts.rand.len().max(1) as f64;
    let at = |q: f64| counts.rand.get((q * counts.rand.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    println!(
        "adjusted Rand index: mean {mean:.3}, median {:.3}, lower decile {:.3} of {} plants",
        at(0.5),
        at(0.1),
        counts.rand.len()
    );
    println!("loops that nobody can call a victim or none: {} of {}", counts.doubtful, counts.loops);
    println!("no group in a plant without a source: {}", wilson(counts.quiet.0, counts.quiet.1));
    println!(
        "| source | swings nobody else | its group is missed | found | ranked first in it | among the first two |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, (all, right, second)) in &counts.first {
        let (nobody, missed) = counts.outside.get(name).copied().unwrap_or_default();
        println!(
            "| {name} | {nobody} | {missed} | {all} | {} | {} |",
            wilson(*right, *all),
            wilson(*second, *all)
        );
    }
}

fn count(of: &Plant, shares: &[Vec<f64>], found: &Analysis, signs: bool, counts: &mut Counts) {
    if of.sources.is_empty() {
        counts.quiet.1 += 1;
        counts.quiet.0 += usize::from(found.groups.is_empty());
        return;
    }
    // A source that swings nobody else begins no group.
    let begins = |s: usize| shares.iter().filter(|share| share[s] >= VICTIM[1]).count() >= 2;
    let (mut truth, mut said) = (Vec::new(), Vec::new());
    for (i, share) in shares.iter().enumerate() {
        let most = (0..share.len()).max_by(|a, b| share[*a].total_cmp(&share[*b])).unwrap_or(0);
        counts.loops += 1;
        if share[most] > VICTIM[0] && (share[most] < VICTIM[1] || !begins(most)) {
            counts.doubtful += 1;
            continue;
        }
        truth.push(if share[most] >= VICTIM[1] { most + 1 } else { 0 });
        said.push(found.loops[i].group.map_or(0, |g| g + 1));
    }
    counts.rand.push(rand_index(&truth, &said));
    for (s, (source, at)) in of.sources.iter().enumerate() {
        let victims = shares.iter().filter(|share| share[s] >= VICTIM[1]).count();
        let group = found.loops[*at].group.map(|g| &found.groups[g]);
        let name = match source {
            Source::Valve => "valve",
            Source::Tight => "loop",
            _ => "load",
        };
        let outside = counts.outside.entry(name).or_default();
        if victims < 2 {
            outside.0 += 1;
            continue;
        }
        let Some(group) = group else {
            outside.1 += 1;
            continue;
        };
        let place = group.suspects.iter().position(|suspect| suspect.at == *at);
        let said = found.loops[*at].reason.as_ref().map_or("at rest", |r| r.cause.as_str());
        *counts.causes.entry((name, said)).or_default() += 1;
        let entry = counts.first.entry(name).or_default();
        entry.0 += 1;
        entry.1 += usize::from(place == Some(0));
        entry.2 += usize::from(place.is_some_and(|p| p < 2));
        if signs && place.is_some() {
            for suspect in &group.suspects {
                let signs: Vec<String> = suspect.signs.iter().map(|x| format!("{x:.4}")).collect();
                println!(
                    "sign {}{} {} {}",
                    of.sources.len(),
                    *at,
                    u8::from(suspect.at == *at),
                    signs.join(" ")
                );
            }
            println!("end {name}");
        }
    }
}
