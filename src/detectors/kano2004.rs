//! Kano, Maruta, Kugemoto & Shimizu 2004: two methods on the plot of OP against flow or stem.
//!
//! A: the time in which the stem stands still although OP moves.
//!
//! ```text
//! index_A = samples in still stretches in which OP moves by more than E_u / N
//! still: every |y[k] - y[k - h]| <= E_y        S_A = mean of OP's range over those stretches
//! ```
//!
//! B: a valve that sticks draws a parallelogram. xi is how far the stem is behind OP, up to xi_max on one side:
//!
//! ```text
//! xi[k] = max(min(xi[k-1] + u[k] - u[k-1], xi_max), 0)         r(xi_max) = correlation of u - xi with y
//! index_B = (r_max - r_0) / (1 - r_0)                          r_0 = r(0), r_max at S_B = xi_max
//! ```
//!
//! u: OP (OP unit); y: stem, or PV for it (its unit); N: samples; indices (-); S_A, S_B (OP unit) measure dead band plus stick
//! band.
//!
//! Source: Practical model and detection algorithm for valve stiction, IFAC DYCOPS 2004. The paper leaves its thresholds to
//! the user: those here are calibrated on simulated loops by `numerics/examples/opinions -- --calibrate`. Chosen here:
//! h a thirtieth of a period, E_y a quarter of the mean change, E_u a tenth of OP's range.
//! Limits: PV stands for the stem in flow loops alone, so that processes which integrate are refused and slow ones missed;
//! a pure dead band is found by B and hardly by A; noise hides what stands still.

use super::{Band, Facts, Integrates, Method, Opinion};
use crate::sysid::stats::{mean, range, sd};

/// Threshold of A's index, calibrated (-): more than a tenth of the valves that stick have an index of 0.
pub const BAND_A: Band = Band::above(0.16);
/// Threshold of B's index, calibrated (-): likewise.
pub const BAND_B: Band = Band::above(0.71);
/// Changes are taken over the period divided by this.
const PARTS: f64 = 30.0;
/// `E_y` as a share of the mean change, and `E_u` as a share of OP's range.
const STILL: f64 = 0.25;
const MOVES: f64 = 0.1;
/// Values of xi_max tried up to OP's range.
const BANDS: usize = 40;

/// The stem, or what stands for it.
fn stem<'a>(facts: &'a Facts<'_>) -> Result<(&'static str, &'a [f64]), String> {
    match (&facts.stem, facts.integration.answer) {
        (Some(stem), _) => Ok(("the measured stem", stem)),
        (None, Integrates::No) => Ok(("PV", &facts.y)),
        (None, Integrates::Yes) => Err("the process integrates: PV does not stand for the stem".into()),
        (None, Integrates::Unknown) => Err(facts.integration.why()),
    }
}

/// A's index, and the mean range of OP while the stem stands still.
pub fn still(u: &[f64], y: &[f64], step: usize) -> (f64, f64) {
    let n = u.len().min(y.len());
    let changes: Vec<f64> = y[..n].windows(step + 1).map(|w| (w[step] - w[0]).abs()).collect();
    let limit = STILL * mean(&changes);
    let (low, high) = range(&u[..n]);
    let (mut samples, mut ranges, mut from) = (0, Vec::new(), 0);
    for run in changes.chunk_by(|a, b| (*a <= limit) == (*b <= limit)) {
        let to = from + run.len() + step;
        if run[0] <= limit {
            let (least, most) = range(&u[from..to]);
            if most - least > MOVES * (high - low) {
                samples += run.len();
                ranges.push(most - least);
            }
        }
        from += run.len();
    }
    (samples as f64 / n.max(1) as f64, mean(&ranges))
}

/// What method A says.
pub fn opinion_a(facts: &Facts<'_>) -> Opinion {
    const ME: Method = Method::Kano2004A;
    let (period, (name, stem)) = match facts.oscillates().and_then(|period| Ok((period, stem(facts)?))) {
        Ok(found) => found,
        Err(why) => return Opinion::cannot_tell(ME, why),
    };
    let step = ((period / PARTS).round() as usize).max(1);
    let (index, s) = still(&facts.u, stem, step);
    let why = format!("{name} stands still and OP moves for {:.0} % of the time", 100.0 * index);
    Opinion::of(ME, index, BAND_A, why)
        .with(s * facts.unit, "mean movement of OP while the stem stands still")
}

/// B's index and xi_max; none where nothing correlates.
pub fn parallelogram(u: &[f64], y: &[f64]) -> Option<(f64, f64)> {
    let (low, high) = range(u);
    let mut plain = None;
    let mut best = (f64::NEG_INFINITY, 0.0);
    for i in 0..BANDS {
        let top = (high - low) * i as f64 / BANDS as f64;
        let (mut xi, mut before) = (0.5 * top, *u.first()?);
        let stem: Vec<f64> = u
            .iter()
            .map(|u| {
                xi = (xi + u - before).min(top).max(0.0);
                before = *u;
                u - xi
            })
            .collect();
        let r = correlation(&stem, y)?.abs();
        plain = plain.or(Some(r));
        if r > best.0 {
            best = (r, top);
        }
    }
    let plain = plain?;
    // Without a dead band the correlation may be perfect already: nothing is left to improve.
    let left = (1.0 - plain).max(1e-9);
    Some(((best.0 - plain) / left, best.1))
}

fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let (ma, mb) = (mean(a), mean(b));
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (a - ma) * (b - mb)).sum();
    let r = sum / (a.len() as f64 * sd(a) * sd(b));
    r.is_finite().then_some(r)
}

/// What method B says.
pub fn opinion_b(facts: &Facts<'_>) -> Opinion {
    const ME: Method = Method::Kano2004B;
    let (_, (name, stem)) = match facts.oscillates().and_then(|period| Ok((period, stem(facts)?))) {
        Ok(found) => found,
        Err(why) => return Opinion::cannot_tell(ME, why),
    };
    let Some((index, s)) = parallelogram(&facts.u, stem) else {
        return Opinion::cannot_tell(ME, "OP and PV do not correlate");
    };
    let why =
        format!("a parallelogram explains {:.0} % of what a line of OP and {name} leaves", 100.0 * index);
    Opinion::of(ME, index, BAND_B, why).with(s * facts.unit, "dead band plus stick band S")
}
