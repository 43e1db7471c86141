//! What `f_detectable` and the bound of "no friction needed" are worth, on sticking valves of three generators:
//! `cargo run --release -p stictiond-numerics --example detectable -- --records 100 --first-seed 8800`.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use clap::Parser;
use generators::{Case, GENERATORS, Generator, Size};
use stictiond_numerics::detectors::tally;
use stictiond_numerics::diagnosis::{self, Verdict, diagnose};
use stictiond_numerics::residual::{self, Kind, trace_record};

/// Effects that half of the loops have: one of the load, one of the process, one of the valve, one of the sensor.
const EFFECTS: [Kind; 4] =
    [Kind::OscillatingLoad, Kind::GainChange, Kind::ValveSaturation, Kind::QuantisedPv];
/// Bounds of f over `f_detectable` between the rows of the table.
const BOUNDS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, f64::INFINITY];

/// What was said of a sticking loop.
struct Said {
    name: String,
    /// Whether it has an effect that is not declared.
    has_effect: bool,
    /// S/2 (% OP).
    f: f64,
    verdict: Verdict,
    /// The upper end of the interval (% OP).
    bound: f64,
    detectable: Option<f64>,
}

/// What `f_detectable` and the bound of "no friction needed" are worth
#[derive(Parser)]
struct Args {
    /// Sticking loops of each generator, half of them with an effect that is not declared
    #[arg(long, default_value_t = 60)]
    records: usize,
    /// First seed
    #[arg(long, default_value_t = 8800)]
    first_seed: u64,
    /// Loops judged at once
    #[arg(long, default_value_t = 2)]
    threads: usize,
    /// Print the loops on which a bound excludes the truth, or that are missed above `f_detectable`
    #[arg(long)]
    each: bool,
}

fn main() {
    let Args { records, first_seed: first, threads, each } = Args::parse();
    println!("{records} sticking loops a generator, seeds from {first}; Wilson 95 % intervals in brackets\n");
    let said: Vec<(&str, Vec<Said>)> =
        GENERATORS.iter().map(|g| (g.name, of(g, records, first, threads))).collect();
    power(&said);
    honest(&said, each);
}

/// Sticking loops of a generator, judged.
fn of(generator: &Generator, records: usize, first: u64, threads: usize) -> Vec<Said> {
    let case = |i: u64| {
        let effect = if i.is_multiple_of(2) { None } else { Some(EFFECTS[(i / 2 % 4) as usize]) };
        let variants = (generator.variants)(effect) as u64;
        Case {
            effect,
            size: Size::Medium,
            variant: (i / 2 % variants) as usize,
            seed: first + i / 2 / variants,
            tags: 2,
        }
    };
    // Every class of loops comes with a sound valve, too: more cases than loops are drawn.
    let cases: Vec<Case> = (0..4 * records as u64).map(case).collect();
    let mut said: Vec<Said> = Vec::new();
    for few in cases.chunks(2 * threads.max(1)) {
        said.extend(parallel::on(threads, few, |case| judge(generator, case)).into_iter().flatten());
        if said.len() >= records {
            break;
        }
    }
    said.truncate(records);
    said
}

/// What is said of a case; `None` where the valve is sound.
fn judge(generator: &Generator, case: &Case) -> Option<Said> {
    let (record, truth) = (generator.record)(case);
    if truth.f <= 0.0 {
        return None;
    }
    let settings = diagnosis::Settings::default();
    let diagnosed = diagnose(&record, &settings);
    let found = trace_record(&record, &diagnosed, &settings, &residual::Settings::default());
    let kind = case.effect.map_or("clean", Kind::as_str);
    let own = diagnosed.estimate.as_ref().map_or(f64::NAN, |e| e.f_ci95[1]);
    Some(Said {
        name: format!("{} {kind} v{} seed {} {}", generator.name, case.variant, case.seed, truth.name),
        has_effect: case.effect.is_some(),
        f: truth.f,
        verdict: found.as_ref().map_or(diagnosed.verdict, |found| found.verdict.clone()),
        bound: found.as_ref().map_or(own, |found| found.friction_after.f_ci95[1]),
        detectable: found.and_then(|found| found.f_detectable),
    })
}

