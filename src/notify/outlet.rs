//! What a machine of a fleet has to tell people: who hands it over learns when all receivers have it on disk.

use crate::results::{AlarmChange, Event};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use tokio::sync::broadcast::{self, error::RecvError, error::TryRecvError};
use tokio::sync::oneshot;

/// Changes that wait for a receiver.
const WAITING: usize = 4096;

/// A change that people have to be told of. A receiver holds it until it has it on disk.
#[derive(Debug)]
pub(super) struct Untold {
    pub(super) change: AlarmChange,
    /// Receivers that have it on disk, or have nothing to tell of it.
    kept: Arc<AtomicUsize>,
    /// Goes with it: who waits for that learns that no receiver holds it any more.
    _held: oneshot::Sender<()>,
}

impl Untold {
    /// One more receiver has it on disk.
    pub(super) fn keep(&self) {
        self.kept.fetch_add(1, Ordering::AcqRel);
    }
}

/// Hands changes to all receivers of this machine.
#[derive(Clone, Debug)]
pub struct Outlet {
    sender: broadcast::Sender<Arc<Untold>>,
    speaks: Arc<AtomicBool>,
}

impl Default for Outlet {
    fn default() -> Self {
        Self { sender: broadcast::channel(WAITING).0, speaks: Arc::default() }
    }
}

impl Outlet {
    /// From now on this machine tells people, or it does not; whether that is new.
    pub fn speak(&self, speaks: bool) -> bool {
        self.speaks.swap(speaks, Ordering::Relaxed) != speaks
    }

    /// Whether this machine tells people now.
    pub fn speaks(&self) -> bool {
        self.speaks.load(Ordering::Relaxed)
    }

    /// Has every receiver tell of a change.
    pub fn tell(&self, change: AlarmChange) -> Telling {
        let kept: Arc<AtomicUsize> = Arc::default();
        let (held, let_go) = oneshot::channel();
        // An error says that there are no receivers.
        let receivers =
            self.sender.send(Arc::new(Untold { change, kept: kept.clone(), _held: held })).unwrap_or(0);
        Telling { receivers, kept, let_go }
    }

    /// Whether anybody would hear what is told.
    pub fn is_heard(&self) -> bool {
        self.sender.receiver_count() > 0
    }

    pub(super) fn hear(&self) -> broadcast::Receiver<Arc<Untold>> {
        self.sender.subscribe()
    }

    /// A receiver that has on disk whatever it hears, until its task is aborted.
    #[cfg(test)]
    pub(crate) fn kept_by_a_task(&self) -> tokio::task::JoinHandle<()> {
        let mut news = self.hear();
        tokio::spawn(async move {
            while let Ok(untold) = news.recv().await {
                untold.keep();
            }
        })
    }
}

/// A change on its way to the receivers.
#[derive(Debug)]
pub struct Telling {
    receivers: usize,
    kept: Arc<AtomicUsize>,
    let_go: oneshot::Receiver<()>,
}

impl Telling {
    /// Whether there was no receiver, so that nobody hears of it.
    pub fn nobody(&self) -> bool {
        self.receivers == 0
    }

    /// Waits until no receiver holds it any more; whether every one has it on disk. It is asked once.
    pub async fn kept(&mut self) -> bool {
        // An error is what comes: nothing is ever sent.
        let _ = (&mut self.let_go).await;
        self.kept.load(Ordering::Acquire) >= self.receivers
    }
}

/// What a receiver hears.
#[derive(Debug)]
pub(super) enum News {
    /// Everything that happens at this machine.
    All(broadcast::Receiver<Event>),
    /// What was picked for it.
    Picked(broadcast::Receiver<Arc<Untold>>),
}

/// One piece of news.
#[derive(Clone, Debug)]
pub(super) enum Heard {
    Event(Event),
    Untold(Arc<Untold>),
}

impl News {
    pub(super) async fn recv(&mut self) -> Result<Heard, RecvError> {
        match self {
            Self::All(events) => events.recv().await.map(Heard::Event),
            Self::Picked(untold) => untold.recv().await.map(Heard::Untold),
        }
    }

    /// What was picked and is not heard yet.
    pub(super) fn try_recv(&mut self) -> Result<Arc<Untold>, TryRecvError> {
        match self {
            Self::All(_) => Err(TryRecvError::Empty),
            Self::Picked(untold) => untold.try_recv(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::notify::notice::tests::change;
    use futures::FutureExt;

    #[test]
    fn a_change_is_kept_once_every_receiver_has_it() {
        let outlet = Outlet::default();
        let mut telling = outlet.tell(change());
        assert!(telling.nobody() && !outlet.is_heard(), "nobody is to be told");
        assert_eq!(telling.kept().now_or_never(), Some(true));
        let (mut one, mut two) = (outlet.hear(), outlet.hear());
        let mut telling = outlet.tell(change());
        assert!(!telling.nobody() && outlet.is_heard());
        assert_eq!(telling.kept().now_or_never(), None);
        one.try_recv().expect("heard").keep();
        assert_eq!(telling.kept().now_or_never(), None, "the other has not");
        two.try_recv().expect("heard").keep();
        assert_eq!(telling.kept().now_or_never(), Some(true));
    }

    #[test]
    fn a_receiver_that_ends_without_it_is_noticed() {
        let outlet = Outlet::default();
        let (mut one, two) = (outlet.hear(), outlet.hear());
        let mut telling = outlet.tell(change());
        one.try_recv().expect("heard").keep();
        drop(two);
        assert_eq!(telling.kept().now_or_never(), Some(false));
    }
}
