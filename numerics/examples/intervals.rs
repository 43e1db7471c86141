//! How often the interval of f contains the true f, on simulated sticking loops of three generators that share no code, sampled
//! at the controller's ticks; and how often it would with other values of the error of the valve models:
//! `cargo run --release -p stictiond-numerics --example intervals -- --records 1500 --first-seed 71000`.

#[path = "../tests/common/acquired.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod acquired;
#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use acquired::{draw, judge};
use clap::Parser;
use stictiond_numerics::detectors::tally::wilson;
use stictiond_numerics::sysid::valve::model_error::{MODEL_SD, NORMAL_95, without_model_error};

/// Relative standard deviations of f that are tried.
const TRIED: [f64; 7] = [0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12];

/// How often the interval of f contains the true f
#[derive(Parser)]
struct Args {
    /// Loops of three generators, sound and sticking
    #[arg(long, default_value_t = 300)]
    records: u64,
    /// First seed
    #[arg(long, default_value_t = 71_000)]
    first_seed: u64,
    /// Loops judged at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
}

/// A sticking valve that is found: the true f and the ends of the likelihood's interval, as logarithms of their ratio to the
/// estimate of f.
struct Told {
    generator: char,
    truth: f64,
    ends: [f64; 2],
}

impl Told {
    /// Whether the interval contains the true f if the models' error has this standard deviation.
    fn is_inside(&self, model_sd: f64) -> bool {
        let [low, high] = self.ends.map(|end| end.hypot(NORMAL_95 * model_sd));
        (-low..=high).contains(&self.truth)
    }
}

fn main() {
    let Args { records, first_seed, threads } = Args::parse();
    let told = parallel::on(threads.max(1), 0..records, |at| {
        let own = draw(at, first_seed + at);
        let said = judge(&own, &own.record);
        let logarithm = |f: f64| (f / said.f).ln();
        (own.f > 0.0 && said.sticks()).then(|| Told {
            generator: own.name.chars().next().unwrap_or_default(),
            truth: logarithm(own.f),
            ends: without_model_error(said.f, said.ci).map(logarithm),
        })
    });
    let told: Vec<Told> = told.into_iter().flatten().collect();
    println!("{records} loops, seeds from {first_seed}; Wilson 95 % intervals in brackets\n");
    println!("| standard deviation of the models' error | A | B | C | all |\n|---|---|---|---|---|");
    for model_sd in TRIED {
        let share = |generators: &str| {
            let of: Vec<&Told> = told.iter().filter(|own| generators.contains(own.generator)).collect();
            let inside = of.iter().filter(|own| own.is_inside(model_sd)).count();
            wilson(inside, of.len()).map_or("-".to_string(), |[low, high]| {
                format!("{inside} of {} [{:.0}, {:.0}]", of.len(), 100.0 * low, 100.0 * high)
            })
        };
        let mark = if model_sd == MODEL_SD { " (published)" } else { "" };
        println!(
            "| {model_sd}{mark} | {} | {} | {} | {} |",
            share("A"),
            share("B"),
            share("C"),
            share("ABC")
        );
    }
}
