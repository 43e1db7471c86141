//! What a plant's diagnoses cost a processor: two days of windows of each loop, one after the other, as a daemon sees them.
//!
//! `cargo bench -p stictiond-numerics --bench hourly`. A third of the loops stick, a third are driven by a load that oscillates,
//! a third are at rest. Whatever a run found is given to the next, which searches only where that no longer holds.

use std::time::Instant;
use stictiond_numerics::diagnosis::{Settings, diagnose};
use stictiond_numerics::residual::{self, Findings, Structure, confirm, trace_record};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::scenarios::{Scenario, calibration, random_sound};
use stictiond_numerics::sim::{Load, LoadKind, Run};

/// Samples of a window, windows of two days, loops of each kind.
const SAMPLES: usize = 2000;
const WINDOWS: usize = 48;
const LOOPS: u64 = 8;
/// Loops of a large plant, each diagnosed once an hour.
const PLANT: f64 = 10_000.0;

fn main() {
    println!("{LOOPS} loops of each kind, {WINDOWS} windows of {SAMPLES} samples, processor time");
    println!(
        "| loops | runs | without a search | mean of these, ms | mean of the others, ms | mean, ms | sticks |"
    );
    println!("|---|---|---|---|---|---|---|");
    let means = [row("stick", calibration), row("driven by a load", driven), row("at rest", at_rest)];
    let mean = means.iter().sum::<f64>() / means.len() as f64;
    println!("{PLANT} such loops once an hour: {:.0} % of a core", 100.0 * PLANT * mean / 3.6e6);
}

/// One kind of loop; returns the mean cost of a run (ms).
fn row(name: &str, scenario: fn(u64) -> Scenario) -> f64 {
    let (mut confirmed, mut searched, mut sticks) = (Vec::new(), Vec::new(), 0);
    for seed in 0..LOOPS {
        let mut scenario = scenario(seed);
        scenario.n = scenario.warm_up + WINDOWS * SAMPLES;
        let Ok(run) = scenario.run() else { continue };
        let mut last = None;
        for window in 0..WINDOWS {
            let before = now_ms();
            let (found, by_search) = judge(&record(&run, window), last.as_ref());
            let spent = now_ms() - before;
            if by_search { &mut searched } else { &mut confirmed }.push(spent);
            sticks += usize::from(found.as_ref().is_some_and(|found| found.friction_after.f > 0.0));
            last = found.and_then(|found| found.structure);
        }
    }
    let mean = |spent: &[f64]| spent.iter().sum::<f64>() / spent.len().max(1) as f64;
    let all = [confirmed.clone(), searched.clone()].concat();
    println!(
        "| {name} | {} | {} | {:.0} | {:.0} | {:.0} | {sticks} |",
        all.len(),
        confirmed.len(),
        mean(&confirmed),
        mean(&searched),
        mean(&all)
    );
    mean(&all)
}

/// What a run finds, and whether it searched.
fn judge(record: &Record, last: Option<&Structure>) -> (Option<Findings>, bool) {
    let (settings, tracing) = (Settings::default(), residual::Settings::default());
    match last.and_then(|last| confirm(record, &settings, &tracing, last)) {
        Some((_, found)) => (Some(found), false),
        None => {
            let diagnosis = diagnose(record, &settings);
            (trace_record(record, &diagnosis, &settings, &tracing), true)
        }
    }
}

fn record(run: &Run, window: usize) -> Record {
    let part = window * SAMPLES..(window + 1) * SAMPLES;
    let at = |k: usize| k as f64 * 3600.0 / SAMPLES as f64;
    let series = |v: &[f64]| part.clone().map(|k| Sample::good(at(k), v[k])).collect();
    let (op, pv, sp) = (series(&run.op), series(&run.pv), Some(series(&run.sp)));
    Record { op, pv, sp, op_span: Some(100.0), ..Record::default() }
}

/// A sound loop and nothing but its noise.
fn at_rest(seed: u64) -> Scenario {
    let mut scenario = random_sound(seed);
    scenario.spec.loads.clear();
    scenario.spec.sp_schedule.clear();
    scenario.spec.sp = scenario.spec.pv0;
    scenario
}

/// The same with a load that oscillates.
fn driven(seed: u64) -> Scenario {
    let mut scenario = at_rest(seed);
    scenario.spec.loads.push(Load::input(LoadKind::Sine {
        amplitude: 2.0,
        period_s: (40 + 3 * seed) as f64 * scenario.spec.ts_s,
        phase: 0.0,
        growth_per_s: 0.0,
    }));
    scenario
}

/// Processor time of this thread where the system tells it, else the wall's (ms): what else runs here is not counted.
fn now_ms() -> f64 {
    static BEGUN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds: Option<f64> = stat.split(' ').next().and_then(|text| text.parse().ok());
    let wall = || BEGUN.get_or_init(Instant::now).elapsed().as_secs_f64() * 1e3;
    nanoseconds.map_or_else(wall, |ns| ns * 1e-6)
}
