//! A small plant of twenty loops with a known truth, for showing and for testing the whole way from a register to a
//! verdict. Its valves stick as Choudhury's and Kano's do, with two parameters S and J, where the diagnosis fits one.

use super::controller::{ControllerSpec, Mode};
use super::load::{Load, LoadKind};
use super::plant::{LoopSpec, SetPointSteps};
use super::process::{ProcessKind, ProcessSpec};
use super::scenarios::Truth;
use super::sensor::{Freeze, SensorSpec};
use super::valve::{Friction, ValveSpec};

/// Sample period of the controllers (s).
pub const TS_S: f64 = 0.5;
/// |Δop| up to this stops a stem (%).
const RESOLUTION: f64 = 0.005;

/// Set-point steps of loops whose loads alone tell too little about the valve: the demo reads every fourth scan only, so that OP
/// tells more of PV than the samples of PV do.
const SP_STEPS: SetPointSteps = SetPointSteps { every_s: 300.0, size: 4.0 };

/// What a diagnosis ought to say about a loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expected {
    /// The valve sticks or has a dead band.
    Stiction,
    /// The valve is sound.
    NoStiction,
    /// The data cannot tell.
    NotIdentifiable,
}

impl Expected {
    /// The verdict as the report writes it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Stiction => "stiction",
            Self::NoStiction => "no_stiction",
            Self::NotIdentifiable => "not_identifiable",
        }
    }
}

/// What a loop controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// Flow.
    Flow,
    /// Level.
    Level,
    /// Pressure.
    Pressure,
    /// Temperature.
    Temperature,
}

impl Class {
    /// All classes, in the plant's order.
    pub const ALL: [Class; 4] = [Class::Flow, Class::Level, Class::Pressure, Class::Temperature];

    /// In words.
    pub fn as_str(self) -> &'static str {
        match self {
            Class::Flow => "flow",
            Class::Level => "level",
            Class::Pressure => "pressure",
            Class::Temperature => "temperature",
        }
    }

    /// Letters and hundreds of its loops' names.
    fn prefix(self) -> &'static str {
        match self {
            Class::Flow => "FIC1",
            Class::Level => "LIC2",
            Class::Pressure => "PIC3",
            Class::Temperature => "TIC4",
        }
    }

    /// The loop at rest, with a PI tuned by the SIMC rules.
    fn at_rest(self) -> LoopSpec {
        let (kind, dead_time_s, controller) = match self {
            Class::Flow => {
                (ProcessKind::FirstOrder { gain: 1.2, tau_s: 6.0 }, 2.0, ControllerSpec::pi(1.1, 6.0))
            }
            Class::Level => (ProcessKind::Integrating { rate: 0.05 }, 2.0, ControllerSpec::pi(4.0, 25.0)),
            Class::Pressure => (ProcessKind::two_lags(1.5, 12.0, 3.0), 1.0, ControllerSpec::pi(1.5, 10.0)),
            Class::Temperature => (ProcessKind::two_lags(0.9, 25.0, 6.0), 2.0, ControllerSpec::pi(2.0, 18.0)),
        };
        LoopSpec {
            process: ProcessSpec { kind, dead_time_s },
            controller,
            valve: ValveSpec::linear(Friction::Ideal),
            loads: Vec::new(),
            sensor: SensorSpec::noisy(0.02),
            sp: 50.0,
            sp_schedule: Vec::new(),
            sp_steps: None,
            ts_s: TS_S,
            op0: 50.0,
            pv0: 50.0,
        }
    }
}

/// One loop of the plant.
#[derive(Clone, Debug, PartialEq)]
pub struct DemoLoop {
    /// Its name.
    pub id: String,
    /// What it controls.
    pub class: Class,
    /// How to simulate it.
    pub spec: LoopSpec,
    /// What is true of its valve.
    pub truth: Truth,
    /// What a diagnosis ought to say.
    pub expected: Expected,
    /// Seed of its noise and loads.
    pub seed: u64,
}

impl DemoLoop {
    /// True when the controller is in automatic.
    pub fn in_automatic(&self) -> bool {
        self.spec.controller.mode == Mode::Automatic
    }
}

