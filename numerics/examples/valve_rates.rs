//! How often the search for a valve misses the best one, and what it costs: a tool for work on `residual::valve_search`.
//! `cargo run --release -p stictiond-numerics --example valve_rates -- --from 1 --to 7`.
//!
//! A record's best score is the largest that any search has reached, among them one that starts from the true valve in many
//! forms. With a file as `--known` the best scores are kept between runs, so that versions are compared with the same.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use clap::Parser;
use generators::{Case, Generator, Size, Truth};
use std::collections::BTreeMap;
use std::path::PathBuf;
use stictiond_numerics::diagnosis::{self, gate, region};
use stictiond_numerics::residual::Kind;
use stictiond_numerics::residual::hypothesis::Hypothesis;
use stictiond_numerics::residual::valve_search::{Effort, Found, search};
use stictiond_numerics::sysid::iddata::IdData;
use stictiond_numerics::sysid::valve::{Rest, Start, StopRule, ValveModel};

/// Score behind the best at which a valve counts as missed.
const MISSED: f64 = 2.0;

/// How often the search for a valve misses the best one, and what it costs
#[derive(Parser)]
struct Args {
    /// Letters of the generators
    #[arg(long, default_value = "ABC")]
    r#gen: String,
    /// First seed
    #[arg(long, default_value_t = 1)]
    from: u64,
    /// Seed after the last one
    #[arg(long, default_value_t = 7)]
    to: u64,
    /// Records with an effect instead of clean ones
    #[arg(long)]
    effects: bool,
    /// Print every miss
    #[arg(long)]
    each: bool,
    /// Also time a search beside a valve that is 5 % off
    #[arg(long)]
    near: bool,
    /// Start no search from the true valve, and write no scores
    #[arg(long)]
    uninformed: bool,
    /// File that keeps the best scores between runs
    #[arg(long, value_name = "FILE")]
    known: Option<PathBuf>,
    /// Records searched at once
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

fn main() {
    let args = Args::parse();
    let mut known = BTreeMap::new();
    if let Some(text) = args.known.as_ref().and_then(|file| std::fs::read_to_string(file).ok()) {
        for line in text.lines() {
            let (key, score) = line.rsplit_once(' ').expect("a key and a score");
            known.insert(key.to_string(), score.parse::<f64>().expect("a score"));
        }
    }
    for generator in [generators::a::A, generators::b::B, generators::c::C] {
        if args.r#gen.contains(generator.name) {
            rates(&generator, &args, &mut known);
        }
    }
    if let Some(file) = args.known.as_ref().filter(|_| !args.uninformed) {
        let text: String = known.iter().map(|(key, score)| format!("{key} {score}\n")).collect();
        std::fs::write(file, text).expect("the file can be written");
    }
}

/// Sticky records.
fn cases(generator: &Generator, args: &Args) -> Vec<Case> {
    let direct = [Kind::QuantisedPv, Kind::Outliers, Kind::FrozenPv, Kind::ClockSkew, Kind::SlipJump];
    let kinds: Vec<Option<Kind>> = if args.effects {
        Kind::ALL.into_iter().filter(|kind| !direct.contains(kind)).map(Some).collect()
    } else {
        vec![None]
    };
    let mut cases = Vec::new();
    for effect in kinds {
        for seed in args.from..args.to {
            for variant in 0..(generator.variants)(effect) {
                cases.push(Case { effect, size: Size::Medium, variant, seed, tags: 0 });
            }
        }
    }
    cases
}

/// The true valve in many forms.
fn informed(data: &IdData, truth: &Truth) -> Vec<ValveModel> {
    let s = 2.0 * truth.f / data.units.u;
    let js = if truth.j.is_finite() {
        vec![truth.j / data.units.u]
    } else {
        [0.15, 0.3, 0.45, 0.6].map(|r| r * s).to_vec()
    };
    let mut all = Vec::new();
    for rule in StopRule::ALL {
        for &j in &js {
            let tied = j > 0.9 * s;
            let places = if tied && rule == StopRule::Slip { 20 } else { 4 };
            for place in 0..=places {
                for turned in [false, true] {
                    let rest = Rest { turned, beyond: f64::from(place) / f64::from(places) };
                    all.push(ValveModel {
                        s,
                        j: if tied { s } else { j },
                        rule,
                        rest,
                        ..ValveModel::default()
                    });
                }
            }
        }
    }
    all
}

