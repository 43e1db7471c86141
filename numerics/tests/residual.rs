//! Effects that the declared model lacks are named, few are invented, sound valves are not
//! accused, and friction is as large as it is.
//!
//! A few cases of what `cargo run --release -p stictiond-numerics --example tracing_rates` sweeps. A bound is the sweep's share
//! less what chance does to as many cases as there are here.

#[path = "common/bounds.rs"]
mod bounds;
#[path = "common/generators/mod.rs"]
#[allow(dead_code, reason = "each user takes a part")]
mod generators;
#[path = "../examples/tracing_rates/judge.rs"]
#[allow(dead_code, reason = "each user takes a part")]
mod judge;
#[path = "../examples/held_out_optimism/optimism.rs"]
mod optimism;
#[path = "common/parallel.rs"]
mod parallel;

use bounds::{fewest, most};
use generators::{Case, GENERATORS, Generator, Size};
use judge::{Judged, Naming, judge};
use optimism::{Errors, mean_with_interval};
use stictiond_numerics::residual::Kind;

/// No seed that constants were chosen by.
const SEED: u64 = 701;
/// Cases of each kind, and records with nothing hidden, of each generator.
const OF_A_KIND: usize = 2;
const CLEAN: usize = 12;
/// Tags that have nothing to do with the loop, beside an effect.
const TAGS: usize = 3;

/// Shares of a sweep over a generator's loops that have an effect.
struct Rates {
    /// First effect named right.
    named: f64,
    /// Sticking valves that are told.
    told: f64,
    /// The interval of f covers the truth, on sticking valves that are told.
    covered: f64,
}

/// `tracing_rates --seeds 1 --clean 60`, with `--first-seed 421` and `1013` together: 261 of 344, 196 of 248, 177 of 196.
const RATES_OF_A: Rates = Rates { named: 0.76, told: 0.79, covered: 0.90 };
/// 240 of 430, 140 of 310, 123 of 140.
const RATES_OF_B: Rates = Rates { named: 0.56, told: 0.45, covered: 0.88 };
/// 369 of 644, 217 of 462, 142 of 217.
const RATES_OF_C: Rates = Rates { named: 0.57, told: 0.47, covered: 0.65 };
/// Sound valves that are told to stick beside an effect: in the same sweeps 3 of 398.
const ACCUSED: f64 = 0.0075;
/// Something invented on a record with nothing hidden: there on 11 of 360.
const INVENTED: f64 = 0.031;

/// Cases of a kind, their variants spread over loop classes and valves.
fn of_kind(generator: &Generator, kind: Kind, count: usize, size: Size) -> Vec<Case> {
    let variants = (generator.variants)(Some(kind));
    let at = Kind::ALL.iter().position(|other| *other == kind).unwrap_or(0);
    // Consecutive cases differ in class and in valve.
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
    // Steps of five meet all variants, but where their number is a multiple of it.
    let step = if variants.is_multiple_of(5) { 7 } else { 5 };
    let case = |i: usize| Case {
        effect: None,
        size: Size::Medium,
        variant: step * i % variants,
        seed: SEED + i as u64,
        tags: [0, 5, 20, 50][i / 2 % 4],
    };
    (0..CLEAN).map(case).collect()
}

/// Prints a count and asserts that it is no less than the rate and chance leave.
fn at_least(what: &str, count: usize, of: usize, rate: f64) {
    println!("{what} {count} of {of}");
    assert!(count >= fewest(rate, of), "{what} {count} of {of}, {rate} expected");
}

/// The same of no more.
fn at_most(what: &str, count: usize, of: usize, rate: f64) {
    println!("{what} {count} of {of}");
    assert!(count <= most(rate, of), "{what} {count} of {of}, {rate} expected");
}

/// What has to hold of a generator's loops that have an effect: named right, nobody accused, f within its interval.
fn holds(generator: &Generator, rates: &Rates) {
    let effects = Kind::ALL.into_iter().flat_map(|kind| of_kind(generator, kind, OF_A_KIND, Size::Medium));
    let found = parallel::each(effects, |case| judge(generator, &case, false));
    assert!(found.iter().all(|j| j.is_traced), "every case can be traced");
    let odd = found.iter().filter(|j| j.naming() != Naming::Right || !j.beside().is_empty());
    odd.for_each(|j| println!("{}", j.line()));
    let (sticking, sound): (Vec<&Judged>, Vec<&Judged>) = found.iter().partition(|j| j.f_true > 0.0);
    let told: Vec<&&Judged> = sticking.iter().filter(|j| j.sticks).collect();
    let right = found.iter().filter(|j| j.naming() == Naming::Right).count();
    at_least("named right", right, found.len(), rates.named);
    let named: Vec<(f64, bool)> = found.iter().flat_map(Judged::competing).collect();
    let share = named.iter().map(|own| own.0).sum::<f64>() / named.len() as f64;
    let there = named.iter().filter(|own| own.1).count();
    at_least("there of what is named, as often as the posteriors say", there, named.len(), share);
    let accused = sound.iter().filter(|j| j.sticks).count();
    at_most("accused", accused, sound.len(), ACCUSED);
    at_least("told to stick", told.len(), sticking.len(), rates.told);
    let covered = told.iter().filter(|j| (j.ci[0]..=j.ci[1]).contains(&j.f_true)).count();
    at_least("interval covers", covered, told.len(), rates.covered);
}

