//! What a diagnosis says of the same loops at the controller's ticks and as a historian holds them, polled and with holes:
//! `cargo run --release -p stictiond-numerics --example polled -- --records 100 --first-seed 7000`.
//!
//! Options: `--records N` loops of three generators that share no code, sound and sticking, `--first-seed K`, `--threads T`,
//! `--rows A,B` only the rows whose names contain one of these, `--each`, which prints what differs from the ticks.

#[path = "../../tests/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../../tests/diagnosis_common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use generators::{Case, GENERATORS, Size};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::process::ExitCode;
use stictiond_numerics::detectors::tally;
use stictiond_numerics::diagnosis::{self, diagnose};
use stictiond_numerics::residual::{self, Kind, trace_record};
use stictiond_numerics::signal::Record;
use stictiond_numerics::sim::acquisition::{Acquisition, Gaps, Poll, Scans, acquire};

/// Largest share by which the clock of who polls differs from the controller's.
const CLOCK: f64 = 3e-4;
/// Mean length of a burst of lost polls.
const BURST: f64 = 8.0;
/// Tags that have nothing to do with the loop.
const TAGS: usize = 2;

/// One loop, at the controller's ticks.
struct Loop {
    name: String,
    record: Record,
    /// S/2 (% OP).
    f: f64,
    also: Vec<Kind>,
    seed: u64,
}

/// What was said of one record.
#[derive(Clone)]
struct Said {
    verdict: &'static str,
    f: f64,
    ci: [f64; 2],
    invented: Vec<Kind>,
    reason: String,
}

/// Draws an acquisition for a scan period (s).
type Draw = dyn Fn(f64, &mut Pcg64Mcg) -> Acquisition + Sync;

/// A row of the table: its name, and how the record comes about of the scan's period and chances of the loop's own.
struct Row {
    name: String,
    how: Box<Draw>,
}

