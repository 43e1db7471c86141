//! Whose turn it is on a connection: of one device, or of all units behind a gateway that takes one connection only.

use super::config::Framing;
use super::link::Link;
use super::plan::Plan;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;
use tokio::sync::{Mutex as Turns, MutexGuard};
use tokio::time::{Instant, sleep_until};

/// What was opened to an address, if anything is, and when it was last used. Turns are given in the order asked for,
/// so that no unit waits for more than one request of each other.
#[derive(Default)]
pub(super) struct Line {
    state: Turns<State>,
}

#[derive(Default)]
pub(super) struct State {
    /// The connection; whoever takes it out and does not put it back has lost it for all.
    pub(super) link: Option<Link>,
    used: Option<Instant>,
}

impl State {
    /// A request has ended.
    pub(super) fn used(&mut self) {
        self.used = Some(Instant::now());
    }
}

type Shared = Mutex<Vec<((String, Framing), Weak<Line>)>>;

/// Lines in use by address: a gateway counts the connections of the whole process, whoever opened them.
static SHARED: Shared = Mutex::new(Vec::new());

impl Line {
    /// The line of a device: its own, or the one all who share the address have.
    pub(super) fn of(plan: &Plan) -> Arc<Line> {
        if !plan.share_connection {
            return Arc::default();
        }
        let key = (plan.address.clone(), plan.framing);
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        shared.retain(|(_, line)| line.strong_count() > 0);
        if let Some(line) =
            shared.iter().find(|(known, _)| *known == key).and_then(|(_, line)| line.upgrade())
        {
            return line;
        }
        let line = Arc::default();
        shared.push((key, Arc::downgrade(&line)));
        line
    }

    /// Waits for a turn, and then until `gap` has passed since the last request.
    pub(super) async fn turn(&self, gap: Duration) -> MutexGuard<'_, State> {
        let state = self.state.lock().await;
        if let Some(used) = state.used.filter(|_| !gap.is_zero()) {
            sleep_until(used + gap).await;
        }
        state
    }
}
