//! Kano, Maruta, Kugemoto & Shimizu 2004: two methods on the plot of OP against flow or stem.
//!
//! A: the share of the time in which the stem stands still although OP moves.
//!
//! ```text
//! index_A = samples in still stretches in which OP moves by more than E_u / N
//! still: every |y[k] - y[k - h]| <= E_y        S_A = mean of OP's range over those stretches
//! ```
//!
//! B: a valve that sticks draws a parallelogram. xi is the distance of the stem behind OP, at most xi_max on one side:
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
//! Limits: PV takes the place of the stem in flow loops alone, so that integrating processes are refused and slow ones missed; a pure
//! dead band is found by B and hardly by A; noise hides a standstill.

use super::facts::Facts;
use super::opinion::{Band, Method, Opinion};
use super::picture::{Layer, Picture, Tone, excerpt};
use crate::sysid::stats::{mean, range, sd};

/// Threshold of A's index, calibrated (-): more than a tenth of the valves that stick have an index of 0.
pub const BAND_A: Band = Band::above(0.16);
/// Threshold of B's index, calibrated (-): likewise.
pub const BAND_B: Band = Band::above(0.71);
/// Changes are taken over the period divided by this.
const PARTS: f64 = 30.0;
/// `E_y`, as a share of the mean change.
const STILL: f64 = 0.25;
/// `E_u`, as a share of OP's range.
const MOVES: f64 = 0.1;
/// Values of xi_max tried up to OP's range.
const BANDS: usize = 40;

/// The stretches in which the stem stands still although OP moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Still {
    /// A's index: their share of the samples (-).
    pub index: f64,
    /// S_A: mean range of OP over them, in the unit of `u`.
    pub s: f64,
    /// The stretches (samples).
    pub stretches: Vec<std::ops::Range<usize>>,
}

/// Finds the stretches in which the stem stands still although OP moves.
///
/// * `u`, `y`: OP and the stem.
/// * `step`: h, the samples over which changes are taken.
pub fn still(u: &[f64], y: &[f64], step: usize) -> Still {
    let n = u.len().min(y.len());
    let changes: Vec<f64> = y[..n].windows(step + 1).map(|w| (w[step] - w[0]).abs()).collect();
    let limit = STILL * mean(&changes);
    let (low, high) = range(&u[..n]);
    let (mut samples, mut ranges, mut from, mut stretches) = (0, Vec::new(), 0, Vec::new());
    for run in changes.chunk_by(|a, b| (*a <= limit) == (*b <= limit)) {
        let to = from + run.len() + step;
        if run[0] <= limit {
            let (least, most) = range(&u[from..to]);
            if most - least > MOVES * (high - low) {
                samples += run.len();
                ranges.push(most - least);
                stretches.push(from..to);
            }
        }
        from += run.len();
    }
    Still { index: samples as f64 / n.max(1) as f64, s: mean(&ranges), stretches }
}

/// Evaluates method A: the name and the values of the stem, or of PV in its place, and its standstills.
fn evaluate_a<'a>(facts: &'a Facts<'_>) -> Result<(&'static str, &'a [f64], Still), String> {
    let period = facts.oscillates()?;
    let (name, stem) = facts.stem_or_pv()?;
    let step = ((period / PARTS).round() as usize).max(1);
    Ok((name, stem, still(&facts.u, stem, step)))
}

/// OP and stem over time, the still stretches marked.
pub(super) fn picture_a(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok((name, stem, found)) = evaluate_a(facts) else { return Vec::new() };
    let shown = excerpt(facts);
    let at = |k: usize| (k - shown.start) as f64 * facts.window.ts;
    let over = |v: &[f64]| shown.clone().map(|k| (at(k), v[k])).collect();
    let stands = found.stretches.iter().flat_map(Clone::clone).filter(|k| shown.contains(k));
    let layers = vec![
        Layer::line("OP", Tone::Beside, over(&facts.u)),
        Layer::line(name, Tone::Data, over(stem)),
        Layer::dots("stands still while OP moves", Tone::Sticks, stands.map(|k| (at(k), stem[k])).collect()),
    ];
    let title =
        format!("A few periods from the middle of the record: where {name} stands still while OP moves");
    vec![Picture::new(title, "time (s)", "standard deviations", layers)]
}

