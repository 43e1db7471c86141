//! From hand values over exact recovery to bounded error.

use super::*;
use crate::sysid::least_squares::dot;
use crate::sysid::zeros::{outward, zeros};
use nalgebra::DMatrix;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// Largest modulus of the zeros of `1 + c1 q^-1 + …`, from the companion matrix; `None` when the QR iteration
/// does not settle.
fn largest_zero(c: &[f64]) -> Option<f64> {
    let n = c.len();
    let mut companion = DMatrix::zeros(n, n);
    for (i, &c) in c.iter().enumerate() {
        companion[(0, i)] = -c;
        if i + 1 < n {
            companion[(i + 1, i)] = 1.0;
        }
    }
    let schur = nalgebra::linalg::Schur::try_new(companion, 1e-14, 10_000)?;
    Some(schur.complex_eigenvalues().iter().map(|z| z.norm()).fold(0.0, f64::max))
}

/// An input that excites everything: a square-like wave with random steps and its direction.
fn input(n: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut x = vec![0.0; n];
    let mut dir = vec![1.0; n];
    for k in 1..n {
        let moves = rng.random::<f64>() < 0.4;
        x[k] = if moves { 2.0 * rng.random::<f64>() - 1.0 } else { x[k - 1] };
        dir[k] = if x[k] == x[k - 1] { dir[k - 1] } else { (x[k] - x[k - 1]).signum() };
    }
    (x, dir)
}

/// The model run forward from rest.
fn forward(orders: Orders, theta: &Theta, x: &[f64], dir: &[f64], e: &[f64]) -> Vec<f64> {
    let mut y = vec![0.0; x.len()];
    for k in 0..x.len() {
        let mut value = theta.c0 + e[k];
        for i in 0..orders.na.min(k) {
            value -= theta.a[i] * y[k - 1 - i];
        }
        for j in 0..orders.nb {
            if let Some(at) = k.checked_sub(orders.nk + j) {
                value += theta.b[j] * (x[at] - theta.lag * dir[at]);
            }
        }
        for l in 0..orders.nc.min(k) {
            value += theta.c[l] * e[k - 1 - l];
        }
        y[k] = value;
    }
    y
}

const ORDERS: Orders = Orders { na: 2, nb: 2, nc: 2, nk: 3 };

/// Poles 0.8 and 0.6, zeros of C at 0.5 ± 0.3i.
fn truth() -> Theta {
    let mut theta = Theta { c0: 0.3, lag: 0.2, ..Theta::default() };
    theta.a[..2].copy_from_slice(&[-1.4, 0.48]);
    theta.b[..2].copy_from_slice(&[0.5, 0.2]);
    theta.c[..2].copy_from_slice(&[-1.0, 0.34]);
    theta
}

fn normal(n: usize, seed: u64, sd: f64) -> Vec<f64> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    StandardNormal.sample_iter(&mut rng).take(n).map(|e: f64| sd * e).collect()
}

#[test]
fn there_are_fifteen_splits_of_six() {
    let all: Vec<Orders> = splits(4).collect();
    assert_eq!(all.len(), 15);
    assert!(all.iter().all(|o| o.na >= 1 && o.nb >= 1 && o.na + o.nb + o.nc == 6 && o.nk == 4));
}

#[test]
fn the_loss_by_hand() {
    // y[k] - 0.5 y[k-1] - 2 x[k-1] = e[k] + 0.5 e[k-1], counted from the third sample on.
    let (y, x, dir) = ([1.0, 2.0, 4.0, 8.0, 5.0], [1.0, 0.0, 1.0, 2.0, 0.0], [1.0; 5]);
    let orders = Orders { na: 1, nb: 1, nc: 1, nk: 1 };
    let mut theta = Theta::default();
    (theta.a[0], theta.b[0], theta.c[0]) = (-0.5, 2.0, 0.5);
    let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 3, rows: Rows::default() };
    let mut work = Workspace::new(5);
    let loss = work.evaluate(&s, orders, &theta);
    // w = [., ., 3, 4, -3]; e = [0, 0, 3, 2.5, -4.25] (the recursion begins at start + 2 = 2).
    assert_eq!(work.errors(), [0.0, 0.0, 3.0, 2.5, -4.25]);
    assert_eq!(loss, (2.5 * 2.5 + 4.25 * 4.25) / 2.0);
}

