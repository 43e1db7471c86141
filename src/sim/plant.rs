//! One control loop, put together and run.

use super::controller::{Controller, ControllerSpec, Mode};
use super::load::{At, Load, LoadState};
use super::process::{Process, ProcessSpec};
use super::sensor::{Sensor, SensorSpec};
use super::valve::{Characteristic, Friction, Valve, ValveSpec};
use rand_pcg::Pcg64Mcg;

/// Longest dead time in samples that a loop may have: bounds the delay line's memory.
pub const MAX_DEAD_TIME_SAMPLES: f64 = 100_000.0;

/// A control loop. It starts at rest: OP and stem at `op0`, PV at `pv0`, which the process holds there.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopSpec {
    /// From flow to PV, about the operating point.
    pub process: ProcessSpec,
    /// The controller.
    pub controller: ControllerSpec,
    /// The valve.
    pub valve: ValveSpec,
    /// Loads.
    pub loads: Vec<Load>,
    /// The transmitter; the controller sees what it measures.
    pub sensor: SensorSpec,
    /// Set point from the start (%).
    pub sp: f64,
    /// Later set points, (time (s), set point (%)) by increasing time.
    pub sp_schedule: Vec<(f64, f64)>,
    /// Set-point steps for as long as the loop runs, added to the set point.
    pub sp_steps: Option<SetPointSteps>,
    /// Sample period of the controller and the valve (s).
    pub ts_s: f64,
    /// OP at rest (%).
    pub op0: f64,
    /// PV at rest (%).
    pub pv0: f64,
}

/// Up and down again, each time after the same time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetPointSteps {
    /// Time between two steps (s).
    pub every_s: f64,
    /// Size of a step (%).
    pub size: f64,
}

impl SetPointSteps {
    /// What is added to the set point at this time (%); `t` in s from the start, which is down.
    fn at(self, t: f64) -> f64 {
        if (t / self.every_s).floor() % 2.0 == 0.0 { 0.0 } else { self.size }
    }
}

/// Why a loop cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// A number that must be positive is not, or is not finite.
    #[error("simulated loop: {name} must be a positive, finite number, not {value}")]
    NotPositive {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A number that must not be negative is, or is not finite.
    #[error("simulated loop: {name} must be a finite number from 0, not {value}")]
    Negative {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The dead time is negative, not finite or too long.
    #[error(
        "simulated loop: dead time {dead_time_s} s must be between 0 and 100000 sample periods of {ts_s} s"
    )]
    DeadTime {
        /// Dead time (s).
        dead_time_s: f64,
        /// Sample period (s).
        ts_s: f64,
    },
    /// Limits that are reversed or no numbers.
    #[error("simulated loop: {name} must be a lower and a higher limit, not {low} and {high}")]
    Limits {
        /// Which.
        name: &'static str,
        /// Lower limit.
        low: f64,
        /// Upper limit.
        high: f64,
    },
}

/// The loop at one sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Time (s).
    pub t: f64,
    /// Controller output, without any term added after it (%).
    pub op: f64,
    /// Process variable as measured (%).
    pub pv: f64,
    /// Set point (%).
    pub sp: f64,
    /// True stem position (%).
    pub mv: f64,
}

/// A loop at work.
#[derive(Clone, Debug)]
pub struct LoopSim {
    process: Process,
    controller: Controller,
    valve: Valve,
    valve_spec: ValveSpec,
    loads: Vec<LoadState>,
    sensor: Sensor,
    sp: f64,
    sp_schedule: Vec<(f64, f64)>,
    next_sp: usize,
    sp_steps: Option<SetPointSteps>,
    rng: Pcg64Mcg,
    ts_s: f64,
    flow0: f64,
    pv0: f64,
    k: u64,
}

impl LoopSim {
    /// A loop at rest, its randomness fixed by `seed`.
    ///
    /// # Errors
    /// [`SpecError`] where a number makes no sense.
    pub fn new(spec: &LoopSpec, seed: u64) -> Result<Self, SpecError> {
        check(spec)?;
        // The multiplier spreads neighbouring seeds over the generator's state.
        let mut rng = Pcg64Mcg::new(u128::from(seed).wrapping_mul(0x9E37_79B9_7F4A_7C15_F39C_C060_5CED_C835));
        let loads = spec.loads.iter().map(|load| LoadState::new(load, spec.ts_s, &mut rng)).collect();
        let rest = spec.op0.max(spec.valve.travel.0).min(spec.valve.travel.1);
        Ok(Self {
            process: Process::new(&spec.process, spec.ts_s),
            controller: Controller::new(&spec.controller, spec.ts_s, spec.op0, spec.pv0),
            valve: Valve::new(&spec.valve, spec.op0),
            valve_spec: spec.valve,
            loads,
            sensor: Sensor::new(&spec.sensor, spec.pv0),
            sp: spec.sp,
            sp_schedule: spec.sp_schedule.clone(),
            next_sp: 0,
            sp_steps: spec.sp_steps,
            rng,
            ts_s: spec.ts_s,
            flow0: spec.valve.flow(rest),
            pv0: spec.pv0,
            k: 0,
        })
    }

