//! Simulated loops by scenario.

use super::judged::{Judged, judge};
use super::{parallel, tables};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::scenarios::{random_sound, random_sticky, table2};
use stictiond_numerics::sim::{ProcessKind, Scenario};

/// First seed of the benchmark, and of the calibration: nothing was tuned on the former.
pub const BENCHMARK: u64 = 7_000_000;
pub const CALIBRATION: u64 = 3_000_000;
/// Noise of a measured stem (% of span).
const STEM_NOISE: f64 = 0.05;
/// Dead time from which a loop counts as one with much of it (samples), and noise (of the cycle) likewise.
const LONG: f64 = 4.0;
const NOISY: f64 = 0.2;

/// Judges and prints.
pub fn print(loops: u64, each: bool, threads: usize) {
    let mut judged = judge_all(table2(), threads);
    for of in &mut judged {
        of.scenarios = vec!["the paper's loops".into()];
    }
    judged.extend(random(BENCHMARK, loops, threads));
    let all: Vec<&Judged> = judged.iter().collect();
    println!("\n### Simulated: {} loops\n", all.len());
    tables::methods(&all, false);
    println!("\nTold whether the process integrates:\n");
    tables::methods(&all, true);
    tables::scenarios(&all);
    tables::friction(&all);
    tables::integration(&all);
    tables::agreement(&all);
    if each {
        judged.iter().for_each(tables::one);
    }
}

/// Half of them sticky, half sound, from a first seed on.
pub fn random(first: u64, loops: u64, threads: usize) -> Vec<Judged> {
    let drawn = (0..loops / 2).flat_map(|k| [random_sticky(first + k), random_sound(first + k)]);
    judge_all(drawn.collect(), threads)
}

fn judge_all(scenarios: Vec<Scenario>, threads: usize) -> Vec<Judged> {
    parallel::on(threads, scenarios, |scenario| {
        let truth = &scenario.truth;
        let mut judged = judge(
            truth.kind.clone(),
            truth.sticky,
            scenario.spec.process.kind.is_integrating(),
            &record(&scenario),
        );
        judged.s = truth.sticky.then_some(truth.s);
        judged.lag = lag(&scenario, &judged);
        judged.scenarios = labels(&scenario);
        judged
    })
}

/// `1/(w tau)`, tau the sum of the lags.
fn lag(scenario: &Scenario, judged: &Judged) -> Option<f64> {
    let tau_s = match scenario.spec.process.kind {
        ProcessKind::FirstOrder { tau_s, .. } => tau_s,
        ProcessKind::SecondOrder { tau_s, zeta, .. } => 2.0 * zeta * tau_s,
        ProcessKind::Integrating { .. } | ProcessKind::IntegratingLag { .. } => return Some(0.0),
    };
    Some(judged.period_s? / (std::f64::consts::TAU * tau_s))
}

/// What a loop is an example of; it may be one of several things.
fn labels(scenario: &Scenario) -> Vec<String> {
    let (kind, spec) = (&scenario.truth.kind, &scenario.spec);
    if !scenario.truth.sticky {
        return vec![format!("sound: {}", kind.split_once(", ").map_or(kind.as_str(), |(_, kind)| kind))];
    }
    let noise = kind.split("noise ").nth(1).and_then(|rest| rest.split(' ').next()?.parse::<f64>().ok());
    let facts = [
        (noise.is_some_and(|noise| noise > NOISY), "noise above a fifth of the cycle"),
        (!spec.loads.is_empty(), "with a load"),
        (spec.process.dead_time_s >= LONG * spec.ts_s, "dead time of 4 samples and more"),
        (spec.process.kind.is_integrating(), "integrating"),
        (kind.contains("dead band only"), "dead band only"),
        (!spec.sp_schedule.is_empty(), "set-point changes"),
    ];
    let mut labels: Vec<String> =
        facts.iter().filter(|(true_, _)| *true_).map(|(_, label)| format!("sticks: {label}")).collect();
    if labels.is_empty() {
        labels.push("sticks: none of these".into());
    }
    labels
}

fn record(scenario: &Scenario) -> Record {
    let run = scenario.run().expect("the scenarios are valid loops");
    let series = |v: &[f64]| -> Vec<Sample> {
        run.t.iter().zip(v).map(|(t, value)| Sample::good(*t, *value)).collect()
    };
    let mut noise = StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(scenario.seed));
    let stem: Vec<f64> = run.mv.iter().map(|mv| mv + STEM_NOISE * noise.next().unwrap_or(0.0)).collect();
    Record {
        op: series(&run.op),
        pv: series(&run.pv),
        sp: Some(series(&run.sp)),
        mv: Some(series(&stem)),
        op_span: Some(100.0),
        ..Record::default()
    }
}
