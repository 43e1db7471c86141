//! The penalty of a valve: what its parameters and its alternatives cost in the criterion.

use crate::sysid::criterion::{REGULAR, THRESHOLD};
use crate::sysid::valve::{StopRule, ValveModel};

/// Resolutions tried: these quantiles of the steps of OP. A stem that stops at larger ones hardly moves.
pub(super) const RESOLUTIONS: [f64; 7] = [0.003, 0.006, 0.0125, 0.025, 0.05, 0.1, 0.2];

/// The penalty of a valve: the sum of the rates of its parameters, and the number of alternatives (-), as
/// [`crate::sysid::criterion::score`] takes them. `(0, 1)` without friction.
pub fn cost(valve: Option<&ValveModel>) -> (f64, f64) {
    let Some(valve) = valve else { return (0.0, 1.0) };
    let of_j = match valve.rule {
        _ if valve.j == valve.s => 0.0,
        StopRule::Reversal => REGULAR,
        _ => THRESHOLD,
    };
    let resolutions = if valve.resolution > 0.0 { RESOLUTIONS.len() as f64 } else { 1.0 };
    (THRESHOLD + of_j, StopRule::ALL.len() as f64 * resolutions)
}
