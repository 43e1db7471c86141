//! How often tracing names the true effect, how often it invents one, and what that does to the error and to f, on loops
//! that the seeds draw: `cargo run --release -p stictiond-numerics --example tracing_rates -- --seeds 10 --first-seed 1000`.
//!
//! Options: `--seeds N`, `--first-seed K`, `--sizes small,medium,large`, `--clean N`, `--effects a,b`, `--threads T`, and
//! `--each`, which also prints every case that went wrong; `--records FOLDER` writes the cases as CSV and traces none.

#[path = "../tests/residual_common/drawn.rs"]
mod drawn;
#[path = "../tests/residual_common/judge.rs"]
mod judge;
#[path = "../../tests/diagnosis_common/parallel.rs"]
mod parallel;
#[path = "../../tests/generators/a/plant.rs"]
mod plant;
#[path = "../../tests/generators/a/valve.rs"]
mod valve;

use drawn::{nothing_hidden, traced};
use judge::{Judged, LOADS, judge};
use plant::{Case, LOOPS, SIZES, Undeclared, VALVES, cases, clean, record};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{fs, io};
use stictiond_numerics::residual::Kind;
use stictiond_numerics::sim::scenarios::{random_sound, random_sticky};

/// Effects after which f is compared.
const FRICTION: [Kind; 4] = [Kind::OscillatingLoad, Kind::Drift, Kind::LoadStep, Kind::Outliers];

/// Of how many seeds one is also fitted by a model that is told the effect.
const TOLD: u64 = 3;

struct Options {
    seeds: u64,
    first_seed: u64,
    sizes: Vec<usize>,
    clean: u64,
    effects: Vec<Kind>,
    threads: Option<usize>,
    each: bool,
    records: Option<PathBuf>,
}

fn main() -> ExitCode {
    let options = match options(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(why) => {
            eprintln!("{why}");
            return ExitCode::from(2);
        }
    };
    let seeds = options.first_seed..options.first_seed + options.seeds;
    if let Some(folder) = &options.records {
        let Err(why) = write_records(folder, &options, seeds) else { return ExitCode::SUCCESS };
        eprintln!("{}: {why}", folder.display());
        return ExitCode::FAILURE;
    }
    println!("seeds {} to {}; Wilson 95 % intervals in brackets\n", seeds.start, seeds.end.saturating_sub(1));
    for &size in &options.sizes {
        let all: Vec<Case> = options
            .effects
            .iter()
            .flat_map(|kind| cases(Undeclared::Listed(*kind), size, seeds.clone()))
            .collect();
        let found = run(&options, &all, |case| judge(case, case.seed.is_multiple_of(TOLD)));
        named(size, &options, &found);
        loads(size, &found);
        friction(size, &found);
        verdicts(SIZES[size], &found);
    }
    let found = run(&options, &clean(options.clean, seeds.start), |case| judge(case, false));
    invented(&found, options.each);
    verdicts("nothing hidden", &found);
    drawn_loops(&options, seeds.start);
    outside(&options, seeds);
    ExitCode::SUCCESS
}

/// The cases as records, named for effect, loop, valve and seed.
fn write_records(folder: &Path, options: &Options, seeds: std::ops::Range<u64>) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    for (size, kind) in options.sizes.iter().flat_map(|size| options.effects.iter().map(move |k| (*size, *k)))
    {
        for case in cases(Undeclared::Listed(kind), size, seeds.clone()) {
            let (class, valve) = (LOOPS[case.class], VALVES[case.valve].0);
            let name = format!("{}-{}-{class}-{valve}-{}.csv", kind.as_str(), SIZES[size], case.seed);
            let (drawn, _) = record(&case);
            let mut out = String::from("t,op,pv,sp\n");
            for ((op, pv), sp) in drawn.op.iter().zip(&drawn.pv).zip(drawn.sp.iter().flatten()) {
                out += &format!("{},{:.4},{:.4},{:.4}\n", op.t, op.value, pv.value, sp.value);
            }
            fs::write(folder.join(name), out)?;
        }
    }
    Ok(())
}

