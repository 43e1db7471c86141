//! How often the diagnosis is right on random loops of known truth, beside the floor that the issue names: the
//! argmin of the paper's AIC curve at a fixed delay of one sample, believed when it gains more than 20.

use super::common::parallel;
use super::common::records::simulated;
use std::collections::BTreeMap;
use stictiond_numerics::diagnosis::grid::GRID;
use stictiond_numerics::diagnosis::search::Searcher;
use stictiond_numerics::diagnosis::{Diagnosis, Settings, Verdict, diagnose, gate, prepare, verdict};
use stictiond_numerics::sim::Scenario;
use stictiond_numerics::sim::scenarios::{calibration, random_sound, random_sticky};
use stictiond_numerics::sysid::valve::model_error::without_model_error;

/// Largest relative error of an f that counts as right.
const CLOSE: f64 = 0.10;

/// Evidence at which the prototype believes in friction.
const PROTOTYPE: f64 = 20.0;

/// What the prototype says of a loop: the f of least AIC and what it gains over f = 0; none where it cannot look.
fn prototype(scenario: &Scenario) -> Option<(f64, f64)> {
    let settings = Settings { max_delay: 1, ..Settings::default() };
    let record = simulated(scenario);
    let (window, mut preparation) = gate::gate(&record, &settings).ok()?;
    let (window, region) = prepare::prepare(window, &settings, &mut preparation);
    let (problem, scale) = verdict::pose(&window, &region, &settings).ok()?;
    let grid = Searcher::new(&problem).grid(GRID);
    let best = grid.iter().min_by(|a, b| a.loss.total_cmp(&b.loss))?;
    let gain = problem.rows() * (grid[0].loss / best.loss).ln();
    Some((best.f * scale.u, gain)).filter(|(f, _)| *f > settings.f_threshold)
}

/// A scenario with what both say of it.
struct Judged {
    scenario: Scenario,
    diagnosis: Diagnosis,
    /// None where the prototype was not asked either.
    prototype: Option<(f64, f64)>,
}

impl Judged {
    fn all(
        seeds: std::ops::Range<u64>,
        draw: fn(u64) -> Scenario,
        prototype: fn(&Scenario) -> Option<(f64, f64)>,
    ) -> Vec<Self> {
        parallel::each(seeds, |seed| {
            let scenario = draw(seed);
            let diagnosis = diagnose(&simulated(&scenario), &Settings::default());
            let prototype = prototype(&scenario);
            Judged { scenario, diagnosis, prototype }
        })
    }

    fn sticky(&self) -> bool {
        self.diagnosis.verdict == Verdict::Stiction
    }

    /// f as the diagnosis has it, where it says stiction.
    fn f(&self) -> Option<f64> {
        self.diagnosis.estimate.as_ref().filter(|_| self.sticky()).map(|e| e.f)
    }