#[test]
fn zeros_by_hand() {
    // (1 - 0.9 q^-1)(1 + 0.5 q^-1) = 1 - 0.4 q^-1 - 0.45 q^-2.
    assert!(is_inside(&[-0.4, -0.45], 0.91));
    assert!(!is_inside(&[-0.4, -0.45], 0.89));
    assert!(is_inside(&[], 0.5));
    assert!(!is_inside(&[f64::NAN, 0.1], 1.0));
    let mut c = [f64::INFINITY, 1.0];
    draw_inside(&mut c, RHO);
    assert_eq!(c, [0.0, 0.0]);
    let mut c = [-2.0];
    draw_inside(&mut c, RHO);
    // One zero at 2 is drawn to RHO, a millionth inside.
    assert!((c[0] + RHO).abs() < 2e-6 && c[0] > -RHO, "{}", c[0]);
    // Zeros at 2 and 0.5: the second stays.
    let mut c = [-2.5, 1.0];
    draw_inside(&mut c, RHO);
    assert!((c[0] + RHO + 0.5).abs() < 2e-6 && (c[1] - 0.5 * RHO).abs() < 2e-6, "{c:?}");
}

#[test]
fn a_noise_free_model_is_recovered_exactly() {
    let n = 600;
    let (x, dir) = input(n, 1);
    let theta = truth();
    let y = forward(ORDERS, &theta, &x, &dir, &vec![0.0; n]);
    let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 20, rows: Rows::default() };
    let mut start = Theta::default();
    start.a[0] = -0.5;
    start.b[0] = 0.3;
    let mut work = Workspace::new(n);
    let fit = work.minimise(&s, ORDERS, start, Lag::Free { max: 1.0 }, 1e-14, 200);
    // Without noise C is free; the rest is determined, and the loss ends where rounding does.
    assert!(fit.loss < 1e-18, "{}", fit.loss);
    let wanted = [theta.a[0], theta.a[1], theta.b[0], theta.b[1], theta.c0, theta.lag];
    let got = [fit.theta.a[0], fit.theta.a[1], fit.theta.b[0], fit.theta.b[1], fit.theta.c0, fit.theta.lag];
    for (got, wanted) in got.iter().zip(wanted) {
        assert!((got - wanted).abs() < 1e-6, "{got} {wanted}");
    }
}

#[test]
fn the_gradient_is_that_of_finite_differences() {
    let n = 400;
    let (x, dir) = input(n, 2);
    let y = forward(ORDERS, &truth(), &x, &dir, &normal(n, 3, 0.1));
    let s = Signals { y: &y, x: &x, dir: &dir, start: 2, first: 30, rows: Rows::default() };
    let mut theta = truth();
    theta.a[0] += 0.05;
    theta.b[1] -= 0.1;
    theta.c[0] += 0.2;
    theta.c0 += 0.05;
    theta.lag += 0.1;
    let free = Lag::Free { max: 10.0 };
    let mut work = Workspace::new(n);
    work.evaluate(&s, ORDERS, &theta);
    let gradient = work.normal_equations(&s, ORDERS, &theta, free);
    let rows = (n - s.first) as f64;
    let column = |work: &mut Workspace, i: usize, step: f64| -> Vec<f64> {
        let mut moved = theta;
        match i {
            0 | 1 => moved.a[i] += step,
            2 | 3 => moved.b[i - 2] += step,
            4 | 5 => moved.c[i - 4] += step,
            6 => moved.c0 += step,
            _ => moved.lag += step,
        }
        work.evaluate(&s, ORDERS, &moved);
        work.errors()[s.first..].to_vec()
    };
    // Central differences of step h err by h² and by 1e-16/h: 1e-5 makes both about 1e-10.
    let h = 1e-5;
    let jacobian: Vec<Vec<f64>> = (0..gradient.size)
        .map(|i| {
            let (up, down) = (column(&mut work, i, h), column(&mut work, i, -h));
            up.iter().zip(&down).map(|(u, d)| (u - d) / (2.0 * h)).collect()
        })
        .collect();
    let e = column(&mut work, 0, 0.0);
    assert_eq!(gradient.size, 8);
    for i in 0..gradient.size {
        let size = dot(&jacobian[i], &jacobian[i]).sqrt();
        let wanted = dot(&jacobian[i], &e);
        // The filters start at rest at `start`, the errors two lags later: their difference dies out with C,
        // whose zeros have modulus 0.6 and less, over the 25 samples before the first that counts: 0.6^25 = 3e-6.
        let bound = 1e-5 * size * (dot(&e, &e).sqrt() + size);
        assert!((gradient.jte[i] - wanted).abs() < bound, "{i}: {} {wanted}", gradient.jte[i] / rows);
        for (j, other) in jacobian[..=i].iter().enumerate() {
            let wanted = dot(&jacobian[i], other);
            let bound = 1e-5 * size * dot(other, other).sqrt();
            assert!((gradient.jtj[i][j] - wanted).abs() < bound, "{i} {j}: {} {wanted}", gradient.jtj[i][j]);
        }
    }
}

