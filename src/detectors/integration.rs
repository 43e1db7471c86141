//! Whether the process integrates, at the frequency of the cycle.
//!
//! The equation of a first-order process is integrated over L, a quarter of a period, so that noise averages out:
//!
//! ```text
//! y(t) - y(t - L) = -(1/tau) ∫ y dt + (K/tau) ∫ x(t - d) dt + c        over t - L .. t
//! lag = 1/(w tau)
//! ```
//!
//! y: PV; x: measured stem, otherwise OP through the valve, of a few, with which the equation fits best; d: delay (samples); tau: time
//! constant (samples); w: angular frequency of the cycle (rad/sample); lag (-). With a lag near 0 PV is the integral of the valve's
//! steps, whatever the plant calls the process. With a large one PV follows the steps. A negative lag is not that of a process: it is
//! the controller seen backwards, where a load moves PV and OP follows.
//!
//! Source: integral equations, Whitfield & Messali, Int. J. Control 1987, 45, 1431. The thresholds are calibrated on simulated loops by
//! `numerics/examples/opinions -- --calibrate`.

use super::opinion::Band;
use crate::signal::share_beside;
use crate::sysid::least_squares::{MOST_COLUMNS, dot, factor, substitute, total};
use crate::sysid::stats::range;
use crate::sysid::valve::{Start, ValveModel};

/// Thresholds of the lag (-): up to `sound` the process integrates, above `sticks` it does not.
pub const BAND: Band = Band { sound: 0.1, sticks: 0.45 };
/// Least lag of a process (-): a little below 0, because the lag of an integrator is estimated with an error.
pub const LEAST_LAG: f64 = -0.1;
/// Least share of the variance of PV's changes that the equation must explain (-).
pub const LEAST_FIT: f64 = 0.9;
/// Longest delay tried, as a share of the period.
const LONGEST_DELAY: f64 = 0.25;
/// Number of delays tried.
const DELAYS: usize = 10;
/// Values of S tried, up to the range of OP.
const BANDS: usize = 12;
/// Values of S tried around the best of them, in steps.
const BESIDE: [f64; 6] = [-0.75, -0.5, -0.25, 0.25, 0.5, 0.75];
/// Values of J tried, as shares of S.
const JUMPS: [f64; 3] = [0.0, 0.5, 1.0];

/// The answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Integrates {
    /// PV integrates the valve's movement.
    Yes,
    /// PV follows the valve's movement.
    No,
    /// The lag lies between the thresholds, or OP explains too little of PV.
    #[default]
    Unknown,
}

/// The answer and its evidence.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Integration {
    /// The answer.
    pub answer: Integrates,
    /// The lag `1/(w tau)` (-); none where the answer was given, or the lag cannot be estimated.
    pub lag: Option<f64>,
    /// Share of the variance of PV's changes that is explained (-).
    pub fit: f64,
}

impl Integration {
    /// The reason why it is not known, for a method that needs it.
    pub fn why(&self) -> String {
        match self.lag {
            None => "it is not known whether the process integrates".into(),
            Some(_) if self.fit < LEAST_FIT => {
                format!(
                    "OP explains {} of PV's changes: whether the process integrates is not known",
                    share_beside(self.fit, &[LEAST_FIT], 0)
                )
            }
            Some(lag) if lag < LEAST_LAG => {
                "PV does not answer OP as a process would: whether it integrates is not known".into()
            }
            Some(lag) => {
                format!("whether the process integrates is not clear: 1/(w tau) is {}", BAND.told(lag, 2))
            }
        }
    }
}

/// Whether the process of a loop integrates, by the first letter of the loop's name (ISA-5.1). Levels integrate and flows do not; of
/// pressures, temperatures and analyses it is not known.
///
/// * `name`: as plants write it, with an area before it and numbers behind it (`2111LIC31102B`, `FIC-101`, `10.FC.7`). The last word
///   that may be a controller's counts, because an area may look like one (`FCC-LIC-201`).
pub fn told_by_name(name: &str) -> Option<bool> {
    let controls = |word: &&str| {
        (2..5).contains(&word.len()) && word.chars().skip(1).any(|letter| letter.eq_ignore_ascii_case(&'C'))
    };
    let controller = name.rsplit(|c: char| !c.is_ascii_alphabetic()).find(controls)?;
    match controller.bytes().next()?.to_ascii_uppercase() {
        b'L' => Some(true),
        b'F' => Some(false),
        _ => None,
    }
}

/// The signals that tell whether the process integrates.
pub(super) struct Signals<'a> {
    /// OP, normalised.
    pub u: &'a [f64],
    /// PV, normalised.
    pub y: &'a [f64],
    /// The measured stem, normalised.
    pub stem: Option<&'a [f64]>,
    /// The extremum of OP from which a stem is simulated.
    pub start: Start,
    /// Period of a regular oscillation (samples).
    pub period: Option<f64>,
}

/// Whether the process integrates. `known`: the answer where it is given.
pub(super) fn integration(signals: &Signals<'_>, known: Option<bool>) -> Integration {
    if let Some(known) = known {
        let answer = if known { Integrates::Yes } else { Integrates::No };
        return Integration { answer, lag: None, fit: 1.0 };
    }
    let Some((lag, fit)) = signals.period.and_then(|period| measure(signals, period)) else {
        return Integration::default();
    };
    let answer = if fit < LEAST_FIT || lag < LEAST_LAG {
        Integrates::Unknown
    } else if lag <= BAND.sound {
        Integrates::Yes
    } else if lag > BAND.sticks {
        Integrates::No
    } else {
        Integrates::Unknown
    };
    Integration { answer, lag: Some(lag), fit }
}