#[test]
fn loops_of_generator_a_are_read_right() {
    holds(&GENERATORS[0], &RATES_OF_A);
}

#[test]
fn loops_of_generator_b_are_read_right() {
    holds(&GENERATORS[1], &RATES_OF_B);
}

#[test]
fn loops_of_generator_c_are_read_right() {
    holds(&GENERATORS[2], &RATES_OF_C);
}

/// Of all generators together: of one alone a few records tell little.
#[test]
fn where_nothing_is_hidden_little_is_invented_and_nobody_accused() {
    let generators = GENERATORS;
    let cases = generators.iter().flat_map(|own| clean(own).into_iter().map(move |case| (own, case)));
    let quiet = parallel::each(cases, |(generator, case)| judge(generator, &case, false));
    assert!(quiet.iter().all(|j| j.is_traced), "every case can be traced");
    quiet.iter().filter(|j| !j.beside().is_empty()).for_each(|j| println!("{}", j.line()));
    let invented = quiet.iter().filter(|j| !j.beside().is_empty()).count();
    at_most("invented on", invented, quiet.len(), INVENTED);
    let accused: Vec<String> =
        quiet.iter().filter(|j| j.f_true == 0.0 && j.sticks).map(Judged::line).collect();
    assert!(accused.is_empty(), "sound loops with nothing hidden are accused: {accused:#?}");
}

/// Its valve rests in the first two thirds of the window; then the loop swings to the end.
#[test]
fn a_loop_that_begins_to_swing_late_keeps_its_friction() {
    let case = Case { effect: None, size: Size::Medium, variant: 8, seed: 9205, tags: 2 };
    let judged = judge(&GENERATORS[0], &case, false);
    assert!(judged.sticks && judged.named.is_empty(), "{}", judged.line());
    assert!((judged.ci[0]..=judged.ci[1]).contains(&judged.f_true), "{}", judged.line());
}

const LOADS: [Kind; 4] = [Kind::OscillatingLoad, Kind::MeasuredDisturbance, Kind::LoadStep, Kind::Drift];
/// Large loads that a fit which is told of them finds, or that are found without: 13 of 16, but two drifts and a step. All are asked.
const FOUND_WHEN_TOLD: f64 = 0.81;

#[test]
fn a_load_is_told_in_units_of_op_and_found_by_a_fit_that_is_told_of_it() {
    let a = &GENERATORS[0];
    let (mut found, mut asked) = (0, 0);
    for kind in LOADS {
        // Some act on PV, behind the process, and are worth nothing at the valve.
        let at_valve = |case: &Case| (a.record)(case).1.load.is_some();
        let cases = of_kind(a, kind, 12, Size::Large).into_iter().filter(at_valve).take(4);
        let judged = parallel::each(cases, |case| judge(a, &case, true));
        asked += judged.len();
        found += judged.iter().filter(|j| j.identifiable == Some(true)).count();
        judged.iter().filter(|j| j.identifiable == Some(false)).for_each(|j| println!("{}", j.line()));
        let mut shares: Vec<f64> = judged.iter().filter_map(|j| j.size).collect();
        shares.sort_by(f64::total_cmp);
        println!("{kind}, told of true: {shares:.2?}");
        // A factor of the root of 2 or of 2 is what mixed-up amplitudes, deviations and ranges make.
        assert!(
            shares.len() >= 2 && shares.iter().all(|share| (0.8..1.25).contains(share)),
            "{kind}: {shares:?}"
        );
    }
    println!("found when told: {found} of {asked}");
    assert!(found >= fewest(FOUND_WHEN_TOLD, asked), "{found} of {asked}");
}

#[test]
fn optimism_is_what_the_model_with_the_effects_loses_beyond_the_declared_one() {
    let near = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
    // Both lose a tenth on the continuation, and the model with the effects a fifth more.
    let errors = Errors { held_out: [2.0, 1.0], continued: [2.2, 1.32] };
    near(errors.grown()[0], 1.1f64.ln());
    near(errors.grown()[1], 1.32f64.ln());
    near(errors.gains()[0], 0.5f64.ln());
    near(errors.gains()[1], 0.6f64.ln());
    near(errors.optimism(), 1.2f64.ln());
    assert!(errors.are_positive());
    for wrong in [0.0, f64::NAN, f64::INFINITY] {
        assert!(!Errors { continued: [wrong, 1.0], ..errors }.are_positive());
        assert!(!Errors { held_out: [1.0, wrong], ..errors }.are_positive());
    }
}

#[test]
fn a_bootstrap_interval_is_that_of_the_mean() {
    assert_eq!(mean_with_interval(&[]), None);
    assert_eq!(mean_with_interval(&[0.25; 8]), Some((0.25, [0.25; 2])));
    // Of 400 values, half 0 and half 1: the standard error of the mean is 0.025.
    let values: Vec<f64> = (0..400).map(|k| f64::from(k % 2)).collect();
    let (mean, [low, high]) = mean_with_interval(&values).expect("of 400");
    assert!(mean == 0.5 && (low - 0.451).abs() < 0.005 && (high - 0.549).abs() < 0.005, "{low} {high}");
}
