//! MQTT: values from a broker, as JSON, plain numbers or Sparkplug B. Publishes nothing but the request for births.
//!
//! `config` says what to listen to; `plan` is that, checked, without I/O. `json` makes values of payloads, `session`
//! follows the edge nodes of Sparkplug B, `tags` makes samples of values: all three are pure. `device` keeps the connection.

mod config;
mod device;
mod json;
mod plan;
mod probe;
mod session;
mod tags;

pub use config::{Config, TagConfig, TimeFallback, TimeUnit};
pub use device::Collector;
pub use plan::{Plan, TagSpec};
pub use probe::{Leaf, Probed, Seen, probe};