    /// f as the prototype has it, where it gains more than `evidence`.
    fn floor(&self, evidence: f64) -> Option<f64> {
        self.prototype.filter(|(_, gain)| *gain > evidence).map(|(f, _)| f)
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
        // These valves are the models themselves.
        let [low, high] = without_model_error(e.f, e.f_ci95);
        Some((low..=high).contains(&self.truth()))
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
    let mut table: BTreeMap<String, [usize; 4]> = BTreeMap::new();
    for j in judged {
        let column = match j.diagnosis.verdict {
            Verdict::Stiction => 0,
            Verdict::NoStiction => 1,
            Verdict::NotIdentifiable(_) => 2,
        };
        for kind in of(&j.scenario.truth.kind) {
            let row = table.entry(kind).or_default();
            row[column] += 1;
            row[3] += usize::from(j.floor(PROTOTYPE).is_some());
        }
    }
    println!(
        "{:28} {:>9} {:>12} {:>17} {:>20}",
        "kind", "stiction", "no stiction", "not identifiable", "prototype: stiction"
    );
    for (kind, [sticky, sound, neither, floor]) in table {
        println!("{kind:28} {sticky:>9} {sound:>12} {neither:>17} {floor:>20}");
    }
}

/// The words of a sticky scenario that make groups: noise in three sizes.
fn sticky_kinds(kind: &str) -> Vec<String> {
    let noise =
        |words: &str| -> Option<f64> { words.strip_prefix("noise ")?.split(' ').next()?.parse().ok() };
    let group = |words: &str| match noise(words) {
        Some(0.0) => "no noise".to_owned(),
        Some(share) if share < 0.3 => "some noise".to_owned(),
        Some(_) => "heavy noise".to_owned(),
        None => words.to_owned(),
    };
    kind.split(", ").map(group).collect()
}

#[test]
fn sticky_and_sound_loops_are_told_apart() {
    let sound = Judged::all(0..100, random_sound, prototype);
    let sticky = Judged::all(0..100, random_sticky, prototype);
    confusion(&sound, |kind| kind.split(", ").skip(1).map(str::to_owned).collect());
    confusion(&sticky, sticky_kinds);
    let (accused, found) = (count(&sound, Judged::sticky), count(&sticky, Judged::sticky));
    let close = count(&sticky, |j| j.close(j.f()));
    for j in sound.iter().filter(|j| j.sticky()) {
        println!("ACCUSED {}", j.line());
    }
    for j in sticky.iter().filter(|j| !j.close(j.f())) {
        println!("{} {}", if j.sticky() { "OFF    " } else { "MISSED " }, j.line());
    }
    println!("of 100 each: sound accused {accused}; sticky found {found}, f within 10 % on {close}");
    // The prototype as it is, and with the evidence that it would need to accuse no more sound loops than we do.
    let mut gains: Vec<f64> = sound.iter().filter_map(|j| j.prototype).map(|(_, gain)| gain).collect();
    gains.sort_by(|a, b| b.total_cmp(a));
    let careful = gains.get(accused).copied().unwrap_or(0.0).max(PROTOTYPE);
    let [as_it_is, as_careful] = [PROTOTYPE, careful].map(|evidence| {
        let accused = count(&sound, |j| j.floor(evidence).is_some());
        let found = count(&sticky, |j| j.floor(evidence).is_some());
        let close = count(&sticky, |j| j.close(j.floor(evidence)));
        println!(
            "prototype, dAIC > {evidence:.0}: sound accused {accused}; sticky found {found}, close {close}"
        );
        (accused, found, close)
    });
    // The project promises 2 % of 100 seeds.
    assert!(accused <= 2, "{accused} sound loops accused");
    // The floor is to be left far behind: right more often as it is, by a quarter, and found twice as often at
    // the same rate of false alarms.
    assert!(4 * close >= 5 * as_it_is.2, "{close} close, the prototype {}", as_it_is.2);
    assert!(found >= 2 * as_careful.1, "{found} found, the prototype {}", as_careful.1);
}

#[test]
fn the_interval_of_f_covers_the_truth_as_often_as_it_says() {
    // Nothing is asked of the prototype here.
    let judged = Judged::all(0..200, calibration, |_| None);
    let found = count(&judged, Judged::sticky);
    let close = count(&judged, |j| j.close(j.f()));
    let covered = count(&judged, |j| j.covered() == Some(true));
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
        "calibration loops of {}: found {found}, f within 10 % on {close}, \
         S/2 inside the interval on {covered}: {:.1} %",
        judged.len(),
        100.0 * share(covered, found)
    );
    // The README says 193 and 181: an interval that covers is worth little where few are given.
    assert!(found >= 185 && close >= 170, "found {found}, f within 10 % on {close}");
    // The promise of the project; the sampling error of 95 % on 200 seeds is 1.5 %.
    assert!((0.90..=0.99).contains(&share(covered, found)), "{covered} of {found}");
}
