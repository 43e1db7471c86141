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

use edge::Edge;
use futures::future::BoxFuture;
use tokio_util::sync::CancellationToken;

/// Publishes until `stop` is cancelled, as JSON and where it is configured as an edge node, and then says that it is offline.
pub fn run(publisher: &Publisher, stop: CancellationToken) -> BoxFuture<'_, ()> {
    // Boxed here, so that a binary that calls it does not compile the publisher once more.
    Box::pin(async move {
        let node = async {
            if let Some(sparkplug) = &publisher.config.sparkplug {
                Edge::new(publisher, sparkplug).run(stop.clone()).await;
            }
        };
        tokio::join!(publisher.publish(stop.clone()), node);
    })
}
