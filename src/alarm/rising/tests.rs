use super::*;
use rand::RngExt;
use rand::SeedableRng;
use rand_distr::StandardNormal;
use rand_pcg::Pcg32;

const DAY: f64 = 86_400.0;

#[test]
fn quantiles_are_those_of_the_tables() {
    // Tables of t, one-sided 0.999.
    for (free, table) in [(4.0, 7.173), (6.0, 5.208), (10.0, 4.144), (20.0, 3.552), (30.0, 3.385)] {
        assert!((student(free) / table - 1.0).abs() < 0.01, "{free}: {} is not {table}", student(free));
    }
}

#[test]
fn a_point_is_the_mean_and_its_error_the_larger_of_two() {
    let mut point = Point::default();
    [(0.0, 1.0), (10.0, 3.0)].into_iter().for_each(|(t, f)| point.add(t, f, 0.25));
    assert_eq!((point.t, point.f, point.variance, point.scatter), (5.0, 2.0, 0.25, 2.0));
    // Scatter 2 / (2 - 1) / 2 = 1 is more than 0.25.
    assert_eq!(point.error(), 1.0);
}

#[test]
fn a_line_without_noise_is_found_exactly() {
    let config = RisingConfig::default();
    let mut trend = Trend::default();
    for day in 0..12 {
        let f = 1.0 + 0.1 * f64::from(day);
        trend.take(f, [f - 0.1, f + 0.1], f64::from(day) * DAY, &config);
    }
    let line = trend.line(&config).expect("twelve points");
    assert!((line.rise - 1.1).abs() < 1e-9 && line.span_s == 11.0 * DAY, "{line:?}");
    // sd = 0.1 / 1.96; sum of (t - mean)^2 over eleven steps of 1/11 is 143 / 121; r = (0 + 1) / 8 at most for a line
    // without residuals, whose numerical noise has no autocorrelation that could be told beforehand.
    let least = student(10.0) * 0.1 / CI95 / (143.0f64 / 121.0).sqrt();
    assert!(line.low < 1.1 - least + 1e-9 && line.low > 1.1 - 5.0 * least, "{line:?}, {least}");
}

#[test]
fn nonsense_is_no_observation() {
    let config = RisingConfig::default();
    let mut trend = Trend::default();
    for (f, interval, t) in [
        (f64::NAN, [0.0, 1.0], 0.0),
        (1.0, [1.0, 0.0], 0.0),
        (1.0, [0.0, f64::INFINITY], 0.0),
        (1.0, [0.0, 1.0], f64::NAN),
    ] {
        assert_eq!(trend.take(f, interval, t, &config), Observation::Unknown);
    }
    assert!(trend.saved().is_empty());
    assert!(Trend::restored(vec![Point { t: f64::NAN, ..Point::default() }]).saved().is_empty());
}

/// Days of six diagnoses with errors that are as wide as their intervals say, and on top of them a wandering of the plant's own
/// from day to day with autocorrelation `phi`. On how many days the line rises.
fn days(seed: u64, n: usize, slope_per_day: f64, wander: f64, phi: f64) -> (usize, Option<usize>) {
    let config = RisingConfig::default();
    let mut random = Pcg32::seed_from_u64(seed);
    let mut trend = Trend::default();
    let (mut level, mut rising, mut first) = (0.0, 0, None);
    for day in 0..n {
        let own: f64 = random.sample(StandardNormal);
        level = phi * level + wander * (1.0 - phi * phi).sqrt() * own;
        for part in 0..6 {
            let noise: f64 = random.sample(StandardNormal);
            let f = 2.0 + slope_per_day * day as f64 + level + 0.1 * noise;
            let half = 0.1 * CI95;
            if trend.take(f, [f - half, f + half], (day as f64 + f64::from(part) / 6.0) * DAY, &config)
                == Observation::Present
            {
                rising += 1;
                first.get_or_insert(day);
            }
        }
    }
    (rising, first)
}

/// The numbers that docs/alarms.md has; seeds are fixed, so each is exact.
#[test]
fn noise_does_not_rise() {
    let fooled = |phi| (0..150).filter(|seed| days(1000 + seed, 365, 0.0, 0.2, phi).0 > 0).count();
    let counts = [0.0, 0.6, 0.8].map(fooled);
    println!(
        "raised in so many of 150 loop-years of noise, white and with autocorrelations of 0.6 and 0.8: {counts:?}"
    );
    // Wandering with a memory of many days is what a straight line is most easily fooled by.
    assert_eq!(counts, [0, 2, 19]);
}

/// Likewise.
#[test]
fn a_valve_that_gets_worse_is_noticed_in_time() {
    let told = |slope: f64, seeds: u64| {
        let mut on: Vec<usize> =
            (0..40).filter_map(|seed| days(seeds + seed, 60, slope, 0.1, 0.0).1).collect();
        on.sort_unstable();
        // The first day is day 0.
        (on.len(), on.get(19).map(|day| day + 1), on.last().map(|day| day + 1))
    };
    let (fast, slow) = (told(0.04, 2000), told(0.02, 3000));
    println!(
        "of 40 valves that get worse by 0.04 % and by 0.02 % a day: told, half of them by day, the last by day: {fast:?} {slow:?}"
    );
    assert_eq!((fast.0, fast.2, slow.0), (40, Some(34), 40));
    assert!(slow.1.is_some_and(|day| day <= 36), "{slow:?}");
}

#[test]
fn points_of_a_clock_that_was_ahead_blind_nobody_to_what_comes() {
    let config = RisingConfig::default();
    let mut trend = Trend::default();
    let mut say = |day: f64| {
        let f = 1.0 + 0.1 * day;
        trend.take(f, [f - 0.01, f + 0.01], day * DAY, &config);
    };
    // Two days of another century, and back.
    for day in (0..12).chain(40_000..40_002).chain(12..20) {
        say(f64::from(day));
    }
    let days: Vec<f64> = trend.saved().iter().map(|point| point.t / DAY).collect();
    assert_eq!(days, (0..20).map(f64::from).collect::<Vec<_>>());
}
