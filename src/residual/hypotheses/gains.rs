//! Static and dynamic gains of the fitted model: they put a load of the equation into the units of OP and PV.

use crate::sysid::armax::Armax;
use crate::sysid::iddata::IdData;

/// Least `|A|` and `|B|` by which a load is divided: an integrating process has `A(1) = 0`, and one that does not answer OP `B = 0`.
const LEAST: [f64; 2] = [1e-3, 1e-6];

/// `1/x`, with `|x|` not below `least`.
fn reciprocal(x: f64, least: f64) -> f64 {
    1.0 / if x.abs() < least { least.copysign(x) } else { x }
}

/// Static gain from a load in the equation to the move of the stem with the same effect, `1/B(1)` (OP unit).
pub fn in_op(data: &IdData, model: &Armax) -> f64 {
    reciprocal(model.b.iter().sum(), LEAST[1]) * data.units.u
}

/// Static gain from a load in the equation to PV without control, `1/A(1)` (PV unit). Of an integrating process it is the change of
/// PV in the first thousand samples.
pub fn in_pv(data: &IdData, model: &Armax) -> f64 {
    reciprocal(1.0 + model.a.iter().sum::<f64>(), LEAST[0]) * data.units.y
}

/// The gains `1/|A|` and `1/|B|` from a sine in the equation to PV without control and to the stem (PV unit, OP unit). `w`: its
/// angular frequency (rad/sample).
pub fn of_wave(data: &IdData, model: &Armax, w: f64) -> [f64; 2] {
    let of = |numbers: &mut dyn Iterator<Item = f64>, least: f64| {
        let (mut re, mut im) = (0.0, 0.0);
        for (lag, number) in numbers.enumerate() {
            let (s, c) = (w * lag as f64).sin_cos();
            (re, im) = (re + number * c, im - number * s);
        }
        reciprocal(re.hypot(im), least)
    };
    let a = of(&mut [1.0].into_iter().chain(model.a), LEAST[0]);
    let b = of(&mut model.b.into_iter(), LEAST[1]);
    [a * data.units.y, b * data.units.u]
}