#[test]
fn a_noisy_model_is_recovered_within_its_standard_errors() {
    let (n, sd) = (4000, 0.1);
    let (mut worst, mut squares) = (0.0_f64, 0.0);
    let seeds = 20;
    for seed in 0..seeds {
        let (x, dir) = input(n, 100 + seed);
        let theta = truth();
        let y = forward(ORDERS, &theta, &x, &dir, &normal(n, 200 + seed, sd));
        let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 30, rows: Rows::default() };
        let mut work = Workspace::new(n);
        let mut start = Theta::default();
        start.a[0] = -0.5;
        let fit = work.minimise(&s, ORDERS, start, Lag::Free { max: 1.0 }, 1e-12, 100);
        // The innovations' variance, with a standard error of sqrt(2/N) = 2.2 %: five of them.
        assert!((fit.loss / (sd * sd) - 1.0).abs() < 0.11, "seed {seed}: {}", fit.loss);
        // At the minimum the normal equations give the covariance V (JᵀJ)⁻¹.
        work.evaluate(&s, ORDERS, &fit.theta);
        let normal = work.normal_equations(&s, ORDERS, &fit.theta, Lag::Free { max: 1.0 });
        let information = DMatrix::from_fn(8, 8, |i, j| normal.jtj[i.max(j)][i.min(j)] / fit.loss);
        let covariance = information.cholesky().expect("the input excites every coefficient").inverse();
        let list = |t: &Theta| [t.a[0], t.a[1], t.b[0], t.b[1], t.c[0], t.c[1], t.c0, t.lag];
        for (i, (got, wanted)) in list(&fit.theta).iter().zip(list(&theta)).enumerate() {
            let z = (got - wanted) / covariance[(i, i)].sqrt();
            worst = worst.max(z.abs());
            squares += z * z;
        }
    }
    let count = 8.0 * seeds as f64;
    // The largest of 160 normal values exceeds 4.5 once in a thousand times; the mean square of 160, correlated
    // within a seed, has a standard error below sqrt(2/20) = 0.32.
    assert!(worst < 4.5, "{worst}");
    assert!((0.4..1.7).contains(&(squares / count)), "{}", squares / count);
}

#[test]
fn a_zero_moves_out_as_its_derivative_says() {
    // Two conjugates at 0.9 e^(±i) beside a real zero at -0.5.
    let c = [0.5 - 1.8 * 1f64.cos(), 0.81 - 0.9 * 1f64.cos(), 0.405];
    for zero in &zeros(&c).expect("three zeros")[..3] {
        let mut row = [0.0; 3];
        outward(&c, *zero, &mut row);
        for l in 0..3 {
            let step = 1e-6;
            let mut moved = c;
            moved[l] += step;
            let moved = zeros(&moved).expect("three zeros");
            let nearest = moved[..3].iter().min_by(|a, b| (*a - zero).norm().total_cmp(&(*b - zero).norm()));
            let slope = (nearest.expect("three").norm() - zero.norm()) / step;
            assert!((slope - row[l]).abs() < 1e-4, "{zero}: {slope} {}", row[l]);
        }
    }
}

#[test]
fn on_the_bound_no_other_step_is_better() {
    // Differenced noise wants the zero of C at 1; with it held at RHO the rest must be the least squares of that C.
    let n = 2000;
    let (x, dir) = input(n, 3);
    let e = normal(n + 1, 3, 0.5);
    let mut y = vec![0.0; n];
    for k in 2..n {
        y[k] = 0.7 * y[k - 1] + 0.4 * x[k - 2] + e[k] - e[k - 1];
    }
    let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 30, rows: Rows::default() };
    let orders = Orders { na: 1, nb: 1, nc: 1, nk: 2 };
    let mut work = Workspace::new(n);
    let mut start = Theta::default();
    start.c[0] = -0.6;
    let fit = work.minimise(&s, orders, start, Lag::Fixed, 1e-9, 40);
    assert!(fit.theta.c[0] < -RHO * (1.0 - 1e-3), "{:?}", fit.theta);
    for (a, b, c0) in [
        (1e-3, 0.0, 0.0),
        (-1e-3, 0.0, 0.0),
        (0.0, 1e-3, 0.0),
        (0.0, -1e-3, 0.0),
        (0.0, 0.0, 1e-4),
        (0.0, 0.0, -1e-4),
    ] {
        let mut beside = fit.theta;
        beside.a[0] += a;
        beside.b[0] += b;
        beside.c0 += c0;
        assert!(work.evaluate(&s, orders, &beside) > fit.loss * (1.0 - 1e-7), "{a} {b} {c0}");
    }
}

