//! Measured records: no sound loop is accused, and the free run is worth more with what was found. Without the records, which
//! are no part of the repository, a line that begins with SKIPPED says so.

mod diagnosis_common {
    pub mod measured;
    pub mod parallel;
}

use diagnosis_common::measured::measured;
use diagnosis_common::parallel;
use stictiond::diagnosis::{Settings, Verdict, diagnose};
use stictiond::residual::{self, trace_record};
use stictiond::signal::Record;

/// Records whose free run has to be nearer with what was found: a third of all.
const NEARER: usize = 15;

/// What is made of a record.
struct Found {
    sticks: bool,
    /// Free-run error on the held-out samples, the declared model's and that with the effects; none where nothing was traced.
    free: Option<[f64; 2]>,
    line: String,
}

fn traced(name: &str, record: &Record) -> Found {
    let settings = Settings::default();
    let d = diagnose(record, &settings);
    let found = trace_record(record, &d, &settings, &residual::Settings::default());
    let verdict = found.as_ref().map_or(&d.verdict, |f| &f.verdict);
    let free = found.as_ref().map(|f| [f.before.free_run_rmse, f.after.free_run_rmse]);
    let effects = found.iter().flat_map(|f| &f.effects).map(|e| format!("{} {:.2}", e.kind, e.posterior));
    let effects = effects.collect::<Vec<_>>().join(", ");
    let line =
        format!("{name}: {} -> {}, free run {free:.4?}, {effects}", d.verdict.as_str(), verdict.as_str());
    Found { sticks: *verdict == Verdict::Stiction, free, line }
}

#[test]
fn measured_records_are_accused_of_nothing_and_told_better() {
    let loops = measured();
    if loops.is_empty() {
        return;
    }
    let found = parallel::each(&loops, |(row, record)| traced(&row[1], record));
    found.iter().for_each(|f| println!("{}", f.line));
    let of_sound = loops.iter().zip(&found).filter(|((row, _), _)| row[6] == "no stiction");
    let sound: Vec<&Found> = of_sound.map(|(_, f)| f).collect();
    assert_eq!((found.len(), sound.len()), (43, 28), "the index is not the known one");
    let ratios = || found.iter().filter_map(|f| f.free.map(|[before, after]| after / before));
    let (nearer, farther) =
        (ratios().filter(|r| *r < 0.999).count(), ratios().filter(|r| *r > 1.0001).count());
    println!("of {} traced the free run is better on {nearer}, worse on {farther}", ratios().count());
    let accused: Vec<&str> = sound.iter().filter(|f| f.sticks).map(|f| f.line.as_str()).collect();
    assert!(accused.is_empty(), "sound loops that are accused: {accused:#?}");
    assert!(nearer >= NEARER, "{nearer} of {}", found.len());
}
