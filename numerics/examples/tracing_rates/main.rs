//! How often tracing names the true effect, how often it invents one, how well its probabilities and intervals hold, on loops
//! of three generators that share no code:
//! `cargo run --release -p stictiond-numerics --example tracing_rates -- --seeds 10 --first-seed 9000`.

#[path = "../../tests/common/generators/mod.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod generators;
#[expect(dead_code, reason = "each user takes a part")]
mod judge;
#[path = "../../tests/common/parallel.rs"]
#[expect(dead_code, reason = "each user takes a part")]
mod parallel;

use clap::Parser;
use generators::{Case, GENERATORS, Generator, Size, c};
use judge::{Judged, Naming, judge};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use std::{fs, io};
use stictiond_numerics::detectors::tally;
use stictiond_numerics::residual::Kind;

/// How often tracing names the true effect, and how often it invents one
#[derive(Parser)]
struct Options {
    /// Letters of the generators; D is C under loads that swing
    #[arg(long, default_value = "ABC")]
    generators: String,
    /// Number of seeds
    #[arg(long, default_value_t = 10)]
    seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 9000)]
    first_seed: u64,
    /// How large the effects are: small, medium or large
    #[arg(long, default_value = "medium", value_parser = size)]
    size: Size,
    /// Records of each generator with nothing hidden
    #[arg(long, default_value_t = 300)]
    clean: usize,
    /// Only these effects, separated by commas
    #[arg(long, value_parser = kinds)]
    effects: Option<Box<[Kind]>>,
    /// Only this variant of each effect
    #[arg(long)]
    variant: Option<usize>,
    /// Cases traced at once
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Also fit every case told its effect and true friction: what no such fit finds is not in the data
    #[arg(long)]
    told: bool,
    /// Print every case that is not right
    #[arg(long)]
    each: bool,
    /// Print what speaks for every effect that is named or rejected, for `calibrate posterior`
    #[arg(long)]
    evidence: bool,
    /// Write the cases as CSV to this folder, and trace none
    #[arg(long, value_name = "FOLDER")]
    records: Option<PathBuf>,
}

impl Options {
    fn range(&self) -> std::ops::Range<u64> {
        self.first_seed..self.first_seed + self.seeds
    }

    fn kinds(&self) -> &[Kind] {
        self.effects.as_deref().unwrap_or(&Kind::ALL)
    }
}

fn size(name: &str) -> Result<Size, &'static str> {
    let sizes = [("small", Size::Small), ("medium", Size::Medium), ("large", Size::Large)];
    sizes.into_iter().find(|own| own.0 == name).map(|own| own.1).ok_or("small, medium or large")
}

/// Names of effects; an empty value is none of them, so that only records with nothing hidden are traced.
fn kinds(names: &str) -> Result<Box<[Kind]>, String> {
    let kind = |s: &str| Kind::ALL.into_iter().find(|k| k.as_str() == s).ok_or(format!("no effect {s}"));
    names.split(',').filter(|name| !name.is_empty()).map(kind).collect()
}

fn main() -> ExitCode {
    let options = Options::parse();
    println!("seeds {:?}, {:?}; Wilson 95 % intervals in brackets\n", options.range(), options.size);
    for generator in GENERATORS.iter().chain([&c::D]).filter(|g| options.generators.contains(g.name)) {
        if let Some(folder) = &options.records {
            if let Err(why) = write_records(folder, generator, &options) {
                eprintln!("{}: {why}", folder.display());
                return ExitCode::FAILURE;
            }
            continue;
        }
        rates(generator, &options);
    }
    ExitCode::SUCCESS
}

/// Tags of the cases that have an effect.
const TAGS: usize = 3;

/// All cases of an effect.
fn cases(generator: &Generator, kind: Kind, options: &Options) -> Vec<Case> {
    let variants = (generator.variants)(Some(kind));
    let wanted = |v: &usize| options.variant.is_none_or(|variant| *v == variant);
    let of_seed = |seed| {
        (0..variants).filter(wanted).map(move |variant| Case {
            effect: Some(kind),
            size: options.size,
            variant,
            seed,
            tags: TAGS,
        })
    };
    options.range().flat_map(of_seed).collect()
}

