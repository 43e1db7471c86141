//! Measured loops, read as a user's file and diagnosed with the defaults: the whole table is printed.

#[path = "../numerics/tests/common/labelled.rs"]
mod labelled;
#[path = "../numerics/tests/common/parallel.rs"]
mod parallel;

use labelled::labelled;
use stictiond::diagnosis::{Diagnosis, Settings, Verdict, diagnose};
use stictiond::table;

/// From the package's root, where cargo runs the tests.
const FOLDER: &str = "../shared/data";

#[test]
fn measured_loops_are_judged_as_their_owners_do() {
    let loops = labelled(FOLDER, |file| table::record(file).expect("the measured records are readable"));
    if loops.is_empty() {
        return;
    }
    let found = parallel::each(&loops, |(_, record)| diagnose(record, &Settings::default()));
    println!(
        "{:34} {:11} {:16} {:>8} {:>17} {:>7} {:>6}  {:20} reason",
        "loop", "label", "verdict", "f", "95 %", "dAIC", "steady", "rival"
    );
    // Set, name and label of each with what was found.
    let judged: Vec<_> =
        loops.iter().zip(&found).map(|((row, _), d)| (&*row[0], &*row[1], &*row[6], d)).collect();
    for &(_, name, label, d) in &judged {
        println!("{name:34} {label:11} {}", line(d));
    }
    let of = |set: &str, wanted: &str| -> Vec<_> {
        judged
            .iter()
            .filter(|(s, _, label, _)| *s == set && (wanted.is_empty() || *label == wanted))
            .collect()
    };
    let sticky = |d: &Diagnosis| d.verdict == Verdict::Stiction;
    let (isdb, sound, stuck) = (of("isdb", ""), of("plant", "no stiction"), of("plant", "stiction"));
    let right = isdb.iter().filter(|(_, _, label, d)| sticky(d) == (*label == "stiction")).count();
    let alarms = sound.iter().filter(|(.., d)| sticky(d)).count();
    let caught = stuck.iter().filter(|(.., d)| sticky(d)).count();
    let missed = stuck.iter().filter(|(.., d)| d.verdict == Verdict::NoStiction).count();
    println!(
        "ISDB right {right} of {}; plant false alarms {alarms} of {}; of {} caught {caught}, missed {missed}",
        isdb.len(),
        sound.len(),
        stuck.len()
    );
    // What the README says.
    assert_eq!((isdb.len(), sound.len(), stuck.len()), (7, 26, 10), "the index is not the known one");
    assert!(right >= 6, "{right} of 7 ISDB loops");
    for (_, name, _, d) in isdb.iter().filter(|(_, name, ..)| ["PAP7", "CHEM13"].contains(name)) {
        assert!(!sticky(d), "{name}: {}", d.reason);
    }
    assert_eq!(alarms, 0, "false alarms on sound plant loops");
    assert!(caught >= 2 && missed <= 1, "of {} caught {caught}, missed {missed}", stuck.len());
}

fn line(d: &Diagnosis) -> String {
    let verdict = d.verdict.as_str();
    let Some(e) = &d.estimate else {
        return format!("{verdict:16} {:70}  {}", "", d.reason);
    };
    format!(
        "{verdict:16} {:>8.4} {:>8.4} {:>8.4} {:>7.0} {:>6.1}  {:20} {}",
        e.f,
        e.f_ci95[0],
        e.f_ci95[1],
        e.delta_aic,
        e.steadiness,
        e.rival.name(),
        d.reason
    )
}
