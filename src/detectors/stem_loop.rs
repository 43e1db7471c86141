//! The loop of OP and the measured stem: the reference for every method that has to guess the stem.
//!
//! ```text
//! m[k] = a + b x[k - n] + e[k]          x: OP through a valve with S and J
//! (S, J, n) with the least sum of e²    index = 1 - V / V_0        V_0: of a valve that follows OP
//! ```
//!
//! m: measured stem (its unit), x (OP unit), n: samples by which the stem is late; S: dead band plus stick band, J: slip jump
//! (OP unit); V: mean square of e; index: the share that friction explains of what a line leaves (-).
//!
//! Source: the valve is that of Choudhury, Thornhill & Shah, Control Eng. Practice 2005, 13, 641; the thresholds are
//! calibrated on simulated loops by `numerics/examples/opinions -- --calibrate`.
//! Limits: a positioner that is slow, or a stem that is stored as OP, has no loop; a lag of the positioner beyond the delays
//! tried widens it.

use super::facts::Facts;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, excerpt};
use crate::sysid::least_squares::{dot, total};
use crate::sysid::stats::mean;
use crate::sysid::valve::{StopRule, ValveModel};

const ME: Method = Method::StemLoop;
/// Thresholds of the index, calibrated (-): 95 % of the sound valves lie below 0.01, 95 % of the sticking above 0.5.
pub const BAND: Band = Band { sound: 0.1, sticks: 0.3 };
/// Longest delay of the stem (samples).
const DELAYS: usize = 3;
/// Values of S up to OP's range, and of J up to S.
const BANDS: usize = 40;
const JUMPS: usize = 4;
/// Steps of OP up to which it has stopped, as a share of its range.
const RESOLUTION: f64 = 1e-4;
/// What a line may leave of the stem's variance before nothing is left to explain (-).
const FLOOR: f64 = 1e-6;

/// S and J (unit of `u`), and the index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loop {
    /// Dead band plus stick band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// What the stem does where OP stops.
    pub rule: StopRule,
    /// Share explained (-).
    pub index: f64,
}

impl Loop {
    /// The valve that was fitted.
    fn valve(&self, facts: &Facts<'_>) -> ValveModel {
        ValveModel { s: self.s, j: self.j, ..plain(facts, self.rule) }
    }
}

/// A valve without friction that knows when OP has stopped.
fn plain(facts: &Facts<'_>, rule: StopRule) -> ValveModel {
    ValveModel { rule, resolution: RESOLUTION * facts.op_range(), ..ValveModel::default() }
}

/// Fits the valve to a stem.
pub fn fit(facts: &Facts<'_>, stem: &[f64]) -> Loop {
    let without = left(&facts.u, stem);
    let mut best = (without, 0.0, 0.0, StopRule::Stop);
    let (mut x, mut dir) = (Vec::new(), Vec::new());
    let mut offer = |s: f64, j: f64, best: &mut (f64, f64, f64, StopRule)| {
        for rule in [StopRule::Stop, StopRule::Slip] {
            let valve = ValveModel { s, j, ..plain(facts, rule) };
            valve.run(&facts.u, facts.start, facts.len(), &mut x, &mut dir);
            let left = left(&x, stem);
            if left < best.0 {
                *best = (left, s, j, rule);
            }
        }
    };
    let step = facts.op_range() / BANDS as f64;
    for i in 1..BANDS {
        for j in 0..=JUMPS {
            let s = step * i as f64;
            offer(s, s * j as f64 / JUMPS as f64, &mut best);
        }
    }
    let (_, s, j, _) = best;
    for a in -4..=4 {
        for b in -4..=4 {
            let (s, j) = (s + 0.25 * step * f64::from(a), j + 0.25 * s / JUMPS as f64 * f64::from(b));
            if s > 0.0 && (0.0..=s).contains(&j) {
                offer(s, j, &mut best);
            }
        }
    }
    let (left, s, j, rule) = best;
    Loop { s, j, rule, index: 1.0 - (left + FLOOR) / (without + FLOOR) }
}

/// Share of the stem's variance that a line of `x`, some samples late, leaves.
fn left(x: &[f64], stem: &[f64]) -> f64 {
    (0..=DELAYS)
        .map(|delay| {
            let n = x.len() - delay;
            let (x, m) = (&x[..n], &stem[delay..]);
            let (count, sx, sm) = (n as f64, total(x), total(m));
            let xx = dot(x, x) - sx * sx / count;
            let mm = dot(m, m) - sm * sm / count;
            let xm = dot(x, m) - sx * sm / count;
            // A valve opens with OP: a stem that moves against it is none of its.
            if xx > 0.0 && mm > 0.0 && xm > 0.0 { (1.0 - xm * xm / (xx * mm)).max(0.0) } else { 1.0 }
        })
        .fold(1.0, f64::min)
}

/// The loop of OP and the stem, and the stem that the fitted valve would make.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Some(stem) = &facts.stem else { return Vec::new() };
    let found = fit(facts, stem);
    let (mut x, mut dir) = (Vec::new(), Vec::new());
    found.valve(facts).run(&facts.u, facts.start, facts.len(), &mut x, &mut dir);
    // The line of the fitted stem and the measured one, on which the misfit is judged.
    let (mx, my) = (mean(&x), mean(stem));
    let slope = {
        let moved = x.iter().zip(stem).map(|(x, m)| (x - mx) * (m - my)).sum::<f64>();
        moved / x.iter().map(|x| (x - mx).powi(2)).sum::<f64>()
    };
    let shown = excerpt(facts);
    let path = shown.clone().map(|k| (facts.u[k], stem[k])).collect();
    let fitted = shown.map(|k| (facts.u[k], my + slope * (x[k] - mx))).collect();
    let layers = vec![
        Layer::line("measured", Tone::Data, path),
        Layer::line("valve with the fitted S and J", Tone::Sticks, fitted),
    ];
    let title = "The measured stem against OP: a line where the valve follows, a loop where it sticks";
    vec![Picture::new(title, "OP (standard deviations)", "stem (standard deviations)", layers)]
}

/// What the loop says.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let Some(stem) = &facts.stem else { return Opinion::cannot_tell(ME, "no stem that moves is measured") };
    let found = fit(facts, stem);
    let percent = 100.0 / facts.op_range();
    let why = format!(
        "S {:.0} and J {:.0} % of OP's range explain {:.0} % of what a line of OP and stem leaves",
        found.s * percent,
        found.j * percent,
        100.0 * found.index
    );
    Opinion::of(ME, found.index, BAND, why).with(found.s * facts.unit, "dead band plus stick band S")
}
