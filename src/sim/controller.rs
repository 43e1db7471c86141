//! PI and PID controllers in velocity form.

/// Whether the controller or an operator sets OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// The controller computes OP.
    Automatic,
    /// OP is held at this value (%).
    Manual(f64),
}

/// Tuning of a PI(D) controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerSpec {
    /// Proportional gain Kc (%/%); negative for a process whose gain is negative.
    pub gain: f64,
    /// Integral time Ti (s); infinite for none.
    pub ti_s: f64,
    /// Derivative time Td (s), on PV; 0 for PI.
    pub td_s: f64,
    /// Output limits (%).
    pub op_limits: (f64, f64),
    /// Automatic or manual.
    pub mode: Mode,
}

impl ControllerSpec {
    /// A PI controller in automatic with OP between 0 and 100 %.
    pub fn pi(gain: f64, ti_s: f64) -> Self {
        Self { gain, ti_s, td_s: 0.0, op_limits: (0.0, 100.0), mode: Mode::Automatic }
    }
}

/// `Δop = Kc ((e[k] - e[k-1]) + ts/Ti e[k]) - Kc Td/ts (pv[k] - 2 pv[k-1] + pv[k-2])`, e = sp - pv.
///
/// OP itself is limited, so nothing winds up beyond the limits; in manual the error is still remembered, so
/// that the return to automatic is bumpless.
#[derive(Clone, Debug)]
pub struct Controller {
    spec: ControllerSpec,
    integral: f64,
    derivative: f64,
    op: f64,
    error: f64,
    pv: [f64; 2],
}

impl Controller {
    /// A controller at rest: OP at `op0`, PV and set point so far at `pv0`.
    pub fn new(spec: &ControllerSpec, ts_s: f64, op0: f64, pv0: f64) -> Self {
        Self {
            spec: *spec,
            integral: ts_s / spec.ti_s,
            derivative: spec.td_s / ts_s,
            op: op0.max(spec.op_limits.0).min(spec.op_limits.1),
            error: 0.0,
            pv: [pv0, pv0],
        }
    }

    /// Switches between automatic and manual.
    pub fn set_mode(&mut self, mode: Mode) {
        self.spec.mode = mode;
    }

    /// One execution: the new OP (%).
    pub fn step(&mut self, sp: f64, pv: f64) -> f64 {
        let error = sp - pv;
        match self.spec.mode {
            Mode::Automatic => {
                let curvature = pv - 2.0 * self.pv[0] + self.pv[1];
                self.op += self.spec.gain
                    * (error - self.error + self.integral * error - self.derivative * curvature);
            }
            Mode::Manual(op) => self.op = op,
        }
        self.op = self.op.max(self.spec.op_limits.0).min(self.spec.op_limits.1);
        self.error = error;
        self.pv = [pv, self.pv[0]];
        self.op
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pi_by_hand() {
        // Kc 2, ts/Ti 0.1, SP steps by 1 with PV at rest: 2 * 1.1 at once, then 0.2 a sample.
        let mut c = Controller::new(&ControllerSpec::pi(2.0, 10.0), 1.0, 50.0, 20.0);
        let ops: Vec<f64> = (0..4).map(|_| c.step(21.0, 20.0)).collect();
        for (op, want) in ops.iter().zip([52.2, 52.4, 52.6, 52.8]) {
            assert!((op - want).abs() < 1e-12);
        }
    }

    #[test]
    fn derivative_acts_on_pv_only() {
        let spec = ControllerSpec { ti_s: f64::INFINITY, td_s: 3.0, ..ControllerSpec::pi(1.0, 1.0) };
        let mut c = Controller::new(&spec, 1.0, 50.0, 0.0);
        // SP step: proportional only. Then PV moves by 1: -1 proportional, -3 derivative; then the -3 is taken back.
        assert_eq!(c.step(2.0, 0.0), 52.0);
        assert_eq!(c.step(2.0, 1.0), 48.0);
        assert_eq!(c.step(2.0, 1.0), 51.0);
    }

    #[test]
    fn no_windup_beyond_the_limits() {
        let mut c = Controller::new(&ControllerSpec::pi(1.0, 1.0), 1.0, 90.0, 0.0);
        for _ in 0..100 {
            assert!(c.step(5.0, 0.0) <= 100.0);
        }
        // The first sample with the error reversed leaves the limit.
        assert!(c.step(-1.0, 0.0) < 100.0);
    }

    #[test]
    fn manual_holds_and_returns_without_a_bump() {
        let mut c = Controller::new(&ControllerSpec::pi(1.0, 100.0), 1.0, 50.0, 0.0);
        c.set_mode(Mode::Manual(30.0));
        assert_eq!(c.step(3.0, 0.0), 30.0);
        assert_eq!(c.step(4.0, 0.0), 30.0);
        c.set_mode(Mode::Automatic);
        // Only the integral of one sample: 4 / 100.
        assert!((c.step(4.0, 0.0) - 30.04).abs() < 1e-12);
    }
}
