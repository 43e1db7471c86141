//! One device of any kind: its plan, and the task that keeps it.

use super::{Clock, DeviceHealth, Sink, modbus, mqtt, opcua};
use crate::signal::Sample;
use std::sync::Arc;
use tokio_util::sync::CancellationToken;

/// What to ask of one device, whatever it speaks.
#[derive(Clone, Debug)]
pub enum Plan {
    /// A Modbus/TCP device.
    Modbus(modbus::Plan),
    /// An OPC UA server.
    Opcua(opcua::Plan),
    /// An MQTT broker.
    Mqtt(mqtt::Plan),
}

impl Plan {
    /// The device's name.
    pub fn name(&self) -> &str {
        match self {
            Plan::Modbus(plan) => &plan.name,
            Plan::Opcua(plan) => &plan.config.name,
            Plan::Mqtt(plan) => &plan.config.name,
        }
    }

    /// The number under which the [`Sink`] hears of it.
    pub fn device(&self) -> usize {
        match self {
            Plan::Modbus(plan) => plan.device,
            Plan::Opcua(plan) => plan.device,
            Plan::Mqtt(plan) => plan.device,
        }
    }

    /// The numbers of its tags.
    pub fn tags(&self) -> Vec<usize> {
        match self {
            Plan::Modbus(plan) => plan.tags.iter().map(|tag| tag.index).collect(),
            Plan::Opcua(plan) => plan.tags.iter().map(|tag| tag.index).collect(),
            Plan::Mqtt(plan) => plan.tags.iter().map(|tag| tag.index).collect(),
        }
    }

    /// Whether a device would be asked the same under both plans, apart from the numbers of its tags and its own.
    pub fn asks_the_same(&self, other: &Plan) -> bool {
        match (self, other) {
            (Plan::Modbus(a), Plan::Modbus(b)) => a.asks_the_same(b),
            (Plan::Opcua(a), Plan::Opcua(b)) => a.asks_the_same(b),
            (Plan::Mqtt(a), Plan::Mqtt(b)) => a.asks_the_same(b),
            _ => false,
        }
    }
}

/// The task of one device.
pub enum Collector {
    /// Polls registers.
    Modbus(Box<modbus::Collector>),
    /// Keeps a session.
    Opcua(Box<opcua::Collector>),
    /// Listens to a broker.
    Mqtt(Box<mqtt::Collector>),
}

impl Collector {
    /// A collector for the plan. `seed` decides the jitter only: give each device another.
    pub fn new(plan: Plan, clock: Arc<dyn Clock>, seed: u64) -> Self {
        match plan {
            Plan::Modbus(plan) => Self::Modbus(Box::new(modbus::Collector::new(plan, clock, seed))),
            Plan::Opcua(plan) => Self::Opcua(Box::new(opcua::Collector::new(plan, clock, seed))),
            Plan::Mqtt(plan) => Self::Mqtt(Box::new(mqtt::Collector::new(plan, clock, seed))),
        }
    }

    /// Connects by `dial` and not by TCP, where it polls: a simulated network.
    pub fn dialling(self, dial: modbus::Dial) -> Self {
        match self {
            Self::Modbus(collector) => Self::Modbus(Box::new(collector.dialling(dial))),
            other => other,
        }
    }

    /// Takes the numbers of namespaces for those that all who share `pinned` take them for, where it speaks OPC UA.
    pub fn pinning(self, pinned: &opcua::Pinned) -> Self {
        match self {
            Self::Opcua(collector) => Self::Opcua(Box::new(collector.pinning(pinned))),
            other => other,
        }
    }

    /// The device's counters, live.
    pub fn health(&self) -> Arc<DeviceHealth> {
        match self {
            Self::Modbus(collector) => collector.health(),
            Self::Opcua(collector) => collector.health(),
            Self::Mqtt(collector) => collector.health(),
        }
    }

    /// Before it runs: the newest sample that each tag has from before the start.
    pub fn resume(&mut self, newest: &dyn Fn(usize) -> Option<Sample>) {
        match self {
            Self::Opcua(collector) => collector.resume(newest),
            Self::Mqtt(collector) => collector.resume(newest),
            // What is polled has a stamp of ours.
            Self::Modbus(_) => {}
        }
    }

    /// Collects until `shutdown` is cancelled.
    pub async fn run(self, sink: Arc<dyn Sink>, shutdown: CancellationToken) {
        match self {
            Self::Modbus(collector) => collector.run(sink, shutdown).await,
            Self::Opcua(collector) => collector.run(sink, shutdown).await,
            Self::Mqtt(collector) => collector.run(sink, shutdown).await,
        }
    }
}
