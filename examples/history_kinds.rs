//! What archives do to f, and how many of them are recognised, on loops that the seeds draw:
//! `cargo run --release --example history_kinds -- 24` diagnoses so many sticky and so many sound loops, raw and as each
//! archive would have kept them. The declared model alone judges them.

#[path = "../numerics/tests/common/parallel.rs"]
mod parallel;

use std::process::ExitCode;
use stictiond::diagnosis::{Diagnosis, Settings, Verdict, diagnose};
use stictiond::signal::{Record, Sample};
use stictiond::sim::archive::{averaged, exception, held, interpolated, moving_average, swinging_door};
use stictiond::sim::scenarios::{Scenario, random_sound, random_sticky};

/// What an archive does to one tag, sampled every so many seconds.
type Archive = Box<dyn Fn(&[Sample], f64) -> Vec<Sample> + Sync>;

/// Archives report at least once in so many samples.
const LONGEST: f64 = 100.0;

fn archives() -> Vec<(String, Archive)> {
    let mut all: Vec<(String, Archive)> = vec![("raw".into(), Box::new(|raw: &[Sample], _| raw.to_vec()))];
    for band in [0.02, 0.1, 0.25] {
        let door = move |raw: &[Sample], ts| swinging_door(raw, band * spread(raw), LONGEST * ts);
        all.push((format!("swinging door {band} sd"), Box::new(door)));
        all.push((
            format!("swinging door {band} sd, interpolated"),
            Box::new(move |raw, ts| interpolated(&door(raw, ts), ts)),
        ));
        all.push((
            format!("exception {band} sd"),
            Box::new(move |raw, ts| exception(raw, band * spread(raw), LONGEST * ts, false)),
        ));
    }
    for k in [2, 5] {
        all.push((format!("mean of {k}"), Box::new(move |raw, _| averaged(raw, k))));
        all.push((format!("held for {k}"), Box::new(move |raw, _| held(raw, k))));
    }
    all.push(("running mean of 10".into(), Box::new(|raw, _| moving_average(raw, 10))));
    all
}

/// Standard deviation.
fn spread(series: &[Sample]) -> f64 {
    let n = series.len().max(1) as f64;
    let mean = series.iter().map(|s| s.value).sum::<f64>() / n;
    (series.iter().map(|s| (s.value - mean).powi(2)).sum::<f64>() / n).sqrt()
}

/// Diagnoses of a loop under each archive, with the share of PV's samples that it kept.
fn judged(scenario: &Scenario, archives: &[(String, Archive)]) -> Vec<(Diagnosis, f64)> {
    let Ok(run) = scenario.run() else { return Vec::new() };
    let ts = run.t[1] - run.t[0];
    let series =
        |v: &[f64]| -> Vec<Sample> { run.t.iter().zip(v).map(|(&t, &x)| Sample::good(t, x)).collect() };
    let (op, pv) = (series(&run.op), series(&run.pv));
    let under = |(_, archive): &(String, Archive)| {
        let (op, pv) = (archive(&op, ts), archive(&pv, ts));
        let kept = pv.len() as f64 / run.pv.len() as f64;
        let record = Record { op, pv, op_span: Some(100.0), ..Record::default() };
        (diagnose(&record, &Settings::default()), kept)
    };
    archives.iter().map(under).collect()
}

fn main() -> ExitCode {
    let Ok(seeds) = std::env::args().nth(1).map_or(Ok(24), |n| n.parse::<u64>()) else {
        eprintln!("the number of loops, for example 24");
        return ExitCode::FAILURE;
    };
    let archives = archives();
    for (class, scenarios) in [
        ("sticky", (0..seeds).map(random_sticky).collect::<Vec<_>>()),
        ("sound", (0..seeds).map(random_sound).collect()),
    ] {
        println!("{class}: {seeds} loops");
        println!(
            "{:36} {:>6} {:>9} {:>6} {:>4} | {:>5} {:>6} {:>6} {:>6} | {:>5} {:>6} {:>6} {:>6} | recognised",
            "archive",
            "kept",
            "stiction",
            "none",
            "n.i.",
            "both",
            "low",
            "f/raw",
            "high",
            "n",
            "low",
            "f/true",
            "high"
        );
        let found = parallel::each(&scenarios, |scenario| judged(scenario, &archives));
        for (at, (name, _)) in archives.iter().enumerate() {
            let of: Vec<Judged> = scenarios
                .iter()
                .zip(&found)
                .filter_map(|(scenario, all)| {
                    let (diagnosis, kept) = all.get(at)?;
                    Some(Judged {
                        truth: 0.5 * scenario.truth.s,
                        raw: &all.first()?.0,
                        diagnosis,
                        kept: *kept,
                    })
                })
                .collect();
            println!("{name:36} {}", line(&of));
        }
    }
    ExitCode::SUCCESS
}

/// What an archive makes of one loop.
struct Judged<'a> {
    /// S/2 (% OP); 0 where the valve is sound.
    truth: f64,
    /// What is said of the raw record.
    raw: &'a Diagnosis,
    diagnosis: &'a Diagnosis,
    /// Share of PV's samples that are kept.
    kept: f64,
}

/// f where stiction is told.
fn f(of: &Diagnosis) -> Option<f64> {
    of.estimate.as_ref().filter(|_| of.verdict == Verdict::Stiction).map(|e| e.f)
}

/// How many ratios there are, and their quartiles.
fn quartiles(mut ratios: Vec<f64>) -> String {
    ratios.sort_by(f64::total_cmp);
    let [low, middle, high] = [0.25, 0.5, 0.75].map(|share| {
        let at = (share * ratios.len() as f64) as usize;
        ratios.get(at).map_or("-".into(), |ratio| format!("{ratio:.2}"))
    });
    format!("{:>5} {low:>6} {middle:>6} {high:>6}", ratios.len())
}

/// Verdicts; f against the raw record's where both say that it sticks, which leaves out what the archive hides, and against the
/// truth where the archive's record is said to stick; and what was recognised.
fn line(of: &[Judged]) -> String {
    let count = |wanted: &str| of.iter().filter(|own| own.diagnosis.verdict.as_str() == wanted).count();
    let by_raw = of.iter().filter_map(|own| Some(f(own.diagnosis)? / f(own.raw)?)).collect();
    let sticking = of.iter().filter(|own| own.truth > 0.0);
    let by_truth = sticking.filter_map(|own| Some(f(own.diagnosis)? / own.truth)).collect();
    let mut kinds: Vec<&str> = of
        .iter()
        .map(|own| own.diagnosis.preparation.history.as_ref().map_or("-", |h| h.kind.as_str()))
        .collect();
    kinds.sort_unstable();
    let kinds: Vec<String> =
        kinds.chunk_by(|a, b| a == b).map(|same| format!("{} {}", same[0], same.len())).collect();
    format!(
        "{:>5.0}% {:>9} {:>6} {:>4} | {} | {} | {}",
        100.0 * of.iter().map(|own| own.kept).sum::<f64>() / of.len().max(1) as f64,
        count("stiction"),
        count("no_stiction"),
        count("not_identifiable"),
        quartiles(by_raw),
        quartiles(by_truth),
        kinds.join(", ")
    )
}