    /// Measures, controls, moves the valve, and lets the process run to the next sample.
    pub fn step(&mut self) -> Point {
        self.step_with(0.0)
    }

    /// As [`LoopSim::step`], with `extra` (%) added to the valve's input after the controller.
    pub fn step_with(&mut self, extra: f64) -> Point {
        self.step_by(|_| extra)
    }

    /// As [`LoopSim::step`], with a term that may depend on this sample's OP added to the valve's input: a
    /// compensator sees OP and acts in the same sample.
    pub fn step_by(&mut self, extra: impl FnOnce(f64) -> f64) -> Point {
        let t = self.k as f64 * self.ts_s;
        while let Some(&(at, sp)) = self.sp_schedule.get(self.next_sp)
            && t >= at
        {
            self.sp = sp;
            self.next_sp += 1;
        }
        let (mut at_input, mut at_output) = (0.0, 0.0);
        for load in &mut self.loads {
            let value = load.step(t, &mut self.rng);
            match load.at() {
                At::ProcessInput => at_input += value,
                At::ProcessOutput => at_output += value,
            }
        }
        let y = self.pv0 + self.process.output() + at_output;
        let pv = self.sensor.step(t, y, &mut self.rng);
        let sp = self.sp + self.sp_steps.map_or(0.0, |steps| steps.at(t));
        let op = self.controller.step(sp, pv);
        let mv = self.valve.step(op + extra(op));
        self.process.step(self.valve_spec.flow(mv) - self.flow0 + at_input);
        self.k += 1;
        Point { t, op, pv, sp, mv }
    }

    /// Changes the set point from the next sample on (%).
    pub fn set_sp(&mut self, sp: f64) {
        self.sp = sp;
    }

    /// Switches the controller between automatic and manual.
    pub fn set_mode(&mut self, mode: Mode) {
        self.controller.set_mode(mode);
    }
}

/// How a historian stores samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Recording {
    /// Every sample.
    All,
    /// The first of every `every` samples.
    Sample {
        /// Samples a record.
        every: usize,
    },
    /// The mean of every `every` samples, stamped with the first one's time.
    Mean {
        /// Samples a record.
        every: usize,
    },
}

/// A record of a loop: equally long columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Run {
    /// Period of the record (s).
    pub ts: f64,
    /// Time (s).
    pub t: Vec<f64>,
    /// Controller output (%).
    pub op: Vec<f64>,
    /// Measured process variable (%).
    pub pv: Vec<f64>,
    /// Set point (%).
    pub sp: Vec<f64>,
    /// True stem position (%).
    pub mv: Vec<f64>,
}

impl Run {
    fn with_capacity(ts: f64, n: usize) -> Self {
        Self {
            ts,
            t: Vec::with_capacity(n),
            op: Vec::with_capacity(n),
            pv: Vec::with_capacity(n),
            sp: Vec::with_capacity(n),
            mv: Vec::with_capacity(n),
        }
    }

    fn push(&mut self, p: Point) {
        self.t.push(p.t);
        self.op.push(p.op);
        self.pv.push(p.pv);
        self.sp.push(p.sp);
        self.mv.push(p.mv);
    }

    /// The record without its first `from` points.
    pub fn after(&self, from: usize) -> Run {
        let cut = |v: &[f64]| v[from.min(v.len())..].to_vec();
        Run {
            ts: self.ts,
            t: cut(&self.t),
            op: cut(&self.op),
            pv: cut(&self.pv),
            sp: cut(&self.sp),
            mv: cut(&self.mv),
        }
    }
}

/// `n` samples of the loop, each recorded.
///
/// # Errors
/// [`SpecError`] where a number of the specification makes no sense.
pub fn simulate(spec: &LoopSpec, n: usize, seed: u64) -> Result<Run, SpecError> {
    record(spec, n, seed, Recording::All)
}

