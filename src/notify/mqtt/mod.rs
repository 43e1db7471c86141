//! Diagnoses and alarms to an MQTT broker: retained JSON, and as an option Sparkplug B.
//!
//! `config` is the section of the file; `message` makes payloads and `outbox` keeps the latest of each topic until the broker
//! has it: both are pure. `publisher` keeps the connection; `edge` is the node of Sparkplug B.

mod config;
mod edge;
mod message;
mod outbox;
mod publisher;

pub use config::{Config, SparkplugConfig};
pub use publisher::{Counters, LoopName, Publisher};
