//! The open loop of a PI or PID controller and a linear process, at any frequency.
//!
//! ```text
//! L(z) = C(z) G(z),   z = e^(j omega ts)
//! C = (q0 + q1 z^-1 + q2 z^-2) / (1 - z^-1)
//! G = z^-nk (b1 + b2 z^-1 + …) / (1 + a1 z^-1 + a2 z^-2 + …)
//! ```
//!
//! `q` controller (OP unit per PV unit), `a`, `b` and `nk` as [`Model`] has them, `omega` frequency (rad/s), `ts` sample period (s).
//! G has the hold of OP between two samples in it, because it is identified from samples.

use crate::diagnosis::Model;
use nalgebra::Complex;
use std::f64::consts::PI;
use std::iter::successors;

/// Part of an angle over which a slope is taken (-): the errors of the difference and of its rounding are both near 1e-10.
const STEP: f64 = 1e-5;

/// A controller and a process.
#[derive(Clone, Copy, Debug)]
pub struct OpenLoop<'a> {
    /// `q0`, `q1`, `q2` (OP unit per PV unit).
    pub controller: [f64; 3],
    /// The process, from OP to PV.
    pub process: &'a Model,
}

impl OpenLoop<'_> {
    /// L at an angle omega ts (0..pi rad).
    pub fn at(&self, angle: f64) -> Complex<f64> {
        let back = delay(angle);
        let controller = polynomial(&self.controller, back) / (Complex::new(1.0, 0.0) - back);
        let dead = back.powu(u32::try_from(self.process.nk).unwrap_or(u32::MAX));
        controller * dead * polynomial(&self.process.b, back) / self.poles(back)
    }

    /// Derivative of ln L by the angle: its real part is that of ln |L|, its imaginary part that of arg L.
    pub fn slope(&self, angle: f64) -> Complex<f64> {
        let step = STEP * angle;
        (self.at(angle + step) / self.at(angle - step)).ln() / (2.0 * step)
    }

    /// Derivatives of ln L by the coefficients of A and then of B.
    pub fn sensitivity(&self, angle: f64) -> Vec<Complex<f64>> {
        let back = delay(angle);
        let powers = |from: Complex<f64>| successors(Some(from), move |power| Some(power * back));
        let (poles, zeros) = (self.poles(back), polynomial(&self.process.b, back));
        let by_a = powers(back).take(self.process.a.len()).map(|power| -power / poles);
        let by_b = powers(Complex::new(1.0, 0.0)).take(self.process.b.len()).map(|power| power / zeros);
        by_a.chain(by_b).collect()
    }

    /// A, the denominator of G.
    fn poles(&self, back: Complex<f64>) -> Complex<f64> {
        polynomial(&self.process.a, back) * back + 1.0
    }
}

/// z^-1 at an angle, real at pi.
fn delay(angle: f64) -> Complex<f64> {
    if (angle - PI).abs() < f64::EPSILON { Complex::new(-1.0, 0.0) } else { Complex::from_polar(1.0, -angle) }
}

/// `c0 + c1 x + c2 x² + …`.
fn polynomial(coefficients: &[f64], x: Complex<f64>) -> Complex<f64> {
    coefficients.iter().rev().fold(Complex::new(0.0, 0.0), |sum, c| sum * x + *c)
}
