//! The receiving end of a subscription: keeps of each value what a sample is made of, and passes it on without waiting. What
//! waits for the collector is counted by its memory, since a server may send faster than it is asked to.

use super::value::{Meaning, Received};
use opcua::client::{MonitoredItem, OnSubscriptionNotification};
use opcua::types::{DataValue, StatusChangeNotification, StatusCode};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use tokio::sync::Notify;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::Instant;

/// Memory of the events that wait for the collector at most (bytes): room for some 100,000 numbers. What is more is dropped and
/// counted, and so is all that comes later: what is held has no holes.
const MOST_BYTES: usize = 8 << 20;
/// From so many bytes on the collector waits for a server only while that answers: half, so that nothing is dropped yet.
const CROWDED: usize = MOST_BYTES / 2;

/// What a subscription brings.
#[derive(Debug)]
pub(super) enum Event {
    /// A value of the tag at this position.
    Value(usize, Received),
    /// The server ended the subscription.
    Ended(StatusCode),
}

impl Event {
    /// Memory that it takes while it waits (bytes).
    fn bytes(&self) -> usize {
        let text = match self {
            Event::Value(_, value) => value.text_bytes(),
            Event::Ended(_) => 0,
        };
        size_of::<Event>() + text
    }
}

/// What both ends know of the events that wait.
#[derive(Default)]
struct Waiting {
    /// Memory of those that wait.
    bytes: AtomicUsize,
    /// Those that found no room, or came later than one that found none.
    dropped: AtomicU64,
    /// When the first of them came.
    full: OnceLock<Instant>,
    /// Told when there are too many.
    crowded: Notify,
}

/// Takes what a subscription brings.
pub(super) struct Listener {
    /// How the values of each tag are read, by position.
    meanings: Vec<Meaning>,
    sender: UnboundedSender<Event>,
    waiting: Arc<Waiting>,
}

/// What a subscription brought, in its order.
pub(super) struct Events {
    receiver: UnboundedReceiver<Event>,
    waiting: Arc<Waiting>,
}

/// A listener to a subscription whose tags have these meanings, and what it hears.
pub(super) fn listener(meanings: Vec<Meaning>) -> (Listener, Events) {
    let ((sender, receiver), waiting) = (unbounded_channel(), Arc::<Waiting>::default());
    (Listener { meanings, sender, waiting: waiting.clone() }, Events { receiver, waiting })
}

