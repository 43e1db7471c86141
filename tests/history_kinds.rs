//! What archives leave in a record is recognised, and what measuring leaves is not taken for it. The counts are printed:
//! `cargo test --test history_kinds -- --nocapture`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use stictiond::diagnosis::history_kind::recognise;
use stictiond::signal::Sample;
use stictiond::sim::archive::{averaged, exception, held, interpolated, moving_average, swinging_door};
use stictiond::sim::scenarios::{Scenario, random_sound, random_sticky};
use stictiond::table;

/// From the package root, where cargo runs the tests.
const FOLDER: &str = "../shared/data";

type Tags = (Vec<Sample>, Vec<Sample>);

fn kind((op, pv): &Tags) -> &'static str {
    recognise(op, pv).map_or("raw", |found| found.kind.as_str())
}

fn good(series: &[Sample]) -> Vec<Sample> {
    series.iter().filter(|s| s.quality.is_good()).copied().collect()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> =
        entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect();
    found.retain(|path| path.extension().is_some_and(|e| e == "csv") && !path.ends_with("index.csv"));
    found.sort();
    found
}

/// Loops of plants with OP and PV; of the other folders one has OP alone, the rest is simulated or from a rig.
const PLANT_LOOPS: [&str; 4] = ["damadics", "isdb", "long", "plant"];

#[test]
fn measured_records_and_their_parts_are_raw() {
    let files: Vec<PathBuf> =
        PLANT_LOOPS.iter().flat_map(|name| files(&Path::new(FOLDER).join(name))).collect();
    if files.is_empty() {
        eprintln!("SKIPPED: no measured records, {FOLDER} is missing");
        return;
    }
    let (mut parts, mut wrong) = (0, Vec::new());
    for file in &files {
        let record = table::record(file).expect("the measured records are readable");
        let (op, pv) = (good(&record.op), good(&record.pv));
        for n in [pv.len(), 1000, 300] {
            for at in 0..(pv.len() / n).min(200) {
                let cut = |s: &[Sample]| s[(at * n).min(s.len())..((at + 1) * n).min(s.len())].to_vec();
                let part = (cut(&op), cut(&pv));
                parts += 1;
                if kind(&part) != "raw" {
                    wrong.push(format!("{} {at} of {n}: {}", file.display(), kind(&part)));
                }
            }
        }
    }
    println!(
        "{} measured records, {parts} parts: {} taken for another kind {wrong:?}",
        files.len(),
        wrong.len()
    );
    assert!(wrong.len() * 500 <= parts, "{wrong:?}");
}

/// OP and PV of a scenario.
fn run(scenario: &Scenario) -> Option<Tags> {
    let run = scenario.run().ok()?;
    let series = |v: &[f64]| run.t.iter().zip(v).map(|(&t, &x)| Sample::good(t, x)).collect();
    Some((series(&run.op), series(&run.pv)))
}

fn spread(series: &[Sample]) -> f64 {
    let n = series.len() as f64;
    let mean = series.iter().map(|s| s.value).sum::<f64>() / n;
    (series.iter().map(|s| (s.value - mean).powi(2)).sum::<f64>() / n).sqrt()
}

fn rounded(series: &[Sample], unit: f64) -> Vec<Sample> {
    series.iter().map(|s| Sample::good(s.t, (s.value / unit).round() * unit)).collect()
}

fn changes(series: &[Sample]) -> Vec<Sample> {
    let mut kept: Vec<Sample> = Vec::new();
    for s in series {
        if kept.last().is_none_or(|last| last.value != s.value) {
            kept.push(*s);
        }
    }
    kept
}