fn main() -> ExitCode {
    let (mut count, mut first, mut each, mut wanted) = (60, 7000, false, Vec::new());
    let mut threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut args = std::env::args().skip(1);
    while let Some(name) = args.next() {
        if name == "--each" {
            each = true;
            continue;
        }
        let value = args.next().unwrap_or_default();
        match (name.as_str(), value.parse::<u64>()) {
            ("--records", Ok(n)) => count = n,
            ("--first-seed", Ok(n)) => first = n,
            ("--threads", Ok(n)) => threads = n.max(1) as usize,
            ("--rows", _) => wanted = value.split(',').map(str::to_string).collect(),
            _ => {
                eprintln!("{name} {value}: not an option, see the first lines of the example");
                return ExitCode::from(2);
            }
        }
    }
    let loops: Vec<Loop> = parallel::on(threads, 0..count, |i| draw(i, first + i));
    println!("{count} loops, seeds from {first}; Wilson 95 % intervals in brackets\n");
    println!(
        "| acquisition | sticking found | of those found at the ticks | f within 10 % | interval covers S/2 | sound called sticking | effect invented | same verdict | not identifiable |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let at_ticks = parallel::on(threads, &loops, |own| judge(own, &own.record));
    show("at the controller's ticks", &loops, &at_ticks, &at_ticks, false);
    for row in rows() {
        if !wanted.is_empty() && !wanted.iter().any(|part| row.name.contains(part)) {
            continue;
        }
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

/// The `i`-th loop: the generators in turn, each with all its classes and valves.
fn draw(i: u64, seed: u64) -> Loop {
    let generator = &GENERATORS[i as usize % GENERATORS.len()];
    let variants = (generator.variants)(None);
    // Steps of five meet all variants, but where their number is a multiple of it.
    let step = if variants.is_multiple_of(5) { 7 } else { 5 };
    let variant = i as usize / GENERATORS.len() * step % variants;
    let case = Case { effect: None, size: Size::Medium, variant, seed, tags: TAGS };
    let (record, truth) = (generator.record)(&case);
    Loop {
        name: format!("{} v{variant} {seed} {}", generator.name, truth.name),
        record,
        f: truth.f,
        also: truth.also,
        seed,
    }
}

fn scans(record: &Record) -> Option<Scans> {
    let values =
        |series: &[stictiond_numerics::signal::Sample]| series.iter().map(|s| s.value).collect::<Vec<f64>>();
    Some(Scans {
        t0: record.op.first()?.t,
        scan_s: record.op.get(1)?.t - record.op[0].t,
        op: values(&record.op),
        pv: values(&record.pv),
        sp: record.sp.as_deref().map(values),
        mv: None,
        tags: record.tags.iter().map(|(name, series)| (name.clone(), values(series))).collect(),
    })
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
        row("every 2.3 scans", |s, rng| Acquisition::Polled(poll(s, 2.3, rng))),
        row("scaled integers of 0.01", |s, rng| {
            Acquisition::Polled(Poll { step: 0.01, ..poll(s, 1.0, rng) })
        }),
        row("PV read 0.3 scans late", |s, rng| {
            Acquisition::Polled(Poll { pv_late: 0.3, ..poll(s, 1.0, rng) })
        }),
        row("on change, with source stamps", |_, _| Acquisition::OnChange { dead_band: 0.0 }),
    ];
    for percent in [5, 10, 30] {
        let share = f64::from(percent) / 100.0;
        // 1 of 20, 1 of 10, 3 of 10.
        let (every, lost) = if percent == 30 { (10, 3) } else { (100 / percent as usize, 1) };
        let kinds = [
            ("at random", Gaps::Random { share }),
            ("in bursts", Gaps::Bursts { share, length: BURST }),
            ("periodic", Gaps::Periodic { every, lost }),
        ];
        rows.extend(kinds.map(|(how, gaps)| {
            row(&format!("{percent} % missing, {how}"), move |s, _| {
                Acquisition::Polled(Poll { gaps, phase: 0.5, ..Poll::every(s) })
            })
        }));
    }
    rows
}

/// What the daemon says of a record.
fn judge(own: &Loop, record: &Record) -> Said {
    let settings = diagnosis::Settings::default();
    let d = diagnose(record, &settings);
    let found = trace_record(record, &d, &settings, &residual::Settings::default());
    let decides = found.as_ref().filter(|f| f.decide());
    let (verdict, reason) = decides.map_or((&d.verdict, &d.reason), |f| (&f.verdict, &f.reason));
    let friction = decides.map(|f| (f.friction_after.f, f.friction_after.f_ci95));
    let friction = friction.or(d.estimate.as_ref().map(|e| (e.f, e.f_ci95))).unwrap_or_default();
    let named = found.iter().flat_map(|f| &f.effects).map(|e| e.kind);
    Said {
        verdict: verdict.as_str(),
        f: friction.0,
        ci: friction.1,
        invented: named.filter(|kind| !own.also.contains(kind)).collect(),
        reason: reason.clone(),
    }
}

fn show(name: &str, loops: &[Loop], at_ticks: &[Said], said: &[Said], each: bool) {
    let sticks = |said: &Said| said.verdict == "stiction";
    let all: Vec<(&Loop, &Said, &Said)> =
        loops.iter().zip(at_ticks).zip(said).map(|((own, ticks), said)| (own, ticks, said)).collect();
    let sticking: Vec<_> = all.iter().filter(|(own, ..)| own.f > 0.0).collect();
    let found: Vec<_> = sticking.iter().filter(|(_, _, said)| sticks(said)).collect();
    let known: Vec<_> = sticking.iter().filter(|(_, ticks, _)| sticks(ticks)).collect();
    let again = known.iter().filter(|(_, _, said)| sticks(said)).count();
    let near = found.iter().filter(|(own, _, said)| (said.f / own.f - 1.0).abs() < 0.1).count();
    let covers = found.iter().filter(|(own, _, said)| (said.ci[0]..=said.ci[1]).contains(&own.f)).count();
    let accused = all.iter().filter(|(own, _, said)| own.f == 0.0 && sticks(said)).count();
    let invented = all.iter().filter(|(_, _, said)| !said.invented.is_empty()).count();
    let same = all.iter().filter(|(_, ticks, said)| ticks.verdict == said.verdict).count();
    let silent = all.iter().filter(|(_, _, said)| said.verdict == "not_identifiable").count();
    println!(
        "| {name} | {} of {} | {} | {} | {} | {} | {} | {} | {silent} |",
        found.len(),
        sticking.len(),
        wilson(again, known.len()),
        wilson(near, found.len()),
        wilson(covers, found.len()),
        wilson(accused, all.len() - sticking.len()),
        wilson(invented, all.len()),
        wilson(same, all.len())
    );
    for (own, ticks, said) in all.iter().filter(|_| each) {
        let near = own.f == 0.0 || (said.f / own.f - 1.0).abs() < 0.1;
        let covers = own.f == 0.0 || (said.ci[0]..=said.ci[1]).contains(&own.f);
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
