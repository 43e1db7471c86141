//! How often what the signals alone show is told where it is there, and where it is not.
//!
//! `cargo run --release -p stictiond-numerics --example quality_rates -- --gen A --kind outliers,clean`.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
mod parallel;

use clap::Parser;
use generators::{Case, Generator, Size};
use std::collections::BTreeMap;
use stictiond_numerics::diagnosis::{self, gate, region};
use stictiond_numerics::residual::Kind;
use stictiond_numerics::residual::data_quality::{Fact, assess, of_gate};
use stictiond_numerics::residual::hypothesis::Hypothesis;
use stictiond_numerics::residual::valve_search::{Effort, search};
use stictiond_numerics::sysid::arx::Arx;
use stictiond_numerics::sysid::iddata::IdData;
use stictiond_numerics::sysid::valve::Start;

/// The facts of the signals.
const FACTS: [Kind; 4] = [Kind::QuantisedPv, Kind::FrozenPv, Kind::ClockSkew, Kind::Outliers];

/// How often what the signals alone show is told where it is there, and where it is not
#[derive(Parser)]
struct Asked {
    /// Letters of the generators
    #[arg(long, default_value = "ABC")]
    r#gen: String,
    /// First seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of seeds
    #[arg(long, default_value_t = 5)]
    seeds: u64,
    /// Only records with these effects, separated by commas; `clean` is none
    #[arg(long, value_delimiter = ',', value_parser = kind)]
    kind: Vec<Option<Kind>>,
    /// Print the records on which a fact is missed or invented
    #[arg(long)]
    each: bool,
}

fn kind(name: &str) -> Result<Option<Kind>, &'static str> {
    let known = Kind::ALL.into_iter().find(|kind| kind.as_str() == name);
    if known.is_some() || name == "clean" { Ok(known) } else { Err("neither an effect nor clean") }
}

fn main() {
    let mut asked = Asked::parse();
    if asked.kind.is_empty() {
        let others = Kind::ALL.into_iter().filter(|kind| !FACTS.contains(kind));
        asked.kind = FACTS.into_iter().chain(others).map(Some).chain([None]).collect();
    }
    for generator in [generators::a::A, generators::b::B, generators::c::C] {
        if asked.r#gen.contains(generator.name) {
            rates(&generator, &asked);
        }
    }
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
    let (window, prepared) = gate::gate(&record, &diagnosis::Settings::default()).ok()?;
    let found = region::analyse(&window.op);
    let start =
        region::start_of(&found, &window.op, 0, window.len() / 3).unwrap_or(Start { index: 0, is_max: true });
    let mut data = IdData::new(&window, start)?;
    let mut facts = assess(&mut data, &stem);
    facts.extend(of_gate(prepared.acquisition.map_or(0.0, |found| found.pv_late_s), window.ts));
    Some(Told { case, name: truth.name, facts })
}

fn rates(generator: &Generator, asked: &Asked) {
    for &kind in &asked.kind {
        let mut cases = Vec::new();
        for seed in asked.seed..asked.seed + asked.seeds {
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
            if odd {
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
