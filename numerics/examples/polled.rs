//! What a diagnosis says of the same loops at the controller's ticks and as a historian holds them, polled and with holes:
//! `cargo run --release -p stictiond-numerics --example polled -- --records 100 --first-seed 7000`.

#[path = "../tests/common/acquired.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod acquired;
#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use acquired::{Loop, Said, draw, judge, kinds_of_gaps, scans};
use clap::Parser;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::process::ExitCode;
use stictiond_numerics::detectors::tally;
use stictiond_numerics::signal::Record;
use stictiond_numerics::sim::acquisition::{Acquisition, Poll, acquire};

/// Largest share by which the clock of who polls differs from the controller's.
const CLOCK: f64 = 3e-4;
/// Draws an acquisition for a scan period (s).
type Draw = dyn Fn(f64, &mut Pcg64Mcg) -> Acquisition + Sync;

/// A row of the table: its name, and how the record comes about of the scan's period and chances of the loop's own.
struct Row {
    name: String,
    how: Box<Draw>,
}

/// What a diagnosis says of the same loops at the controller's ticks, polled and with holes
#[derive(Parser)]
struct Args {
    /// Loops of three generators that share no code, sound and sticking
    #[arg(long, default_value_t = 60)]
    records: u64,
    /// First seed
    #[arg(long, default_value_t = 7000)]
    first_seed: u64,
    /// Loops judged at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Only the rows with these names, whole and separated by semicolons
    #[arg(long = "rows", value_name = "ROWS", value_delimiter = ';')]
    wanted: Vec<String>,
    /// Print what differs from the ticks
    #[arg(long)]
    each: bool,
}

