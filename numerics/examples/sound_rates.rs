//! How often a sound valve is told to stick, by what drives its loop; and how often a sticking one is.
//!
//! `cargo run --release -p stictiond-numerics --example sound_rates`

#[path = "../tests/common/records.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod records;

use clap::Parser;
use stictiond_numerics::detectors::tally::wilson;
use stictiond_numerics::diagnosis::{Settings, Verdict, diagnose};
use stictiond_numerics::residual::{self, trace_record};
use stictiond_numerics::sim::scenarios::{SOUND_KINDS, Scenario, random_sound, random_sticky};

/// How often a sound valve is told to stick
#[derive(Parser)]
struct Args {
    /// First seed
    #[arg(long, default_value_t = 44_000)]
    first_seed: u64,
    /// Sound loops; a multiple of 11 gives every kind the same number. As many sticking ones as of one kind
    #[arg(long, default_value_t = 660)]
    loops: u64,
}

/// Records, and on how many the diagnosis alone and tracing tell stiction.
#[derive(Clone, Copy, Default)]
struct Count {
    records: usize,
    diagnosis: usize,
    tracing: usize,
}

impl Count {
    fn add(&mut self, scenario: Scenario) {
        let Ok(record) = records::window(scenario) else { return };
        let settings = Settings::default();
        let diagnosis = diagnose(&record, &settings);
        let found = trace_record(&record, &diagnosis, &settings, &residual::Settings::default());
        let verdict = found.filter(|found| found.replaces_diagnosis()).map(|found| found.verdict);
        self.records += 1;
        self.diagnosis += usize::from(diagnosis.verdict == Verdict::Stiction);
        self.tracing += usize::from(verdict.unwrap_or(diagnosis.verdict) == Verdict::Stiction);
    }

    fn row(&self, name: &str) {
        let of = |told: usize| {
            let [low, high] = wilson(told, self.records).unwrap_or([0.0, 1.0]).map(|share| 100.0 * share);
            format!("{told} of {} [{low:.1}, {high:.1}]", self.records)
        };
        println!("| {name} | {} | {} |", of(self.diagnosis), of(self.tracing));
    }
}

fn main() {
    let args = Args::parse();
    let mut counts = [Count::default(); SOUND_KINDS.len()];
    for seed in args.first_seed..args.first_seed + args.loops {
        counts[(seed % SOUND_KINDS.len() as u64) as usize].add(random_sound(seed));
    }
    println!(
        "| what drives the loop | told to stick by the diagnosis alone | after tracing |\n|---|---|---|"
    );
    let mut all = Count::default();
    for (kind, count) in SOUND_KINDS.iter().zip(&counts) {
        count.row(kind);
        all.records += count.records;
        all.diagnosis += count.diagnosis;
        all.tracing += count.tracing;
    }
    all.row("all sound valves");
    let mut sticking = Count::default();
    let as_many = args.loops / SOUND_KINDS.len() as u64;
    (args.first_seed..args.first_seed + as_many).for_each(|seed| sticking.add(random_sticky(seed)));
    sticking.row("sticking valves");
}