/// The opinion of method A.
pub fn opinion_a(facts: &Facts<'_>) -> Opinion {
    const METHOD: Method = Method::Kano2004A;
    let (name, _, Still { index, s, .. }) = match evaluate_a(facts) {
        Ok(found) => found,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    let why = format!("{name} stands still and OP moves for {} of the time", BAND_A.told_in_percent(index));
    Opinion::of(METHOD, index, BAND_A, why)
        .with(s * facts.unit, "mean movement of OP while the stem stands still")
}

/// The parallelogram of OP and stem that fits best.
#[derive(Clone, Debug, PartialEq)]
pub struct Parallelogram {
    /// B's index (-).
    pub index: f64,
    /// S_B = xi_max, in the unit of `u`.
    pub s: f64,
    /// Sign of r there: -1 where the stem, or PV in its place, moves against OP.
    pub sign: f64,
    /// |r| over xi_max.
    pub tried: Vec<(f64, f64)>,
}

/// The stem of a valve with a pure dead band: `u - xi`, with xi between 0 and `top`.
fn dead_band(u: &[f64], top: f64) -> Vec<f64> {
    let (mut xi, mut before) = (0.5 * top, u.first().copied().unwrap_or(0.0));
    let step = |u: &f64| {
        xi = (xi + u - before).min(top).max(0.0);
        before = *u;
        u - xi
    };
    u.iter().map(step).collect()
}

/// The parallelogram of OP and stem; none where nothing correlates.
pub fn parallelogram(u: &[f64], y: &[f64]) -> Option<Parallelogram> {
    if u.is_empty() {
        return None;
    }
    let (low, high) = range(u);
    let (mut tried, mut best) = (Vec::with_capacity(BANDS), (f64::NEG_INFINITY, 0.0, 1.0));
    for i in 0..BANDS {
        let top = (high - low) * i as f64 / BANDS as f64;
        let r = correlation(&dead_band(u, top), y)?;
        tried.push((top, r.abs()));
        if r.abs() > best.0 {
            best = (r.abs(), top, r.signum());
        }
    }
    let plain = tried.first()?.1;
    // Without a dead band the correlation may be perfect already, with nothing left to improve.
    let left = (1.0 - plain).max(1e-9);
    Some(Parallelogram { index: (best.0 - plain) / left, s: best.1, sign: best.2, tried })
}

/// Evaluates method B: the name and the values of the stem, or of PV in its place, and its parallelogram.
fn evaluate_b<'a>(facts: &'a Facts<'_>) -> Result<(&'static str, &'a [f64], Parallelogram), String> {
    facts.oscillates()?;
    let (name, stem) = facts.stem_or_pv()?;
    let found = parallelogram(&facts.u, stem).ok_or("OP and PV do not correlate")?;
    Ok((name, stem, found))
}

/// OP against the stem with the parallelogram, and how its width was found.
pub(super) fn picture_b(facts: &Facts<'_>) -> Vec<Picture> {
    let Ok((name, stem, found)) = evaluate_b(facts) else { return Vec::new() };
    let shown = excerpt(facts);
    let lagging = dead_band(&facts.u, found.s);
    // The regression line of the stem on the lagging OP.
    let (mx, my) = (mean(&lagging), mean(stem));
    let slope = correlation(&lagging, stem).unwrap_or(0.0) * sd(stem) / sd(&lagging);
    let path = shown.clone().map(|k| (facts.u[k], stem[k])).collect();
    let fitted = shown.map(|k| (facts.u[k], my + slope * (lagging[k] - mx))).collect();
    let layers =
        vec![Layer::line("path", Tone::Data, path), Layer::line("parallelogram", Tone::Sticks, fitted)];
    let widths = found.tried.iter().map(|(top, r)| (top * facts.unit, *r)).collect();
    let best = vec![
        Layer::line("correlation", Tone::Data, widths),
        Layer::upright("the best", Tone::Sticks, found.s * facts.unit),
    ];
    let y = format!("{name} (standard deviations)");
    let title = format!("OP against {name}, and the parallelogram that follows it best");
    vec![
        Picture::new(title, "OP (standard deviations)", &y, layers),
        Picture::new(
            "How well a parallelogram follows, by its width",
            "width S (OP unit)",
            "correlation (-)",
            best,
        ),
    ]
}

/// The correlation of two signals; none where one does not move.
fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let (ma, mb) = (mean(a), mean(b));
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (a - ma) * (b - mb)).sum();
    let r = sum / (a.len() as f64 * sd(a) * sd(b));
    r.is_finite().then_some(r)
}

/// The opinion of method B.
pub fn opinion_b(facts: &Facts<'_>) -> Opinion {
    const METHOD: Method = Method::Kano2004B;
    let (name, _, Parallelogram { index, s, .. }) = match evaluate_b(facts) {
        Ok(found) => found,
        Err(why) => return Opinion::cannot_tell(METHOD, why),
    };
    let explained = BAND_B.told_in_percent(index);
    let why = format!("a parallelogram explains {explained} of what a line of OP and {name} leaves");
    Opinion::of(METHOD, index, BAND_B, why).with(s * facts.unit, "dead band plus stick band S")
}
