//! What waits for a slot: runs that somebody asked for go before those that are due.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use tokio::sync::{Mutex, mpsc};

/// Why a diagnosis on demand is not begun.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// The loop is not there.
    #[error("there is no such loop")]
    UnknownLoop,
    /// The loop is another machine's.
    #[error("this loop is diagnosed at its site: ask there")]
    NotHere,
    /// Too many were asked for, or too many wait for this loop already.
    #[error("too many diagnoses are waiting; try again later")]
    Busy,
    /// The previous run passed its deadline and has not returned.
    #[error("the previous diagnosis of this loop passed its deadline and still runs")]
    Overrunning,
    /// The daemon is shutting down.
    #[error("the daemon is shutting down")]
    Stopping,
}

/// Two queues. A run that is in both comes out twice; its taker ignores the second, whose loop is no longer queued.
pub struct Queues<T> {
    asked: mpsc::Sender<T>,
    /// Each loop is due at most once, and once more for each time that it was asked for meanwhile, so this one needs no bound.
    due: mpsc::UnboundedSender<T>,
    out: Mutex<(mpsc::Receiver<T>, mpsc::UnboundedReceiver<T>)>,
    waiting: AtomicU64,
}

impl<T> Queues<T> {
    /// Empty ones, of which the first holds `most` runs.
    pub fn new(most: usize) -> Self {
        let (asked, from_asked) = mpsc::channel(most.max(1));
        let (due, from_due) = mpsc::unbounded_channel();
        Self { asked, due, out: Mutex::new((from_asked, from_due)), waiting: AtomicU64::new(0) }
    }

    /// How many wait.
    pub fn waiting(&self) -> u64 {
        self.waiting.load(Relaxed)
    }

    /// Puts in a run that somebody asked for.
    ///
    /// # Errors
    /// [`Refused::Busy`] where too many wait, [`Refused::Stopping`] at the end.
    pub fn ask(&self, run: T) -> Result<(), Refused> {
        self.counted(|| {
            self.asked.try_send(run).map_err(|refused| match refused {
                mpsc::error::TrySendError::Full(_) => Refused::Busy,
                mpsc::error::TrySendError::Closed(_) => Refused::Stopping,
            })
        })
    }

    /// Puts in a run that is due.
    ///
    /// # Errors
    /// [`Refused::Stopping`] at the end.
    pub fn due(&self, run: T) -> Result<(), Refused> {
        self.counted(|| self.due.send(run).map_err(|_| Refused::Stopping))
    }

    /// Counts before it can be taken out, so that the gauge never goes below zero.
    fn counted(&self, put: impl FnOnce() -> Result<(), Refused>) -> Result<(), Refused> {
        self.waiting.fetch_add(1, Relaxed);
        let done = put();
        if done.is_err() {
            self.waiting.fetch_sub(1, Relaxed);
        }
        done
    }

    /// The next run; may be dropped while it waits.
    pub async fn next(&self) -> Option<T> {
        let mut out = self.out.lock().await;
        let (asked, due) = &mut *out;
        let next = tokio::select! {
            biased;
            run = asked.recv() => run,
            run = due.recv() => run,
        }?;
        self.waiting.fetch_sub(1, Relaxed);
        Some(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_is_asked_for_goes_before_what_is_due() {
        let queues = Queues::new(1);
        (0..1000).for_each(|run| assert_eq!(queues.due(run), Ok(())));
        assert_eq!(queues.ask(5000), Ok(()));
        assert_eq!(queues.ask(5001), Err(Refused::Busy));
        assert_eq!(queues.waiting(), 1001);
        assert_eq!(queues.next().await, Some(5000));
        assert_eq!(queues.ask(5002), Ok(()));
        assert_eq!(queues.next().await, Some(5002));
        assert_eq!((queues.next().await, queues.next().await, queues.waiting()), (Some(0), Some(1), 998));
    }
}
