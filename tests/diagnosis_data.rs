//! Measured loops, read as a user's file and diagnosed with the defaults: the whole table is printed.

mod diagnosis_common {
    pub mod measured;
    pub mod parallel;
}

use diagnosis_common::measured::{Measured, measured};
use diagnosis_common::parallel;
use stictiond::diagnosis::{Diagnosis, Settings, Verdict, diagnose};

#[test]
fn measured_loops_are_judged_as_their_owners_do() {
    let loops = measured();
    if loops.is_empty() {
        return;
    }
    let found = parallel::each(&loops, |m| diagnose(&m.record, &Settings::default()));
    println!(
        "{:34} {:11} {:16} {:>8} {:>17} {:>7} {:>6}  {:20} reason",
        "loop", "label", "verdict", "f", "95 %", "dAIC", "steady", "rival"
    );
    for (m, d) in loops.iter().zip(&found) {
        println!("{}", line(m, d));
    }
    let pairs = || loops.iter().zip(&found);
    let sticky = |d: &Diagnosis| d.verdict == Verdict::Stiction;
    let isdb = pairs().filter(|(m, _)| m.set == "isdb");
    let right = isdb.clone().filter(|(m, d)| sticky(d) == (m.label == "stiction")).count();
    let sound_plant = pairs().filter(|(m, _)| m.set == "plant" && m.label == "no stiction");
    let alarms = sound_plant.clone().filter(|(_, d)| sticky(d)).count();
    let sticky_plant = pairs().filter(|(m, _)| m.set == "plant" && m.label == "stiction");
    let caught = sticky_plant.clone().filter(|(_, d)| sticky(d)).count();
    println!(
        "ISDB right {right} of {}; plant false alarms {alarms} of {}; plant caught {caught} of {}",
        isdb.clone().count(),
        sound_plant.clone().count(),
        sticky_plant.count()
    );
    assert_eq!((isdb.clone().count(), sound_plant.count()), (7, 26), "the index is not the known one");
    assert!(right >= 6, "{right} of 7 ISDB loops");
    for (m, d) in isdb.filter(|(m, _)| m.name == "PAP7" || m.name == "CHEM13") {
        assert!(!sticky(d), "{}: {}", m.name, d.reason);
    }
    assert!(alarms <= 1, "{alarms} false alarms on sound plant loops");
}

fn line(m: &Measured, d: &Diagnosis) -> String {
    let Measured { name, label, .. } = m;
    let verdict = d.verdict.as_str();
    let Some(e) = &d.estimate else {
        return format!("{name:34} {label:11} {verdict:16} {:65}  {}", "", d.reason);
    };
    format!(
        "{name:34} {label:11} {verdict:16} {:>8.4} {:>8.4} {:>8.4} {:>7.0} {:>6.1}  {:20} {}",
        e.f,
        e.f_ci95[0],
        e.f_ci95[1],
        e.delta_aic,
        e.steadiness,
        e.rival.name(),
        d.reason
    )
}