/// Every case on as many threads as were asked for, else on every core.
fn run(options: &Options, cases: &[Case], work: impl Fn(&Case) -> Judged + Sync) -> Vec<Judged> {
    options
        .threads
        .map_or_else(|| parallel::each(cases, &work), |threads| parallel::on(threads, cases, &work))
}

fn options(mut args: impl Iterator<Item = String>) -> Result<Options, String> {
    let mut o = Options {
        seeds: 10,
        first_seed: 1000,
        sizes: vec![0, 1, 2],
        clean: 300,
        effects: Kind::ALL.to_vec(),
        threads: None,
        each: false,
        records: None,
    };
    while let Some(name) = args.next() {
        if name == "--each" {
            o.each = true;
            continue;
        }
        let value = args.next().ok_or(format!("{name} takes a value"))?;
        let number = || value.parse::<u64>().map_err(|e| format!("{name} {value}: {e}"));
        match name.as_str() {
            "--seeds" => o.seeds = number()?,
            "--first-seed" => o.first_seed = number()?,
            "--clean" => o.clean = number()?,
            "--records" => o.records = Some(value.into()),
            "--threads" => o.threads = Some(number()?.max(1) as usize),
            "--sizes" => {
                let size = |s: &str| SIZES.iter().position(|n| *n == s).ok_or(format!("no size {s}"));
                o.sizes = value.split(',').filter(|s| !s.is_empty()).map(size).collect::<Result<_, _>>()?;
            }
            "--effects" => {
                let kind =
                    |s: &str| Kind::ALL.into_iter().find(|k| k.as_str() == s).ok_or(format!("no effect {s}"));
                o.effects = value.split(',').map(kind).collect::<Result<_, _>>()?;
            }
            _ => return Err(format!("unknown option {name}")),
        }
    }
    Ok(o)
}

/// The Wilson 95 % interval of a share, in per cent.
fn wilson(hits: usize, of: usize) -> String {
    if of == 0 {
        return "-".into();
    }
    let (n, p, z) = (of as f64, hits as f64 / of as f64, 1.96);
    let centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
    let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    format!("{:.1} % [{:.1}, {:.1}]", 100.0 * p, 100.0 * (centre - half).max(0.0), 100.0 * (centre + half))
}

fn counted<T: Ord + ToString>(items: impl Iterator<Item = T>) -> String {
    let mut counts: BTreeMap<T, usize> = BTreeMap::new();
    items.for_each(|item| *counts.entry(item).or_default() += 1);
    let mut counts: Vec<(usize, String)> = counts.into_iter().map(|(k, n)| (n, k.to_string())).collect();
    counts.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    counts.iter().map(|(n, k)| format!("{k} {n}")).collect::<Vec<_>>().join(", ")
}

fn median(mut v: Vec<f64>) -> f64 {
    v.retain(|x| x.is_finite());
    v.sort_by(f64::total_cmp);
    if v.is_empty() { f64::NAN } else { 0.5 * (v[(v.len() - 1) / 2] + v[v.len() / 2]) }
}

fn where_(case: &Case) -> String {
    format!("{} {} seed {}", LOOPS[case.class], VALVES[case.valve].0, case.seed)
}

fn names(kinds: &[Kind]) -> String {
    kinds.iter().map(|k| k.as_str()).collect::<Vec<_>>().join(" ")
}

