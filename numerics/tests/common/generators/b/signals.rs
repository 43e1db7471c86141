//! Loads, noise, set points and foreign tags.

use std::f64::consts::TAU;

use super::draw::{Draw, Range};

/// The colour of a random signal (times in scans).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Colour {
    /// No memory.
    White,
    /// First order, of a time constant.
    First(f64),
    /// Second order: a hump in the spectrum at a period, with poles of a radius.
    Hump { period: f64, radius: f64 },
}

/// Memory of a first-order load (scans).
const MEMORY: Range = (2.0, 60.0);
/// Memory of a load that wanders: an integrated one that is pulled back (scans).
const WANDERING: Range = (100.0, 400.0);
/// Period of a load with a hump (scans).
const HUMP_PERIOD: Range = (8.0, 60.0);
/// Radius of its poles.
const HUMP_RADIUS: Range = (0.7, 0.92);

impl Colour {
    /// A load's colour.
    pub fn draw(draw: &mut Draw) -> Self {
        match draw.whole(0, 5) {
            0 => Colour::White,
            1 | 2 => Colour::First(draw.log_uniform(MEMORY)),
            3 => Colour::Hump { period: draw.log_uniform(HUMP_PERIOD), radius: draw.uniform(HUMP_RADIUS) },
            _ => Colour::First(draw.log_uniform(WANDERING)),
        }
    }

    /// A signal of this colour with sd 1.
    pub fn signal(self, draw: &mut Draw, n: usize) -> Vec<f64> {
        match self {
            Colour::White => (0..n).map(|_| draw.normal()).collect(),
            Colour::First(time) => {
                let keep = (-1.0 / time).exp();
                let fresh = (1.0 - keep * keep).sqrt();
                let mut value = draw.normal();
                (0..n)
                    .map(|_| {
                        value = keep * value + fresh * draw.normal();
                        value
                    })
                    .collect()
            }
            Colour::Hump { period, radius } => {
                let (a, b) = (2.0 * radius * (TAU / period).cos(), -radius * radius);
                let mut last = [0.0; 2];
                let signal: Vec<f64> = (0..n)
                    .map(|_| {
                        last = [a * last[0] + b * last[1] + draw.normal(), last[0]];
                        last[0]
                    })
                    .collect();
                let scale = 1.0 / sd(&signal);
                signal.iter().map(|v| v * scale).collect()
            }
        }
    }
}

/// Mean of a signal.
pub fn mean(signal: &[f64]) -> f64 {
    signal.iter().sum::<f64>() / signal.len() as f64
}

/// Standard deviation of a signal.
pub fn sd(signal: &[f64]) -> f64 {
    let centre = mean(signal);
    (signal.iter().map(|v| (v - centre).powi(2)).sum::<f64>() / signal.len() as f64).sqrt()
}

/// The value below which a share of the signal lies.
pub fn quantile(signal: &[f64], share: f64) -> f64 {
    let mut sorted = signal.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// How an operator treats the set point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Habit {
    /// Leaves it alone.
    Rest,
    /// Now and then a step.
    Steps,
    /// Slow ramps between levels.
    Ramps,
    /// Small moves.
    Moves,
}

/// Scans between steps of the set point.
const STEP_EVERY: (usize, usize) = (120, 450);
/// Scans that a level is held before a ramp.
const HOLD: (usize, usize) = (60, 250);
/// Scans that a ramp takes.
const RAMP: (usize, usize) = (40, 250);
/// Scans between an operator's small moves.
const MOVE_EVERY: (usize, usize) = (30, 180);
/// A small move as a share of the unit of the set point's moves.
const SMALL: Range = (0.1, 0.35);
/// How far levels lie from the middle, in units.
const LEVELS: Range = (0.3, 1.0);

