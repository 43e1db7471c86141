//! Effects that the declared model lacks are named, few are invented, and nothing is named with confidence that does not help.
//!
//! A few seeds of what `cargo run --release --example tracing_rates` sweeps; each bound is what its seeds showed, less
//! the binomial error of as many cases as there are here.

mod diagnosis_common {
    pub mod parallel;
}
mod residual_common {
    pub mod drawn;
    pub mod judge;
    #[path = "../generators/a/plant.rs"]
    pub mod plant;
    #[path = "../generators/a/valve.rs"]
    pub mod valve;
}

use diagnosis_common::parallel;
use residual_common::drawn::{nothing_hidden, traced};
use residual_common::judge::{Judged, LOADS, judge};
use residual_common::plant::{Case, LOOPS, SIZES, Undeclared, VALVES, cases, clean, record};
use stictiond::residual::Kind;
use stictiond::sim::scenarios::random_sound;

/// No seed of the published rates, nor of those that thresholds were chosen by.
const SEED: u64 = 700;
const MEDIUM: usize = 1;

/// Every second case of each kind at medium size, every loop class and valve among them.
fn half_of(kinds: &[Kind]) -> Vec<Case> {
    kinds
        .iter()
        .enumerate()
        .flat_map(|(at, kind)| {
            let all = cases(Undeclared::Listed(*kind), MEDIUM, SEED..SEED + 1);
            all.into_iter().enumerate().filter(move |(i, _)| (i + at).is_multiple_of(2)).map(|(_, case)| case)
        })
        .collect()
}

fn shown(j: &Judged) -> String {
    let names: Vec<&str> = j.named.iter().map(|k| k.as_str()).collect();
    format!(
        "{:?} {}, {} {} seed {}: {names:?}, one step {:.4?}, free run {:.4?}, f {:.3?}",
        j.case.undeclared,
        SIZES[j.case.size],
        LOOPS[j.case.class],
        VALVES[j.case.valve].0,
        j.case.seed,
        j.one,
        j.free,
        j.f
    )
}

