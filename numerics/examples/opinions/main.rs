//! How often each published method, and the program's own verdict, is right: on a folder of labelled records, and on
//! simulated loops. `docs/benchmark.md` is made of what this prints.
//!
//! ```text
//! opinions DIR                 labelled records: DIR/index.csv with columns loop, file, label
//! opinions --simulated 500     so many simulated loops, by scenario
//! opinions --calibrate 600     what the thresholds that no author gives are taken from, on other seeds
//! opinions --combine 600 [DIR] whether a probability from all votes is better than the verdict alone
//! ```
//!
//! Options: `--each` prints every record; `--threads N`.

mod calibrate;
mod combine;
mod judged;
mod measured;
#[path = "../../../tests/diagnosis_common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;
mod simulated;
mod tables;

/// What is asked for.
struct Args {
    folder: Option<String>,
    simulated: u64,
    calibrate: u64,
    combine: u64,
    each: bool,
    threads: usize,
}

fn main() {
    let mut args = Args { folder: None, simulated: 0, calibrate: 0, combine: 0, each: false, threads: 2 };
    let mut given = std::env::args().skip(1);
    while let Some(word) = given.next() {
        let mut number = || given.next().and_then(|n| n.parse().ok()).expect("a number");
        match word.as_str() {
            "--simulated" => args.simulated = number(),
            "--calibrate" => args.calibrate = number(),
            "--combine" => args.combine = number(),
            "--threads" => args.threads = number() as usize,
            "--each" => args.each = true,
            folder => args.folder = Some(folder.to_owned()),
        }
    }
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
