//! Results to those who want to hear of them, as `[notify]` says.

use super::Clock;
use crate::config::Config;
use crate::notify::mqtt::{LoopName, Publisher};
use crate::results::Results;
use crate::signal::LoopId;
use std::sync::{Arc, Mutex, PoisonError};
use tokio_util::sync::CancellationToken;

/// Who is told.
pub struct Notifying {
    publisher: Option<Publisher>,
    loops: Arc<Mutex<Vec<LoopName>>>,
}

impl Notifying {
    /// Nothing connects yet.
    pub fn new(config: &Config, clock: Clock, results: &Arc<Results>) -> Self {
        let loops = Arc::new(Mutex::new(names(config)));
        let known = loops.clone();
        let known = Arc::new(move || known.lock().unwrap_or_else(PoisonError::into_inner).clone());
        let now = Arc::new(move || clock.now());
        let publisher =
            config.notify.mqtt.clone().map(|mqtt| Publisher::new(mqtt, results.clone(), known, now));
        Self { publisher, loops }
    }

    /// Tells until `stop` is cancelled.
    pub async fn run(&self, stop: CancellationToken) {
        if let Some(publisher) = &self.publisher {
            publisher.run(stop).await;
        }
    }

    /// Another configuration is in force: the loops that are told of.
    pub fn reload(&self, config: &Config) {
        *self.loops.lock().unwrap_or_else(PoisonError::into_inner) = names(config);
    }
}

fn names(config: &Config) -> Vec<LoopName> {
    let name = |control_loop: &crate::config::LoopConfig| LoopName {
        id: LoopId::new(control_loop.id.as_str()),
        group: control_loop.group.clone(),
    };
    config.loops.iter().map(name).collect()
}
