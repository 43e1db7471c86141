//! What collecting from a broker and publishing to one have in common: how it is reached, as which client, and
//! Sparkplug B's messages.

mod broker;
mod identity;
pub mod sparkplug;

pub use broker::{Broker, BrokerError, Password, topic_fault};
pub use identity::{Takeovers, default_client_id};