impl Listener {
    /// Only this end adds, so nothing comes between the look at what waits and the event.
    fn send(&self, event: Event) {
        let bytes = event.bytes();
        let all = self.waiting.bytes.load(Ordering::Relaxed) + bytes;
        if all > MOST_BYTES || self.waiting.full.get().is_some() {
            self.waiting.full.get_or_init(Instant::now);
            self.waiting.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        self.waiting.bytes.fetch_add(bytes, Ordering::Relaxed);
        if self.sender.send(event).is_err() {
            // Nobody receives any more.
            self.waiting.bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
        if all >= CROWDED {
            self.waiting.crowded.notify_one();
        }
    }

    fn value(&self, client_handle: u32, value: &DataValue) {
        let Some(at) = client_handle.checked_sub(1).map(|at| at as usize) else { return };
        if let Some(meaning) = self.meanings.get(at) {
            self.send(Event::Value(at, Received::of(value, meaning)));
        }
    }
}

impl OnSubscriptionNotification for Listener {
    fn on_data_value(&mut self, value: DataValue, item: &MonitoredItem) {
        self.value(item.client_handle(), &value);
    }

    fn on_subscription_status_change(&mut self, change: StatusChangeNotification) {
        self.send(Event::Ended(change.status));
    }
}

impl Events {
    /// The next event; `None` when no more can come.
    pub(super) async fn recv(&mut self) -> Option<Event> {
        let event = self.receiver.recv().await?;
        self.waiting.bytes.fetch_sub(event.bytes(), Ordering::Relaxed);
        Some(event)
    }

    /// The next event, if one waits.
    pub(super) fn take(&mut self) -> Option<Event> {
        let event = self.receiver.try_recv().ok()?;
        self.waiting.bytes.fetch_sub(event.bytes(), Ordering::Relaxed);
        Some(event)
    }

    /// Whether none waits.
    pub(super) fn is_empty(&self) -> bool {
        self.receiver.is_empty()
    }

    /// Ends when so many wait that they have to be taken before anything else is done.
    pub(super) async fn crowded(&self) {
        while self.waiting.bytes.load(Ordering::Relaxed) < CROWDED {
            self.waiting.crowded.notified().await;
        }
    }

    /// Since when events are dropped, and how many were, if any.
    pub(super) fn dropped(&self) -> Option<(Instant, u64)> {
        let since = self.waiting.full.get()?;
        Some((*since, self.waiting.dropped.load(Ordering::Relaxed)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collect::scaling::Scaling;
    use futures::FutureExt;
    use opcua::types::Variant;

    fn meaning() -> Meaning {
        let scaling = Scaling { scale: 1.0, offset: 0.0, range: None, auto_values: None };
        Meaning { scaling, element: None, decimal: None }
    }

    fn of(value: Variant) -> DataValue {
        DataValue { value: Some(value), ..DataValue::null() }
    }

    /// Sends a value again and again until one was dropped; returns how many found room.
    fn flood(listener: &Listener, value: &DataValue) -> u64 {
        (0..10_000_000)
            .take_while(|_| {
                listener.value(1, value);
                listener.waiting.dropped.load(Ordering::Relaxed) == 0
            })
            .count() as u64
    }

    #[test]
    fn whatever_is_sent_and_not_taken_is_held_up_to_a_bound_and_the_rest_is_counted() {
        let text = "\u{1f321}".repeat(1000);
        let large = of(Variant::from(vec![0.0; 1000]));
        let kinds = [of(Variant::from(1.0)), DataValue::null(), large, of(Variant::from(text.as_str()))];
        for value in kinds {
            let (listener, mut events) = listener(vec![meaning()]);
            let room = flood(&listener, &value);
            let bytes = events.waiting.bytes.load(Ordering::Relaxed);
            assert!(bytes <= MOST_BYTES && bytes > MOST_BYTES - 1000, "{bytes} bytes of {value:?}");
            // A number, a value of nothing and an array of any length take the same; a text is cut short.
            assert!(room > 20_000, "{room} of {value:?}");
            listener.value(1, &value);
            assert_eq!(events.dropped().map(|(_, count)| count), Some(2));
            for _ in 0..room {
                assert!(matches!(events.recv().now_or_never(), Some(Some(Event::Value(0, _)))));
            }
            assert!(events.is_empty() && events.waiting.bytes.load(Ordering::Relaxed) == 0);
            // There is room again, but what comes now would stand behind a hole.
            listener.value(1, &value);
            listener.send(Event::Ended(StatusCode::BadTimeout));
            assert!(events.take().is_none() && events.dropped().map(|(_, count)| count) == Some(4));
        }
    }

    #[test]
    fn too_many_are_told_before_any_is_dropped_and_only_while_they_wait() {
        let (listener, mut events) = listener(vec![meaning()]);
        let one = of(Variant::from(1.0));
        listener.value(1, &one);
        assert!(events.crowded().now_or_never().is_none());
        while events.waiting.bytes.load(Ordering::Relaxed) < CROWDED {
            listener.value(1, &one);
        }
        assert!(events.crowded().now_or_never().is_some() && events.crowded().now_or_never().is_some());
        assert_eq!(events.dropped(), None);
        assert!(events.recv().now_or_never().is_some());
        assert!(events.crowded().now_or_never().is_none());
    }

    #[test]
    fn a_value_of_no_tag_is_none_of_ours() {
        let (listener, events) = listener(vec![meaning()]);
        for handle in [0, 2, u32::MAX] {
            listener.value(handle, &of(Variant::from(1.0)));
        }
        assert!(events.is_empty() && events.dropped().is_none());
    }
}
