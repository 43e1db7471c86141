//! An edge asks workers for diagnoses. Who has no answer in time diagnoses by itself, and does not ask for a while.

use super::{lock, window};
use crate::fleet::link::{Link, LinkError, Outgoing, digest};
use crate::fleet::message::Answer;
use crate::fleet::subject::{Subject, What, all};
use crate::fleet::weights;
use crate::results::Told;
use crate::schedule::{Asked, Clock, Elsewhere};
use crate::signal::LoopId;
use futures::StreamExt;
use prost::Message;
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::time::Duration;
use tokio::sync::oneshot;

/// After a question without an answer nobody is asked for so long.
const REST: Duration = Duration::from_secs(60);

/// Questions that wait for an answer, by the digest of the window.
type Pending = HashMap<[u8; 32], oneshot::Sender<Told>>;

/// A question that waits for an answer, until this is dropped.
struct Question<'a> {
    pending: &'a Mutex<Pending>,
    key: [u8; 32],
}

impl Drop for Question<'_> {
    fn drop(&mut self) {
        lock(self.pending).remove(&self.key);
    }
}

/// Asks workers.
pub(super) struct Asking {
    site: String,
    within_s: f64,
    clock: Clock,
    link: OnceLock<Link>,
    pending: Mutex<Pending>,
    /// Until when nobody is asked, on a steady clock.
    rests_until: Mutex<Duration>,
    /// Loops that are diagnosed here whatever happens: write-back takes no other diagnosis for evidence.
    own: RwLock<HashSet<LoopId>>,
}

impl Asking {
    pub(super) fn new(site: &str, within_s: f64, clock: Clock) -> Self {
        Self {
            site: site.to_string(),
            within_s,
            clock,
            link: OnceLock::new(),
            pending: Mutex::default(),
            rests_until: Mutex::default(),
            own: RwLock::default(),
        }
    }

    /// For the scheduler.
    pub(super) fn elsewhere(self: Arc<Self>) -> Elsewhere {
        Arc::new(move |asked| {
            let own = self.clone();
            Box::pin(async move { own.ask(asked).await })
        })
    }

    /// These loops are diagnosed here.
    pub(super) fn keep(&self, loops: HashSet<LoopId>) {
        *self.own.write().unwrap_or_else(PoisonError::into_inner) = loops;
    }

    /// Windows that wait for an answer.
    pub(super) fn waiting(&self) -> u64 {
        lock(&self.pending).len() as u64
    }

    async fn ask(&self, asked: Asked) -> Option<Told> {
        let link = self.link.get().filter(|link| link.is_up())?;
        let own = self.own.read().unwrap_or_else(PoisonError::into_inner).contains(&asked.id);
        if own || self.clock.elapsed() < *lock(&self.rests_until) {
            return None;
        }
        let body = window::of(&asked, self.within_s)?.encode_to_vec();
        let subject = Subject::new(&self.site, asked.id.as_str(), What::Window).to_string();
        let key = digest(&subject, &body);
        // Whoever asks may be gone before there is an answer.
        let (_question, told) = self.question(key);
        match link.send(&[Outgoing::once(subject, body)]).await {
            Err((_, LinkError::TooLarge(bytes))) => {
                tracing::info!(control_loop = %asked.id, bytes, "a window is too large to be sent: diagnosed here");
                return None;
            }
            Err((_, error)) => {
                self.rest(&error.to_string());
                return None;
            }
            Ok(()) => {}
        }
        let within = Duration::from_secs_f64(self.within_s);
        match tokio::time::timeout(within, told).await {
            Ok(told) => told.ok(),
            Err(_) => {
                self.rest("no worker answered in time");
                None
            }
        }
    }

    /// Begins to wait for the answer to a window with this digest.
    fn question(&self, key: [u8; 32]) -> (Question<'_>, oneshot::Receiver<Told>) {
        let (tell, told) = oneshot::channel();
        lock(&self.pending).insert(key, tell);
        (Question { pending: &self.pending, key }, told)
    }

    fn rest(&self, why: &str) {
        *lock(&self.rests_until) = self.clock.elapsed() + REST;
        tracing::warn!(why, for_s = REST.as_secs(), "diagnoses are made here for a while");
    }

    /// Hears answers, until the connection is closed for good.
    pub(super) async fn hear(&self, link: &Link) -> Result<(), LinkError> {
        let mut answers = link.hear(all(Some(&self.site), What::Answer)).await?;
        let _ = self.link.set(link.clone());
        while let Some(message) = answers.next().await {
            let Some(answer) = weights::read::<Answer>(message.subject.as_str(), message.payload) else {
                continue;
            };
            let key: Result<[u8; 32], _> = answer.window.as_slice().try_into();
            let Some(tell) = key.ok().and_then(|key| lock(&self.pending).remove(&key)) else { continue };
            match window::answered(&answer) {
                Some(told) => drop(tell.send(told)),
                // Dropped, so that who asked diagnoses at once.
                None => {
                    tracing::warn!(worker = answer.worker, refused = answer.refused, "a worker cannot tell")
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;

    #[test]
    fn a_question_that_is_given_up_leaves_nothing_behind() {
        let asking = Asking::new("north", 60.0, Clock::wall());
        let mut waits = Box::pin(async {
            let (_question, told) = asking.question([7; 32]);
            told.await.ok()
        });
        assert!(waits.as_mut().now_or_never().is_none(), "nobody answers");
        assert_eq!(asking.waiting(), 1);
        drop(waits);
        assert_eq!(asking.waiting(), 0);
    }
}