#[test]
fn the_first_effect_named_is_the_true_one() {
    let found = parallel::each(half_of(&Kind::ALL), |case| judge(&case, false));
    let right = |j: &&Judged| j.first().is_some_and(|k| Undeclared::Listed(k) == j.case.undeclared);
    found.iter().filter(|j| !right(j)).for_each(|j| println!("{}", shown(j)));
    let share = found.iter().filter(right).count() as f64 / found.len() as f64;
    println!("right on {:.1} % of {}", 100.0 * share, found.len());
    assert!(found.iter().all(|j| j.traced), "every case can be traced");
    assert!(share >= NAMED, "{share}");
    // Effects raise no false alarm, and those of friction take away no verdict.
    let alarms = found.iter().filter(|j| j.f[0] == 0.0 && j.sticks == [false, true]);
    let of_friction = [Kind::SlipJump, Kind::AsymmetricFriction, Kind::FrictionDrift];
    let taken = found.iter().filter(|j| j.sticks == [true, false]);
    let taken = taken.filter(|j| j.named.iter().all(|kind| of_friction.contains(kind)));
    let wrong: Vec<String> = alarms.chain(taken).map(shown).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// 80.5 % of the published sweep, less two and a half standard errors of 86 cases.
const NAMED: f64 = 0.7;

#[test]
fn little_is_invented_where_nothing_is() {
    let found = parallel::each(clean(60, SEED), |case| judge(&case, false));
    let wrong: Vec<&Judged> = found.iter().filter(|j| !j.invented().is_empty()).collect();
    wrong.iter().for_each(|j| println!("{}", shown(j)));
    println!("invented on {} of {}", wrong.len(), found.len());
    assert!(wrong.len() <= INVENTED, "{}", wrong.len());
}

/// 5 % of 60 is 3; the chance of more than 6 at that rate is 3 %.
const INVENTED: usize = 6;

/// With a linear controller and a set point at rest the lags of OP follow from PV's, which those of another stem do not; and of loads
/// that are squares or triangles a few waves leave corners, which a stem that rests fits.
#[test]
fn little_is_invented_and_none_accused_on_loops_of_the_other_generator() {
    let found = parallel::each(0..220, |seed| (seed, traced(&random_sound(seed))));
    let quiet = nothing_hidden(0..220);
    let invented = found.iter().filter(|(seed, traced)| quiet.contains(seed) && !traced.named.is_empty());
    let invented: Vec<_> = invented.map(|(seed, traced)| (seed, &traced.named)).collect();
    println!("invented on {} of {}: {invented:?}", invented.len(), quiet.len());
    assert!(quiet.len() >= 80 && invented.len() <= INVENTED_THERE, "{}", invented.len());
    let accused: Vec<u64> =
        found.iter().filter(|(_, traced)| traced.sticks == [false, true]).map(|(seed, _)| *seed).collect();
    println!("accused by an effect: {accused:?} of {}", found.len());
    assert!(accused.len() <= ACCUSED, "{accused:?}");
}

/// 7 of 220 without the rivals, 1 with them.
const ACCUSED: usize = 2;

/// 5 % of 85 is 4; the chance of more than 8 at that rate is 3 %.
const INVENTED_THERE: usize = 8;

#[test]
fn the_error_after_is_that_of_a_fit_told_the_effect() {
    let kinds = [Kind::OscillatingLoad, Kind::MeasuredDisturbance, Kind::ValveSaturation];
    let found = parallel::each(half_of(&kinds), |case| judge(&case, true));
    let within = |j: &&Judged| j.told.is_some_and(|told| j.free[1] <= 1.1 * told);
    found.iter().filter(|j| !within(j)).for_each(|j| println!("told {:.4?}: {}", j.told, shown(j)));
    let share = found.iter().filter(within).count() as f64 / found.len() as f64;
    println!("within 10 % of a fit told the effect: {:.0} % of {}", 100.0 * share, found.len());
    assert!(share >= TOLD, "{share}");
}

/// 94 % of the published sweep, less two and a half standard errors of 18 cases.
const TOLD: f64 = 0.8;

#[test]
fn a_load_is_told_in_units_of_op() {
    for kind in LOADS {
        let some = half_of(&[kind]);
        let at_valve = some.iter().filter(|case| record(case).1.load.is_some()).count();
        let mut shares: Vec<f64> =
            parallel::each(some, |case| judge(&case, true)).iter().filter_map(|j| j.size).collect();
        assert!(shares.len() + 1 >= at_valve && at_valve > 2, "{kind}: {shares:?} of {at_valve}");
        shares.sort_by(f64::total_cmp);
        println!("{kind}, told of true: {shares:.2?}");
        let median = shares[shares.len() / 2];
        assert!((0.85..1.15).contains(&median), "{kind}: {median}");
        let near = shares.iter().filter(|share| (0.6..1.6).contains(*share)).count();
        assert!(4 * near >= 3 * shares.len(), "{kind}: {shares:?}");
    }
}

#[test]
fn friction_that_an_effect_hides_is_found_with_it() {
    let sticky: Vec<Case> =
        half_of(&[Kind::OscillatingLoad, Kind::Outliers]).into_iter().filter(|case| case.valve > 0).collect();
    let found = parallel::each(sticky, |case| judge(&case, false));
    let error = |at: usize| -> f64 { found.iter().map(|j| (j.f[at] - j.f[0]).abs() / j.f[0]).sum() };
    println!(
        "sum of the relative errors of f before {:.2}, after {:.2} on {}",
        error(1),
        error(2),
        found.len()
    );
    assert!(error(2) <= 1.05 * error(1), "{} {}", error(1), error(2));
}

#[test]
fn what_is_outside_the_list_is_unexplained_or_improves_the_prediction() {
    for undeclared in [Undeclared::Bursts, Undeclared::SensorBacklash] {
        let some = cases(undeclared, MEDIUM, SEED..SEED + 1).into_iter().step_by(3);
        for j in parallel::each(some, |case| judge(&case, false)) {
            let better = j.free[1] <= j.free[0] || j.one[1] < j.one[0];
            println!("{} unexplained {}", shown(&j), j.unexplained);
            assert!(j.named.is_empty() || better, "{}", shown(&j));
        }
    }
}
