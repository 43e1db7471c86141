//! How often the diagnosis is right on random loops of known truth, beside the floor that the issue names: the
//! argmin of the paper's AIC curve at a fixed delay of one sample, believed when it gains more than 20.

mod diagnosis_common {
    pub mod parallel;
    pub mod records;
}

use diagnosis_common::parallel;
use diagnosis_common::records::simulated;
use std::collections::BTreeMap;
use stictiond::diagnosis::search::{GRID, Searcher};
use stictiond::diagnosis::{Diagnosis, Settings, Verdict, diagnose, gate, prepare, verdict};
use stictiond::sim::Scenario;
use stictiond::sim::reverses_beyond;
use stictiond::sim::scenarios::{calibration, random_sound, random_sticky};

/// Least relative error of f that counts as wrong.
const CLOSE: f64 = 0.10;

/// What the prototype says of a loop: f where it believes in friction.
fn prototype(scenario: &Scenario) -> Option<f64> {
    let settings = Settings { max_delay: 1, ..Settings::default() };
    let record = simulated(scenario);
    let (window, mut preparation) = gate::gate(&record, &settings).ok()?;
    let (window, region) = prepare::prepare(window, &settings, &mut preparation);
    let (problem, scale) = verdict::pose(&window, &region, &settings).ok()?;
    let grid = Searcher::new(&problem).grid(GRID);
    let best = grid.iter().min_by(|a, b| a.loss.total_cmp(&b.loss))?;
    let gain = problem.rows() * (grid[0].loss / best.loss).ln();
    (best.f * scale.u > settings.f_threshold && gain > settings.evidence_threshold)
        .then_some(best.f * scale.u)
}

/// A scenario with what both say of it.
struct Judged {
    scenario: Scenario,
    diagnosis: Diagnosis,
    floor: Option<f64>,
}

impl Judged {
    fn all(seeds: std::ops::Range<u64>, draw: fn(u64) -> Scenario) -> Vec<Self> {
        parallel::each(seeds, |seed| {
            let scenario = draw(seed);
            let diagnosis = diagnose(&simulated(&scenario), &Settings::default());
            let floor = prototype(&scenario);
            Judged { scenario, diagnosis, floor }
        })
    }

    fn sticky(&self) -> bool {
        self.diagnosis.verdict == Verdict::Stiction
    }

    /// f as the diagnosis has it, where it says stiction.
    fn f(&self) -> Option<f64> {
        self.diagnosis.estimate.as_ref().filter(|_| self.sticky()).map(|e| e.f)
    }

    fn truth(&self) -> f64 {
        0.5 * self.scenario.truth.s
    }

    fn close(&self, f: Option<f64>) -> bool {
        f.is_some_and(|f| (f - self.truth()).abs() <= CLOSE * self.truth())
    }

    /// Whether the interval of f holds S/2, where the diagnosis says stiction.
    fn covered(&self) -> Option<bool> {
        let e = self.diagnosis.estimate.as_ref().filter(|_| self.sticky())?;
        Some((e.f_ci95[0]..=e.f_ci95[1]).contains(&self.truth()))
    }

    fn line(&self) -> String {
        let Scenario { seed, truth, .. } = &self.scenario;
        let d = &self.diagnosis;
        let numbers = d.estimate.as_ref().map_or(String::new(), |e| {
            format!("f {:.3} [{:.3}, {:.3}] dAIC {:.0}", e.f, e.f_ci95[0], e.f_ci95[1], e.delta_aic)
        });
        format!(
            "{seed:4} {:70} S/2 {:.3} J {:.3}: {} {numbers}; {}",
            truth.kind,
            self.truth(),
            truth.j,
            d.verdict.as_str(),
            d.reason
        )
    }
}

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

fn count(judged: &[Judged], is: impl Fn(&Judged) -> bool) -> usize {
    judged.iter().filter(|j| is(j)).count()
}

