//! What else has been proposed to get a sticking valve moving by a term added to OP.
//!
//! The two-move method (Srinivasan & Rengaswamy, Comput. Chem. Eng. 2008) is not here: it brings the stem to the OP of
//! the steady state and then holds it there against the controller. It has to know that OP beforehand, and while
//! it holds, no load is controlled: it is not a term beside a controller at work.

use super::{Compensator, sign};

/// The knocker (Hägglund, J. Process Control 2002, 12, 897): pulses of height a and width τ, one every h_k, in the
/// direction in which OP has moved since the pulse before, `a sign(u(t) - u(t_p))`.
///
/// With τ and h_k both one sample period it is constant reinforcement.
#[derive(Clone, Debug)]
pub struct Knocker {
    amplitude: f64,
    width_s: f64,
    period_s: f64,
    since_s: f64,
    at_pulse: Option<f64>,
    direction: f64,
}

impl Knocker {
    /// Pulses of `amplitude` a [%] and `width_s` τ (s), the starts of two of them `period_s` h_k (s) apart.
    pub fn new(amplitude: f64, width_s: f64, period_s: f64) -> Self {
        Self { amplitude, width_s, period_s, since_s: 0.0, at_pulse: None, direction: 0.0 }
    }
}

impl Compensator for Knocker {
    fn step(&mut self, op: f64, dt_s: f64) -> f64 {
        let Some(at_pulse) = self.at_pulse else {
            self.at_pulse = Some(op);
            return 0.0;
        };
        self.since_s += dt_s;
        // Sums of sample periods miss a multiple of them by roundings.
        let slack = 1e-9 * self.period_s;
        if self.since_s >= self.period_s - slack {
            self.direction = sign(op - at_pulse);
            self.at_pulse = Some(op);
            self.since_s = 0.0;
        }
        if self.since_s < self.width_s - slack { self.amplitude * self.direction } else { 0.0 }
    }
}

/// The backlash inverse (Hägglund, J. Process Control 2007, 17, 489): half the dead band in OP's direction, held while
/// OP rests. For a valve with S and J the dead band is `S - J`.
#[derive(Clone, Debug)]
pub struct BacklashInverse {
    amplitude: f64,
    last: Option<f64>,
    direction: f64,
}

impl BacklashInverse {
    /// With half the dead band as `amplitude` [%].
    pub fn new(amplitude: f64) -> Self {
        Self { amplitude, last: None, direction: 0.0 }
    }
}

impl Compensator for BacklashInverse {
    fn step(&mut self, op: f64, _dt_s: f64) -> f64 {
        let moved = sign(op - self.last.unwrap_or(op));
        self.last = Some(op);
        if moved != 0.0 {
            self.direction = moved;
        }
        self.amplitude * self.direction
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compensation::{ConstantReinforcement, CrSettings};
    use proptest::prelude::*;

    #[test]
    fn the_knocker_by_hand() {
        // Width 2, period 4: the first pulse after 4 samples, up because OP rose; then down; then none for a standstill.
        let ops = [50.0, 51.0, 52.0, 53.0, 54.0, 53.0, 52.0, 51.0, 50.0, 51.0, 50.5, 50.2, 50.0];
        let mut knocker = Knocker::new(1.5, 2.0, 4.0);
        let terms: Vec<f64> = ops.iter().map(|&op| knocker.step(op, 1.0)).collect();
        assert_eq!(terms, [0.0, 0.0, 0.0, 0.0, 1.5, 1.5, 0.0, 0.0, -1.5, -1.5, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn the_backlash_inverse_undoes_backlash() {
        let mut inverse = BacklashInverse::new(1.5);
        let mut mv: f64 = 50.0;
        inverse.step(50.0, 1.0);
        for k in 1..200 {
            let op = 50.0 + 4.0 * (0.1 * f64::from(k)).sin();
            let input = op + inverse.step(op, 1.0);
            // A loose linkage of width 3.
            mv = mv.max(input - 1.5).min(input + 1.5);
            // One rounding of numbers of order 50.
            assert!((mv - op).abs() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn a_knocker_without_pause_is_constant_reinforcement(ops in prop::collection::vec(0.0..100.0f64, 1..100)) {
            let mut knocker = Knocker::new(2.0, 1.0, 1.0);
            let mut cr = ConstantReinforcement::new(2.0, [2.0, 2.0], CrSettings::default()).expect("valid");
            for op in ops {
                prop_assert_eq!(knocker.step(op, 1.0), cr.step(op, 1.0));
            }
        }
    }
}