fn named(size: usize, options: &Options, found: &[Judged]) {
    println!("## {}\n", SIZES[size]);
    println!(
        "| true effect | first named right | none | others first | also invented | free run: within 10 % of a fit told | median after/before |"
    );
    println!("|---|---|---|---|---|---|---|");
    let row = |label: &str, of: &[&Judged]| {
        let is_right =
            |j: &Judged| Undeclared::Listed(j.first().unwrap_or(Kind::SlipJump)) == j.case.undeclared;
        let right = of.iter().filter(|j| !j.named.is_empty() && is_right(j)).count();
        let none = of.iter().filter(|j| j.named.is_empty()).count();
        let others = counted(of.iter().filter(|j| !is_right(j)).filter_map(|j| j.first()).map(Kind::as_str));
        let also = of.iter().filter(|j| !j.invented().is_empty()).count();
        let told: Vec<bool> = of.iter().filter_map(|j| j.told.map(|told| j.free[1] <= 1.1 * told)).collect();
        let near = told.iter().filter(|t| **t).count();
        println!(
            "| {label} | {right} of {}, {} | {none} | {others} | {also} | {near} of {} | {:.2} |",
            of.len(),
            wilson(right, of.len()),
            told.len(),
            median(of.iter().map(|j| j.free[1] / j.free[0]).collect())
        );
    };
    for kind in &options.effects {
        let of: Vec<&Judged> =
            found.iter().filter(|j| j.case.undeclared == Undeclared::Listed(*kind)).collect();
        row(kind.as_str(), &of);
        for j in of.iter().filter(|j| options.each && j.first() != Some(*kind)) {
            println!(
                "  {} [{}] told {:?} free {:.4?} one {:.4?} f {:.2?}",
                where_(&j.case),
                names(&j.named),
                j.told,
                j.free,
                j.one,
                j.f
            );
        }
    }
    row("all", &found.iter().collect::<Vec<_>>());
    println!();
}

/// Sizes of loads at the valve, of the fits that were told the effect.
fn loads(size: usize, found: &[Judged]) {
    println!("| {}: size of a load at the valve, told of true | median | within 20 % |", SIZES[size]);
    println!("|---|---|---|");
    for kind in LOADS {
        let of = found.iter().filter(|j| j.case.undeclared == Undeclared::Listed(kind));
        let shares: Vec<f64> = of.filter_map(|j| j.size).collect();
        let near = shares.iter().filter(|share| (0.8..1.2).contains(*share)).count();
        println!("| {kind} ({}) | {:.2} | {near} |", shares.len(), median(shares.clone()));
    }
    println!();
}

/// Verdicts of stiction before and after, by what is true of the valve.
fn verdicts(label: &str, found: &[Judged]) {
    println!("| {label}: verdict of stiction | of the declared model | with the effects |");
    println!("|---|---|---|");
    for (name, sticks) in [("valves that stick", true), ("sound valves", false)] {
        let of = found.iter().filter(|j| (j.f[0] > 0.0) == sticks);
        verdict_row(name, &of.map(|j| j.sticks).collect::<Vec<_>>());
    }
    println!();
}

fn verdict_row(name: &str, of: &[[bool; 2]]) {
    let [before, after] = [0, 1].map(|at| of.iter().filter(|sticks| sticks[at]).count());
    println!(
        "| {name} ({}) | {before}, {} | {after}, {} |",
        of.len(),
        wilson(before, of.len()),
        wilson(after, of.len())
    );
}

/// f before and after on the valves that stick.
fn friction(size: usize, found: &[Judged]) {
    println!(
        "| {}: error of f on sticking valves (% OP) | median before | median after | mean before | mean after | f 0 before | after |",
        SIZES[size]
    );
    println!("|---|---|---|---|---|---|---|");
    for kind in FRICTION {
        let of: Vec<&Judged> = found
            .iter()
            .filter(|j| j.case.undeclared == Undeclared::Listed(kind) && j.case.valve > 0)
            .collect();
        let error = |at: usize| -> Vec<f64> { of.iter().map(|j| (j.f[at] - j.f[0]).abs()).collect() };
        let mean = |at: usize| error(at).iter().sum::<f64>() / of.len().max(1) as f64;
        let zero = |at: usize| of.iter().filter(|j| j.f[at] == 0.0).count();
        println!(
            "| {kind} ({}) | {:.4} | {:.4} | {:.4} | {:.4} | {} | {} |",
            of.len(),
            median(error(1)),
            median(error(2)),
            mean(1),
            mean(2),
            zero(1),
            zero(2)
        );
    }
    println!();
}

