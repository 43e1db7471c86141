//! Orders of people on their way to the streams: who answers them has to know that they are kept.

use super::{Fleet, lock, orders};
use crate::fleet::link::{Link, Outgoing};
use crate::fleet::subject::{self, Subject, What};
use crate::serve::AskDurable;
use prost::Message;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Longest wait for an order to be kept: longer than one answer of the server takes.
const PATIENCE: Duration = Duration::from_secs(5);

#[derive(Debug, Default)]
struct Count {
    waiting: usize,
    given_up: u64,
}

/// Counts orders that are not kept yet, and those that were given up.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    count: Mutex<Count>,
    changed: Condvar,
}

impl Waiting {
    fn lock(&self) -> MutexGuard<'_, Count> {
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One more waits.
    pub(super) fn begin(&self) {
        self.lock().waiting += 1;
    }

    /// One is kept, or was given up.
    pub(super) fn end(&self, kept: bool) {
        let mut count = self.lock();
        count.waiting = count.waiting.saturating_sub(1);
        count.given_up += u64::from(!kept);
        self.changed.notify_all();
    }

    /// Waits until none is on its way; false where that takes longer than `patience`, or one was given up meanwhile. It blocks
    /// its thread.
    pub(super) fn are_kept(&self, patience: Duration) -> bool {
        let count = self.lock();
        let given_up = count.given_up;
        let waited = self.changed.wait_timeout_while(count, patience, |count| count.waiting > 0);
        let (count, late) = waited.unwrap_or_else(PoisonError::into_inner);
        !late.timed_out() && count.given_up == given_up
    }
}

impl Fleet {
    /// Passes on what people want done about alarms.
    pub(super) async fn pass_on(&self, link: &Link) {
        let mut wanted = self.wanted.lock().await;
        while let Some((own, epoch)) = wanted.recv().await {
            let subject = own.id.subject.to_string();
            let mut kept = false;
            if let Some((site, name)) = subject::split(&subject) {
                let to = Subject::new(site, name, What::Action).to_string();
                let edge = lock(&self.claims).owner(&subject).unwrap_or_default().to_string();
                let order = orders::action(own, (name, edge.as_str()), epoch);
                let message = [Outgoing::once(to, order.encode_to_vec())];
                let sending = async {
                    while let Err((_, error)) = link.send(&message).await {
                        self.rest(&error, "an order waits").await;
                    }
                };
                kept = tokio::time::timeout(PATIENCE, sending).await.is_ok();
                if !kept {
                    tracing::error!(
                        subject,
                        "an order is given up: the streams have not said that they take it; its edge may still do it, once the line is back"
                    );
                }
            }
            self.orders_waiting.end(kept);
        }
    }

    /// Waits for orders of people to be in the streams too, where this is a centre.
    pub(in crate::app) fn with_orders(self: Arc<Self>, durable: AskDurable) -> AskDurable {
        Arc::new(move || self.orders_waiting.are_kept(PATIENCE) && durable())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_hears_that_an_order_is_kept() {
        let waiting = Arc::new(Waiting::default());
        waiting.begin();
        let own = waiting.clone();
        let keeper = std::thread::spawn(move || own.end(true));
        assert!(waiting.are_kept(Duration::from_secs(60)));
        keeper.join().expect("no panic");
    }

    #[test]
    fn without_orders_nothing_is_waited_for_and_with_one_no_longer_than_told() {
        let waiting = Waiting::default();
        assert!(waiting.are_kept(Duration::ZERO));
        waiting.begin();
        assert!(!waiting.are_kept(Duration::ZERO));
        waiting.end(false);
        assert!(waiting.are_kept(Duration::ZERO), "what was given up before is no matter of this order");
    }
}
