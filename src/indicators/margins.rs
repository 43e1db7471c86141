//! Gain margin and phase margin of a loop, from its controller and the linear model of its process.
//!
//! ```text
//! L = C G                                   controller C, process G
//! gain margin  = 1 / |L(j omega_180)|       omega_180: where arg L falls through -180°
//! phase margin = 180° + arg L(j omega_c)    omega_c: where |L| = 1
//! ```
//!
//! * C is identified from OP, PV and set point (`controller`); G is the model that a diagnosis has fitted.
//! * The crossovers are searched from the period of the whole window down to two samples. Where there are several, the least margin
//!   counts.
//! * Margins are those of a linear loop. Whether the valve and the process are linear is the caller's question.
//!
//! Feedback alone does not tell the process from the controller: without a set point that moves, a model may as well be -1/C, the
//! inverse of the controller, which gives a gain margin of 1 whatever the loop is like. So the set point must move, and both margins
//! must be sure by what its moves alone tell (`set_point`).
//!
//! Source: Åström & Hägglund, Advanced PID Control, 2006 (margins and their usual values); Ljung, System Identification,
//! 1999, section 13.4 (closed loops that are informative).

mod controller;
mod open_loop;
mod set_point;

use crate::diagnosis::Model;
use crate::signal::{Window, beside};
use controller::controller;
use nalgebra::Complex;
use open_loop::OpenLoop;
use set_point::Told;
use std::f64::consts::{PI, TAU};

/// Gain margin that a loop usually has (-): Åström & Hägglund.
const USUAL_GAIN: (f64, f64) = (2.0, 5.0);
/// Phase margin that a loop usually has (degrees): Åström & Hägglund.
const USUAL_PHASE: (f64, f64) = (30.0, 60.0);
/// Largest standard error of the logarithm of the gain margin (-): about half the width of the usual range, ln(5/2) = 0.92.
const GAIN_ERROR: f64 = 0.5;
/// Largest standard error of the phase margin (degrees): less than the width of the usual range, 30°.
const PHASE_ERROR: f64 = 25.0;
/// Angles at which the open loop is looked at: with a dead time of 100 samples, L turns by less than half a turn between two of them.
const ANGLES: usize = 2000;
/// Halvings of the interval in which a crossover is: an `f64` tells no smaller interval apart.
const HALVINGS: usize = 60;

/// The margins of a loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Margins {
    /// Gain margin (-): the factor by which the loop's gain may grow before it swings without end. None without a phase crossover.
    pub gain: Option<f64>,
    /// Phase margin (degrees): the lag that may be added before it does. None without a gain crossover.
    pub phase_deg: Option<f64>,
    /// Period of the phase crossover (s).
    pub phase_crossover_s: Option<f64>,
    /// Period of the gain crossover (s): a loop with a small margin swings with about this period.
    pub gain_crossover_s: Option<f64>,
}

/// What margins say of the tuning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tuned {
    /// One of them is smaller than usual.
    Tightly,
    /// Neither is smaller than usual, and one of them is not larger.
    Usually,
    /// Both are larger than usual.
    Loosely,
}

impl Margins {
    /// What they say of the tuning; a margin without a crossover is larger than any.
    pub fn tuned(&self) -> Tuned {
        let is_below = |margin: Option<f64>, least: f64| margin.is_some_and(|margin| margin < least);
        let is_above = |margin: Option<f64>, most: f64| margin.is_none_or(|margin| margin > most);
        if is_below(self.gain, USUAL_GAIN.0) || is_below(self.phase_deg, USUAL_PHASE.0) {
            Tuned::Tightly
        } else if is_above(self.gain, USUAL_GAIN.1) && is_above(self.phase_deg, USUAL_PHASE.1) {
            Tuned::Loosely
        } else {
            Tuned::Usually
        }
    }

    /// In words, as `gain margin 1.3, phase margin 17°`: with as many digits as show on which side each is of a usual margin, and of
    /// none.
    pub fn words(&self) -> String {
        let ((least, most), (from, to)) = (USUAL_GAIN, USUAL_PHASE);
        let gain = self.gain.map(|gain| format!("gain margin {}", beside(gain, &[1.0, least, most], 1)));
        // No minus before a zero.
        let told = |phase: f64| beside(phase + 0.0, &[0.0, from, to], 0);
        let phase = self.phase_deg.map(|phase| format!("phase margin {}°", told(phase)));
        gain.into_iter().chain(phase).collect::<Vec<String>>().join(", ")
    }

    /// The usual margins in words.
    pub fn usual() -> String {
        let ((least, most), (from, to)) = (USUAL_GAIN, USUAL_PHASE);
        format!("usual are {least} to {most} and {from}° to {to}°")
    }
}

