//! Loads that come from elsewhere in a plant and swing about as they like: no hypothesis of tracing describes them quite.

use super::draw::{Draw, deviation, lagged};
use std::f64::consts::TAU;

/// About how many samples one swing takes.
const PERIOD: (f64, f64) = (20.0, 200.0);
/// How much one swing's length differs from the next (standard deviation of its logarithm).
const WANDER: (f64, f64) = (0.02, 0.3);
/// Time in which the load arrives (samples).
const LAG: (f64, f64) = (0.5, 20.0);

/// A load of standard deviation 1.
pub fn draw_swings(n: usize, draw: &mut Draw) -> Vec<f64> {
    let period = draw.log(PERIOD.0, PERIOD.1);
    let wander = draw.log(WANDER.0, WANDER.1);
    let shape: fn(f64, f64) -> f64 = match draw.whole(0, 3) {
        // A pump that runs for a part of each swing.
        0 => |phase, part| f64::from(u8::from(phase < part)),
        // A tank that fills slowly and is emptied at once, or the other way round.
        1 => |phase, part| if part < 0.5 { phase } else { 1.0 - phase },
        // Another loop whose valve sticks.
        2 => |phase, _| (2.0 * phase - 1.0).abs(),
        // A fan, a furnace: a sine whose period wanders.
        _ => |phase, _| (TAU * phase).sin(),
    };
    let part = draw.even(0.25, 0.75);
    let steps = draw.chance(0.2).then(|| draw.steps(n, period));
    let lag = draw.log(LAG.0, LAG.1);
    let mut phase = draw.even(0.0, 1.0);
    let mut own = period;
    let mut swing = || {
        phase += 1.0 / own;
        if phase >= 1.0 {
            phase -= 1.0;
            own = period * (wander * draw.normal()).exp();
        }
        shape(phase, part)
    };
    // Orders, batches: levels at any time.
    let load = steps.unwrap_or_else(|| (0..n).map(|_| swing()).collect());
    let load = lagged(&load, lag);
    let (mean, sd) = (load.iter().sum::<f64>() / n as f64, deviation(&load).max(1e-9));
    load.iter().map(|value| (value - mean) / sd).collect()
}
