use super::*;
use crate::diagnosis::armax::{Fit, Orders, Theta};
use crate::diagnosis::friction::{Cell, Start};
use crate::diagnosis::search::Holes;
use crate::signal::{Row, Window};

#[test]
fn a_gain_in_one_block_is_not_steady_and_one_in_all_is() {
    let sticky: Vec<f64> = (0..1000).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
    let scaled = |by: &dyn Fn(usize) -> f64| -> Vec<f64> {
        sticky.iter().enumerate().map(|(k, e)| e * by(k)).collect()
    };
    // All in one of ten blocks: mean m/10, standard error m/10, so exactly 1.
    let once = scaled(&|k| if k < 100 { 3.0 } else { 1.0 });
    assert!((steadiness(&once, &sticky) - 1.0).abs() < 1e-9);
    let shared = scaled(&|k| 1.5 + 0.1 * ((k / 100) % 2) as f64);
    assert!(steadiness(&shared, &sticky) > 10.0);
    assert!(steadiness(&sticky, &shared) < -10.0);
    assert_eq!(steadiness(&sticky, &sticky), 0.0);
    assert_eq!(steadiness(&[], &[]), 0.0);
}

#[test]
fn rows_that_do_not_count_change_no_steadiness() {
    // Seven rows of ten do not count, so that most errors are blanked.
    let counts = |k: &usize| k % 10 < 3;
    let worth = |k: usize| if counts(&k) { Row::Counts } else { Row::Silent };
    let window = Window { rows: (0..1000).map(worth).collect(), ..Window::default() };
    let p = Problem {
        u: vec![0.0; 1000],
        y: vec![0.0; 1000],
        start: Start { index: 0, is_max: false },
        first: 100,
        max_delay: 1,
        f_top: 1.0,
        holes: Holes::of(&window, 100),
    };
    let sticky: Vec<f64> = (100..1000).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
    let sound: Vec<f64> =
        sticky.iter().enumerate().map(|(k, e)| e * (1.5 + 0.1 * ((k / 90) % 2) as f64)).collect();
    let of_counted = |errors: &[f64]| -> Vec<f64> {
        errors.iter().zip(100..).filter(|(_, k)| counts(k)).map(|(e, _)| *e).collect()
    };
    let expected = steadiness(&of_counted(&sound), &of_counted(&sticky));
    let blanked = [&sound, &sticky].map(|errors| {
        let mut errors = errors.clone();
        p.blank(&mut errors);
        errors
    });
    let orders = Orders { na: 1, nb: 1, nc: 4, nk: 1 };
    let fit = Fit { orders, theta: Theta::default(), loss: 1.0, iterations: 1 };
    let cell = Cell { lo: 0.0, hi: 0.5 };
    let model = Refined { cell, resume: 0.0, f: 0.25, fit, long_loss: 1.0, long_lag: 0.0 };
    let found = weigh(&p, &model, &model, [&blanked[0], &blanked[1]], None, f64::INFINITY);
    assert!(expected > 10.0 && (found.steadiness - expected).abs() < 1e-9, "{} {expected}", found.steadiness);
}

#[test]
fn the_interval_is_the_hull_of_the_likely_cells_and_a_step() {
    let n = 200;
    let u: Vec<f64> = (0..n).map(|k| if k % 2 == 0 { 0.0 } else { 0.25 }).collect();
    let start = Start { index: 0, is_max: false };
    let p = Problem {
        u: u.clone(),
        y: u,
        start,
        first: 100,
        max_delay: 1,
        f_top: 4.0,
        holes: Default::default(),
    };
    // 100 rows: LR = 100 ln V/V0, 7.35 at a loss 7.6 % above.
    let at = |lo: f64, hi: f64, loss: f64| CellPoint { cell: Cell { lo, hi }, resume: 0.0, loss, lag: 0.0 };
    let cells = [
        at(0.0, 0.5, 9.0),
        at(0.5, 1.0, 1.07),
        at(1.0, 1.5, 1.0),
        at(1.5, 2.0, 1.5),
        at(2.0, 3.0, 1.05),
        at(3.0, f64::INFINITY, 1.08),
    ];
    let fit = Fit {
        orders: Orders { na: 1, nb: 1, nc: 4, nk: 1 },
        theta: Theta::default(),
        loss: 1.0,
        iterations: 1,
    };
    let sticky = Refined { cell: cells[2].cell, resume: 0.0, f: 1.25, fit, long_loss: 1.0, long_lag: 0.0 };
    let [low, high] = interval(&p, &cells, &sticky);
    assert!((low - 0.25).abs() < 1e-12 && (high - 3.25).abs() < 1e-12, "{low} {high}");
}
