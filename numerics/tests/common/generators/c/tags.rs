//! Recorded tags that have nothing to do with the loop.

use std::f64::consts::TAU;

use super::draw::{Draw, lagged};

/// Number of kinds of tags.
const KINDS: usize = 9;
/// First letters of tags' names.
const LETTERS: [&str; 6] = ["TI", "PI", "FI", "LI", "AI", "SI"];

/// Draws `count` tags beside a loop whose recorded PV is `pv`.
pub fn draw_tags(count: usize, pv: &[f64], draw: &mut Draw) -> Vec<(String, Vec<f64>)> {
    let first = draw.whole(0, KINDS - 1);
    (0..count)
        .map(|i| {
            let mut values = shape((first + i) % KINDS, pv, draw);
            let (mean, scale) = (draw.even(10.0, 90.0), draw.log(0.2, 8.0));
            values.iter_mut().for_each(|v| *v = mean + scale * *v);
            let name = LETTERS[draw.whole(0, LETTERS.len() - 1)];
            (format!("{name}{}", 100 * (i + 1) + draw.whole(0, 99)), values)
        })
        .collect()
}

/// A signal of about unit size.
fn shape(kind: usize, pv: &[f64], draw: &mut Draw) -> Vec<f64> {
    let n = pv.len();
    let length = n as f64;
    match kind {
        0 => draw.white(n),
        1 => {
            let tau = draw.log(3.0, 40.0);
            draw.coloured(n, tau)
        }
        2 => {
            let tau = draw.log(150.0, 800.0);
            let wander = draw.coloured(n, tau);
            noisy(wander, 0.03, draw)
        }
        3 => {
            let wave = wave(n, draw).into_iter().map(f64::sin).collect();
            noisy(wave, 0.1, draw)
        }
        4 => {
            let square = wave(n, draw).into_iter().map(|phase| phase.sin().signum()).collect();
            noisy(square, 0.05, draw)
        }
        5 => {
            let steps = draw.steps(n, length / 5.0);
            noisy(steps, 0.02, draw)
        }
        // OP of another loop that cycles: near a triangle.
        6 => {
            let triangle = wave(n, draw).into_iter().map(|phase| phase.sin().asin() / TAU * 4.0).collect();
            noisy(triangle, 0.05, draw)
        }
        // PV of another loop that cycles: a rounded square.
        7 => {
            let square: Vec<f64> = wave(n, draw).into_iter().map(|phase| phase.sin().signum()).collect();
            let tau = draw.even(1.0, 6.0);
            noisy(lagged(&square, tau), 0.05, draw)
        }
        _ => follower(pv, draw),
    }
}

/// The phase of an oscillation whose period wanders a little (rad).
fn wave(n: usize, draw: &mut Draw) -> Vec<f64> {
    let period = draw.log(12.0, 200.0);
    let wander = draw.even(0.0, 0.15);
    let pace = draw.coloured(n, 3.0 * period);
    let mut phase = draw.even(0.0, TAU);
    pace.into_iter()
        .map(|pace| {
            phase += TAU / period * (1.0 + wander * pace);
            phase
        })
        .collect()
}

fn noisy(values: Vec<f64>, sd: f64, draw: &mut Draw) -> Vec<f64> {
    values.into_iter().map(|v| v + sd * draw.normal()).collect()
}

/// A tag that follows PV with a lag and noise.
fn follower(pv: &[f64], draw: &mut Draw) -> Vec<f64> {
    let tau = draw.log(2.0, 25.0);
    let behind = lagged(pv, tau);
    let mean = behind.iter().sum::<f64>() / behind.len() as f64;
    let sd = super::draw::deviation(&behind).max(1e-6);
    let noise = draw.even(0.05, 0.5);
    let sign = draw.sign();
    let scaled = behind.into_iter().map(|v| sign * (v - mean) / sd).collect();
    noisy(scaled, noise, draw)
}
