//! Modbus/TCP, read only: no function code that writes exists in this module.
//!
//! `config` says what to read, `plan` groups it into requests without I/O, `device` polls one device,
//! `decode` makes values of registers. `slots` decides which request is asked when, `backoff` when to try
//! a lost link again; both are pure. `link` is the only place that talks to a socket. `probe` helps at
//! commissioning.

mod backoff;
mod config;
mod decode;
mod device;
mod link;
mod plan;
mod probe;
mod slots;

pub use config::{ByteOrder, Config, Contradiction, Issue, Register, TagConfig, ValueType, contradictions};
pub use decode::{Decoder, Reading};
pub use device::Collector;
pub use plan::{Limits, Plan, Request, Span, Tag, TagSpec, group};
pub use probe::{ProbeError, ProbeTarget, Table, probe};
