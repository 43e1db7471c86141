//! Signals that oscillate or do not, of all kinds that a controller's output may be; the oscillation's period is known.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

pub struct Wave {
    pub x: Vec<f64>,
    /// Period (samples); none where nothing oscillates.
    pub period: Option<f64>,
    /// Power of the oscillation over that of everything else that is as fast or faster.
    pub clear: f64,
}

fn uniform(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

fn log_uniform(rng: &mut Pcg64Mcg, low: f64, high: f64) -> f64 {
    uniform(rng, low.ln(), high.ln()).exp()
}

fn normal(rng: &mut Pcg64Mcg) -> f64 {
    StandardNormal.sample(rng)
}

/// A signal by its seed; every second one oscillates.
pub fn draw(seed: u64) -> Wave {
    let rng = &mut Pcg64Mcg::new(u128::from(seed).wrapping_mul(0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835));
    let n = log_uniform(rng, 200.0, 6000.0) as usize;
    let oscillates = seed % 2 == 1;
    let most = (n as f64 / if rng.random::<f64>() < 0.2 { 3.0 } else { 6.0 }).min(300.0);
    let period = n as f64 / log_uniform(rng, 3.0, most);
    let fast = background(rng, n, period, oscillates);
    let slow = drift(rng, n, oscillates);
    let mut x: Vec<f64> = fast.iter().zip(&slow).map(|(a, b)| a + b).collect();
    let mut clear = 0.0;
    if oscillates {
        let wave = if rng.random::<f64>() < 0.2 { ringing(rng, n, period) } else { wave(rng, n, period) };
        let power = |v: &[f64]| {
            let around = (period.round() as usize).max(2);
            let changes = v.windows(around).step_by((around / 4).max(1)).map(|w| {
                let m = w.iter().sum::<f64>() / w.len() as f64;
                w.iter().map(|x| (x - m).powi(2)).sum::<f64>() / w.len() as f64
            });
            let all: Vec<f64> = changes.collect();
            all.iter().sum::<f64>() / all.len().max(1) as f64
        };
        clear = power(&wave) / power(&x).max(1e-12);
        x.iter_mut().zip(&wave).for_each(|(x, w)| *x += w);
    }
    if !oscillates && rng.random::<f64>() < 0.25 {
        burst(rng, &mut x);
    }
    if rng.random::<f64>() < 0.2 {
        let step = uniform(rng, 0.05, 0.6);
        x.iter_mut().for_each(|x| *x = (*x / step).round() * step);
    }
    Wave { x, period: oscillates.then_some(period), clear }
}

/// White noise, first-order noise, a damped answer, or all of them.
fn background(rng: &mut Pcg64Mcg, n: usize, period: f64, oscillates: bool) -> Vec<f64> {
    let white = uniform(rng, 0.0, 0.6);
    let coloured = if rng.random::<f64>() < 0.6 { uniform(rng, 0.0, 1.0) } else { 0.0 };
    let tau = log_uniform(rng, 1.0, if oscillates { period } else { n as f64 / 8.0 });
    let keep = (-1.0 / tau).exp();
    let damped = if rng.random::<f64>() < 0.5 { uniform(rng, 0.0, 1.0) } else { 0.0 };
    let (zeta, turn) = (uniform(rng, 0.3, 1.0), TAU / log_uniform(rng, 6.0, (n as f64 / 6.0).max(7.0)));
    let radius = (-zeta * turn).exp();
    let angle = turn * (1.0 - zeta * zeta).max(0.0).sqrt();
    let (a1, a2) = (2.0 * radius * angle.cos(), -radius * radius);
    // Variance of an AR(2) driven by unit noise, to give it the size that is asked for.
    let variance = (1.0 - a2) / ((1.0 + a2) * ((1.0 - a2).powi(2) - a1 * a1)).max(1e-12);
    let fresh = damped / variance.max(1e-12).sqrt();
    let (mut c, mut d) = (0.0, [0.0; 2]);
    let total = if oscillates { 1.0 } else { 2.0 };
    (0..n)
        .map(|_| {
            c = keep * c + (1.0 - keep * keep).sqrt() * coloured * normal(rng);
            let next = a1 * d[0] + a2 * d[1] + fresh * normal(rng);
            d = [next, d[0]];
            total * (white * normal(rng) + c + next)
        })
        .collect()
}

/// A random walk, steps, or nothing.
fn drift(rng: &mut Pcg64Mcg, n: usize, oscillates: bool) -> Vec<f64> {
    let size = if rng.random::<f64>() < 0.5 { log_uniform(rng, 0.1, 5.0) } else { 0.0 };
    let steps = if rng.random::<f64>() < 0.3 { log_uniform(rng, 1.0, 12.0) / n as f64 } else { 0.0 };
    let walk = if oscillates && rng.random::<f64>() < 0.3 { 10.0 * size } else { size } / (n as f64).sqrt();
    let mut level = 0.0;
    let (zeta, turn) = (uniform(rng, 0.3, 1.0), TAU / log_uniform(rng, 6.0, (n as f64 / 6.0).max(7.0)));
    let answer = rng.random::<f64>() < 0.5;
    let mut y = [0.0; 2];
    (0..n)
        .map(|_| {
            level += walk * normal(rng);
            if rng.random::<f64>() < steps {
                level += uniform(rng, 0.5, 4.0) * normal(rng).signum();
            }
            // As a loop answers steps: damped well.
            let pull = (level - y[0]) * (turn * turn).min(0.5);
            y[1] = (y[1] + pull) * (1.0 - (2.0 * zeta * turn).min(0.9));
            y[0] += y[1];
            if answer { y[0] } else { level }
        })
        .collect()
}

/// A few cycles in a part of the record.
fn burst(rng: &mut Pcg64Mcg, x: &mut [f64]) {
    let n = x.len();
    let length = ((n as f64) * uniform(rng, 0.04, 0.25)) as usize;
    let from = rng.random_range(0..n - length);
    let (height, period) = (uniform(rng, 1.0, 6.0), length as f64 / uniform(rng, 1.0, 12.0));
    let kind = rng.random::<f64>() < 0.5;
    for k in 0..length {
        let wave = (TAU * k as f64 / period).sin();
        x[from + k] += height * if kind { wave } else { wave.abs() };
    }
}

/// Noise through a loop that hardly damps it: a damping of 0.11 halves each cycle.
fn ringing(rng: &mut Pcg64Mcg, n: usize, period: f64) -> Vec<f64> {
    let (zeta, turn) = (uniform(rng, 0.01, 0.11), TAU / period);
    let radius = (-zeta * turn).exp();
    let (a1, a2) = (2.0 * radius * turn.cos(), -radius * radius);
    let fresh = (2.0 * zeta * turn).sqrt() * turn.sin();
    let mut y = [0.0; 2];
    (0..n)
        .map(|_| {
            let next = a1 * y[0] + a2 * y[1] + fresh * normal(rng);
            y = [next, y[0]];
            next
        })
        .collect()
}

/// A wave of amplitude about 1 whose period and height wander from cycle to cycle.
fn wave(rng: &mut Pcg64Mcg, n: usize, period: f64) -> Vec<f64> {
    let jitter = uniform(rng, 0.0, 0.12);
    let swing = uniform(rng, 0.0, 0.4);
    let shape = rng.random_range(0..4);
    let (mut phase, mut height, mut rate) = (rng.random::<f64>(), 1.0, 1.0 / period);
    let at = uniform(rng, 0.3, 0.7);
    (0..n)
        .map(|_| {
            let before = phase.floor();
            phase += rate;
            if phase.floor() > before {
                height = (0.5 * height + 0.5 * (1.0 + swing * normal(rng))).clamp(0.2, 2.5);
                rate = 1.0 / (period * (1.0 + jitter * normal(rng)).clamp(0.5, 2.0));
            }
            let p = phase.fract();
            height
                * match shape {
                    0 => (TAU * p).sin(),
                    1 => {
                        if p < 0.5 {
                            4.0 * p - 1.0
                        } else {
                            3.0 - 4.0 * p
                        }
                    }
                    2 => ((TAU * p).sin() * 3.0).clamp(-1.0, 1.0),
                    _ => {
                        if p < at {
                            2.0 * p / at - 1.0
                        } else {
                            1.0 - 2.0 * (p - at) / (1.0 - at)
                        }
                    }
                }
        })
        .collect()
}