/// Verdicts by kind, the kind being what `of` makes of the scenario's words.
fn confusion(judged: &[Judged], of: impl Fn(&str) -> Vec<String>) {
    let mut table: BTreeMap<String, [usize; 3]> = BTreeMap::new();
    for j in judged {
        let column = match j.diagnosis.verdict {
            Verdict::Stiction => 0,
            Verdict::NoStiction => 1,
            Verdict::NotIdentifiable(_) => 2,
        };
        for kind in of(&j.scenario.truth.kind) {
            table.entry(kind).or_default()[column] += 1;
        }
    }
    println!("{:34} {:>9} {:>12} {:>17}", "kind", "stiction", "no stiction", "not identifiable");
    for (kind, [sticky, sound, neither]) in table {
        println!("{kind:34} {sticky:>9} {sound:>12} {neither:>17}");
    }
}

#[test]
fn sound_loops_are_not_accused() {
    let judged = Judged::all(0..100, random_sound);
    confusion(&judged, |kind| kind.split(", ").skip(1).map(str::to_owned).collect());
    let accused = count(&judged, Judged::sticky);
    let floor = count(&judged, |j| j.floor.is_some());
    println!("sound loops accused: {accused} of {}, by the prototype {floor}", judged.len());
    for j in judged.iter().filter(|j| j.sticky()) {
        println!("ACCUSED {}", j.line());
    }
    // The project promises 2 % of 100 seeds.
    assert!(accused <= 2, "{accused}");
    assert!(accused <= floor, "no better than the prototype: {accused} against {floor}");
}

#[test]
fn sticky_loops_are_found_with_the_right_f() {
    let judged = Judged::all(0..100, random_sticky);
    confusion(&judged, |kind| {
        let words: Vec<&str> = kind.split(", ").collect();
        words.iter().map(|w| w.split_whitespace().take(2).collect::<Vec<_>>().join(" ")).collect()
    });
    let found = count(&judged, Judged::sticky);
    let close = count(&judged, |j| j.close(j.f()));
    let (floor_found, floor_close) =
        (count(&judged, |j| j.floor.is_some()), count(&judged, |j| j.close(j.floor)));
    println!(
        "sticky loops of {}: found {found}, f within 10 % on {close}; prototype {floor_found} and {floor_close}",
        judged.len()
    );
    let reversing = |j: &Judged| {
        let op = j.diagnosis.window.as_ref().map_or(&[][..], |w| &w.op);
        reverses_beyond(op, j.scenario.truth.s) >= 4
    };
    println!("OP reverses by more than S four times in the window: {}", count(&judged, reversing));
    for j in judged.iter().filter(|j| !j.close(j.f())) {
        println!("{} {}", if j.sticky() { "OFF   " } else { "MISSED" }, j.line());
    }
    assert!(found > floor_found && close > floor_close, "no better than the prototype");
}

#[test]
fn the_interval_of_f_covers_the_truth_as_often_as_it_says() {
    let judged = Judged::all(0..200, calibration);
    let found = count(&judged, Judged::sticky);
    let close = count(&judged, |j| j.close(j.f()));
    let covered = count(&judged, |j| j.covered() == Some(true));
    let floor_close = count(&judged, |j| j.close(j.floor));
    for j in judged.iter().filter(|j| j.covered() != Some(true)) {
        println!("{} {}", if j.sticky() { "OUTSIDE" } else { "MISSED " }, j.line());
    }
    for at in 0..4 {
        let of_jump: Vec<&Judged> = judged.iter().filter(|j| j.scenario.seed % 4 == at).collect();
        let inside = of_jump.iter().filter(|j| j.covered() == Some(true)).count();
        let said = of_jump.iter().filter(|j| j.sticky()).count();
        let kind = of_jump[0].scenario.truth.kind.split(", ").find(|w| w.starts_with("J ="));
        println!("{}: S/2 inside {inside} of {said}", kind.unwrap_or_default());
    }
    println!(
        "calibration loops of {}: found {found}, f within 10 % on {close} (prototype {floor_close}), \
         S/2 inside the interval on {covered}: {:.1} %",
        judged.len(),
        100.0 * share(covered, found)
    );
    // The promise of the project; the sampling error of 95 % on 200 seeds is 1.5 %.
    assert!((0.90..=0.99).contains(&share(covered, found)), "{covered} of {found}");
}