#[test]
fn every_fit_keeps_c_inside() {
    let n = 300;
    for seed in 0..40 {
        let (x, dir) = input(n, seed);
        // Differenced noise puts the zeros of C on the unit circle, where the fit wants to go.
        let e = normal(n + 2, seed, 0.5);
        let y: Vec<f64> = (0..n).map(|k| e[k + 2] - 2.0 * e[k + 1] + e[k]).collect();
        let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 30, rows: Rows::default() };
        let mut work = Workspace::new(n);
        for orders in splits(1 + seed as usize % 10) {
            let fit = work.minimise(&s, orders, Theta::default(), Lag::Fixed, 1e-8, 40);
            assert!(is_inside(&fit.theta.c[..orders.nc], RHO), "{seed} {orders:?}");
            assert!(fit.loss.is_finite());
        }
    }
}

proptest! {
    #[test]
    fn inside_is_where_the_eigenvalues_say(c in prop::collection::vec(-2.5..2.5f64, 1..=4), radius in 0.3..1.2f64) {
        let largest = largest_zero(&c).expect("a companion matrix of order 4 settles");
        // A fourfold zero is known to 1e-16^(1/4) = 1e-4 only.
        prop_assume!((largest / radius - 1.0).abs() > 1e-3);
        prop_assert_eq!(is_inside(&c, radius), largest < radius);
    }

    #[test]
    fn drawn_c_is_inside_or_on_the_circle(c in prop::collection::vec(-1e3..1e3f64, 1..=4)) {
        let mut drawn = c.clone();
        draw_inside(&mut drawn, RHO);
        prop_assert!(is_inside(&drawn, RHO));
        let largest = largest_zero(&c).expect("a companion matrix of order 4 settles");
        if largest < RHO * (1.0 - 1e-3) {
            prop_assert_eq!(drawn, c);
        } else if largest > RHO * (1.0 + 1e-3) {
            // What was outside now lies on the circle, a multiple zero a little inside.
            prop_assert!(!is_inside(&drawn, RHO * (1.0 - 2e-3)), "{:?}", drawn);
        }
    }
}

#[test]
fn missing_samples_are_replaced_by_their_prediction_and_do_not_count() {
    let n = 600;
    let (x, dir) = input(n, 3);
    let theta = truth();
    let whole = forward(ORDERS, &theta, &x, &dir, &vec![0.0; n]);
    let (mut y, mut worth) = (whole.clone(), vec![Row::Counts; n]);
    for k in (100..n).filter(|k| k % 7 < 2) {
        (y[k], worth[k]) = (1e6, Row::Missing);
    }
    // Right, but said not to count: its error is left out, whatever it is.
    worth[300] = Row::Silent;
    let left_out: Vec<usize> = (20..n).filter(|k| worth[*k] != Row::Counts).collect();
    let rows = Rows { left_out: &left_out, worth: &worth };
    let s = Signals { y: &y, x: &x, dir: &dir, start: 0, first: 20, rows };
    let mut work = Workspace::new(n);
    // Without noise the predictions are the samples, to rounding.
    assert!(work.evaluate(&s, ORDERS, &theta) < 1e-20);
    assert!(work.filled.iter().zip(&whole).all(|(filled, y)| (filled - y).abs() < 1e-9));
    let mut start = theta;
    start.a[0] += 0.05;
    start.b[0] *= 1.1;
    let fit = work.minimise(&s, ORDERS, start, Lag::Fixed, 1e-14, 200);
    assert!(fit.loss < 1e-16, "{}", fit.loss);
    assert!((fit.theta.a[0] - theta.a[0]).abs() < 1e-5 && (fit.theta.b[0] - theta.b[0]).abs() < 1e-5);
}
