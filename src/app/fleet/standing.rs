//! Which of several centres acts, and what it has to tell people when it takes over.

use super::{Fleet, PAUSE};
use crate::fleet::lease::{Lease, Seen, Step};
use crate::fleet::link::{Link, LinkError};
use crate::fleet::streams::{EVENTS, SAMPLES};
use crate::results::{AlarmChange, Event};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Changes that are remembered until it is known that the centre that leads has told people.
const UNTOLD: usize = 10_000;
/// How often what everybody has done is deleted from the streams.
const PURGE: Duration = Duration::from_secs(60);

/// This centre among several.
pub(super) struct Standing {
    /// Our epoch while we lead; 0 while we do not.
    epoch: AtomicU64,
    /// Changes of which nobody may have told people, by their number in the stream.
    untold: Mutex<VecDeque<(u64, Arc<AlarmChange>)>>,
}

impl Standing {
    pub(super) fn new() -> Self {
        Self { epoch: AtomicU64::new(0), untold: Mutex::default() }
    }

    /// Our epoch while we lead.
    pub(super) fn epoch(&self) -> Option<u64> {
        Some(self.epoch.load(Relaxed)).filter(|epoch| *epoch > 0)
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<(u64, Arc<AlarmChange>)>> {
        self.untold.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Fleet {
    /// Takes the lease where it can, and keeps it.
    pub(super) async fn leading(&self, link: &Link) {
        let lasts = Duration::from_secs_f64(self.config.cut_off_after_s * 0.8);
        let mut lease = Lease::new(&self.name, lasts);
        let mut purged = self.clock.elapsed();
        loop {
            if let Err(error) = self.look(link, &mut lease).await {
                tracing::debug!(%error, "the lease cannot be looked at");
            }
            let now = self.clock.elapsed();
            self.lead(lease.epoch(now));
            if self.standing.epoch().is_some() && now >= purged + PURGE {
                purged = now;
                for stream in [EVENTS, SAMPLES] {
                    if let Err(error) = link.purge_done(stream).await {
                        tracing::debug!(%error, stream, "what is done is not deleted yet");
                    }
                }
            }
            tokio::time::sleep(lasts / 8).await;
        }
    }

    async fn look(&self, link: &Link, lease: &mut Lease) -> Result<(), LinkError> {
        let last = link.lease().await?;
        let now = self.clock.elapsed();
        match lease.look(last.clone(), now) {
            Step::Wait => {
                // What the centre that leads has done, people know.
                if let Some(Seen { holder, .. }) = last {
                    let done = link.done_by(EVENTS, &reader(&holder)).await?;
                    let mut untold = self.standing.lock();
                    untold.retain(|(sequence, _)| *sequence > done);
                    tracing::debug!(holder, done, left = untold.len(), "what the centre that leads has done");
                }
            }
            Step::Write { after, epoch } => {
                match link.write_lease(after, Seen::text(&self.name, epoch)).await {
                    Ok(sequence) => lease.wrote(sequence, epoch, now),
                    Err(LinkError::Overtaken) => tracing::info!("another centre was first"),
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(())
    }

    /// Takes over, or stands back.
    fn lead(&self, epoch: Option<u64>) {
        let before = self.standing.epoch.swap(epoch.unwrap_or(0), Relaxed);
        self.speaks.store(epoch.is_some(), Relaxed);
        match (before, epoch) {
            (0, Some(epoch)) => {
                tracing::warn!(epoch, "this centre leads");
                for (_, change) in self.standing.lock().drain(..) {
                    let _ = self.outlet.send(Event::Alarm(change));
                }
            }
            (1.., None) => tracing::warn!("this centre does not lead any more"),
            _ => {}
        }
    }

    /// Tells people of a change, or remembers it until it is known that they are told.
    pub(super) fn tell_or_wait(&self, sequence: u64, change: Arc<AlarmChange>) {
        if self.standing.epoch().is_some() {
            let _ = self.outlet.send(Event::Alarm(change));
            return;
        }
        let mut untold = self.standing.lock();
        if untold.len() == UNTOLD {
            untold.pop_front();
        }
        untold.push_back((sequence, change));
    }

    /// Waits a little where the server is away.
    pub(super) async fn rest(&self, error: &LinkError, what: &str) {
        tracing::warn!(%error, "{what}");
        tokio::time::sleep(PAUSE).await;
    }
}

/// What a centre is called where it reads events.
pub(super) fn reader(name: &str) -> String {
    format!("centre-{}", name.replace(|c: char| !c.is_ascii_alphanumeric(), "-"))
}
