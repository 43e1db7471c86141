//! Control loops on paper, pure: processes, controllers, sticking valves, loads and sensors, put together
//! as a [`LoopSpec`] and run by [`LoopSim`]. Time is counted in samples and every seed is an argument: the
//! same specification and seed give the same record. Everything is in % of span; times in seconds.

pub mod acquisition;
pub mod archive;
pub mod controller;
pub mod demo_plant;
pub mod load;
pub mod plant;
pub mod process;
pub mod scenarios;
pub mod sensor;
pub mod units;
pub mod valve;

pub use controller::{Controller, ControllerSpec, Mode};
pub use demo_plant::{Class, DemoLoop, Expected, demo_plant};
pub use load::{At, Load, LoadKind};
pub use plant::{LoopSim, LoopSpec, Point, Recording, Run, SetPointSteps, SpecError, simulate};
pub use process::{Process, ProcessKind, ProcessSpec};
pub use scenarios::{Scenario, Truth, reverses_beyond};
pub use sensor::{Freeze, Outliers, Sensor, SensorSpec};
pub use valve::{Characteristic, Friction, Valve, ValveSpec};
