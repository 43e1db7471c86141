//! What waits for a slot: runs that somebody asked for go before those that are due, but not for ever.

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

/// Runs on demand in a row before one that is due: who asks without end leaves a fifth of the slots to the schedule.
const IN_A_ROW: usize = 4;

/// Two queues. A run that is in both comes out twice; its taker ignores the second, whose loop is no longer queued.
pub struct Queues<T> {
    asked: mpsc::Sender<T>,
    /// Each loop is due at most once, and once more for each time that it was asked for meanwhile, so this one needs no bound.
    due: mpsc::UnboundedSender<T>,
    out: Mutex<Out<T>>,
    waiting: AtomicU64,
}

/// The ends from which runs are taken.
struct Out<T> {
    asked: mpsc::Receiver<T>,
    due: mpsc::UnboundedReceiver<T>,
    /// Runs on demand taken since one that was due.
    in_a_row: usize,
}

impl<T> Queues<T> {
    /// Empty ones, of which the first holds `most` runs.
    pub fn new(most: usize) -> Self {
        let (asked, from_asked) = mpsc::channel(most.max(1));
        let (due, from_due) = mpsc::unbounded_channel();
        let out = Out { asked: from_asked, due: from_due, in_a_row: 0 };
        Self { asked, due, out: Mutex::new(out), waiting: AtomicU64::new(0) }
    }

    /// How many wait.
    pub fn waiting(&self) -> u64 {
        self.waiting.load(Relaxed)
    }

    /// Puts in a run that somebody asked for.
    ///
    /// # Errors
    /// [`Refused::Busy`] where too many wait, [`Refused::Stopping`] once they are closed.
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
    /// [`Refused::Stopping`] once they are closed.
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
        let Out { asked, due, in_a_row } = &mut *out;
        let turn = if *in_a_row < IN_A_ROW { None } else { due.try_recv().ok() };
        let (run, after) = match turn {
            Some(run) => (Some(run), 0),
            None => tokio::select! {
                biased;
                run = asked.recv() => (run, (*in_a_row + 1).min(IN_A_ROW)),
                run = due.recv() => (run, 0),
            },
        };
        *in_a_row = after;
        self.waiting.fetch_sub(u64::from(run.is_some()), Relaxed);
        run
    }

    /// Takes no more runs, and gives back those that wait.
    pub async fn close(&self) -> Vec<T> {
        let mut out = self.out.lock().await;
        out.asked.close();
        out.due.close();
        let asked = std::iter::from_fn(|| out.asked.try_recv().ok()).collect::<Vec<_>>();
        let due = std::iter::from_fn(|| out.due.try_recv().ok());
        let left: Vec<T> = asked.into_iter().chain(due).collect();
        self.waiting.fetch_sub(left.len() as u64, Relaxed);
        left
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

    #[tokio::test]
    async fn who_asks_without_end_leaves_slots_to_what_is_due() {
        let queues = Queues::new(100);
        (0..3).for_each(|run| assert_eq!(queues.due(run), Ok(())));
        (0..20).for_each(|run| assert_eq!(queues.ask(100 + run), Ok(())));
        let mut taken = Vec::new();
        for _ in 0..15 {
            taken.extend(queues.next().await);
        }
        assert_eq!([taken[4], taken[9], taken[14]], [0, 1, 2]);
        assert_eq!(taken.iter().filter(|run| **run >= 100).count(), 12);
    }

    #[tokio::test]
    async fn closed_queues_give_back_what_waits_and_refuse() {
        let queues = Queues::new(2);
        assert_eq!((queues.due(1), queues.ask(2)), (Ok(()), Ok(())));
        assert_eq!((queues.close().await, queues.waiting()), (vec![2, 1], 0));
        assert_eq!((queues.due(3), queues.ask(4)), (Err(Refused::Stopping), Err(Refused::Stopping)));
        assert_eq!((queues.next().await, queues.waiting()), (None, 0));
    }
}