/// The twenty loops; `seed` decides their noise and loads.
pub fn demo_plant(seed: u64) -> Vec<DemoLoop> {
    use Class::{Flow, Level, Pressure, Temperature};
    let mut plant = Builder { seed, loops: Vec::new() };
    plant.sound(Flow, "sound", disturbed);
    plant.sticky(Flow, "strong stiction", choudhury(5.0, 1.0), |_| ());
    plant.sticky(Flow, "weak stiction", choudhury(1.0, 0.4), |_| ());
    plant.sound(Flow, "oscillating load", |spec| oscillating(spec, 3.0, 70.0));
    plant.sound(Flow, "tight tuning", |spec| tight(spec, 2.55));
    plant.mute(Flow, "saturated", |spec| spec.sp = 130.0);
    plant.sticky(Flow, "dead band only", kano(4.0, 0.0), |spec| {
        spec.loads.push(Load::input(LoadKind::Coloured { sd: 2.0, tau_s: 200.0 }));
        // Steps that OP follows far beyond the dead band.
        spec.sp_steps = Some(SetPointSteps { size: 8.0, ..SP_STEPS });
    });
    plant.sticky(Flow, "stiction, noisy", choudhury(6.0, 2.0), |spec| {
        spec.sensor = SensorSpec::noisy(0.15);
    });

    plant.sticky(Level, "strong stiction", kano(5.0, 1.0), |_| ());
    plant.sticky(Level, "dead band only", kano(3.0, 0.0), |_| ());
    plant.sound(Level, "oscillating load", |spec| oscillating(spec, 4.0, 160.0));
    plant.mute(Level, "manual", |spec| spec.controller.mode = Mode::Manual(50.0));

    plant.sticky(Pressure, "weak stiction", choudhury(1.2, 0.5), |_| ());
    plant.mute(Pressure, "frozen PV", freeze);
    plant.sticky(Pressure, "strong stiction", kano(4.0, 1.5), |_| ());
    plant.sound(Pressure, "sound, noisy", |spec| {
        spec.loads.push(Load::input(LoadKind::Coloured { sd: 2.0, tau_s: 10.0 }));
        spec.sensor = SensorSpec::noisy(0.05);
    });
    plant.sound(Pressure, "tight tuning", |spec| tight(spec, 2.1));

    plant.sticky(Temperature, "stiction", kano(5.0, 2.0), |_| ());
    plant.sound(Temperature, "oscillating load", |spec| oscillating(spec, 3.0, 240.0));
    plant.mute(Temperature, "saturated", |spec| spec.sp = -10.0);
    plant.loops
}

fn choudhury(s: f64, j: f64) -> Friction {
    Friction::Choudhury { s, j, resolution: RESOLUTION }
}

fn kano(s: f64, j: f64) -> Friction {
    Friction::Kano { s, j, resolution: RESOLUTION }
}

/// Coloured disturbance of the flow through the valve, as any loop in a plant has.
fn disturbed(spec: &mut LoopSpec) {
    spec.loads.push(Load::input(LoadKind::Coloured { sd: 2.0, tau_s: 40.0 }));
}

/// A periodic load, beside one that moves OP enough for the record of a sound valve to exclude friction.
fn oscillating(spec: &mut LoopSpec, amplitude: f64, period_s: f64) {
    spec.loads.push(Load::input(LoadKind::Sine { amplitude, period_s, phase: 0.0, growth_per_s: 0.0 }));
    spec.loads.push(Load::input(LoadKind::Coloured { sd: 1.0, tau_s: 40.0 }));
}

/// More gain than is good: the loop rings on every disturbance.
fn tight(spec: &mut LoopSpec, factor: f64) {
    spec.controller.gain *= factor;
    // A high gain makes large moves of OP from small steps.
    spec.sp_steps = Some(SetPointSteps { size: 2.0, ..SP_STEPS });
    spec.loads.push(Load::input(LoadKind::Coloured { sd: 0.5, tau_s: 20.0 }));
}

