use super::*;
use crate::diagnosis::friction::{Start, largest_reversal, stick_slip};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

const MAX_DELAY: usize = 10;

fn noise(n: usize, seed: u64, sd: f64) -> Vec<f64> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    StandardNormal.sample_iter(&mut rng).take(n).map(|e: f64| sd * e).collect()
}

/// A wandering OP of unit spread.
fn wander(n: usize, seed: u64) -> Vec<f64> {
    let mut level = 0.0;
    let mut step = |e| {
        level = 0.9 * level + e;
        level
    };
    noise(n, seed, 0.45).into_iter().map(&mut step).collect()
}

/// The first-order answer of y to the stem and a load at the output's rate.
fn problem(u: Vec<f64>, stem: &[f64], load: &[f64]) -> Problem {
    let mut y = vec![0.0; u.len()];
    for k in 1..u.len() {
        y[k] = 0.8 * y[k - 1] + 0.3 * stem[k - 1] + load[k];
    }
    let start = Start { index: 0, is_max: true };
    let f_top = largest_reversal(&u, start);
    Problem {
        u,
        y,
        start,
        first: Screen::lead(MAX_DELAY),
        max_delay: MAX_DELAY,
        f_top,
        holes: Default::default(),
    }
}

fn rated(p: &Problem) -> Vec<Rated> {
    // A sticky model that is no better than the sound one: gains are then those over the linear loop.
    rate(p, &|u| u.to_vec(), None)
}

fn gain(rated: &[Rated], wanted: impl Fn(&Rival) -> bool) -> f64 {
    rated.iter().filter(|r| wanted(&r.rival)).map(|r| r.gain).fold(f64::INFINITY, f64::min)
}

#[test]
fn the_linear_loop_gains_nothing_over_itself() {
    let u = wander(800, 1);
    let p = problem(u.clone(), &u, &noise(800, 2, 0.05));
    assert_eq!(gain(&rated(&p), |r| *r == Rival::Linear), 0.0);
}

#[test]
fn a_fit_with_more_columns_is_least_squares() {
    let u = wander(500, 3);
    let p = problem(u.clone(), &u, &noise(500, 4, 0.1));
    let extra = harmonic_columns(&p, 0.3, 2);
    let got = Fitter::new(&p, &p.u).loss(extra.clone());
    let (n, nx) = (p.y.len(), Screen::input_lags(MAX_DELAY));
    let column = |v: &[f64], lag: usize| -> Vec<f64> { v[p.first - lag..n - lag].to_vec() };
    let columns: Vec<nalgebra::DVector<f64>> = (1..=LONG_Y)
        .map(|l| column(&p.y, l))
        .chain((1..=nx).map(|l| column(&p.u, l)))
        .chain([vec![1.0; n - p.first]])
        .chain(extra)
        .map(nalgebra::DVector::from_vec)
        .collect();
    let matrix = nalgebra::DMatrix::from_columns(&columns);
    let y = nalgebra::DVector::from_vec(column(&p.y, 0));
    let projected = matrix.qr().q().transpose() * &y;
    let wanted = (y.norm_squared() - projected.norm_squared()) / y.len() as f64;
    // Normal equations of a condition below 1e6 lose half the digits.
    assert!((got / wanted - 1.0).abs() < 1e-8, "{got} {wanted}");
}

#[test]
fn sines_and_cosines_together_are_those_alone_to_the_last_bit() {
    let bits = |v: &[f64]| v.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
    for (n, w) in [(60, 0.013), (61, 0.9), (573, 0.113), (1534, 0.0778)] {
        let u = wander(n, 8);
        let p = problem(u.clone(), &u, &vec![0.0; n]);
        let columns = harmonic_columns(&p, w, 40);
        assert_eq!(columns.len(), 80);
        for (i, column) in columns.iter().enumerate() {
            let w = w * (i / 2 + 1) as f64;
            let alone = |of: fn(f64) -> f64| (p.first..n).map(|k| of(w * k as f64)).collect::<Vec<f64>>();
            let plain = alone(if i % 2 == 0 { f64::sin } else { f64::cos });
            assert_eq!(bits(column), bits(&plain), "{n} {w} {i}");
        }
    }
}

