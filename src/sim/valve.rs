//! Control valves: the friction between OP and stem, the stem's travel, and what the stem lets through.

/// How the stem follows OP. S, J, fs, fd, f and the dead band are in % of OP span.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Friction {
    /// The stem follows at once.
    Ideal,
    /// Choudhury, Thornhill and Shah (Control Eng. Practice 2005, 13, 641). The stem sticks where OP stops or
    /// reverses; from the OP value where it stuck, OP must move by S against the last motion of the stem, or by J
    /// along it; the moving stem is at `op - sign(Δop) (S - J)/2`.
    /// The stuck point is taken once, when the stem sticks; [`Friction::ChoudhuryChart`] takes it anew.
    Choudhury {
        /// Dead band plus stick band S.
        s: f64,
        /// Slip jump J.
        j: f64,
        /// |Δop| up to this counts as stopped.
        resolution: f64,
    },
    /// Choudhury's chart read to the letter: the stuck point is taken anew at every stop and every reversal of OP, and
    /// once OP has turned back while the stem is stuck, S counts either way. Ripple then holds the stem for longer
    /// than S says, and PV noise for good.
    ChoudhuryChart {
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
    /// Where OP was going in the last sample: -1, 0 or 1.
    heading: f64,
    /// Whether OP has turned back since the stem stuck.
    turned: bool,
    /// OP where the stem stuck; for He and the one-parameter element the residual force.
    held: f64,
}

impl Valve {
    /// A valve at rest at `op0`, with the same force needed to move it either way.
    pub fn new(spec: &ValveSpec, op0: f64) -> Self {
        let held = match spec.friction {
            // Stopped on the way up at op0 + (S - J)/2: both thresholds are then (S + J)/2 away from the stem.
            Friction::Choudhury { s, j, .. } | Friction::Kano { s, j, .. } => op0 + 0.5 * (s - j),
            // Its stuck point is a value that OP had.
            Friction::ChoudhuryChart { .. } => op0,
            _ => 0.0,
        };
        let (direction, moving, heading, turned) = (1.0, false, 0.0, false);
        Self { spec: *spec, op: op0, mv: op0, direction, moving, heading, turned, held }
    }