/// A transmitter that stopped before anyone looked.
fn freeze(spec: &mut LoopSpec) {
    disturbed(spec);
    spec.sensor.freeze = Some(Freeze { from_s: 60.0, to_s: f64::INFINITY });
}

struct Builder {
    seed: u64,
    loops: Vec<DemoLoop>,
}

impl Builder {
    fn sound(&mut self, class: Class, kind: &str, change: impl FnOnce(&mut LoopSpec)) {
        self.push(class, kind, Expected::NoStiction, Friction::Ideal, |spec| {
            spec.sp_steps = Some(SP_STEPS);
            change(spec);
        });
    }

    fn sticky(&mut self, class: Class, kind: &str, friction: Friction, change: impl FnOnce(&mut LoopSpec)) {
        self.push(class, kind, Expected::Stiction, friction, change);
    }

    /// A loop whose data cannot tell.
    fn mute(&mut self, class: Class, kind: &str, change: impl FnOnce(&mut LoopSpec)) {
        self.push(class, kind, Expected::NotIdentifiable, Friction::Ideal, change);
    }

    fn push(
        &mut self,
        class: Class,
        kind: &str,
        expected: Expected,
        friction: Friction,
        change: impl FnOnce(&mut LoopSpec),
    ) {
        let mut spec = class.at_rest();
        spec.valve.friction = friction;
        let (s, j) = match friction {
            Friction::Choudhury { s, j, .. } | Friction::Kano { s, j, .. } => (s, j),
            _ => (0.0, 0.0),
        };
        // A step of more than S gets the stem off its first stuck point.
        spec.sp += 1.5 * s;
        change(&mut spec);
        let number = self.loops.iter().filter(|l| l.class == class).count() + 1;
        self.loops.push(DemoLoop {
            id: format!("{}{number:02}", class.prefix()),
            class,
            spec,
            truth: Truth { sticky: s > 0.0, s, j, kind: kind.to_owned() },
            expected,
            // Every loop its own noise, whatever the plant's seed.
            seed: self.seed.wrapping_mul(1000).wrapping_add(self.loops.len() as u64),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::plant::{Recording, record};
    use crate::sim::reverses_beyond;

    /// As the demo polls: every fourth sample, after 2,000 s.
    fn polled(demo: &DemoLoop, n: usize) -> crate::sim::Run {
        record(&demo.spec, n + 1000, demo.seed, Recording::Sample { every: 4 })
            .expect("the plant is valid")
            .after(1000)
    }

    #[test]
    fn sticky_loops_cycle_and_stay_inside_their_limits() {
        for seed in 0..5 {
            for demo in demo_plant(seed) {
                let run = polled(&demo, 600);
                let (low, high) = run.op.iter().fold((f64::MAX, f64::MIN), |(l, h), &u| (l.min(u), h.max(u)));
                let reversals = reverses_beyond(&run.op, demo.truth.s);
                println!("{} {:18} reversals {reversals:4} OP {low:.2}..{high:.2}", demo.id, demo.truth.kind);
                match demo.expected {
                    Expected::Stiction => assert!(reversals >= 8, "{}: {reversals}", demo.id),
                    Expected::NoStiction => assert!(high - low > 0.2, "{}: OP rests", demo.id),
                    Expected::NotIdentifiable => continue,
                }
                assert!(low > 5.0 && high < 95.0, "{}: OP {low}..{high}", demo.id);
            }
        }
    }

    #[test]
    fn twenty_loops_of_every_class_and_kind() {
        let plant = demo_plant(1);
        assert_eq!(plant.len(), 20);
        for class in Class::ALL {
            let own: Vec<_> = plant.iter().filter(|l| l.class == class).collect();
            assert!(own.iter().any(|l| l.expected == Expected::Stiction));
            assert!(own.iter().any(|l| l.expected == Expected::NoStiction));
            assert!(own.iter().any(|l| l.expected == Expected::NotIdentifiable));
        }
        for demo in &plant {
            assert_eq!(demo.truth.sticky, demo.expected == Expected::Stiction);
            assert!(!matches!(demo.spec.valve.friction, Friction::OneParameter { .. }));
        }
    }
}