fn invented(found: &[Judged], each: bool) {
    let wrong: Vec<&Judged> = found.iter().filter(|j| !j.invented().is_empty()).collect();
    println!(
        "Nothing hidden: an effect is named on {} of {} records, {}",
        wrong.len(),
        found.len(),
        wilson(wrong.len(), found.len())
    );
    println!("  by kind: {}", counted(wrong.iter().flat_map(|j| j.invented()).map(Kind::as_str)));
    println!("  by valve: {}", counted(wrong.iter().map(|j| VALVES[j.case.valve].0)));
    println!("  by tags: {}", counted(wrong.iter().map(|j| j.case.tags)));
    let worse = found.iter().filter(|j| j.free[1] > 1.0001 * j.free[0]).count();
    println!(
        "  free run worse than before on {worse}; untraced {}\n",
        found.iter().filter(|j| !j.traced).count()
    );
    for j in wrong.iter().filter(|_| each) {
        println!(
            "  {} tags {} [{}] free {:.4?} one {:.4?}",
            where_(&j.case),
            j.case.tags,
            names(&j.named),
            j.free,
            j.one
        );
    }
}

/// The same on the sound loops that the diagnosis is tested with, and the verdicts on all of its loops.
fn drawn_loops(options: &Options, first: u64) {
    let threads =
        options.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    // Two of five are of a kind in which nothing is hidden.
    let seeds = first..first + 5 * options.clean / 2;
    let quiet = nothing_hidden(seeds.clone());
    let sound = parallel::on(threads, seeds, |seed| (seed, traced(&random_sound(seed))));
    let found: Vec<_> = sound.iter().filter(|(seed, _)| quiet.contains(seed)).collect();
    let wrong: Vec<_> = found.iter().filter(|(_, traced)| !traced.named.is_empty()).collect();
    println!(
        "Nothing hidden in loops of the diagnosis' generator: an effect is named on {} of {}, {}",
        wrong.len(),
        found.len(),
        wilson(wrong.len(), found.len())
    );
    let kinds = wrong.iter().flat_map(|(_, traced)| &traced.named).map(|kind| kind.as_str());
    println!("  by kind: {}\n", counted(kinds));
    for (seed, traced) in wrong.iter().filter(|_| options.each) {
        println!("  sound loop {seed} [{}]", names(&traced.named));
    }
    let sticky = parallel::on(threads, first..first + options.clean, |seed| traced(&random_sticky(seed)));
    println!("| the diagnosis' loops: verdict of stiction | of the declared model | with the effects |");
    println!("|---|---|---|");
    verdict_row("valves that stick", &sticky.iter().map(|traced| traced.sticks).collect::<Vec<_>>());
    verdict_row("sound valves", &sound.iter().map(|(_, traced)| traced.sticks).collect::<Vec<_>>());
    println!();
}

fn outside(options: &Options, seeds: std::ops::Range<u64>) {
    println!(
        "| outside the list | named, and predicts better | nothing named, unexplained | nothing named, white | named, predicts no better | names |"
    );
    println!("|---|---|---|---|---|---|");
    for (label, undeclared) in
        [("bursts of load", Undeclared::Bursts), ("hysteresis of the sensor", Undeclared::SensorBacklash)]
    {
        let found = run(options, &cases(undeclared, 1, seeds.clone()), |c| judge(c, false));
        let better = |j: &Judged| j.free[1] < j.free[0] || j.one[1] < j.one[0];
        let count = |of: &dyn Fn(&Judged) -> bool| found.iter().filter(|j| of(j)).count();
        println!(
            "| {label} ({}) | {} | {} | {} | {} | {} |",
            found.len(),
            count(&|j| !j.named.is_empty() && better(j)),
            count(&|j| j.named.is_empty() && j.unexplained),
            count(&|j| j.named.is_empty() && !j.unexplained),
            count(&|j| !j.named.is_empty() && !better(j)),
            counted(found.iter().filter_map(Judged::first).map(Kind::as_str))
        );
    }
}