/// How many are found, by f over `f_detectable`.
fn power(said: &[(&str, Vec<Said>)]) {
    println!("| true f over `f_detectable` | {} |", said.iter().map(|s| s.0).collect::<Vec<_>>().join(" | "));
    println!("|---|---|---|---|");
    let found = |own: &[&Said]| {
        let count = own.iter().filter(|s| s.verdict == Verdict::Stiction).count();
        format!("{count} of {} {}", own.len(), wilson(count, own.len()))
    };
    let mut low = 0.0;
    for high in BOUNDS {
        let within =
            |s: &&Said| s.detectable.is_some_and(|d| (low..high).contains(&(s.f / d))) && s.f.is_finite();
        let cells: Vec<String> =
            said.iter().map(|(_, all)| found(&all.iter().filter(within).collect::<Vec<_>>())).collect();
        let name = if high.is_finite() { format!("{low} to {high}") } else { format!("above {low}") };
        println!("| {name} | {} |", cells.join(" | "));
        low = high;
    }
    for (name, wanted) in [("above 1, all", true), ("no f would have shown", false)] {
        let within = |s: &&Said| match s.detectable {
            Some(d) => wanted && s.f >= d,
            None => !wanted,
        };
        let cells: Vec<String> =
            said.iter().map(|(_, all)| found(&all.iter().filter(within).collect::<Vec<_>>())).collect();
        println!("| {name} | {} |", cells.join(" | "));
    }
    println!();
}

/// How often "no stiction" is said of a sticking valve, and how often its bound excludes the truth.
fn honest(said: &[(&str, Vec<Said>)], each: bool) {
    println!(
        "| | sticking | told stiction | told none | of these the bound excludes f | true f above `f_detectable` | not identifiable |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (which, has_effect) in [("nothing undeclared", false), ("with an effect", true)] {
        for (name, all) in said {
            row(&format!("{name}, {which}"), &of_either(all, has_effect));
        }
        let all: Vec<&Said> = said.iter().flat_map(|(_, all)| of_either(all, has_effect)).collect();
        row(&format!("all, {which}"), &all);
    }
    let missed = |s: &&Said| {
        s.verdict != Verdict::Stiction && (s.f > s.bound || s.detectable.is_some_and(|d| s.f > d))
    };
    for said in said.iter().flat_map(|(_, all)| all).filter(missed).filter(|_| each) {
        println!(
            "{}: f {:.3}, {}, bound {:.3}, detectable {:.3?}",
            said.name,
            said.f,
            said.verdict.as_str(),
            said.bound,
            said.detectable
        );
    }
}

/// Those with an effect that is not declared, or those without.
fn of_either(all: &[Said], has_effect: bool) -> Vec<&Said> {
    all.iter().filter(|said| said.has_effect == has_effect).collect()
}

/// A row of the table of [`honest`].
fn row(name: &str, all: &[&Said]) {
    let count = |of: &dyn Fn(&&&Said) -> bool| all.iter().filter(of).count();
    let none: Vec<&&Said> = all.iter().filter(|s| s.verdict == Verdict::NoStiction).collect();
    let excluded = none.iter().filter(|s| s.f > s.bound).count();
    let above = none.iter().filter(|s| s.detectable.is_some_and(|d| s.f > d)).count();
    println!(
        "| {name} | {} | {} | {} | {excluded} {} | {above} {} | {} |",
        all.len(),
        count(&|s| s.verdict == Verdict::Stiction),
        none.len(),
        wilson(excluded, none.len()),
        wilson(above, none.len()),
        count(&|s| matches!(s.verdict, Verdict::NotIdentifiable(_)))
    );
}

/// Wilson's 95 % interval in per cent.
fn wilson(count: usize, of: usize) -> String {
    tally::wilson(count, of)
        .map_or_else(String::new, |[low, high]| format!("[{:.0}, {:.0}]", 100.0 * low, 100.0 * high))
}