/// As devices deliver a loop: to their resolution, on change, frozen, stamped unevenly, with losses.
fn ordinary((op, pv): &Tags, seed: u64) -> Vec<Tags> {
    let mut state = seed + 1;
    // Numerical Recipes' generator: chance enough to lose samples by.
    let mut chance = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1_u64 << 31) as f64
    };
    let mut all = vec![(op.clone(), pv.clone()), (rounded(op, 0.01), rounded(pv, 0.01))];
    for resolution in [0.02, 0.1, 0.3] {
        let coarse = (rounded(op, 0.1), rounded(pv, resolution * spread(pv)));
        all.push((changes(&coarse.0), changes(&coarse.1)));
        all.push(coarse);
    }
    let n = pv.len();
    let frozen = |(i, s): (usize, &Sample)| {
        let stuck = i > n / 2 && i < n / 2 + n / 5;
        Sample::good(s.t, if stuck { pv[n / 2].value } else { s.value })
    };
    all.push((op.clone(), pv.iter().enumerate().map(frozen).collect()));
    let ts = op[1].t - op[0].t;
    let late: Vec<f64> = (0..n).map(|_| chance() * 0.9 * ts).collect();
    let shift = |s: &[Sample]| s.iter().zip(&late).map(|(s, by)| Sample::good(s.t + by, s.value)).collect();
    all.push((shift(op), shift(pv)));
    for share in [0.1, 0.3] {
        let there: Vec<bool> = (0..n).map(|_| chance() > share).collect();
        let of = |s: &[Sample]| s.iter().zip(&there).filter(|(_, there)| **there).map(|(s, _)| *s).collect();
        all.push((of(op), of(pv)));
    }
    all
}

#[test]
fn simulated_loops_are_raw_however_devices_deliver_them() {
    let (mut count, mut wrong) = (0, Vec::new());
    for seed in 0..40 {
        for scenario in [random_sticky(seed), random_sound(seed)] {
            let Some(tags) = run(&scenario) else { continue };
            for (at, delivered) in ordinary(&tags, seed).iter().enumerate() {
                count += 1;
                if kind(delivered) != "raw" {
                    wrong.push(format!(
                        "seed {seed}, {}, way {at}: {}",
                        scenario.truth.kind,
                        kind(delivered)
                    ));
                }
            }
        }
    }
    println!("{count} simulated records: {} taken for another kind {wrong:?}", wrong.len());
    assert!(wrong.len() * 200 <= count, "{wrong:#?}");
}

#[test]
fn archives_are_recognised_where_they_left_out_enough() {
    let mut found: BTreeMap<&str, BTreeMap<&str, usize>> = BTreeMap::new();
    for seed in 0..40 {
        let Some((op, pv)) = run(&random_sticky(seed)) else { continue };
        let ts = op[1].t - op[0].t;
        let both = |archive: &dyn Fn(&[Sample]) -> Vec<Sample>| (archive(&op), archive(&pv));
        let band = |s: &[Sample]| 0.1 * spread(s);
        let door = both(&|s| swinging_door(s, band(s), 100.0 * ts));
        let lines = (interpolated(&door.0, ts), interpolated(&door.1, ts));
        let reports = both(&|s| exception(s, band(s), 100.0 * ts, false));
        let mut note =
            |name, tags: &Tags| *found.entry(name).or_default().entry(kind(tags)).or_default() += 1;
        if door.1.len() * 10 < pv.len() * 7 && door.1.len() >= 60 {
            note("swinging door", &door);
            note("swinging door, interpolated", &lines);
        }
        if reports.1.len() * 10 < pv.len() * 7 && reports.1.len() >= 60 {
            note("exception", &reports);
        }
        note("held for 5", &both(&|s| held(s, 5)));
        note("running mean of 10", &both(&|s| moving_average(s, 10)));
        note("means of 5", &both(&|s| averaged(s, 5)));
    }
    for (name, kinds) in &found {
        println!("{name:30} {kinds:?}");
    }
    // The shares that docs/backfill.md tells, less what another seed may cost.
    for (name, as_kind, least) in [
        ("exception", "exception", 0.8),
        ("held for 5", "held", 0.95),
        ("swinging door, interpolated", "interpolated", 0.5),
        ("swinging door", "swinging_door", 0.1),
        ("running mean of 10", "averaged", 0.3),
    ] {
        let (of, right) =
            (found[name].values().sum::<usize>(), found[name].get(as_kind).copied().unwrap_or(0));
        assert!(of > 10 && right as f64 >= least * of as f64, "{name}: {right} of {of}");
    }
    // Means of blocks leave no trace: whoever reads them has to know.
    assert_eq!(found["means of 5"].keys().collect::<Vec<_>>(), [&"raw"]);
}
