//! A structure that still holds is not searched for again; one that no longer holds is.

use stictiond_numerics::diagnosis::{Settings, Verdict, diagnose};
use stictiond_numerics::residual::{self, Findings, LASTS_S, Structure, Test, confirm, trace_record};
use stictiond_numerics::signal::{Record, Sample};
use stictiond_numerics::sim::scenarios::{Scenario, random_sound, random_sticky};
use stictiond_numerics::sim::{Load, LoadKind};

/// Samples of each window.
const WINDOW: usize = 1000;

/// So many windows of a scenario, one after the other.
fn windows<const N: usize>(mut scenario: Scenario) -> [Record; N] {
    scenario.n = scenario.warm_up + N * WINDOW;
    let run = scenario.run().expect("can be simulated");
    std::array::from_fn(|window| {
        let part = window * WINDOW..(window + 1) * WINDOW;
        let series =
            |v: &[f64]| -> Vec<Sample> { part.clone().map(|k| Sample::good(run.t[k], v[k])).collect() };
        Record { op: series(&run.op), pv: series(&run.pv), op_span: Some(100.0), ..Record::default() }
    })
}

/// A structure without anything, just found.
fn none(record: &Record) -> Structure {
    let end = record.op.last().expect("some").t;
    Structure { searched: end, failed: Test::ALL.to_vec(), ..Structure::default() }
}

fn search(record: &Record) -> Findings {
    let settings = Settings::default();
    let diagnosis = diagnose(record, &settings);
    trace_record(record, &diagnosis, &settings, &residual::Settings::default()).expect("long enough")
}

fn confirmed(record: &Record, last: &Structure) -> Option<Findings> {
    Some(confirm(record, &Settings::default(), &residual::Settings::default(), last)?.1)
}

#[test]
fn a_valve_that_goes_on_sticking_is_fitted_and_not_searched_for() {
    let (mut known, mut held, mut near) = (0, 0, 0);
    for seed in 500..508 {
        let scenario = random_sticky(seed);
        let s = scenario.truth.s;
        let [first, second] = windows(scenario);
        let Some(structure) = search(&first).structure.filter(|own| own.valve.is_some()) else { continue };
        known += 1;
        let Some((diagnosis, found)) =
            confirm(&second, &Settings::default(), &residual::Settings::default(), &structure)
        else {
            continue;
        };
        held += 1;
        assert_eq!((&diagnosis.verdict, &found.verdict), (&Verdict::Stiction, &Verdict::Stiction));
        let estimate = diagnosis.estimate.expect("it sticks");
        assert_eq!(estimate.f, found.friction_after.f);
        near += usize::from((2.0 * estimate.f / s - 1.0).abs() < 0.15);
        assert!(estimate.curve.len() > 20 && estimate.mv.len() == diagnosis.window.expect("one").len());
        assert_eq!(found.structure.expect("it holds").confirmed, 1);
    }
    assert!(known >= 3 && held >= 2 && near + 1 >= held, "{near} near of {held} that hold of {known}");
}

#[test]
fn friction_that_begins_or_ends_is_searched_for() {
    let mut asked = [0, 0];
    for seed in 510..516 {
        let [sticking] = windows(random_sticky(seed));
        let found = search(&sticking);
        if found.verdict == Verdict::Stiction {
            asked[0] += 1;
            assert_eq!(confirmed(&sticking, &none(&sticking)), None, "seed {seed}: it was sound");
        }
        let [sound] = windows(random_sound(seed));
        let stuck = Structure {
            valve: search(&sticking).structure.and_then(|own| own.valve),
            ..Structure::default()
        };
        if search(&sound).verdict == Verdict::NoStiction && stuck.valve.is_some() {
            asked[1] += 1;
            assert_eq!(confirmed(&sound, &stuck), None, "seed {seed}: it stuck");
        }
    }
    assert!(asked[0] >= 3 && asked[1] >= 2, "{asked:?}");
}

#[test]
fn a_load_that_sets_in_is_searched_for() {
    let quiet = |seed| {
        let mut scenario = random_sticky(seed);
        scenario.spec.loads.clear();
        scenario
    };
    let mut asked = 0;
    for seed in 520..526 {
        let [first] = windows(quiet(seed));
        let Some(structure) = search(&first).structure else { continue };
        let mut loaded = quiet(seed);
        let of = |fold: fn(f64, f64) -> f64| first.pv.iter().map(|s| s.value).reduce(fold).expect("some");
        let (amplitude, ts) = (0.4 * (of(f64::max) - of(f64::min)), first.op[1].t - first.op[0].t);
        loaded.spec.loads.push(Load::output(LoadKind::Sine {
            amplitude,
            period_s: 23.7 * ts,
            phase: 0.0,
            growth_per_s: 0.0,
        }));
        let [second] = windows(loaded);
        asked += 1;
        assert_eq!(confirmed(&second, &structure), None, "seed {seed}");
    }
    assert!(asked >= 2, "{asked}");
}

#[test]
fn everything_is_searched_for_again_in_the_end() {
    let last = (500..508).find_map(|seed| {
        let [first] = windows(random_sticky(seed));
        let structure = search(&first).structure?;
        confirmed(&first, &structure).map(|_| (first, structure))
    });
    let (record, structure) = last.expect("one of eight holds on its own window");
    let until =
        |age: f64| confirmed(&record, &Structure { searched: structure.searched - age, ..structure.clone() });
    let before = until(LASTS_S - 1.0).expect("it holds").structure.expect("it holds");
    assert_eq!((before.confirmed, before.searched), (1, structure.searched - LASTS_S + 1.0));
    assert_eq!(until(LASTS_S), None);
    assert_eq!(until(-1.0), None, "it is of later");
}
