//! A plant of many loops of three tags at 1 Hz, over Modbus/TCP from a server in another process, through the real collectors,
//! history, store, scheduler, diagnosis and API. Prints what that takes and what was missed.
//!
//! `cargo bench --bench load` runs both kinds of loops, one after the other, each with a daemon and a plant of its own, and
//! prints both as rows of one table. Options stand behind `--`, as in `cargo bench --bench load -- --speed 1`:
//!
//! | option | default | |
//! |---|---|---|
//! | `--kind` | `both` | `random`: drawn at random, half of them sticking, in records of 1,500 samples that are repeated, so that hardly any loop is identifiable; `excited`: a third cycle, a third stick, a third are at rest |
//! | `--loops` | 2000 | loops |
//! | `--speed` | 10 | plant time over time on the wall |
//! | `--plant-s` | 600 | plant time that a run takes (s) |
//! | `--period-s` | 300 | plant time between two diagnoses of a loop (s) |
//! | `--samples` | 4096 | samples that are remembered of each tag; a diagnosis reads all of them |
//! | `--parallelism` | 1 | diagnoses at the same time |
//! | `--no-store` | | the daemon keeps nothing |
//! | `--folder` | `target/tmp` | where the store's folder is made; it is removed at the end |
//! | `--rate`, `--listeners` | 0, 200 | with a rate, so many requests are made each second by a third process, beside so many clients that listen to events |
//!
//! **Measured and scaled.** With `--speed 1` an hour of plant takes an hour and nothing is scaled. With `--speed 10` the plant's
//! clock goes ten times as fast: polls, commits of the store and diagnoses come ten times as often, and each second of plant time
//! has as many of them as at 1. Shares of a core are of plant time, so 1,000 loops at 10 load this machine as 10,000 loops at 1 do.
//! What goes by the wall comes less often for each second of plant time: ticks of alarms, upkeep of the store, memory that is
//! given back. A diagnosis has less time until the loop is due again. Memory is that of the loops that were run, never scaled.
//!
//! **First period and following ones.** In the first period nothing is known of any loop and rings are still filling; what comes
//! after goes on for years. Both are told apart. A run must take two periods at least to have a following one.
//!
//! **Bytes a loop-hour** are what the store's database has in use at the end, over loops and hours of plant time. Samples of the
//! last minutes are not chunks yet and take more, so a short run shows more than a long one.
//!
//! **It fails** where a poll was missed or not answered, a diagnosis was skipped, late, panicked or never begun, or the store lost
//! something. Shares of a core and memory are printed with their aims, and fail nothing: they depend on the machine. Other
//! programs on the machine count against it: `taskset -c 0,1` in front gives it two cores, which the plant shares.
//!
//! The aims are for 10,000 loops, each diagnosed once an hour, which takes four hours:
//! `cargo bench --bench load -- --speed 1 --loops 10000 --plant-s 7200 --period-s 3600 --samples 2048 --parallelism 2`.
//! `scripts/profile` shows where the processor time goes.

mod asking;
mod daemon;
mod kind;
mod look;
mod plant;
mod told;

use kind::Kind;
use std::io::{BufRead, BufReader};
use std::process::{Command, ExitCode, Stdio};
use std::time::Duration;
use told::Told;

/// As the daemon's own.
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

type Failed = Box<dyn std::error::Error + Send + Sync>;

/// Tells the run of one kind that the table's head is another's to print.
const BESIDE: &str = "--beside";

fn main() -> Result<ExitCode, Failed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    if let Some(address) = text("--asking") {
        return runtime.block_on(asking::run(address.parse()?)).map(|()| ExitCode::SUCCESS);
    }
    let name = text("--kind").unwrap_or_else(|| "both".to_string());
    if name == "both" {
        return each_alone();
    }
    let kind = Kind::named(&name).ok_or("--kind is random, excited or both")?;
    if flag("--server") {
        let (speed, scenarios) = (option("--speed", 10.0), kind.scenarios());
        return runtime.block_on(plant::serve(speed, false, &scenarios)).map(|()| ExitCode::SUCCESS);
    }
    let done = runtime.block_on(daemon::run(kind, daemon::Asked::of_arguments()));
    runtime.shutdown_timeout(Duration::from_secs(1));
    let found = Told::of(done?);
    found.print();
    if !flag(BESIDE) {
        println!("\n{}", told::HEAD);
    }
    println!("{}", found.row());
    Ok(if found.faults().is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The text after `name` among the arguments, the first time it stands there.
fn text(name: &str) -> Option<String> {
    std::env::args().skip_while(|argument| argument != name).nth(1)
}

/// The number after `name` among the arguments.
fn option(name: &str, default: f64) -> f64 {
    text(name).and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// Whether `name` is among the arguments.
fn flag(name: &str) -> bool {
    std::env::args().any(|argument| argument == name)
}

/// Runs every kind in a process of its own, because the kernel tells the most memory of a process only.
fn each_alone() -> Result<ExitCode, Failed> {
    let (mut rows, mut held) = (Vec::new(), true);
    for kind in Kind::ALL {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["--kind", kind.name(), BESIDE]).args(std::env::args().skip(1));
        let mut run = command.stdout(Stdio::piped()).spawn()?;
        let output = run.stdout.take().ok_or("the run has no output")?;
        for line in BufReader::new(output).lines() {
            let line = line?;
            if line.starts_with("| ") { rows.push(line) } else { println!("{line}") }
        }
        held &= run.wait()?.success();
        println!();
    }
    println!("{}", told::HEAD);
    rows.iter().for_each(|row| println!("{row}"));
    Ok(if held { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