/// The lag `1/(w tau)` and the share explained (-), with the valve and the delay that fit best.
fn measure(signals: &Signals<'_>, period: f64) -> Option<(f64, f64)> {
    let equation = Equation::new(signals.y, period)?;
    let (rate, left) = match signals.stem {
        Some(stem) => equation.best(stem)?,
        None => best_valve(signals, &equation)?,
    };
    Some((rate * period / std::f64::consts::TAU, 1.0 - left))
}

/// `1/tau` (per sample) and the share left unexplained (-), with the best valve of a grid of S and of a finer one around its best.
fn best_valve(signals: &Signals<'_>, equation: &Equation) -> Option<(f64, f64)> {
    let (low, high) = range(signals.u);
    let step = (high - low) / (BANDS + 1) as f64;
    let (mut x, mut dir) = (Vec::new(), Vec::new());
    let mut best = equation.best(signals.u).map(|found| (found, 0.0));
    let mut offer = |s: f64, best: &mut Option<((f64, f64), f64)>| {
        for j in JUMPS.map(|share| share * s) {
            ValveModel { s, j, ..ValveModel::default() }.run(
                signals.u,
                signals.start,
                signals.u.len(),
                &mut x,
                &mut dir,
            );
            if let Some(found) = equation.best(&x)
                && best.is_none_or(|best| found.1 < best.0.1)
            {
                *best = Some((found, s));
            }
        }
    };
    for i in 1..=BANDS {
        offer(step * i as f64, &mut best);
    }
    let centre = best?.1;
    for part in BESIDE {
        if centre + part * step > 0.0 {
            offer(centre + part * step, &mut best);
        }
    }
    best.map(|(found, _)| found)
}

/// The integral equation of one PV.
struct Equation {
    /// L (samples).
    window: usize,
    /// Longest delay (samples).
    longest: usize,
    /// `y(t) - y(t - L)` at each row.
    changes: Vec<f64>,
    /// `∫ y dt` at each row.
    areas: Vec<f64>,
}

impl Equation {
    fn new(y: &[f64], period: f64) -> Option<Self> {
        let window = ((period / 4.0).round() as usize).max(2);
        let longest = (LONGEST_DELAY * period).ceil() as usize;
        let rows = y.len().checked_sub(window + longest).filter(|rows| *rows > 50)?;
        let first = y.len() - rows;
        let sums = running(y);
        let changes = (first..y.len()).map(|k| y[k] - y[k - window]).collect();
        // By the trapezoidal rule, so that the noise of both ends counts half.
        let areas =
            (first..y.len()).map(|k| sums[k] - sums[k - window] + 0.5 * (y[k] - y[k - window])).collect();
        Some(Self { window, longest, changes, areas })
    }

    /// `1/tau` (per sample) and the share of the changes' variance left unexplained (-), at the best delay. `x`: a stem.
    fn best(&self, x: &[f64]) -> Option<(f64, f64)> {
        let sums = running(x);
        let rows = self.changes.len();
        let first = x.len().checked_sub(rows)?;
        let step = (self.longest / DELAYS).max(1);
        (0..=self.longest)
            .step_by(step)
            .filter_map(|delay| {
                let flows: Vec<f64> =
                    (first..x.len()).map(|k| sums[k - delay] - sums[k - delay - self.window]).collect();
                self.solve(&flows)
            })
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The same for one delay, by least squares. `flows`: `∫ x(t - d) dt` at each row.
    fn solve(&self, flows: &[f64]) -> Option<(f64, f64)> {
        let (a, c) = (&self.areas, &self.changes);
        let n = c.len() as f64;
        let mut g = [n, 0.0, 0.0, total(a), dot(a, a), 0.0, total(flows), dot(a, flows), dot(flows, flows)];
        let right = [total(c), dot(a, c), dot(flows, c)];
        let mut theta = right;
        let mut live = [true; MOST_COLUMNS];
        factor(&mut g, 3, 3, &mut live);
        substitute(&g, 3, &live, &mut theta);
        let all = dot(c, c) - right[0] * right[0] / n;
        let left = dot(c, c) - theta.iter().zip(&right).map(|(t, r)| t * r).sum::<f64>();
        (all > 0.0 && left.is_finite()).then(|| (-theta[1], (left / all).max(0.0)))
    }
}

/// Sums of the samples before each, one more than there are samples.
fn running(v: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut sums = vec![0.0];
    sums.extend(v.iter().map(|x| {
        sum += x;
        sum
    }));
    sums
}

#[cfg(test)]
mod tests {
    use super::told_by_name;

    #[test]
    fn names_tell_levels_and_flows() {
        for (name, told) in [
            ("2111LIC31102B", Some(true)),
            ("FIC-101", Some(false)),
            ("10.FC.7", Some(false)),
            ("RHT.7050-342_FIC11502", Some(false)),
            ("fic-7", Some(false)),
            // Names of units are no instruments.
            ("FCC-LIC-201", Some(true)),
            ("FCC_TIC_202", None),
            ("FRAC_TIC101", None),
            ("LACT-PIC-1", None),
            ("PIC10201", None),
            ("TC1", None),
            ("LT-5", None),
            ("flow", None),
            ("", None),
            ("é§", None),
        ] {
            assert_eq!(told_by_name(name), told, "{name}");
        }
    }
}
