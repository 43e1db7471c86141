//! What the daemon has around it: a clock, a network, a disk. All of them may be simulated.

use crate::collect::modbus;
use crate::schedule::Clock;
use crate::store;

/// What is around the daemon.
#[derive(Clone)]
pub struct Surroundings {
    /// Plant time.
    pub clock: Clock,
    /// How devices that are polled are connected to.
    pub dial: modbus::Dial,
    /// How the store is opened, and who has its rounds done.
    pub store: store::Driven,
}

impl Surroundings {
    /// The machine's network and disk.
    pub fn of_machine(clock: Clock) -> Self {
        Self { clock, dial: modbus::sockets(), store: store::Driven::default() }
    }
}
