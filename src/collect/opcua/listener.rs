//! The receiving end of a subscription: passes on what comes, without waiting.

use opcua::client::{MonitoredItem, OnSubscriptionNotification};
use opcua::types::{DataValue, StatusChangeNotification, StatusCode};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc::Sender;

/// Events that wait for the collector; more are dropped and counted.
pub(super) const MAX_EVENTS: usize = 100_000;

/// What a subscription brings.
#[derive(Debug)]
pub(super) enum Event {
    /// A value of the tag at this position.
    Value(usize, Box<DataValue>),
    /// The server ended the subscription.
    Ended(StatusCode),
}

/// Passes on what the subscription brings.
pub(super) struct Listener {
    pub(super) sender: Sender<Event>,
    pub(super) dropped: Arc<AtomicU64>,
}

impl Listener {
    fn send(&self, event: Event) {
        if self.sender.try_send(event).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl OnSubscriptionNotification for Listener {
    fn on_data_value(&mut self, value: DataValue, item: &MonitoredItem) {
        if let Some(at) = item.client_handle().checked_sub(1) {
            self.send(Event::Value(at as usize, Box::new(value)));
        }
    }

    fn on_subscription_status_change(&mut self, change: StatusChangeNotification) {
        self.send(Event::Ended(change.status));
    }
}
