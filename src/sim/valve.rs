//! Control valves: the friction between OP and stem, the stem's travel, and what the stem lets through.

/// How the stem follows OP. S, J, fs, fd, f and the dead band are in % of OP span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Friction {
    /// The stem follows at once.
    Ideal,
    /// Choudhury, Thornhill and Shah (Control Eng. Practice 2005, 13, 641). The stem sticks where OP stops or
    /// reverses; from the OP value where it stuck, OP must move by S against the last motion of the stem, or by J
    /// along it; the moving stem is at `op - sign(Δop) (S - J)/2`.
    /// A chart that took the stuck point anew at every reversal of OP would let ripple hold the stem longer than S
    /// says, and PV noise for good; here it is taken once, when the stem sticks.
    Choudhury {
        /// Dead band plus stick band S.
        s: f64,
        /// Slip jump J.
        j: f64,
        /// |Δop| up to this counts as stopped.
        resolution: f64,
    },
    /// Kano et al. (DYCOPS 2004), told by forces: with the same S, J and resolution the stem moves as in
    /// [`Friction::Choudhury`].
    Kano {
        /// Dead band plus stick band S.
        s: f64,
        /// Slip jump J.
        j: f64,
        /// |Δop| up to this counts as stopped.
        resolution: f64,
    },
    /// He, Wang, Pottmann and Qin (Ind. Eng. Chem. Res. 2007): the force accumulates; beyond fs the stem slips by
    /// the force less fd, and fd stays.
    He {
        /// Static friction fs.
        fs: f64,
        /// Kinetic friction fd.
        fd: f64,
    },
    /// The one-parameter element that the diagnosis fits.
    OneParameter {
        /// Friction f.
        f: f64,
    },
    /// A loose linkage: the stem stays while OP is within half the band of it.
    Backlash {
        /// Full width of the band.
        deadband: f64,
    },
}

/// What the stem position lets through, as a share of full flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Characteristic {
    /// `x`.
    Linear,
    /// `R^(x - 1)`.
    EqualPercentage {
        /// Rangeability R (-).
        rangeability: f64,
    },
    /// `√x`.
    QuickOpening,
}

/// A valve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValveSpec {
    /// Friction.
    pub friction: Friction,
    /// Travel limits of the stem (%); OP beyond them moves nothing.
    pub travel: (f64, f64),
    /// Installed characteristic.
    pub characteristic: Characteristic,
}

impl ValveSpec {
    /// A linear valve with full travel.
    pub fn linear(friction: Friction) -> Self {
        Self { friction, travel: (0.0, 100.0), characteristic: Characteristic::Linear }
    }

    /// Flow (%) at stem position `mv` (%).
    pub fn flow(&self, mv: f64) -> f64 {
        let x = (mv / 100.0).max(0.0);
        match self.characteristic {
            Characteristic::Linear => mv,
            Characteristic::EqualPercentage { rangeability } => 100.0 * rangeability.powf(x - 1.0),
            Characteristic::QuickOpening => 100.0 * x.sqrt(),
        }
    }
}

/// A valve at work.
#[derive(Clone, Debug)]
pub struct Valve {
    spec: ValveSpec,
    op: f64,
    mv: f64,
    /// Direction of the stem's last motion.
    direction: f64,
    moving: bool,
    /// OP where the stem stuck; for He and the one-parameter element the residual force.
    held: f64,
}

impl Valve {
    /// A valve at rest at `op0`, with the same force needed to move it either way.
    pub fn new(spec: &ValveSpec, op0: f64) -> Self {
        let held = match spec.friction {
            // Stopped on the way up at op0 + (S - J)/2: both thresholds are then (S + J)/2 away from the stem.
            Friction::Choudhury { s, j, .. } | Friction::Kano { s, j, .. } => op0 + 0.5 * (s - j),
            _ => 0.0,
        };
        Self { spec: *spec, op: op0, mv: op0, direction: 1.0, moving: false, held }
    }

    /// Stem position (%) for this sample's OP (%).
    pub fn step(&mut self, op: f64) -> f64 {
        match self.spec.friction {
            Friction::Ideal => self.mv = op,
            Friction::Choudhury { s, j, resolution } | Friction::Kano { s, j, resolution } => {
                self.stick_slip(op, s, j, resolution);
            }
            Friction::He { fs, fd } => {
                let force = self.held + (op - self.op);
                if force.abs() > fs {
                    self.mv += force - force.signum() * fd;
                    self.held = force.signum() * fd;
                } else {
                    self.held = force;
                }
            }
            Friction::OneParameter { f } => {
                let force = self.held + (op - self.op);
                if force.abs() > f {
                    self.mv = op;
                    self.held = force.signum() * f;
                } else {
                    self.held = force;
                }
            }
            Friction::Backlash { deadband } => {
                self.mv = self.mv.max(op - 0.5 * deadband).min(op + 0.5 * deadband);
            }
        }
        self.op = op;
        self.mv.max(self.spec.travel.0).min(self.spec.travel.1)
    }

