//! What a tempering exponent of the likelihood does on simulated loops:
//! `cargo run --release -p stictiond-numerics --example tempering -- --generators ABC --first-seed 301 --seeds 1`, which are the
//! loops that the exponent was chosen on, and the defaults.
//!
//! For each exponent: the mean logarithmic score of the true kind's posterior at the first step, and how many kinds are named
//! right, named wrongly and missed.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
mod parallel;

use clap::Parser;
use generators::{Case, GENERATORS, Size};
use stictiond_numerics::diagnosis::{self, diagnose};
use stictiond_numerics::residual::{self, Kind, first_step};

/// What a tempering exponent of the likelihood does on simulated loops
#[derive(Parser)]
struct Args {
    /// First seed
    #[arg(long, default_value_t = 301)]
    first_seed: u64,
    /// Number of seeds
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// Letters of the generators
    #[arg(long, default_value = "ABC")]
    generators: String,
}

fn main() {
    let Args { first_seed: first, seeds, generators: letters } = Args::parse();
    for generator in GENERATORS.iter().filter(|g| letters.contains(g.name)) {
        let of_signals = [Kind::QuantisedPv, Kind::Outliers, Kind::FrozenPv, Kind::ClockSkew, Kind::SlipJump];
        let kinds = Kind::ALL.into_iter().filter(|kind| !of_signals.contains(kind)).map(Some);
        let mut cases = Vec::new();
        for effect in kinds.chain([None; 10]) {
            for variant in 0..(generator.variants)(effect) {
                for seed in first..first + seeds {
                    let seed =
                        seed + 1000 * cases.iter().filter(|c: &&Case| c.effect.is_none()).count() as u64;
                    cases.push(Case { effect, size: Size::Medium, variant, seed, tags: 3 });
                }
            }
        }
        let rows = parallel::each(&cases, |case| {
            let (record, _) = (generator.record)(case);
            let settings = diagnosis::Settings::default();
            let d = diagnose(&record, &settings);
            first_step(&record, &d, &settings, &residual::Settings::default())
        });
        println!("generator {}: {} records", generator.name, cases.len());
        for tempering in (4..=20).map(|i| 0.05 * f64::from(i)) {
            let (mut sum, mut right, mut wrong, mut missed, mut n) = (0.0, 0, 0, 0, 0);
            for (case, rows) in cases.iter().zip(&rows) {
                let log = |row: &residual::Row| {
                    let prior = if row.kind.is_some() { -(22.0f64).ln() } else { -(2.0f64).ln() };
                    tempering * row.log_likelihood - row.cost + prior
                };
                let most = rows.iter().map(log).fold(f64::NEG_INFINITY, f64::max);
                if !most.is_finite() {
                    continue;
                }
                let mass = |of: &dyn Fn(&residual::Row) -> bool| -> f64 {
                    rows.iter().filter(|row| of(row)).map(|row| (log(row) - most).exp()).sum()
                };
                let p = mass(&|row| row.kind == case.effect) / mass(&|_| true);
                // What no fit sees is not to be had at any price.
                sum += p.max(1e-3).ln();
                n += 1;
                let named = Kind::ALL
                    .into_iter()
                    .find(|kind| mass(&|row| row.kind == Some(*kind)) > 0.5 * mass(&|_| true));
                right += usize::from(named == case.effect);
                wrong += usize::from(named.is_some() && named != case.effect);
                missed += usize::from(named.is_none() && case.effect.is_some());
            }
            println!(
                "{tempering:.2}: mean log score {:.4}, right {right}, wrong {wrong}, missed {missed} of {n}",
                sum / n as f64
            );
        }
    }
}
