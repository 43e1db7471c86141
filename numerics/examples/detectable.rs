//! What `f_detectable` and the bound of `no_stiction` are worth, on sticking valves of three generators:
//! `cargo run --release -p stictiond-numerics --example detectable -- --records 100 --first-seed 8800`.
//!
//! Where no stiction is told, what is published as `f_detectable` is no less than the upper end of the interval. By that number a
//! loop that is missed would count as one of less friction than a loop that is found, so the first table divides by the least f
//! that the theory says would have shown ([`unraised`]). The second table counts what users see: the published bound.

#[path = "../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use clap::Parser;
use generators::{Case, GENERATORS, Generator, Size};
use stictiond_numerics::detectors::tally;
use stictiond_numerics::diagnosis::{self, Diagnosis, NotIdentifiable, Verdict, diagnose};
use stictiond_numerics::residual::{self, Findings, Kind, trace_record};
use stictiond_numerics::signal::Record;

/// Effects that half of the loops have: one of the load, one of the process, one of the valve, one of the sensor.
const EFFECTS: [Kind; 4] =
    [Kind::OscillatingLoad, Kind::GainChange, Kind::ValveSaturation, Kind::QuantisedPv];
/// Bounds of f over the least f that would have shown, between the rows of the table.
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
    /// `f_detectable` as it is published (% OP).
    published: Option<f64>,
    /// The least f that would have shown (% OP).
    detectable: Option<f64>,
}

/// What `f_detectable` and the bound of `no_stiction` are worth
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
    /// Print the loops on which a bound excludes the truth, or that are missed above the least f that would have shown
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
        verdict: found.as_ref().map_or(&diagnosed.verdict, |found| &found.verdict).clone(),
        bound: found.as_ref().map_or(own, |found| found.friction_after.f_ci95[1]),
        published: found.as_ref().and_then(|found| found.f_detectable),
        detectable: found.and_then(|found| unraised(&record, &diagnosed, &settings, &found)),
    })
}

/// The least f that would have shown, by the theory alone. Where no stiction is told, the findings have the larger of it and of the
/// interval's end, and none where friction is hidden; the same record is then traced once more behind a diagnosis that cannot tell,
/// whose findings have it as it is. Where the diagnosis told stiction and tracing told none, the second fit may begin at another sample.
fn unraised(
    record: &Record,
    diagnosed: &Diagnosis,
    settings: &diagnosis::Settings,
    found: &Findings,
) -> Option<f64> {
    let published = found.f_detectable;
    let is_raised = match &found.verdict {
        Verdict::NoStiction => true,
        Verdict::NotIdentifiable(why) => matches!(why, NotIdentifiable::HiddenFriction { .. }),
        Verdict::Stiction => false,
    };
    if !is_raised {
        return published;
    }
    let why = NotIdentifiable::StemNotFollowed;
    let unsure = Diagnosis { verdict: Verdict::NotIdentifiable(why), ..diagnosed.clone() };
    let again = trace_record(record, &unsure, settings, &residual::Settings::default());
    // Never more than what is published.
    let own = again.and_then(|again| again.f_detectable);
    own.map(|f| f.min(published.unwrap_or(f))).or(published)
}

/// How many are found, by f over the least f that would have shown.
fn power(said: &[(&str, Vec<Said>)]) {
    println!(
        "| true f over the least that would have shown | {} |",
        said.iter().map(|s| s.0).collect::<Vec<_>>().join(" | ")
    );
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
        "| | sticking | told stiction | told none | of these the bound excludes f | \
         told none with an `f_detectable`: true f above it | not identifiable |"
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
            "{}: f {:.3}, {}, bound {:.3}, published {:.3?}, detectable {:.3?}",
            said.name,
            said.f,
            said.verdict.as_str(),
            said.bound,
            said.published,
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
    // The bound that users see: it may be wrong in any of these records, with an `f_detectable` or without.
    let excluded = none.iter().filter(|s| s.f > s.bound).count();
    let published: Vec<bool> = none.iter().filter_map(|s| Some(s.f > s.published?)).collect();
    let above = published.iter().filter(|above| **above).count();
    println!(
        "| {name} | {} | {} | {} | {excluded} {} | {above} of {} {} | {} |",
        all.len(),
        count(&|s| s.verdict == Verdict::Stiction),
        none.len(),
        wilson(excluded, none.len()),
        published.len(),
        wilson(above, published.len()),
        count(&|s| matches!(s.verdict, Verdict::NotIdentifiable(_)))
    );
}

/// Wilson's 95 % interval in per cent.
fn wilson(count: usize, of: usize) -> String {
    tally::wilson(count, of)
        .map_or_else(String::new, |[low, high]| format!("[{:.0}, {:.0}]", 100.0 * low, 100.0 * high))
}
