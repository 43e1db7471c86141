//! Whether PV answers as a hypothesis of the valve says, asked with OP beside it (see [`crate::sysid::encompass`]).

use super::decide::{Decided, has_positive_feedback};
use super::hypothesis::Hypothesis;
use crate::sysid::encompass::{Encompassing, Response};
use crate::sysid::iddata::{IdData, LONGEST_LAG};
use crate::sysid::valve::ValveModel;

/// Whether PV is seen to follow the stem beside the effects, and does not move against it beside OP.
pub fn follows(data: &IdData, best: &Decided) -> bool {
    if has_positive_feedback(data, &best.model) {
        return false;
    }
    let best = &best.hypothesis;
    let valve = best.valve.map(|valve| ValveModel::one_parameter(valve.f()));
    let stem = Hypothesis { valve, effects: Vec::new() }.stem(data).0;
    // OP goes the same way to the process.
    let [p, u] = [stem, data.u.clone()].map(|own| best.to_process(data, own));
    let bends = best.effects.iter().any(|effect| effect.bends());
    let mut loads = Vec::new();
    best.effects.iter().for_each(|effect| effect.shapes(data, &mut loads));
    asked(data, best, &loads, [&p, &u]).is_none_or(|found| found.is_seen() && (bends || !found.is_reversed()))
}

/// Whether PV follows the stem up to the stop that is effect `at`, and is not seen to follow what the stop keeps back. Loads that
/// enter the equation are left out: they may be what makes up for a stop that is not there.
pub fn stops(data: &IdData, best: &Hypothesis, at: usize) -> bool {
    let arrives = |of: &Hypothesis| of.to_process(data, of.stem(data).0);
    let (p, whole) = (arrives(best), arrives(&best.without(at)));
    let lost: Vec<f64> = whole.iter().zip(&p).map(|(whole, p)| whole - p).collect();
    asked(data, best, &[], [&p, &lost]).is_none_or(|found| found.is_seen() && !found.is_seen_of_other())
}

fn asked(data: &IdData, best: &Hypothesis, extra: &[Vec<f64>], [p, u]: [&[f64]; 2]) -> Option<Response> {
    let counts: Vec<bool> = data.weight.iter().map(|weight| *weight > 0.0).collect();
    let (y, rows, lags) = (best.pv(data), data.rows(), LONGEST_LAG);
    let (counts, gain_sign) = (counts.as_slice(), data.gain_sign);
    Encompassing { y: &y, u, p, extra, lags, rows, counts, gain_sign }.response()
}
