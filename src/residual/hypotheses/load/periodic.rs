//! What periodic loads have in common, with harmonics or with corners: the number of their shapes, and how they are described.

use crate::residual::findings::Described;
use crate::residual::hypotheses::gains::of_wave;
use crate::signal::{figures, told};
use crate::sysid::armax::Armax;
use crate::sysid::iddata::IdData;
use std::f64::consts::TAU;

/// Sets of harmonics: of a sine, of a load with even harmonics, of a square or triangular wave.
pub const HARMONICS: [&[usize]; 3] = [&[1], &[1, 2, 3], &[1, 3, 5, 7, 9]];
/// Number of shapes: the sets of harmonics, and the wave with corners (-).
pub const PERIODIC_SHAPES: f64 = HARMONICS.len() as f64 + 1.0;

/// The description of a periodic load. `w`: its angular frequency (rad/sample); `own`: amplitude of its first harmonic in the
/// equation.
pub fn describe_periodic(data: &IdData, model: &Armax, w: f64, own: f64) -> Described {
    let period = TAU / w * data.units.ts;
    let [pv, op] = of_wave(data, model, w).map(|worth| own * worth);
    Described::new(format!(
        "a load with a period of {} s drives PV; its amplitude in PV would be {} without control",
        figures(period),
        told(pv)
    ))
    .with("period_s", period, "s")
    .with("amplitude", pv, "PV")
    .with("amplitude_op", op, "OP")
}
