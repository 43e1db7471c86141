//! The free run of a model: PV is computed from the stem and the loads alone, and from measured PV only at the start.
//!
//! ```text
//! y[k] = -sum a_i y[k-i] + sum b_j x[k-nk-(j-1)] + c0 + sum gamma_m phi_m[k] (+ sum c_i e[k-i] before the start)
//! ```

use super::armax::{Armax, ORDER, Signals};
use super::iddata::IdData;
use super::zeros::draw_inside;

/// Largest PV of a run (standard deviations): an unstable A must not end in infinities.
const FARTHEST: f64 = 1e6;

/// PV run free from sample `from` on; PV as measured before it (normalised).
///
/// * `signals`: the input at the parameters of the model.
/// * `e`: one-step prediction errors; those before a start are used.
/// * `stretch`: number of samples after which the run starts again from measured PV. Without it an integrating process would be
///   judged by one slow error.
pub fn simulate(
    model: &Armax,
    data: &IdData,
    signals: &Signals,
    e: &[f64],
    from: usize,
    stretch: usize,
) -> Vec<f64> {
    let mut model = model.clone();
    // One-step errors hide an A just outside the unit circle.
    draw_inside(&mut model.a, 1.0);
    let shown = |k: usize| signals.offset.get(k).copied().unwrap_or(0.0);
    let measured: Vec<f64> = data.y.iter().enumerate().map(|(k, y)| y - shown(k)).collect();
    let mut y = measured.clone();
    let mut origin = from;
    for k in from.max(model.begin(data))..data.len() {
        if k >= origin + stretch.max(1) {
            origin = k;
        }
        let mut value = model.c0;
        for i in 1..=ORDER {
            let past = if k - i < origin { measured[k - i] } else { y[k - i] };
            value -= model.a[i - 1] * past;
            if k - i < origin {
                value += model.c[i - 1] * e[k - i];
            }
            value += model.b[i - 1] * signals.x[k - model.nk - (i - 1)];
        }
        for (gamma, shape) in model.gamma.iter().zip(&signals.shapes) {
            value += gamma * shape[k];
        }
        y[k] = value.clamp(-FARTHEST, FARTHEST);
    }
    y.iter_mut().enumerate().for_each(|(k, y)| *y += shown(k));
    y
}