/// The set point's deviation: levels within one `unit`, and no change per scan larger than `kick`.
pub fn set_point(draw: &mut Draw, habit: Habit, n: usize, unit: f64, kick: f64) -> Vec<f64> {
    let mut wanted: Vec<f64> = Vec::with_capacity(n);
    let mut level: f64 = 0.0;
    while wanted.len() < n {
        let from = level;
        let (hold, ramp) = match habit {
            Habit::Rest => (n, 0),
            Habit::Steps => (draw.whole(STEP_EVERY.0, STEP_EVERY.1), 0),
            Habit::Ramps => (draw.whole(HOLD.0, HOLD.1), draw.whole(RAMP.0, RAMP.1)),
            Habit::Moves => (draw.whole(MOVE_EVERY.0, MOVE_EVERY.1), 0),
        };
        wanted.extend(std::iter::repeat_n(from, hold));
        level = match habit {
            Habit::Rest => 0.0,
            Habit::Moves => (from + draw.sign() * draw.uniform(SMALL) * unit).clamp(-unit, unit),
            _ => {
                let side = if from == 0.0 { draw.sign() } else { -from.signum() };
                let other = if draw.chance(0.75) { side } else { -side };
                other * draw.uniform(LEVELS) * unit
            }
        };
        wanted.extend((1..=ramp).map(|i| from + (level - from) * i as f64 / ramp as f64));
    }
    wanted.truncate(n);
    let mut value = wanted[0];
    wanted
        .iter()
        .map(|&v| {
            value += (v - value).clamp(-kick, kick);
            value
        })
        .collect()
}

/// Period of foreign periodic tags (scans).
const FOREIGN_PERIOD: Range = (10.0, 200.0);
/// Scans between steps of a foreign tag.
const FOREIGN_STEPS: (usize, usize) = (30, 300);
/// Noise on a foreign tag as a share of its sd.
const FOREIGN_NOISE: Range = (0.02, 0.3);
/// Lag of a tag that follows PV (scans).
const FOLLOWER_LAG: Range = (2.0, 30.0);
/// Sd of a foreign tag in its own unit.
const FOREIGN_SD: Range = (0.1, 20.0);
/// Middle of a foreign tag in its own unit.
const FOREIGN_MIDDLE: Range = (10.0, 200.0);

/// A recorded tag that does nothing to the loop, and the letters of its name; `pv` is the loop's PV.
pub fn foreign(draw: &mut Draw, pv: &[f64]) -> (&'static str, Vec<f64>) {
    let n = pv.len();
    let (letters, shape) = match draw.whole(0, 8) {
        0 => ("AI", Colour::White.signal(draw, n)),
        1 => ("TI", Colour::First(draw.log_uniform(MEMORY)).signal(draw, n)),
        2 => ("TI", Colour::First(draw.log_uniform(WANDERING)).signal(draw, n)),
        3 => ("SI", periodic(draw, n, f64::sin)),
        4 => ("XI", periodic(draw, n, |angle| angle.sin().signum())),
        5 => ("FI", steps(draw, n)),
        6 => ("FC-OP", periodic(draw, n, |angle| angle.sin().asin())),
        7 => ("FC-PV", periodic(draw, n, |angle| (4.0 * angle.sin()).tanh() + 0.2 * (3.0 * angle).cos())),
        _ => ("PI", follower(draw, pv)),
    };
    let scale = 1.0 / sd(&shape).max(f64::MIN_POSITIVE);
    let noise = draw.uniform(FOREIGN_NOISE);
    let (unit, middle) = (draw.log_uniform(FOREIGN_SD) * draw.sign(), draw.uniform(FOREIGN_MIDDLE));
    (letters, shape.iter().map(|v| middle + unit * (scale * v + noise * draw.normal())).collect())
}

/// A periodic signal whose period wavers a little.
fn periodic(draw: &mut Draw, n: usize, shape: impl Fn(f64) -> f64) -> Vec<f64> {
    let period = draw.log_uniform(FOREIGN_PERIOD);
    let waver = draw.uniform((0.0, 0.1));
    let mut angle = draw.uniform((0.0, TAU));
    (0..n)
        .map(|_| {
            angle += TAU / period * (1.0 + waver * draw.normal());
            shape(angle)
        })
        .collect()
}

/// Levels held for random times.
pub fn steps(draw: &mut Draw, n: usize) -> Vec<f64> {
    let mut signal = Vec::with_capacity(n);
    while signal.len() < n {
        let (level, hold) = (draw.normal(), draw.whole(FOREIGN_STEPS.0, FOREIGN_STEPS.1));
        signal.extend(std::iter::repeat_n(level, hold));
    }
    signal.truncate(n);
    signal
}

/// PV behind a lag.
fn follower(draw: &mut Draw, pv: &[f64]) -> Vec<f64> {
    let pull = 1.0 - (-1.0 / draw.uniform(FOLLOWER_LAG)).exp();
    let mut state = pv[0];
    pv.iter()
        .map(|v| {
            state += pull * (v - state);
            state
        })
        .collect()
}
