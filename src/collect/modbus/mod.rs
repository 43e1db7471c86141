//! Modbus/TCP, read only: no function code that writes exists in this module.
//!
//! `config` says what to read, `kinds` how registers become numbers, and `overlap` finds tags that contradict each other; `plan` groups them into
//! requests without I/O; `device` polls one device. `slots` decides which request is asked when, `decode` makes
//! values of registers: both are pure. `head` judges whether an answer belongs to its
//! request and is pure too. `link` asks over one connection, and `wire`, the only place that opens a socket, is what it is made of;
//! `line` is whose turn it is on one. `probe` helps at commissioning.

mod config;
mod decode;
mod device;
mod head;
mod kinds;
mod line;
mod link;
mod overlap;
mod plan;
mod probe;
mod slots;
mod wire;

pub use config::{Config, Framing, TagConfig, Tolerated, WHICH_BASE, counted};
pub use decode::Decoder;
pub use device::Collector;
pub use kinds::{ByteOrder, Register, ValueType};
pub use overlap::{Contradiction, contradictions};
pub use plan::{Limits, Plan, Request, Span, Tag, TagSpec, group};
pub use probe::{ProbeError, ProbeTarget, Table, probe, probe_over};
pub use wire::{Dial, Dialled, Wire, sockets};
