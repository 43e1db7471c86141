//! The loop of OP and the measured stem: the reference for all methods that do not measure the stem.
//!
//! ```text
//! m[k] = a + b x[k - n] + e[k]          x: OP through a valve with S and J
//! (S, J, n) with the least sum of e²    index = 1 - V / V_0        V_0: V of a valve without friction
//! ```
//!
//! m: measured stem (its unit); x: simulated stem (OP unit); n: delay (samples); S: dead band plus stick band, J: slip jump (OP
//! unit); V: mean square of e; index: share of V_0 that friction explains (-).
//!
//! b may be negative: the position of a valve that opens without air is often measured in per cent open. Rows at which OP or PV was
//! not measured are left out. The method cannot tell where the best valve leaves most of the stem's variance: then something other
//! than OP moves the stem, or its signal is only sensor noise.
//!
//! Source: the valve is that of Choudhury, Thornhill & Shah, Control Eng. Practice 2005, 13, 641; the thresholds are
//! calibrated on simulated loops by `numerics/examples/opinions -- --calibrate`.
//! Limits: a stem signal that is a copy of OP shows no loop, and a slow positioner hides it; a positioner that lags by more than the
//! delays tried widens it.

use super::facts::Facts;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, excerpt};
use crate::signal::{Row, share_beside};
use crate::sysid::least_squares::{dot, total};
use crate::sysid::stats::mean;
use crate::sysid::valve::{StopRule, ValveModel};
use std::ops::Range;

const METHOD: Method = Method::StemLoop;
/// Thresholds of the index, calibrated (-): 95 % of the sound valves lie below 0.01, 95 % of the sticking above 0.5.
pub const BAND: Band = Band { sound: 0.1, sticks: 0.3 };
/// Longest delay of the stem (samples).
const DELAYS: usize = 3;
/// Values of S, up to the range of OP.
const BANDS: usize = 40;
/// Values of J for each S, up to S.
const JUMPS: usize = 4;
/// Step of OP below which OP has stopped, as a share of its range.
const RESOLUTION: f64 = 1e-4;
/// Share of the stem's variance that is added to V and V_0 (-): below it, nothing is left to explain.
const FLOOR: f64 = 1e-6;
/// Largest share of the stem's variance that the best valve may leave (-): above it OP moves less of the stem than something else
/// does, such as the noise of the sensor on a seized stem.
const MOST_LEFT: f64 = 0.5;
/// Variance in the rows that count below which a signal does not move, as a share of its variance over all rows (-): far above
/// rounding, and far below the resolution of any sensor.
const STILL: f64 = 1e-9;

/// The valve that fits best, S and J in standard deviations of OP, with the index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loop {
    /// Dead band plus stick band.
    pub s: f64,
    /// Slip jump.
    pub j: f64,
    /// When the stem rests.
    pub rule: StopRule,
    /// The index (-).
    pub index: f64,
    /// V as a share of the stem's variance (-).
    pub left: f64,
}

impl Loop {
    /// The fitted valve.
    fn valve(&self, facts: &Facts<'_>) -> ValveModel {
        ValveModel { s: self.s, j: self.j, ..frictionless(facts, self.rule) }
    }
}

/// A valve without friction, with the resolution below which OP has stopped.
fn frictionless(facts: &Facts<'_>, rule: StopRule) -> ValveModel {
    ValveModel { rule, resolution: RESOLUTION * facts.op_range(), ..ValveModel::default() }
}

