//! How often each published method, and the program's own verdict, is right: on a folder of labelled records, and on
//! simulated loops. `docs/benchmark.md` is made of what this prints.
//!
//! `cargo run --release -p stictiond-numerics --example opinions -- --simulated 500`.

mod calibrate;
mod combine;
mod judged;
mod measured;
#[path = "../../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;
mod simulated;
mod tables;

use clap::Parser;

/// How often each published method, and the program's own verdict, is right
#[derive(Parser)]
struct Args {
    /// Labelled records: a folder with index.csv, with columns loop, file, label
    folder: Option<String>,
    /// Simulated loops to judge, by scenario
    #[arg(long, default_value_t = 0)]
    simulated: u64,
    /// Simulated loops of other seeds, by which the thresholds that no author gives are chosen
    #[arg(long, default_value_t = 0)]
    calibrate: u64,
    /// Simulated loops on which a probability from all votes is held against the verdict alone; also on FOLDER
    #[arg(long, default_value_t = 0)]
    combine: u64,
    /// Print every record
    #[arg(long)]
    each: bool,
    /// Records judged at once
    #[arg(long, default_value_t = 2)]
    threads: usize,
}

fn main() {
    let args = Args::parse();
    if args.combine > 0 {
        let sets =
            args.folder.as_deref().map_or_else(Vec::new, |folder| measured::sets(folder, args.threads));
        return combine::print(args.combine, &sets, args.threads);
    }
    if let Some(folder) = &args.folder {
        measured::print(folder, args.each, args.threads);
    }
    if args.simulated > 0 {
        simulated::print(args.simulated, args.each, args.threads);
    }
    if args.calibrate > 0 {
        calibrate::print(args.calibrate, args.threads);
    }
}
