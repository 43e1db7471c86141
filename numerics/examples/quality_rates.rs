//! How often what the signals alone show is told where it is there, and where it is not.
//!
//! `quality_rates [--gen ABC] [--seed 1] [--seeds 5] [--kind outliers,…|clean] [--others] [--each]`

#[path = "../../tests/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../../tests/diagnosis_common/parallel.rs"]
mod parallel;

use generators::{Case, Generator, Size};
use std::collections::BTreeMap;
use stictiond_numerics::diagnosis::{self, gate, region};
use stictiond_numerics::residual::Kind;
use stictiond_numerics::residual::data_quality::{Fact, assess};
use stictiond_numerics::residual::hypothesis::Hypothesis;
use stictiond_numerics::residual::valve_search::{Effort, search};
use stictiond_numerics::sysid::arx::Arx;
use stictiond_numerics::sysid::iddata::IdData;
use stictiond_numerics::sysid::valve::Start;

/// The facts of the signals.
const FACTS: [Kind; 4] = [Kind::QuantisedPv, Kind::FrozenPv, Kind::ClockSkew, Kind::Outliers];

struct Asked {
    generators: String,
    seeds: std::ops::Range<u64>,
    kinds: Vec<Option<Kind>>,
    each: bool,
}

fn main() {
    let asked = asked();
    for generator in [generators::a::A, generators::b::B, generators::c::C] {
        if asked.generators.contains(generator.name) {
            rates(&generator, &asked);
        }
    }
}

fn asked() -> Asked {
    let mut args = std::env::args().skip(1);
    let mut asked = Asked { generators: "ABC".into(), seeds: 1..6, kinds: Vec::new(), each: false };
    let value = |args: &mut dyn Iterator<Item = String>| args.next().expect("a value follows");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--gen" => asked.generators = value(&mut args),
            "--seed" => {
                let (first, count) =
                    (value(&mut args).parse().expect("a number"), asked.seeds.end - asked.seeds.start);
                asked.seeds = first..first + count;
            }
            "--seeds" => {
                let count: u64 = value(&mut args).parse().expect("a number");
                asked.seeds.end = asked.seeds.start + count;
            }
            "--kind" => {
                let names = value(&mut args);
                let named = |name: &str| Kind::ALL.into_iter().find(|kind| kind.as_str() == name);
                asked.kinds.extend(names.split(',').map(named));
            }
            "--each" => asked.each = true,
            _ => panic!("{arg} is not known"),
        }
    }
    if asked.kinds.is_empty() {
        let others = Kind::ALL.into_iter().filter(|kind| !FACTS.contains(kind));
        asked.kinds = FACTS.into_iter().chain(others).map(Some).chain([None]).collect();
    }
    asked
}

/// The stem of the best valve, or OP where that is likelier.
fn stem(data: &IdData) -> Vec<f64> {
    let plain = Arx::new(data, &data.y, &[]).fit(&data.u, None).log_likelihood;
    match search(data, &Hypothesis::default(), &[], Effort::Whole).first() {
        Some(found) if found.score > plain => {
            Hypothesis { valve: Some(found.valve), effects: Vec::new() }.stem(data).0
        }
        _ => data.u.clone(),
    }
}

struct Told {
    case: Case,
    name: String,
    facts: Vec<Fact>,
}

fn judge(generator: &Generator, case: Case) -> Option<Told> {
    let (record, truth) = (generator.record)(&case);
    let (window, _) = gate::gate(&record, &diagnosis::Settings::default()).ok()?;
    let found = region::analyse(&window.op);
    let start = region::start_of(&found, &window.op, 0, window.len() / 3)
        .map_or(Start { index: 0, is_max: true }, |s| Start { index: s.index, is_max: s.is_max });
    let mut data = IdData::new(&window, start)?;
    let facts = assess(
        &mut data,
        &stem,
        std::env::var("ONLY").ok().and_then(|n| Kind::ALL.into_iter().find(|k| k.as_str() == n)),
    );
    Some(Told { case, name: truth.name, facts })
}

fn rates(generator: &Generator, asked: &Asked) {
    for &kind in &asked.kinds {
        let mut cases = Vec::new();
        for seed in asked.seeds.clone() {
            let case = |variant| Case { effect: kind, size: Size::Medium, variant, seed, tags: 0 };
            cases.extend((0..(generator.variants)(kind)).map(case));
        }
        let told: Vec<Told> =
            parallel::each(cases, |case| judge(generator, case)).into_iter().flatten().collect();
        let has = |told: &Told, kind| told.facts.iter().any(|fact| Some(fact.kind) == kind);
        let right = told.iter().filter(|told| has(told, kind)).count();
        let mut wrong: BTreeMap<&str, usize> = BTreeMap::new();
        for fact in told.iter().flat_map(|told| &told.facts).filter(|fact| Some(fact.kind) != kind) {
            *wrong.entry(fact.kind.as_str()).or_default() += 1;
        }
        let name = kind.map_or("clean", Kind::as_str);
        let own = if kind.is_some_and(|kind| FACTS.contains(&kind)) {
            format!("told {right:3}")
        } else {
            " ".repeat(8)
        };
        println!("{} {name:22} {own} of {:3}, else {wrong:?}", generator.name, told.len());
        for told in told.iter().filter(|_| asked.each) {
            let missed = own.starts_with("told") && !has(told, kind);
            let odd = missed || told.facts.iter().any(|fact| Some(fact.kind) != kind);
            if odd || std::env::var("ALL").is_ok() {
                println!(
                    "    v{} seed {} {}{}",
                    told.case.variant,
                    told.case.seed,
                    told.name,
                    if missed { ": missed" } else { "" }
                );
                for fact in &told.facts {
                    println!("        {} {:.3}: {}", fact.kind, fact.posterior, fact.described.explanation);
                }
            }
        }
    }
}