    fn stick_slip(&mut self, op: f64, s: f64, j: f64, resolution: f64) {
        let change = op - self.op;
        // Only a moving stem sticks: a stuck one keeps its stuck point, however OP ripples or creeps.
        if self.moving && change * self.direction <= resolution {
            self.moving = false;
            self.held = self.op;
        }
        if !self.moving {
            let ahead = (op - self.held) * self.direction;
            if -ahead > s {
                self.direction = -self.direction;
                self.moving = true;
            } else if ahead > j {
                self.moving = true;
            }
        }
        if self.moving {
            self.mv = op - self.direction * 0.5 * (s - j);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(friction: Friction, op0: f64, ops: &[f64]) -> Vec<f64> {
        let mut valve = Valve::new(&ValveSpec::linear(friction), op0);
        ops.iter().map(|&op| valve.step(op)).collect()
    }

    const S: f64 = 5.0;
    const J: f64 = 1.0;

    /// S 5, J 1, so fD = 2 and fS = 3: the stem starts once OP is more than 3 away and then trails by 2.
    fn signature(friction: Friction) {
        let up: Vec<f64> = (1..=10).map(|k| 50.0 + k as f64).collect();
        let mv = drive(friction, 50.0, &up);
        assert_eq!(mv, [50.0, 50.0, 50.0, 52.0, 53.0, 54.0, 55.0, 56.0, 57.0, 58.0]);
        // Back down from 60 (stem 58): stuck for 5, so still at 58 at OP 55, then jumps by J + the step to 54 + 2.
        let down: Vec<f64> = up.iter().copied().chain((1..=8).map(|k| 60.0 - k as f64)).collect();
        let mv = drive(friction, 50.0, &down);
        assert_eq!(&mv[10..], [58.0, 58.0, 58.0, 58.0, 58.0, 56.0, 55.0, 54.0]);
    }

    #[test]
    fn choudhury_stickband_jump_and_ramp() {
        signature(Friction::Choudhury { s: S, j: J, resolution: 0.005 });
    }

    #[test]
    fn kano_stickband_jump_and_ramp() {
        signature(Friction::Kano { s: S, j: J, resolution: 0.005 });
    }

    #[test]
    fn a_stop_must_be_crossed_by_the_slip_jump() {
        for friction in [
            Friction::Choudhury { s: S, j: J, resolution: 0.005 },
            Friction::Kano { s: S, j: J, resolution: 0.005 },
        ] {
            // Moving at 56 (stem 54); creeps by less than the resolution; then 0.9 more is not J, 1.1 is.
            let mv = drive(friction, 50.0, &[56.0, 56.004, 56.9, 57.104]);
            assert_eq!(mv, [54.0, 54.0, 54.0, 55.104], "{friction:?}");
        }
    }

    #[test]
    fn ripple_while_stuck_does_not_move_the_stuck_point() {
        // Up to 60 (stem 58), then down by 4, up by 1, down by 3: 6 below where it stuck, though only 3 below the
        // last turn of OP. Back up to 57 it sticks at OP 54 and needs S = 5 again: 58.9 holds, 59.1 moves.
        let ops = [60.0, 56.0, 57.0, 54.0, 57.0, 58.9, 58.8, 59.1];
        for friction in [
            Friction::Choudhury { s: S, j: J, resolution: 0.005 },
            Friction::Kano { s: S, j: J, resolution: 0.005 },
        ] {
            let mv = drive(friction, 50.0, &ops);
            assert_eq!(mv, [58.0, 58.0, 58.0, 56.0, 56.0, 56.0, 56.0, 57.1], "{friction:?}");
        }
    }

    #[test]
    fn back_along_the_last_motion_the_slip_jump_is_enough() {
        // Sticks at 60 moving up; falls to 56 and returns: 60.9 is not J beyond 60, 61.1 is.
        let friction = Friction::Choudhury { s: S, j: J, resolution: 0.005 };
        let mv = drive(friction, 50.0, &[60.0, 56.0, 60.9, 61.1]);
        assert_eq!(mv, [58.0, 58.0, 58.0, 59.1]);
    }

    #[test]
    fn without_slip_jump_kano_is_backlash() {
        let ops: Vec<f64> =
            (0..400).map(|k| 50.0 + 8.0 * (k as f64 * 0.1).sin() + 3.0 * (k as f64 * 0.37).sin()).collect();
        let kano = drive(Friction::Kano { s: 4.0, j: 0.0, resolution: 0.0 }, 50.0, &ops);
        let gap = drive(Friction::Backlash { deadband: 4.0 }, 50.0, &ops);
        for (a, b) in kano.iter().zip(&gap) {
            // Both compute op ± 2; only roundings of 50-sized numbers differ.
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn he_by_hand() {
        // fs 3, fd 2: forces 2, 4 > 3: slips by 2, 2 stays; +1 makes 3, not beyond; -4 makes -1; -3 makes -4: slips by -2.
        let mv = drive(Friction::He { fs: 3.0, fd: 2.0 }, 50.0, &[52.0, 54.0, 55.0, 51.0, 48.0]);
        assert_eq!(mv, [50.0, 52.0, 52.0, 52.0, 50.0]);
    }

    #[test]
    fn one_parameter_by_hand() {
        // f 2: 51 holds (1), 53 slips and lets f stay; on the reversal the band is 2 f = 4: 49 holds at -2, 48.9 slips.
        let mv = drive(Friction::OneParameter { f: 2.0 }, 50.0, &[51.0, 53.0, 54.0, 50.0, 49.9]);
        assert_eq!(mv, [50.0, 53.0, 54.0, 54.0, 49.9]);
    }

    #[test]
    fn travel_and_characteristic() {
        let mut valve =
            Valve::new(&ValveSpec { travel: (20.0, 80.0), ..ValveSpec::linear(Friction::Ideal) }, 50.0);
        assert_eq!([valve.step(95.0), valve.step(60.0), valve.step(-3.0)], [80.0, 60.0, 20.0]);
        let flow =
            |characteristic, mv| ValveSpec { characteristic, ..ValveSpec::linear(Friction::Ideal) }.flow(mv);
        assert_eq!(flow(Characteristic::Linear, 25.0), 25.0);
        assert_eq!(flow(Characteristic::QuickOpening, 25.0), 50.0);
        // R = 100: half travel is a tenth of full flow; powf is exact to a rounding.
        assert!((flow(Characteristic::EqualPercentage { rangeability: 100.0 }, 50.0) - 10.0).abs() < 1e-12);
    }
}