/// `n` records of the loop as a historian keeps them.
///
/// # Errors
/// [`SpecError`] where a number of the specification makes no sense.
pub fn record(spec: &LoopSpec, n: usize, seed: u64, recording: Recording) -> Result<Run, SpecError> {
    let mut sim = LoopSim::new(spec, seed)?;
    let (every, mean) = match recording {
        Recording::All => (1, false),
        Recording::Sample { every } => (every.max(1), false),
        Recording::Mean { every } => (every.max(1), true),
    };
    let mut run = Run::with_capacity(spec.ts_s * every as f64, n);
    for _ in 0..n {
        let first = sim.step();
        let mut sum = first;
        for _ in 1..every {
            let p = sim.step();
            sum.op += p.op;
            sum.pv += p.pv;
            sum.sp += p.sp;
            sum.mv += p.mv;
        }
        let m = every as f64;
        run.push(if mean {
            Point { t: first.t, op: sum.op / m, pv: sum.pv / m, sp: sum.sp / m, mv: sum.mv / m }
        } else {
            first
        });
    }
    Ok(run)
}

fn check(spec: &LoopSpec) -> Result<(), SpecError> {
    use super::process::ProcessKind::{FirstOrder, Integrating, IntegratingLag, SecondOrder};
    let positive = |name, value: f64| {
        if value > 0.0 && value.is_finite() { Ok(()) } else { Err(SpecError::NotPositive { name, value }) }
    };
    let limits = |name, (low, high): (f64, f64)| {
        if low <= high { Ok(()) } else { Err(SpecError::Limits { name, low, high }) }
    };
    positive("sample period", spec.ts_s)?;
    if let Some(steps) = spec.sp_steps {
        positive("time between two set-point steps", steps.every_s)?;
    }
    match spec.process.kind {
        FirstOrder { tau_s, .. } | IntegratingLag { tau_s, .. } => positive("time constant", tau_s)?,
        SecondOrder { tau_s, zeta, .. } => {
            positive("time constant", tau_s)?;
            positive("damping", zeta)?;
        }
        Integrating { .. } => {}
    }
    let samples = spec.process.dead_time_s / spec.ts_s;
    if !(0.0..=MAX_DEAD_TIME_SAMPLES).contains(&samples) {
        return Err(SpecError::DeadTime { dead_time_s: spec.process.dead_time_s, ts_s: spec.ts_s });
    }
    // An infinite integral time is a controller without one.
    if spec.controller.ti_s != f64::INFINITY {
        positive("integral time", spec.controller.ti_s)?;
    }
    limits("OP limits", spec.controller.op_limits)?;
    limits("valve travel", spec.valve.travel)?;
    if let Characteristic::EqualPercentage { rangeability } = spec.valve.characteristic {
        positive("rangeability", rangeability)?;
    }
    let from_zero = |(name, value): (&'static str, f64)| {
        if value >= 0.0 && value.is_finite() { Ok(()) } else { Err(SpecError::Negative { name, value }) }
    };
    friction_numbers(spec.valve.friction).into_iter().try_for_each(from_zero)?;
    if let Some(band) = spec.sensor.band_limited {
        positive("noise sample time", band.sample_time_s)?;
        from_zero(("noise power", band.power))?;
    }
    from_zero(("noise sd", spec.sensor.noise_sd))?;
    from_zero(("quantum", spec.sensor.quantum))
}

