//! What collecting from a broker and publishing to one have in common: how it is reached, and Sparkplug B's messages.

mod broker;
pub mod sparkplug;

pub use broker::{Broker, BrokerError, Password, topic_fault};
