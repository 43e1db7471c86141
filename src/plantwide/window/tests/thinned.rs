//! What is told of records with more samples than there are rows, and of those that have hardly more.

use super::*;
use crate::indicators::Indicators;
use crate::plantwide::LoopFound;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

/// White noise.
fn noise(seed: u64, samples: usize) -> Vec<f64> {
    StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(samples).collect()
}

/// OP and PV so far apart (s).
fn record(ts: f64, samples: usize, op: impl Fn(usize) -> f64, pv: impl Fn(usize) -> f64) -> Record {
    let series =
        |of: &dyn Fn(usize) -> f64| (0..samples).map(|k| Sample::good(ts * k as f64, of(k))).collect();
    Record { op: series(&op), pv: series(&pv), ..Record::default() }
}

#[test]
fn samples_that_are_nearly_as_few_as_rows_stay_as_they_are() {
    // As rows a little further apart they would lose up to a third of the noise.
    for (ts, samples) in [(1.0, 4096), (1.0, 4500), (0.2, 4096), (0.2, 4300)] {
        let pv = noise(1, samples);
        let record = record(ts, samples, |k| 50.0 - pv[k], |k| pv[k]);
        let whole = of_record("FIC1", &record, 4096).expect("samples");
        // That of the latest hour, which these samples do not fill at 0.2 s.
        let recent = recent("FIC1", &record, 3600.0, 3600).expect("samples");
        for (of, least) in [(&whole, samples - 1), (&recent, 3600)] {
            let w = &of.window;
            assert!((w.ts - ts).abs() < 1e-9 && w.len() >= least, "{ts} {samples}: {} {}", w.ts, w.len());
            let own = |k: usize| pv[((w.t0 + k as f64 * w.ts) / ts).round() as usize];
            assert!((0..w.len()).all(|k| (w.pv[k] - own(k)).abs() < 1e-6), "{ts} {samples}");
            assert_eq!((of.raw, of.pv_blurred, of.op_blurred), (None, false, false));
        }
    }
    // An hour at 0.2 s is more than its rows.
    let long = record(0.2, 30_000, |k| (0.01 * k as f64).sin(), |k| (0.01 * k as f64).cos());
    let of = |record| recent("FIC1", record, 3600.0, 3600).expect("samples");
    assert_eq!((of(&long).window.ts, of(&long).window.len()), (1.0, 3600));
    // Rows of a second would hide that a loop at rest is mostly noise.
    let pv = noise(4, 30_000);
    let rest = of(&record(0.2, 30_000, |k| 50.0 - pv[k], |k| pv[k]));
    assert!((rest.window.ts - 0.2).abs() < 1e-9 && !rest.pv_blurred, "{}", rest.window.ts);
    assert_eq!(rest.window.len(), 3600);
}

#[test]
fn causes_are_told_by_the_noise_of_the_samples_however_many_there_are() {
    let (op, pv) = (noise(2, 20_000), noise(3, 20_000));
    let slow = |k: usize| 2.0 * (TAU * k as f64 / 1000.0).sin();
    let record = record(1.0, 20_000, |k| 50.0 - slow(k) + 0.5 * op[k], |k| slow(k) + pv[k]);
    // The same in 4,096 rows of five samples, and as it was sampled.
    let thinned = analyse(&Rings(record.clone()));
    let whole = analyse(&vec![of_record("FIC1", &record, usize::MAX).expect("samples")]);
    let (thinned, whole) = (&thinned.loops[0], &whole.loops[0]);
    assert!(whole.recent.is_none() && whole.indicators.kept.noise_share > 0.25);
    // Steps, noise and effort.
    for sign in [1, 2, 13] {
        let (own, expected) = (thinned.signs[sign], whole.signs[sign]);
        assert!((own - expected).abs() < 1e-6, "{sign}: {own} {expected}");
    }
    let share = |of: &LoopFound| of.indicators.kept.noise_share;
    assert!((share(thinned) - share(whole)).abs() < 1e-6);
    // The Harris index and a stuck valve are those of the latest 3,600 samples, here and in the score.
    let recent = thinned.recent.as_ref().expect("it is thinned");
    let told = |of: &Indicators| (of.harris, of.stuck);
    assert_eq!(told(&thinned.indicators), told(recent));
    assert!(recent.stuck.is_some());
    let index = |of: &LoopFound| of.indicators.harris.expect("long enough").index;
    assert!((index(thinned) - index(whole)).abs() < 0.06, "{} {}", index(thinned), index(whole));
    assert_eq!((thinned.signs[8], thinned.signs[11]), (recent.stuck.unwrap_or(1.0), index(thinned)));
}

#[test]
fn an_op_that_is_too_fast_for_the_rows_does_not_hide_what_pv_does() {
    // OP has a cycle of 7 s, PV one of 1,000 s.
    let fast = |k: usize| 50.0 + 5.0 * (TAU * k as f64 / 7.0 + 0.3).sin();
    let slow = |k: usize| 5.0 * (TAU * k as f64 / 1000.0).sin();
    let of = |op: &dyn Fn(usize) -> f64, pv: &dyn Fn(usize) -> f64| -> PlantLoop {
        of_record("FIC1", &record(1.0, 30_000, op, pv), 4096).expect("samples")
    };
    let mut transforms = Transforms::new();
    let mut told = |of: &PlantLoop| {
        let found = health(of, &mut transforms);
        let known =
            [found.error.is_some(), found.harris.is_some(), found.swing.is_some(), found.score.is_some()];
        (of.pv_blurred, of.op_blurred, known, found.stuck.is_some())
    };
    assert_eq!(told(&of(&fast, &slow)), (false, true, [true; 4], false));
    assert_eq!(told(&of(&slow, &fast)), (true, false, [false; 4], false));
    assert_eq!(told(&of(&slow, &slow)), (false, false, [true; 4], true));
}

#[test]
fn one_zero_of_a_logger_is_no_stroke_of_the_valve() {
    let moves = |k: usize| 50.0 + 10.0 * (0.01 * k as f64).sin();
    let one = |k: usize| if k == 1000 { 0.0 } else { moves(k) };
    let mut record = record(1.0, 3000, one, |k| (0.01 * k as f64).cos());
    record.op_limits = Some((0.0, 100.0));
    let of = of_record("FIC1", &record, 4096).expect("samples");
    let least = of.window.op.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(least > 39.9, "{least}");
}
