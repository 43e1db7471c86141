//! Changes at a time: the unit step, the times beside one, and the largest step.

use crate::sysid::iddata::IdData;

/// Largest step that is believed, in standard deviations of OP or PV.
pub const LARGEST_STEP: f64 = 20.0;

/// The unit step: 0 before sample `at`, 1 from there on.
pub fn heaviside(n: usize, at: usize) -> Vec<f64> {
    (0..n).map(|k| f64::from(u8::from(k >= at))).collect()
}

/// The times on each side of `at`, inside the fitted rows (samples): 4 samples away at step 1, 2 at 1/2, 1 at 1/4.
pub fn neighbouring_times(at: usize, data: &IdData, step: f64) -> Vec<usize> {
    let by = (4.0 * step).round().max(1.0) as usize;
    let inside = |at: &usize| (data.first + 2..data.split - 2).contains(at);
    [at.saturating_sub(by), at + by].into_iter().filter(inside).collect()
}