/// Time of the processor that this thread has had (ms): others may keep it busy.
fn cpu() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux tells it");
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).expect("a number") / 1e6
}

/// One record.
struct Out {
    key: String,
    name: String,
    truth: Truth,
    unit: f64,
    found: Option<Found>,
    best: f64,
    ms: f64,
    near: f64,
}

fn judge(generator: &Generator, case: &Case, args: &Args, known: &BTreeMap<String, f64>) -> Option<Out> {
    let (record, truth) = (generator.record)(case);
    if truth.f <= 0.0 {
        return None;
    }
    let (window, _) = gate::gate(&record, &diagnosis::Settings::default()).ok()?;
    let found = region::analyse(&window.op);
    let start =
        region::start_of(&found, &window.op, 0, window.len() / 3).unwrap_or(Start { index: 0, is_max: true });
    let data = IdData::new(&window, start)?;
    let none = Hypothesis::default();
    let key = format!(
        "{} {} {} {}",
        generator.name,
        case.effect.map_or("clean".into(), |k| k.to_string()),
        case.variant,
        case.seed
    );
    let t = cpu();
    let found = search(&data, &none, &[], Effort::Whole).into_iter().next();
    let ms = cpu() - t;
    let score = |found: &Option<Found>| found.as_ref().map_or(f64::NEG_INFINITY, |found| found.score);
    let mut best = score(&found).max(known.get(&key).copied().unwrap_or(f64::NEG_INFINITY));
    if !args.uninformed {
        let told = search(&data, &none, &informed(&data, &truth), Effort::Whole);
        best = best.max(score(&told.into_iter().next()));
    }
    let mut near = 0.0;
    if args.near {
        let starts: Vec<ValveModel> =
            found.iter().map(|found| ValveModel { s: 1.05 * found.valve.s, ..found.valve }).collect();
        let t = cpu();
        search(&data, &none, &starts, Effort::Near);
        near = cpu() - t;
    }
    Some(Out { key, name: truth.name.clone(), unit: data.units.u, truth, found, best, ms, near })
}

/// The value below which a share of them lie.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get((values.len() as f64 * share) as usize).copied().unwrap_or(0.0)
}

fn rates(generator: &Generator, args: &Args, known: &mut BTreeMap<String, f64>) {
    let shared = &*known;
    let out =
        parallel::on(args.threads, cases(generator, args), |case| judge(generator, &case, args, shared));
    let out: Vec<Out> = out.into_iter().flatten().collect();
    let mut behind = Vec::new();
    for o in &out {
        let score = o.found.as_ref().map_or(f64::NEG_INFINITY, |found| found.score);
        let short = (o.best - score).min(1e3);
        behind.push(short);
        known.insert(o.key.clone(), o.best);
        if args.each && short > MISSED {
            let v = o.found.as_ref().map(|found| found.valve).unwrap_or_default();
            println!(
                "   {} {}: S {:.3} J {:.3}, found S {:.3} J {:.3} {:?} {:?}, short {short:.1}",
                o.key,
                o.name,
                2.0 * o.truth.f,
                o.truth.j,
                v.s * o.unit,
                v.j * o.unit,
                v.rule,
                v.rest
            );
        }
    }
    let n = out.len() as f64;
    println!(
        "{} {} records {n}: missed {:.1} %, mean shortfall {:.2} (at most 20: {:.2}); ms median {:.1} 90 % {:.1}; near {:.1} {:.1}",
        generator.name,
        if args.effects { "effects" } else { "clean" },
        100.0 * behind.iter().filter(|b| **b > MISSED).count() as f64 / n,
        behind.iter().sum::<f64>() / n,
        behind.iter().map(|b| b.min(20.0)).sum::<f64>() / n,
        quantile(out.iter().map(|o| o.ms), 0.5),
        quantile(out.iter().map(|o| o.ms), 0.9),
        quantile(out.iter().map(|o| o.near), 0.5),
        quantile(out.iter().map(|o| o.near), 0.9),
    );
}
