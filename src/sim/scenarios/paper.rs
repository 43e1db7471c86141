//! The six cases of Table 2 (Ivan & Lakshminarayanan 2009). Flow: `1/(0.2 s + 1)`, Kc 0.5, Ti 0.3 min, at 1 s.
//! Level: `e^-s/(15 s)`, Kc 3, Ti 30 min, at 50 s; time constants in minutes.
//!
//! The paper leaves open, and here is chosen: the operating point (50 %), the size of the set-point step that
//! starts the cycle (10 %), the valve's resolution (0.005 %), where the sinusoidal load enters (process output),
//! and which loop saturates (level, with more gain than it bears, the stem's travel limiting the cycle).

use super::{Scenario, Truth};
use crate::sim::controller::ControllerSpec;
use crate::sim::load::{Load, LoadKind};
use crate::sim::plant::LoopSpec;
use crate::sim::process::{ProcessKind, ProcessSpec};
use crate::sim::sensor::SensorSpec;
use crate::sim::valve::{Friction, ValveSpec};
use std::f64::consts::TAU;

/// |Δop| up to this stops the stem (%): without it the noise-free flow loop slides to its set point and rests.
const RESOLUTION: f64 = 0.005;

const OPERATING_POINT: f64 = 50.0;
const SP_STEP: f64 = 10.0;

/// How `sin(30 t)` is read, t in minutes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SineUnit {
    /// 30 rad/min: a period of 12.6 s, which the 50 s sampling folds to 2,368 s.
    Radians,
    /// 30 °/min: a period of 12 min.
    Degrees,
}

/// The paper's flow (`level` false) or level loop with the given friction, started by a set-point step.
pub fn table2_loop(level: bool, friction: Friction) -> LoopSpec {
    let (process, controller, ts_s) = if level {
        let process =
            ProcessSpec { kind: ProcessKind::Integrating { rate: 1.0 / (15.0 * 60.0) }, dead_time_s: 60.0 };
        (process, ControllerSpec::pi(3.0, 30.0 * 60.0), 50.0)
    } else {
        let process =
            ProcessSpec { kind: ProcessKind::FirstOrder { gain: 1.0, tau_s: 12.0 }, dead_time_s: 0.0 };
        (process, ControllerSpec::pi(0.5, 18.0), 1.0)
    };
    LoopSpec {
        process,
        controller,
        valve: ValveSpec::linear(friction),
        loads: Vec::new(),
        sensor: SensorSpec::default(),
        sp: OPERATING_POINT + SP_STEP,
        sp_schedule: Vec::new(),
        sp_steps: None,
        ts_s,
        op0: OPERATING_POINT,
        pv0: OPERATING_POINT,
    }
}

/// The level loop without friction under the load `5 sin(30 t)` at the process output.
pub fn level_sinusoidal(unit: SineUnit) -> LoopSpec {
    let period_s = 60.0
        * match unit {
            SineUnit::Radians => TAU / 30.0,
            SineUnit::Degrees => 360.0 / 30.0,
        };
    LoopSpec {
        loads: vec![Load::output(LoadKind::Sine { amplitude: 5.0, period_s, phase: 0.0, growth_per_s: 0.0 })],
        sp: OPERATING_POINT,
        ..table2_loop(true, Friction::Ideal)
    }
}

/// The six cases in the table's order, 4,000 samples each, the first 1,000 for the transient: a period of the
/// flow loop is 500 to 1,000 samples long.
pub fn table2() -> Vec<Scenario> {
    let sticky = |name: &str, level, fs: f64, fd: f64| {
        let (s, j) = (fs + fd, fs - fd);
        let friction = Friction::Choudhury { s, j, resolution: RESOLUTION };
        scenario(name, table2_loop(level, friction), s, j)
    };
    vec![
        sticky("flow control (weak stiction)", false, 0.65, 0.35),
        sticky("flow control (strong stiction)", false, 3.0, 2.0),
        sticky("level control (weak stiction)", true, 0.65, 0.35),
        sticky("level control (strong stiction)", true, 3.0, 2.0),
        scenario("level control (sinusoidal disturbance)", level_sinusoidal(SineUnit::Radians), 0.0, 0.0),
        scenario("valve saturation", saturation(), 0.0, 0.0),
    ]
}

/// The level loop with Kc 18, about 1.1 times what dead time and sampling let it bear, and a stem that travels
/// 40..60 %: the cycle grows until the travel limits it. OP itself stays inside its limits.
fn saturation() -> LoopSpec {
    let level = table2_loop(true, Friction::Ideal);
    LoopSpec {
        controller: ControllerSpec { gain: 18.0, ..level.controller },
        valve: ValveSpec { travel: (40.0, 60.0), ..level.valve },
        sp: OPERATING_POINT + 0.1,
        ..level
    }
}

fn scenario(name: &str, spec: LoopSpec, s: f64, j: f64) -> Scenario {
    Scenario {
        spec,
        truth: Truth { sticky: s > 0.0, s, j, kind: name.to_owned() },
        seed: 1,
        n: 4000,
        warm_up: 1000,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::reverses_beyond;

    fn half_range(v: &[f64]) -> f64 {
        let (low, high) =
            v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
        0.5 * (high - low)
    }

    #[test]
    fn every_case_cycles() {
        for case in table2() {
            let run = case.run().expect("the paper's loops are valid");
            let reversals = reverses_beyond(&run.op, case.truth.s);
            println!(
                "{:40} reversals {reversals:3}, period {:7.1} s, OP ±{:.3}, PV ±{:.3}, stem ±{:.3}",
                case.truth.kind,
                2.0 * run.op.len() as f64 * run.ts / reversals.max(1) as f64,
                half_range(&run.op),
                half_range(&run.pv),
                half_range(&run.mv),
            );
            assert!(reversals >= 4, "{}: {reversals} reversals", case.truth.kind);
            if case.truth.sticky {
                // A cycling OP crosses S on each way and more: half its range exceeds S/2.
                assert!(half_range(&run.op) > 0.5 * case.truth.s);
                assert!(half_range(&run.mv) > 0.0);
            }
        }
    }

    #[test]
    fn the_saturation_case_is_limited_by_the_stem_not_by_op() {
        let case = &table2()[5];
        let run = case.run().expect("the paper's loops are valid");
        assert!(run.op.iter().all(|&u| u > 0.0 && u < 100.0));
        assert!(run.mv.contains(&40.0) && run.mv.contains(&60.0));
    }
}