/// What must not be negative in a friction.
fn friction_numbers(friction: Friction) -> Vec<(&'static str, f64)> {
    match friction {
        Friction::Ideal => Vec::new(),
        Friction::Choudhury { s, j, resolution }
        | Friction::ChoudhuryChart { s, j, resolution }
        | Friction::Kano { s, j, resolution } => vec![("S", s), ("J", j), ("resolution", resolution)],
        // A kinetic friction above the static one would be thrown back at each slip.
        Friction::He { fs, fd } => vec![("fd", fd), ("fs - fd", fs - fd)],
        Friction::OneParameter { f } => vec![("f", f)],
        Friction::Backlash { deadband } => vec![("dead band", deadband)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::process::ProcessKind;
    use crate::sim::sensor::BandLimited;

    fn flow_loop() -> LoopSpec {
        LoopSpec {
            process: ProcessSpec {
                kind: ProcessKind::FirstOrder { gain: 2.0, tau_s: 5.0 },
                dead_time_s: 0.0,
            },
            controller: ControllerSpec::pi(0.5, 5.0),
            valve: ValveSpec::linear(Friction::Ideal),
            loads: Vec::new(),
            sensor: SensorSpec::default(),
            sp: 40.0,
            sp_schedule: Vec::new(),
            sp_steps: None,
            ts_s: 1.0,
            op0: 50.0,
            pv0: 40.0,
        }
    }

    #[test]
    fn a_loop_at_rest_rests() {
        for characteristic in [
            Characteristic::Linear,
            Characteristic::QuickOpening,
            Characteristic::EqualPercentage { rangeability: 30.0 },
        ] {
            let mut spec = flow_loop();
            spec.valve.characteristic = characteristic;
            let run = simulate(&spec, 50, 1).expect("valid");
            assert!(run.pv.iter().all(|&y| y == 40.0) && run.op.iter().all(|&u| u == 50.0));
        }
    }

    #[test]
    fn a_set_point_step_settles_where_the_gain_says() {
        let mut spec = flow_loop();
        spec.sp_schedule = vec![(10.0, 46.0)];
        let run = simulate(&spec, 300, 1).expect("valid");
        assert_eq!((run.sp[9], run.sp[10]), (40.0, 46.0));
        // The closed loop's slowest time constant is some 5 samples: after 290 only roundings are left.
        assert!((run.pv[299] - 46.0).abs() < 1e-9 && (run.op[299] - 53.0).abs() < 1e-9);
    }

    #[test]
    fn set_point_steps_go_up_and_down() {
        let mut spec = flow_loop();
        spec.sp_steps = Some(SetPointSteps { every_s: 100.0, size: 6.0 });
        let run = simulate(&spec, 300, 1).expect("valid");
        assert_eq!([0, 99, 100, 199, 200, 299].map(|k| run.sp[k]), [40.0, 40.0, 46.0, 46.0, 40.0, 40.0]);
        assert!((run.op[199] - 53.0).abs() < 1e-6 && (run.op[299] - 50.0).abs() < 1e-6);
        spec.sp_steps = Some(SetPointSteps { every_s: 0.0, size: 6.0 });
        assert!(matches!(simulate(&spec, 3, 1), Err(SpecError::NotPositive { .. })));
    }

    #[test]
    fn in_manual_the_stem_follows_op_and_the_added_term_and_pv_follows_the_stem() {
        let mut spec = flow_loop();
        spec.controller.mode = Mode::Manual(55.0);
        let mut sim = LoopSim::new(&spec, 1).expect("valid");
        let first = sim.step_with(2.0);
        assert_eq!((first.op, first.mv, first.pv), (55.0, 57.0, 40.0));
        // One period of 7 % more flow through 2/(5 s + 1).
        let second = sim.step_by(|op| 60.0 - op);
        assert!((second.pv - (40.0 + 14.0 * (1.0 - (-0.2f64).exp()))).abs() < 1e-12);
        assert_eq!(second.mv, 60.0);
    }

    #[test]
    fn a_historian_keeps_means_or_samples() {
        let mut spec = flow_loop();
        spec.sensor = SensorSpec::noisy(0.5);
        let all = simulate(&spec, 60, 5).expect("valid");
        let mean = record(&spec, 6, 5, Recording::Mean { every: 10 }).expect("valid");
        let some = record(&spec, 6, 5, Recording::Sample { every: 10 }).expect("valid");
        assert_eq!((mean.ts, some.ts, mean.t[3]), (10.0, 10.0, 30.0));
        assert_eq!(some.pv[3], all.pv[30]);
        assert!((mean.op[3] - all.op[30..40].iter().sum::<f64>() / 10.0).abs() < 1e-12);
    }

    #[test]
    fn nonsense_is_refused() {
        let bad = |change: fn(&mut LoopSpec)| {
            let mut spec = flow_loop();
            change(&mut spec);
            LoopSim::new(&spec, 1).err().map(|e| e.to_string())
        };
        assert!(bad(|s| s.ts_s = 0.0).is_some_and(|e| e.contains("sample period")));
        assert!(bad(|s| s.process.dead_time_s = f64::NAN).is_some_and(|e| e.contains("dead time")));
        assert!(bad(|s| s.process.dead_time_s = 1e9).is_some_and(|e| e.contains("dead time")));
        assert!(bad(|s| s.controller.op_limits = (1.0, 0.0)).is_some_and(|e| e.contains("OP limits")));
        assert!(bad(|s| s.controller.ti_s = -1.0).is_some_and(|e| e.contains("integral time")));
        assert!(
            bad(|s| s.valve.friction = Friction::Kano { s: -1.0, j: 0.0, resolution: 0.0 })
                .is_some_and(|e| e.contains("S must"))
        );
        assert!(
            bad(|s| s.valve.friction = Friction::He { fs: 1.0, fd: 2.0 })
                .is_some_and(|e| e.contains("fs - fd"))
        );
        assert!(bad(|s| s.sensor.quantum = f64::NAN).is_some_and(|e| e.contains("quantum")));
        let band = |sample_time_s| Some(BandLimited { power: 1.0, sample_time_s });
        for (noise, refused) in [(band(0.0), true), (band(1.0), false)] {
            let mut of = flow_loop();
            of.sensor.band_limited = noise;
            assert_eq!(LoopSim::new(&of, 1).is_err(), refused);
        }
        assert_eq!(bad(|_| ()), None);
    }
}
