//! What a diagnosis costs on one core: the paper's grid pass, each stage, and the memory.
//!
//! `cargo bench --bench diagnosis`; the target for the grid pass is 20 ms.

use std::hint::black_box;
use std::time::Instant;
use stictiond::diagnosis::grid::GRID;
use stictiond::diagnosis::search::{Problem, Searcher};
use stictiond::diagnosis::{Preparation, Settings, diagnose, evidence, gate, prepare, validation, verdict};
use stictiond::signal::{Record, Sample, Window};
use stictiond::sim::Scenario;
use stictiond::sim::scenarios::{calibration, random_sound, random_sticky};

/// Timings of each stage, whose median is printed, and runs in each.
const RUNS: usize = 5;
const REPEATS: u32 = 10;
/// Seeds of each family among which the slowest grid pass is sought.
const SEEDS: u64 = 40;

fn main() {
    let settings = Settings::default();
    let candidates = (0..SEEDS).flat_map(|seed| {
        [("calibration", calibration(seed)), ("sticky", random_sticky(seed)), ("sound", random_sound(seed))]
    });
    let mut cases: Vec<Case> =
        candidates.filter_map(|(family, scenario)| Case::new(family, &scenario, &settings)).collect();
    // The target is for 1,000 samples; longer windows cost in proportion and are told below.
    let longer = cases.extract_if(.., |case| case.problem.y.len() > 1000).count();
    for case in &mut cases {
        case.grid_ms = least(|| drop(black_box(Searcher::new(&case.problem).grid(GRID))));
    }
    cases.sort_by(|a, b| a.grid_ms.total_cmp(&b.grid_ms));
    let at = |share: f64| cases[((cases.len() - 1) as f64 * share) as usize].grid_ms;
    println!(
        "grid pass over {} random loops of 1,000 samples ({longer} longer ones left out): median {:.1} ms, 90 % {:.1} ms, \
         worst {:.1} ms of processor time (target 20 ms)",
        cases.len(),
        at(0.5),
        at(0.9),
        at(1.0)
    );
    let of = |family: &str| cases.iter().filter(|c| c.family == family).nth(5);
    println!(
        "{:56} {:>5} {:>7} {:>5} {:>6} {:>6} {:>6} {:>7} {:>7} {:>7} {:>6} {:>7}",
        "loop",
        "N",
        "screen",
        "fits",
        "gate",
        "prep",
        "grid",
        "profile",
        "refine",
        "rivals",
        "valid",
        "whole"
    );
    for case in [of("sticky"), of("sound"), cases.last()].into_iter().flatten() {
        case.print(&settings);
    }
    println!("times in ms; peak memory {:.1} MiB (VmHWM)", peak_kib() / 1024.0);
}

/// A record posed as a search problem, 1,000 samples where the record has no more.
struct Case {
    family: &'static str,
    name: String,
    record: Record,
    problem: Problem,
    grid_ms: f64,
}

impl Case {
    fn new(family: &'static str, scenario: &Scenario, settings: &Settings) -> Option<Self> {
        let run = scenario.run().ok()?;
        let series = |v: &[f64]| run.t.iter().zip(v).map(|(&t, &x)| Sample::good(t, x)).collect();
        let record =
            Record { op: series(&run.op), pv: series(&run.pv), op_span: Some(100.0), ..Record::default() };
        let (window, preparation) = gate::gate(&record, settings).ok()?;
        let problem = pose(&window, &preparation, settings)?;
        let name = format!("{} {}: {}", family, scenario.seed, scenario.truth.kind);
        Some(Self { family, name, record, problem, grid_ms: 0.0 })
    }

    fn print(&self, settings: &Settings) {
        let p = &self.problem;
        let Ok((window, preparation)) = gate::gate(&self.record, settings) else { return };
        let mut searcher = Searcher::new(p);
        let grid = searcher.grid(GRID);
        let (screened, fits) = (searcher.screened, searcher.fits);
        let cells = searcher.full_profile();
        let (sound, sticky) = searcher.refine(&grid, &cells);
        let Some(sticky) = sticky else { return };
        let (a, _) = searcher.errors(&sound);
        let (b, _) = searcher.errors(&sticky);
        let stages = [
            median(|| drop(black_box(gate::gate(&self.record, settings)))),
            median(|| drop(black_box(pose(&window, &preparation, settings)))),
            median(|| drop(black_box(Searcher::new(p).grid(GRID)))),
            median(|| drop(black_box(Searcher::new(p).full_profile()))),
            median(|| {
                black_box(Searcher::new(p).refine(&grid, &cells));
            }),
            // Without a least worth, so that the rivals are asked of a sound loop too.
            median(|| {
                black_box(evidence::weigh(p, &sound, &sticky, [&a, &b], None, f64::NEG_INFINITY));
            }),
            median(|| {
                black_box(validation::validate(p, &sticky, 1.0));
            }),
            median(|| drop(black_box(diagnose(&self.record, settings)))),
        ];
        let name: String = self.name.chars().take(56).collect();
        print!("{name:56} {:>5} {screened:>7} {fits:>5}", p.y.len());
        for (ms, width) in stages.iter().zip([6, 6, 6, 7, 7, 7, 6, 7]) {
            print!(" {ms:>width$.2}");
        }
        println!();
    }
}

fn pose(window: &Window, preparation: &Preparation, settings: &Settings) -> Option<Problem> {
    let (window, region) = prepare::prepare(window.clone(), settings, &mut preparation.clone());
    verdict::pose(&window, &region, settings).ok().map(|(problem, _)| problem)
}

/// Processor time of this thread where the system tells it, else the wall's [ms]: what else runs here is not counted.
fn now_ms(begun: Instant) -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds: Option<f64> = stat.split(' ').next().and_then(|text| text.parse().ok());
    nanoseconds.map_or_else(|| begun.elapsed().as_secs_f64() * 1e3, |ns| ns * 1e-6)
}

/// Mean time of a few runs [ms]: the kernel counts processor time in steps of up to 4 ms.
fn ms(mut work: impl FnMut()) -> f64 {
    let begun = Instant::now();
    let before = now_ms(begun);
    for _ in 0..REPEATS {
        work();
    }
    (now_ms(begun) - before) / f64::from(REPEATS)
}

/// Least time of three [ms]: the caches of a shared machine are not the search's doing.
fn least(mut work: impl FnMut()) -> f64 {
    (0..3).map(|_| ms(&mut work)).fold(f64::INFINITY, f64::min)
}

/// Median time [ms].
fn median(mut work: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..RUNS).map(|_| ms(&mut work)).collect();
    times.sort_by(f64::total_cmp);
    times[RUNS / 2]
}

fn peak_kib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|text| text.parse().ok()).unwrap_or(f64::NAN)
}