#[test]
fn a_periodic_load_is_found_with_its_period() {
    for (seed, period) in [(5, 37.3), (6, 60.0), (7, 111.7)] {
        let n = 1200;
        let u = wander(n, seed);
        let square = |k: usize| if (k as f64 / period).fract() < 0.5 { 0.3 } else { -0.3 };
        let load: Vec<f64> =
            noise(n, seed + 10, 0.05).iter().enumerate().map(|(k, e)| e + square(k)).collect();
        let rated = rated(&problem(u.clone(), &u, &load));
        let found = rated.iter().find_map(|r| match r.rival {
            Rival::OscillatingLoad { period, harmonics } => Some((period, harmonics, r.gain)),
            _ => None,
        });
        let (found, harmonics, gain) = found.expect("a comb is always tried");
        // A line in n samples is known to a small part of a bin, period²/n; the golden section goes on from there.
        assert!((found - period).abs() < 0.1 * period * period / n as f64, "{found} for {period}");
        // A square has odd harmonics: at least the fifth has to be there to be called one.
        assert!(harmonics >= 5, "{harmonics}");
        // Ten times the evidence that a verdict asks for.
        assert!(gain < -200.0, "{gain} at {period}");
    }
}

#[test]
fn a_clip_is_found_with_its_levels() {
    for (seed, low, high) in [(20, -0.5, 0.7), (21, -5.0, 0.4), (22, -0.3, 0.3)] {
        let n = 1000;
        let u = wander(n, seed);
        let stem: Vec<f64> = u.iter().map(|u| u.max(low).min(high)).collect();
        let p = problem(u.clone(), &stem, &noise(n, seed + 10, 0.01));
        let (loss, bounds) = clipped(&p);
        let (least, most) = range(&u);
        // A narrower clip and a larger gain of B nearly make up for each other: levels are known to 2 % of the range.
        let close = (most - least) / 50.0;
        assert!((bounds[0] - low.max(least)).abs() < close, "{bounds:?} for {low} {high}");
        assert!((bounds[1] - high.min(most)).abs() < close, "{bounds:?} for {low} {high}");
        // The noise is what is left: a standard error of sqrt(2/N) and the grid's own error.
        assert!((loss / 1e-4 - 1.0).abs() < 0.3, "{loss}");
        // Friction where there is none, behind the same clip or not, is far worse: ten times the asked evidence.
        let sticky = |u: &[f64]| {
            let (mut x, mut dir) = (vec![0.0; u.len()], vec![0.0; u.len()]);
            stick_slip(u, 0.3, 0.0, p.start, &mut x, &mut dir);
            x
        };
        let against_friction = gain(&rate(&p, &sticky, None), |r| *r == Rival::ClippedValve);
        assert!(against_friction < -200.0, "{against_friction}");
    }
}

#[test]
fn a_recurring_load_of_any_shape_is_found() {
    let (n, period) = (1200, 83);
    let shape = noise(period, 30, 0.3);
    let u = wander(n, 31);
    // The shape comes back, its size drifting by a half: no comb of fixed lines.
    let load: Vec<f64> = (0..n).map(|k| shape[k % period] * (1.0 + 0.5 * k as f64 / n as f64)).collect();
    let p = problem(u.clone(), &u, &load);
    let rated = rate(&p, &|u| u.to_vec(), Some(period as f64));
    let best =
        gain(&rated, |r| matches!(r, Rival::RecurringLoad { period: p } if p.abs_diff(period) <= REACH));
    // One period back the load is known to a few per cent: the residual falls at least tenfold in variance.
    assert!(best < -(n as f64) * 0.5 * 10.0_f64.ln(), "{best}");
}