/// Fits a valve to a measured stem, over a grid of S and J and a finer grid around its best.
pub fn fit(facts: &Facts<'_>, stem: &[f64]) -> Loop {
    let runs = measured(facts);
    let without = unexplained(&facts.u, stem, &runs);
    let mut best = (without, 0.0, 0.0, StopRule::Stop);
    let (mut x, mut dir) = (Vec::new(), Vec::new());
    let mut offer = |s: f64, j: f64, best: &mut (f64, f64, f64, StopRule)| {
        for rule in [StopRule::Stop, StopRule::Slip] {
            let valve = ValveModel { s, j, ..frictionless(facts, rule) };
            valve.run(&facts.u, facts.start, facts.len(), &mut x, &mut dir);
            let left = unexplained(&x, stem, &runs);
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
    Loop { s, j, rule, index: 1.0 - (left + FLOOR) / (without + FLOOR), left }
}

/// The runs of rows at which OP and PV were measured.
fn measured(facts: &Facts<'_>) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for k in (0..facts.len()).filter(|k| facts.window.row(*k) != Row::Missing) {
        match runs.last_mut() {
            Some(run) if run.end == k => run.end += 1,
            _ => runs.push(k..k + 1),
        }
    }
    runs
}

/// Share of the stem's variance that a regression on `x` leaves, at the best delay (-), over the rows in `runs`.
fn unexplained(x: &[f64], stem: &[f64], runs: &[Range<usize>]) -> f64 {
    (0..=DELAYS)
        .map(|delay| {
            let (mut count, mut sx, mut sm, mut xx, mut mm, mut xm) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
            for run in runs.iter().filter(|run| run.len() > delay) {
                let (x, m) = (&x[run.start..run.end - delay], &stem[run.start + delay..run.end]);
                count += x.len() as f64;
                (sx, sm) = (sx + total(x), sm + total(m));
                (xx, mm, xm) = (xx + dot(x, x), mm + dot(m, m), xm + dot(x, m));
            }
            // Without any row these are NaN, and compare as false.
            let (xx, mm, xm) = (xx - sx * sx / count, mm - sm * sm / count, xm - sx * sm / count);
            let moves = xx > STILL * count && mm > STILL * count;
            if moves { (1.0 - xm * xm / (xx * mm)).max(0.0) } else { 1.0 }
        })
        .fold(1.0, f64::min)
}

/// The measured stem against OP, with the stem of the fitted valve.
pub(super) fn picture(facts: &Facts<'_>) -> Vec<Picture> {
    let Some(stem) = &facts.stem else { return Vec::new() };
    let found = fit(facts, stem);
    let (mut x, mut dir) = (Vec::new(), Vec::new());
    found.valve(facts).run(&facts.u, facts.start, facts.len(), &mut x, &mut dir);
    // The regression of the measured stem on the fitted one, over the same rows as the fit.
    let rows: Vec<usize> = measured(facts).into_iter().flatten().collect();
    let at_rows = |v: &[f64]| rows.iter().map(|k| v[*k]).collect::<Vec<f64>>();
    let (of_x, of_stem) = (at_rows(&x), at_rows(stem));
    let (mx, my) = (mean(&of_x), mean(&of_stem));
    let slope = {
        let moved = of_x.iter().zip(&of_stem).map(|(x, m)| (x - mx) * (m - my)).sum::<f64>();
        moved / of_x.iter().map(|x| (x - mx).powi(2)).sum::<f64>()
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

/// The opinion of the method.
pub fn opinion(facts: &Facts<'_>) -> Opinion {
    let Some(stem) = &facts.stem else {
        return Opinion::cannot_tell(METHOD, "no stem that moves is measured");
    };
    let found = fit(facts, stem);
    if found.left > MOST_LEFT {
        let left = share_beside(found.left, &[MOST_LEFT], 0);
        let why =
            format!("neither OP nor a valve behind it moves the stem: they leave {left} of its variance");
        return Opinion::cannot_tell(METHOD, why);
    }
    let percent = 100.0 / facts.op_range();
    let why = format!(
        "S {:.0} and J {:.0} % of OP's range explain {} of what a line of OP and stem leaves",
        found.s * percent,
        found.j * percent,
        BAND.told_in_percent(found.index)
    );
    Opinion::of(METHOD, found.index, BAND, why).with(found.s * facts.unit, "dead band plus stick band S")
}

#[cfg(test)]
mod tests {
    use super::super::opinion::Says;
    use super::*;
    use crate::signal::Window;
    use crate::sysid::valve::Start;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    /// Twelve periods of 80 samples.
    const N: usize = 960;

    fn noise(seed: u64) -> Vec<f64> {
        StandardNormal.sample_iter(rand_pcg::Pcg64Mcg::seed_from_u64(seed)).take(N).collect()
    }

    fn swing() -> Vec<f64> {
        let wave = |k: usize| 50.0 + 10.0 * (TAU * k as f64 / 80.0).sin();
        noise(1).iter().enumerate().map(|(k, e)| wave(k) + 0.03 * e).collect()
    }

    /// The stem of a valve with a dead band of 3, which is 15 % of OP's range.
    fn stuck(op: &[f64]) -> Vec<f64> {
        let (mut stem, mut dir) = (Vec::new(), Vec::new());
        let valve = ValveModel { s: 3.0, ..ValveModel::default() };
        valve.run(op, Start { index: 20, is_max: true }, N, &mut stem, &mut dir);
        stem.iter().zip(noise(2)).map(|(x, e)| x + 0.03 * e).collect()
    }

    fn said(op: &[f64], stem: Vec<f64>, rows: Vec<Row>) -> Opinion {
        let (op, pv) = (op.to_vec(), op.to_vec());
        let window = Window { ts: 1.0, op, pv, mv: Some(stem), rows, ..Window::default() };
        opinion(&Facts::new(&window, Some(false)).expect("OP moves"))
    }

    #[test]
    fn a_stem_that_moves_against_op_is_judged_as_its_mirror_image() {
        let op = swing();
        let stem = stuck(&op);
        let mirrored: Vec<f64> = stem.iter().map(|x| 100.0 - x).collect();
        let (along, against) = (said(&op, stem, Vec::new()), said(&op, mirrored, Vec::new()));
        assert_eq!((along.says, against.says), (Says::Sticks, Says::Sticks), "{along:?} {against:?}");
        let apart = along.index.zip(against.index).map(|(a, b)| (a - b).abs());
        assert!(apart.is_some_and(|apart| apart < 1e-6), "{along:?} {against:?}");
        // One that follows is sound either way.
        for sign in [1.0, -1.0] {
            let stem = op.iter().zip(noise(3)).map(|(u, e)| sign * u + 0.03 * e).collect();
            assert_eq!(said(&op, stem, Vec::new()).says, Says::Sound);
        }
    }

    #[test]
    fn of_a_seized_stem_nothing_is_said() {
        let stem = noise(4).iter().map(|e| 42.0 + 0.05 * e).collect();
        let found = said(&swing(), stem, Vec::new());
        assert_eq!((found.says, found.index), (Says::CannotTell, None), "{found:?}");
        assert!(found.why.starts_with("neither OP nor a valve"), "{found:?}");
    }

    #[test]
    fn what_was_not_measured_does_not_count() {
        let op = swing();
        let mut stem = stuck(&op);
        let in_hole = |k: usize| (50..75).contains(&(k % 100));
        for k in 1..N {
            if in_hole(k) {
                // The gate holds the stem there, while it carries OP on.
                stem[k] = stem[k - 1];
            }
        }
        let rows = (0..N).map(|k| if in_hole(k) { Row::Missing } else { Row::Counts }).collect();
        let found = said(&op, stem, rows);
        assert!(found.index.is_some_and(|index| index > 0.9), "{found:?}");
        // 15 % of OP's range; a step of the grid is OP's range over 160.
        assert!(found.quantity.is_some_and(|q| (q.value - 3.0).abs() < 0.2), "{found:?}");
    }
}