/// Records with nothing hidden and up to 50 tags that have nothing to do with the loop.
fn clean(generator: &Generator, options: &Options) -> Vec<Case> {
    let variants = (generator.variants)(None);
    let case = |i: usize| Case {
        effect: None,
        size: options.size,
        variant: i % variants,
        seed: options.first_seed + (i / variants) as u64,
        tags: [0, 5, 20, 50][(i + i / variants) % 4],
    };
    (0..options.clean).map(case).collect()
}

fn rates(generator: &Generator, options: &Options) {
    let mut all = Vec::new();
    println!("## Generator {}\n", generator.name);
    println!(
        "| true effect | first named right | named at all | of identifiable | none | abstained | wrong first | also invented |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut spent = Vec::new();
    for &kind in options.kinds() {
        let found = run(generator, options, &cases(generator, kind, options), &mut spent);
        naming(kind.as_str(), &found, options.told);
        show(&found, options);
        all.extend(found);
    }
    naming("all", &all, options.told);
    let quiet = run(generator, options, &clean(generator, options), &mut spent);
    show(&quiet, options);
    println!();
    invented(&quiet);
    reliability(&all, &quiet);
    friction(&all, &quiet);
    spent.sort_by(f64::total_cmp);
    let at =
        |share: f64| spent.get(((spent.len().max(1) - 1) as f64 * share) as usize).copied().unwrap_or(0.0);
    println!("ms a record, wall: median {:.0}, 90 % {:.0}, worst {:.0}\n", at(0.5), at(0.9), at(1.0));
}

fn run(generator: &Generator, options: &Options, cases: &[Case], spent: &mut Vec<f64>) -> Vec<Judged> {
    let found = parallel::on(options.threads.max(1), cases, |case| {
        let begun = Instant::now();
        let judged = judge(generator, case, options.told);
        (judged, begun.elapsed().as_secs_f64() * 1e3)
    });
    spent.extend(found.iter().map(|found| found.1));
    found.into_iter().map(|found| found.0).collect()
}

fn naming(label: &str, found: &[Judged], told: bool) {
    let count = |naming: Naming| found.iter().filter(|j| j.naming() == naming).count();
    let right = count(Naming::Right);
    let recalled = found.iter().filter(|j| j.recalled()).count();
    // What a fit that is told the effect does not find is not in the data, found or not; wrong names count all the same.
    let counted_in: Vec<&Judged> = found.iter().filter(|j| j.counts()).collect();
    let of_these = counted_in.iter().filter(|j| j.naming() == Naming::Right).count();
    let wrong = found.iter().filter(|j| j.naming() == Naming::Wrong).filter_map(Judged::first);
    let also = found.iter().flat_map(Judged::beside).map(Kind::as_str);
    println!(
        "| {label} | {right} of {}, {} | {recalled} of {}, {} | {} | {} | {} | {} | {} |",
        found.len(),
        wilson(right, found.len()),
        found.len(),
        wilson(recalled, found.len()),
        match told {
            true => {
                format!("{of_these} of {}, {}", counted_in.len(), wilson(of_these, counted_in.len()))
            }
            false => "-".into(),
        },
        count(Naming::None),
        count(Naming::Abstained),
        counted(wrong.map(Kind::as_str)),
        counted(also)
    );
}

fn show(found: &[Judged], options: &Options) {
    for j in found {
        if options.each && (j.naming() != Naming::Right || !j.beside().is_empty()) {
            println!("  {}", j.line());
        }
        if options.evidence {
            j.evidence_lines().iter().for_each(|line| println!("{line}"));
        }
    }
}

fn invented(quiet: &[Judged]) {
    let wrong: Vec<&Judged> = quiet.iter().filter(|j| !j.beside().is_empty()).collect();
    println!(
        "Nothing hidden: an effect is invented on {} of {}, {}",
        wrong.len(),
        quiet.len(),
        wilson(wrong.len(), quiet.len())
    );
    println!("  by kind: {}", counted(wrong.iter().flat_map(|j| j.beside()).map(Kind::as_str)));
    let worse = quiet.iter().filter(|j| j.simulates_worse).count();
    println!("  free run worse than the declared model's on {worse}\n");
}

/// Of the effects named with a posterior in each bin, how many are there.
fn reliability(all: &[Judged], quiet: &[Judged]) {
    println!("| posterior | named | right |");
    println!("|---|---|---|");
    let named: Vec<(f64, bool)> = all.iter().chain(quiet).flat_map(Judged::competing).collect();
    for (low, high) in [(0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.01)] {
        let own: Vec<bool> = named.iter().filter(|(p, _)| (low..high).contains(p)).map(|n| n.1).collect();
        let right = own.iter().filter(|right| **right).count();
        println!(
            "| {low} to {:.2} | {} | {right}, {} |",
            f64::min(high, 1.0),
            own.len(),
            wilson(right, own.len())
        );
    }
    println!();
}

/// Verdicts, and how often the interval holds.
fn friction(all: &[Judged], quiet: &[Judged]) {
    println!(
        "| | verdict of stiction: sticking valves | sound valves | f within 10 % | interval covers | sticking, told none | of these the bound excludes f |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (label, found) in [("with an effect", all), ("nothing hidden", quiet)] {
        let (sticky, sound): (Vec<&Judged>, Vec<&Judged>) = found.iter().partition(|j| j.f_true > 0.0);
        let told: Vec<&&Judged> = sticky.iter().filter(|j| j.sticks).collect();
        let near = told.iter().filter(|j| (j.f / j.f_true - 1.0).abs() < 0.1).count();
        let covers = told.iter().filter(|j| (j.ci[0]..=j.ci[1]).contains(&j.f_true)).count();
        let accused = sound.iter().filter(|j| j.sticks).count();
        let denied: Vec<&&Judged> = sticky.iter().filter(|j| j.denied).collect();
        let excluded = denied.iter().filter(|j| j.f_true > j.ci[1]).count();
        println!(
            "| {label} | {} of {}, {} | {accused} of {}, {} | {near} of {} | {covers} of {}, {} | {} | {excluded}, {} |",
            told.len(),
            sticky.len(),
            wilson(told.len(), sticky.len()),
            sound.len(),
            wilson(accused, sound.len()),
            told.len(),
            told.len(),
            wilson(covers, told.len()),
            denied.len(),
            wilson(excluded, denied.len())
        );
    }
    println!();
}

/// The cases as records, named for generator, effect, variant and seed.
fn write_records(folder: &Path, generator: &Generator, options: &Options) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let effects = options.kinds().iter().flat_map(|kind| cases(generator, *kind, options));
    for case in effects.chain(clean(generator, options)) {
        let (record, _) = (generator.record)(&case);
        let kind = case.effect.map_or("clean", Kind::as_str);
        let name = format!("{}.{kind}.{}.{}.csv", generator.name, case.variant, case.seed);
        let mut out = String::from("t,op,pv,sp");
        record.tags.iter().for_each(|(name, _)| out += &format!(",{name}"));
        out.push('\n');
        for (k, (op, pv)) in record.op.iter().zip(&record.pv).enumerate() {
            out += &format!("{},{:.5},{:.5}", op.t, op.value, pv.value);
            let sp = record.sp.iter();
            for series in sp.chain(record.tags.iter().map(|(_, series)| series)) {
                out += &series.get(k).map_or(String::from(","), |sample| format!(",{:.5}", sample.value));
            }
            out.push('\n');
        }
        fs::write(folder.join(name), out)?;
    }
    Ok(())
}

/// The Wilson 95 % interval of a share, in per cent.
fn wilson(hits: usize, of: usize) -> String {
    let Some([low, high]) = tally::wilson(hits, of) else { return "-".into() };
    let share = hits as f64 / of as f64;
    format!("{:.1} % [{:.1}, {:.1}]", 100.0 * share, 100.0 * low, 100.0 * high)
}

fn counted<T: Ord + ToString>(items: impl Iterator<Item = T>) -> String {
    let mut counts: BTreeMap<T, usize> = BTreeMap::new();
    items.for_each(|item| *counts.entry(item).or_default() += 1);
    let mut counts: Vec<(usize, String)> = counts.into_iter().map(|(k, n)| (n, k.to_string())).collect();
    counts.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    counts.iter().map(|(n, k)| format!("{k} {n}")).collect::<Vec<_>>().join(", ")
}