fn main() -> ExitCode {
    let Args { records: count, first_seed: first, threads, wanted, each } = Args::parse();
    let threads = threads.max(1);
    let all = rows();
    let wanted: Vec<&str> = wanted.iter().map(|name| name.trim()).collect();
    if let Some(unknown) = wanted.iter().find(|name| all.iter().all(|row| row.name != **name)) {
        eprintln!("no row {unknown:?}; the rows are");
        all.iter().for_each(|row| eprintln!("  {}", row.name));
        return ExitCode::FAILURE;
    }
    let loops: Vec<Loop> = parallel::on(threads, 0..count, |i| draw(i, first + i));
    println!("{count} loops, seeds from {first}; Wilson 95 % intervals in brackets\n");
    println!(
        "| acquisition | sticking found | of those found at the ticks | f within 10 % | interval covers S/2 | sound called sticking | sticking told none, f within the bound | effect invented | same verdict | not identifiable |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let at_ticks = parallel::on(threads, &loops, |own| judge(own, &own.record));
    show("at the controller's ticks", &loops, &at_ticks, &at_ticks, false);
    for row in all.iter().filter(|row| wanted.is_empty() || wanted.contains(&row.name.as_str())) {
        let said = parallel::on(threads, &loops, |own| {
            let Some(scans) = scans(&own.record) else { return judge(own, &own.record) };
            let mut rng = Pcg64Mcg::seed_from_u64(own.seed);
            let how = (row.how)(scans.scan_s, &mut rng);
            let record = Record { op_span: Some(100.0), ..acquire(&scans, &how, own.seed) };
            judge(own, &record)
        });
        show(&row.name, &loops, &at_ticks, &said, each);
    }
    ExitCode::SUCCESS
}

fn rows() -> Vec<Row> {
    fn row(name: &str, how: impl Fn(f64, &mut Pcg64Mcg) -> Acquisition + Sync + 'static) -> Row {
        Row { name: name.to_string(), how: Box::new(how) }
    }
    /// A poll every `scans` scans with a clock and a phase of its own, and 5 % jitter.
    fn poll(scan_s: f64, scans: f64, rng: &mut Pcg64Mcg) -> Poll {
        let clock = 1.0 + CLOCK * (2.0 * rng.random::<f64>() - 1.0);
        Poll { phase: rng.random::<f64>(), jitter: 0.05, ..Poll::every(scan_s * scans * clock) }
    }
    let mut rows = vec![
        row("same period, own clock, 5 % jitter", |s, rng| Acquisition::Polled(poll(s, 1.0, rng))),
        row("twice per controller scan", |s, rng| Acquisition::Polled(poll(s, 0.5, rng))),
        row("every second scan", |s, _| Acquisition::Polled(Poll { phase: 0.25, ..Poll::every(2.0 * s) })),
        row("every third scan", |s, _| Acquisition::Polled(Poll { phase: 0.25, ..Poll::every(3.0 * s) })),
        row("every 2.3 scans", |s, rng| Acquisition::Polled(poll(s, 2.3, rng))),
        row("scaled integers of 0.01", |s, rng| {
            Acquisition::Polled(Poll { step: 0.01, ..poll(s, 1.0, rng) })
        }),
        row("PV read 0.3 scans late", |s, rng| {
            Acquisition::Polled(Poll { pv_late: 0.3, ..poll(s, 1.0, rng) })
        }),
        row("PV recorded a scan late", |s, rng| {
            Acquisition::Polled(Poll { pv_late: -1.0, ..poll(s, 1.0, rng) })
        }),
        row("on change, with source stamps", |_, _| Acquisition::OnChange { dead_band: 0.0 }),
    ];
    for percent in [5, 10, 30] {
        rows.extend(kinds_of_gaps(percent).map(|(how, gaps)| {
            row(&format!("{percent} % missing, {how}"), move |s, _| {
                Acquisition::Polled(Poll { gaps, phase: 0.5, ..Poll::every(s) })
            })
        }));
    }
    rows
}

fn show(name: &str, loops: &[Loop], at_ticks: &[Said], said: &[Said], each: bool) {
    let all: Vec<(&Loop, &Said, &Said)> =
        loops.iter().zip(at_ticks).zip(said).map(|((own, ticks), said)| (own, ticks, said)).collect();
    let sticking: Vec<_> = all.iter().filter(|(own, ..)| own.f > 0.0).collect();
    let found: Vec<_> = sticking.iter().filter(|(_, _, said)| said.sticks()).collect();
    let known: Vec<_> = sticking.iter().filter(|(_, ticks, _)| ticks.sticks()).collect();
    let again = known.iter().filter(|(_, _, said)| said.sticks()).count();
    let near = found.iter().filter(|(own, _, said)| said.near(own.f)).count();
    let covers = found.iter().filter(|(own, _, said)| said.covers(own.f)).count();
    let denied: Vec<_> = sticking.iter().filter(|(_, _, said)| said.verdict == "no_stiction").collect();
    let within = denied.iter().filter(|(own, _, said)| said.covers(own.f)).count();
    let accused = all.iter().filter(|(own, _, said)| own.f == 0.0 && said.sticks()).count();
    let invented = all.iter().filter(|(_, _, said)| !said.invented.is_empty()).count();
    let same = all.iter().filter(|(_, ticks, said)| ticks.verdict == said.verdict).count();
    let silent = all.iter().filter(|(_, _, said)| said.verdict == "not_identifiable").count();
    println!(
        "| {name} | {} of {} | {} | {} | {} | {} | {} | {} | {} | {silent} |",
        found.len(),
        sticking.len(),
        wilson(again, known.len()),
        wilson(near, found.len()),
        wilson(covers, found.len()),
        wilson(accused, all.len() - sticking.len()),
        wilson(within, denied.len()),
        wilson(invented, all.len()),
        wilson(same, all.len())
    );
    for (own, ticks, said) in all.iter().filter(|_| each) {
        let near = own.f == 0.0 || said.near(own.f);
        let covers = own.f == 0.0 || said.covers(own.f);
        if ticks.verdict != said.verdict || !near || !covers || !said.invented.is_empty() {
            println!(
                "    {}: f {:.3}; ticks {} {:.3} [{:.3}, {:.3}]; here {} {:.3} [{:.3}, {:.3}] {:?}; {}; ticks: {}",
                own.name,
                own.f,
                ticks.verdict,
                ticks.f,
                ticks.ci[0],
                ticks.ci[1],
                said.verdict,
                said.f,
                said.ci[0],
                said.ci[1],
                said.invented,
                said.reason,
                ticks.reason
            );
        }
    }
}

/// Hits, and the Wilson 95 % interval of their share, in per cent.
fn wilson(hits: usize, of: usize) -> String {
    match tally::wilson(hits, of) {
        Some([low, high]) => format!("{hits} of {of} [{:.0}, {:.0}]", 100.0 * low, 100.0 * high),
        None => "-".into(),
    }
}