    /// Stem position (%) for this sample's OP (%).
    pub fn step(&mut self, op: f64) -> f64 {
        match self.spec.friction {
            Friction::Ideal => self.mv = op,
            Friction::Choudhury { s, j, resolution } | Friction::Kano { s, j, resolution } => {
                self.stick_slip(op, s, j, resolution);
            }
            Friction::ChoudhuryChart { s, j, resolution } => self.chart(op, s, j, resolution),
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

    fn chart(&mut self, op: f64, s: f64, j: f64, resolution: f64) {
        let change = op - self.op;
        let heading = if change.abs() > resolution { change.signum() } else { 0.0 };
        if heading != self.heading {
            self.turned = !self.moving && self.turned || heading * self.direction < 0.0;
            self.moving = false;
            self.held = self.op;
        }
        self.heading = heading;
        if !self.moving {
            let ahead = op - self.held;
            let along = ahead * self.direction > 0.0;
            if ahead.abs() > if along && !self.turned { j } else { s } {
                self.direction = ahead.signum();
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

    /// OP up and down in a triangle of ±12 in steps of 0.01, after one round of it: what the stem shows on the way up.
    struct Signature {
        /// How far OP came up from its lowest before the stem moved.
        stickband: f64,
        /// The stem's first move.
        jump: f64,
        /// Stem over OP from there to the top.
        slope: f64,
        /// OP less stem at the top.
        lag: f64,
    }

    fn on_a_triangle(friction: Friction) -> Signature {
        const STEPS: usize = 2400;
        let at = |k: usize| {
            let k = k % (2 * STEPS);
            38.0 + 0.01 * if k < STEPS { k as f64 } else { (2 * STEPS - k) as f64 }
        };
        let ops: Vec<f64> = (0..=3 * STEPS).map(at).collect();
        let mv = drive(friction, 38.0, &ops);
        let (bottom, top) = (2 * STEPS, 3 * STEPS);
        let first = (bottom + 1..=top).find(|&k| mv[k] != mv[bottom]).expect("the stem moves on the way up");
        Signature {
            stickband: ops[first] - ops[bottom],
            jump: mv[first] - mv[bottom],
            slope: (mv[top] - mv[first]) / (ops[top] - ops[first]),
            lag: ops[top] - mv[top],
        }
    }

    #[test]
    fn every_valve_shows_its_stickband_jump_and_ramp() {
        let resolution = 0.005;
        // S, J, and the lag of the ramp behind OP.
        let two_parameters = |name, friction| (name, friction, S, J, 0.5 * (S - J));
        for (name, friction, stickband, jump, lag) in [
            two_parameters("Choudhury", Friction::Choudhury { s: S, j: J, resolution }),
            two_parameters("chart", Friction::ChoudhuryChart { s: S, j: J, resolution }),
            two_parameters("Kano", Friction::Kano { s: S, j: J, resolution }),
            ("one parameter", Friction::OneParameter { f: 2.5 }, 5.0, 5.0, 0.0),
            ("backlash", Friction::Backlash { deadband: 4.0 }, 4.0, 0.0, 2.0),
        ] {
            let found = on_a_triangle(friction);
            // One step of OP, 0.01, is what a triangle in steps resolves.
            assert!((found.stickband - stickband).abs() < 0.0101, "{name}: {}", found.stickband);
            assert!((found.jump - jump).abs() < 0.0101, "{name}: {}", found.jump);
            assert!((found.lag - lag).abs() < 0.0101, "{name}: {}", found.lag);
            // Both ends of the ramp are off by less than a step over a ramp of 19 or more.
            assert!((found.slope - 1.0).abs() < 2e-3, "{name}: {}", found.slope);
        }
    }

    #[test]
    fn he_sticks_anew_after_every_slip() {
        // fs 3, fd 2: S = fs + fd and J = fs - fd as in the others, but each slip leaves fd and needs J again: no
        // ramp, a staircase of steps J (Garcia 2008 holds that against it).
        let found = on_a_triangle(Friction::He { fs: 3.0, fd: 2.0 });
        // The force left at a turn is anything from fd to fs, so the stick band is fs more than that.
        assert!((S..=6.0 + 0.0101).contains(&found.stickband), "{}", found.stickband);
        assert!((found.jump - J).abs() < 0.0101 && (found.slope - 1.0).abs() < 0.1);
        // Within a step of the staircase of fd.
        assert!((2.0..=3.0 + 1e-9).contains(&found.lag), "{}", found.lag);
        let ops: Vec<f64> = (0..2000).map(|k| 50.0 + 0.01 * f64::from(k)).collect();
        let mv = drive(Friction::He { fs: 3.0, fd: 2.0 }, 50.0, &ops);
        let moves = mv.windows(2).filter(|w| w[0] != w[1]).count();
        // From 3 to 20 in steps of a little more than J: the first at 3, then one every 1.01.
        assert!((16..=17).contains(&moves), "{moves}");
    }

    #[test]
    fn the_stop_rule_of_each_valve() {
        let resolution = 0.005;
        // Up to 60, a stop, then on in steps of 0.3: what the stem does after the stop.
        let after_a_stop = |friction| {
            let up = (1..=100).map(|k| 50.0 + 0.1 * f64::from(k));
            let ops: Vec<f64> = up.chain([60.0, 60.0, 60.3, 60.6, 60.9, 61.2]).collect();
            let mv = drive(friction, 50.0, &ops);
            mv[101..].iter().map(|m| ((m - mv[101]) * 10.0).round() / 10.0).collect::<Vec<_>>()
        };
        // J = 1 has to be crossed once more; the two elements without a stop rule go on at once.
        for friction in [
            Friction::Choudhury { s: S, j: J, resolution },
            Friction::ChoudhuryChart { s: S, j: J, resolution },
            Friction::Kano { s: S, j: J, resolution },
        ] {
            assert_eq!(after_a_stop(friction), [0.0, 0.0, 0.0, 0.0, 1.2], "{friction:?}");
        }
        for friction in [Friction::OneParameter { f: 2.5 }, Friction::Backlash { deadband: 4.0 }] {
            assert_eq!(after_a_stop(friction), [0.0, 0.3, 0.6, 0.9, 1.2], "{friction:?}");
        }
    }

    #[test]
    fn the_chart_to_the_letter_lets_ripple_hold_the_stem() {
        // Moves up to 60, turns, and comes down in a ripple of 2 down and 1 up: never S in one go.
        let friction = |anew: bool| {
            let (s, j, resolution) = (S, J, 0.005);
            if anew {
                Friction::ChoudhuryChart { s, j, resolution }
            } else {
                Friction::Choudhury { s, j, resolution }
            }
        };
        let mut ops = vec![60.0];
        for _ in 0..10 {
            let last = ops[ops.len() - 1];
            ops.extend([last - 2.0, last - 1.0]);
        }
        let held = |anew| {
            let mv = drive(friction(anew), 50.0, &ops);
            mv[mv.len() - 1] == mv[0]
        };
        assert!(held(true) && !held(false));
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