/// The margins of a loop; none where OP is not what a PI or PID controller makes of the error, where the moves of the set point do not
/// tell both margins well enough, where no crossover is found, and where the model says that the loop is not stable.
///
/// * `window`: OP, PV and set point in automatic, to which `model` was fitted.
/// * `op_limits`: the controller's output limits (OP unit), where known.
/// * `model`: linear, from OP to PV.
pub fn margins(window: &Window, op_limits: Option<(f64, f64)>, model: &Model) -> Option<Margins> {
    let told = Told::of(window, model)?;
    let open = OpenLoop { controller: controller(window, op_limits)?, process: model };
    let found = crossovers(&open, window.len())?;
    let is_sure = found.gain.is_none_or(|angle| phase_error(&open, angle, &told) <= PHASE_ERROR)
        && found.phase.is_none_or(|angle| gain_error(&open, angle, &told) <= GAIN_ERROR);
    let margins = is_sure.then(|| found.margins(&open, window.ts));
    // A loop that runs is stable: a model that says otherwise is wrong.
    margins
        .filter(|own| own.gain.is_none_or(|gain| gain > 1.0) && own.phase_deg.is_none_or(|phase| phase > 0.0))
}

/// The angles omega ts of the crossovers (rad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Crossovers {
    /// Where |L| = 1.
    gain: Option<f64>,
    /// Where arg L falls through -180°.
    phase: Option<f64>,
}

impl Crossovers {
    fn margins(self, open: &OpenLoop<'_>, ts: f64) -> Margins {
        let period = |angle: f64| TAU / angle * ts;
        Margins {
            gain: self.phase.map(|angle| gain_margin(open.at(angle))),
            phase_deg: self.gain.map(|angle| phase_margin(open.at(angle))),
            phase_crossover_s: self.phase.map(period),
            gain_crossover_s: self.gain.map(period),
        }
    }
}

fn gain_margin(l: Complex<f64>) -> f64 {
    1.0 / l.norm()
}

/// 180° + arg L, in -180° to 180°.
fn phase_margin(l: Complex<f64>) -> f64 {
    (-l).arg().to_degrees()
}

/// The crossovers with the least margins, from the period of `n` samples down to two; none where there is neither of both.
fn crossovers(open: &OpenLoop<'_>, n: usize) -> Option<Crossovers> {
    let first = TAU / n.max(2) as f64;
    let angle = |i: usize| if i < ANGLES { first * (PI / first).powf(i as f64 / ANGLES as f64) } else { PI };
    let mut found = Crossovers::default();
    let mut least = (f64::INFINITY, f64::INFINITY);
    let mut before = (first, open.at(first));
    for i in 1..=ANGLES {
        let now = (angle(i), open.at(angle(i)));
        if before.1.im < 0.0 && now.1.im >= 0.0 {
            let angle = halved(before.0, now.0, |angle| open.at(angle).im >= 0.0);
            let l = open.at(angle);
            // With a positive real part the phase rises through 0°.
            if l.re < 0.0 && gain_margin(l) < least.0 {
                (least.0, found.phase) = (gain_margin(l), Some(angle));
            }
        }
        let is_above = before.1.norm() > 1.0;
        if now.1.norm().is_finite() && is_above != (now.1.norm() > 1.0) {
            let angle = halved(before.0, now.0, |angle| is_above != (open.at(angle).norm() > 1.0));
            let margin = phase_margin(open.at(angle));
            if margin < least.1 {
                (least.1, found.gain) = (margin, Some(angle));
            }
        }
        before = now;
    }
    (found != Crossovers::default()).then_some(found)
}

/// The least value of an interval from which on `is_after` holds, which holds at its end.
fn halved(mut from: f64, mut to: f64, is_after: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..HALVINGS {
        let middle = 0.5 * (from + to);
        if is_after(middle) {
            to = middle;
        } else {
            from = middle;
        }
    }
    to
}

/// Standard error of the logarithm of the gain margin (-). Where L changes, the angle of the crossover does too, but for the largest
/// angle, at which L is always real.
fn gain_error(open: &OpenLoop<'_>, angle: f64, told: &Told) -> f64 {
    let slope = open.slope(angle);
    let moved = if angle < PI { slope.re / slope.im } else { 0.0 };
    let change: Vec<f64> = open.sensitivity(angle).iter().map(|own| own.re - moved * own.im).collect();
    told.error(&change)
}

/// Standard error of the phase margin (degrees).
fn phase_error(open: &OpenLoop<'_>, angle: f64, told: &Told) -> f64 {
    let slope = open.slope(angle);
    let moved = slope.im / slope.re;
    let change: Vec<f64> = open.sensitivity(angle).iter().map(|own| own.im - moved * own.re).collect();
    told.error(&change).to_degrees()
}

#[cfg(test)]
mod tests;
