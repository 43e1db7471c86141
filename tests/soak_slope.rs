//! The slope by which `scripts/soak` judges whether memory grows.

#[path = "../examples/soak/slope.rs"]
mod slope;

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;
use slope::{Judged, Slope, median};

/// What recurs, as in a run of two hours (s).
const ROUND: f64 = 1800.0;

/// A look every 10 s from half an hour to `hours`: what grows by so much in an hour, with what recurs, spikes, and noise of each
/// part of ten minutes.
fn looks(growth: f64, hours: f64, noise: impl Fn(usize) -> f64) -> Vec<(f64, f64)> {
    let times = (180..).map(|look| 10.0 * f64::from(look)).take_while(|t| *t < 3600.0 * hours);
    let value = |t: f64| {
        let away = if t % ROUND < 240.0 { 30.0 } else { 0.0 };
        let spike = if t % 290.0 < 10.0 { 80.0 } else { 0.0 };
        let level = 100.0 + 5.0 * (t % ROUND / 600.0).floor();
        level + growth * t / 3600.0 + away + spike + noise((t / 600.0) as usize)
    };
    times.map(|t| (t, value(t))).collect()
}

#[test]
fn what_recurs_and_spikes_are_no_slope() {
    for growth in [-2.0, 0.0, 5.7] {
        let slope = Slope::of(&looks(growth, 2.0, |_| 0.0), ROUND);
        // Spikes are at other places of each round, so that the middle one is another look.
        assert!((slope.per_hour - growth).abs() < 0.1, "{growth}: {slope:?}");
        assert!(slope.half_width < 0.2, "{growth}: {slope:?}");
    }
}

#[test]
fn an_interval_holds_the_truth_in_95_of_100_cases() {
    let normal = Normal::new(0.0, 3.0).expect("a width");
    let held = (0..1000).filter(|seed| {
        let mut random = Pcg64Mcg::seed_from_u64(*seed);
        let noise: Vec<f64> = (0..20).map(|_| normal.sample(&mut random)).collect();
        let [low, high] = Slope::of(&looks(1.0, 2.0, |part| noise[part]), ROUND).interval();
        (low..=high).contains(&1.0)
    });
    let held = held.count();
    // Three deviations of such a count.
    assert!((929..=971).contains(&held), "{held} of 1000");
}

/// The bound holds for three of them, and each says something else of it.
#[test]
fn what_a_slope_means_for_its_bound_is_said() {
    for (per_hour, half_width, judged, said) in [
        (0.4, 0.5, Judged::Holds, "a growth above 1 MB/h is ruled out at 95 %"),
        (0.5, 0.75, Judged::Holds, "not proven, and one of up to 1.25 MB/h is not ruled out"),
        (2.0, 6.0, Judged::Holds, "not proven, and one of up to 8.00 MB/h is not ruled out"),
        (7.5, 6.0, Judged::Broken, "a growth above 1 MB/h is proven at 95 %: it is 1.50 MB/h or more"),
        (0.0, f64::INFINITY, Judged::TooShort, "nothing is known"),
    ] {
        let slope = Slope { per_hour, half_width };
        assert_eq!(slope.judged(1.0), judged, "{slope:?}");
        let meaning = slope.meaning(1.0, "MB/h");
        assert!(meaning.contains(said), "{slope:?}: {meaning}");
    }
}

#[test]
fn what_is_too_short_is_not_judged() {
    // A part of each place, and one more.
    let slope = Slope::of(&looks(0.0, 1.0 + 1.0 / 6.0, |_| 0.0), ROUND);
    assert!(slope.per_hour.abs() < 1e-6 && slope.half_width.is_infinite(), "{slope:?}");
    let none = Slope::of(&[], ROUND);
    assert!(none.per_hour.is_nan());
    for short in [slope, none] {
        // Not even of a bound that everything would keep.
        let judged = short.judged(f64::INFINITY);
        assert_eq!(judged, Judged::TooShort);
        assert!(judged.to_string().contains("the run was too short"), "{judged}");
    }
    for (growth, judged, said) in [(0.0, Judged::Holds, "holds"), (5.7, Judged::Broken, "BROKEN")] {
        let slope = Slope::of(&looks(growth, 2.0, |_| 0.0), ROUND);
        assert_eq!((slope.judged(1.0), slope.judged(1.0).to_string().as_str()), (judged, said), "{slope:?}");
    }
    assert!(median([]).is_nan());
    assert!((median([3.0, 1.0, 2.0]) - 2.0).abs() < 1e-12);
}
