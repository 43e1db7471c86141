//! Which of several centres acts.

use super::teller::TELLER;
use super::{Fleet, PAUSE, lock};
use crate::fleet::lease::{Lease, Seen, Step};
use crate::fleet::link::{Link, LinkError};
use crate::fleet::streams::{ALARMS, DIAGNOSES};
use crate::fleet::subject::escaped;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

/// A lease lasts for this share of `cut_off_after_s`: another centre leads before edges tell people by themselves.
const LEASE_SHARE: f64 = 0.8;
/// Looks at the lease while it lasts: several may fail before it is lost.
const LOOKS: u32 = 8;
/// Longest look, as a share of the lease: half of what a holder counts on.
const LONGEST_LOOK: u32 = 4;
/// How often what everybody has done is deleted from the streams.
const PURGE: Duration = Duration::from_secs(60);

/// This centre among several.
pub(super) struct Standing {
    /// Our epoch while we lead, and until when we do without another look (ms of a steady clock); 0 while we do not.
    epoch: AtomicU64,
    until_ms: AtomicU64,
    /// Who wrote the lease that was seen last.
    holder: Mutex<Option<String>>,
}

impl Standing {
    pub(super) fn new() -> Self {
        Self { epoch: AtomicU64::new(0), until_ms: AtomicU64::new(0), holder: Mutex::default() }
    }

    /// The lease was seen like this.
    fn saw(&self, lease: Option<&Seen>) {
        *lock(&self.holder) = lease.map(|own| own.holder.clone());
    }

    /// Who wrote the lease that was seen last, where that is not `name`.
    pub(super) fn other_than(&self, name: &str) -> Option<String> {
        lock(&self.holder).clone().filter(|holder| holder != name)
    }

    /// Our epoch while we lead at `now`.
    pub(super) fn epoch(&self, now: Duration) -> Option<u64> {
        let leads = now.as_millis() < u128::from(self.until_ms.load(Relaxed));
        Some(self.epoch.load(Relaxed)).filter(|epoch| *epoch > 0 && leads)
    }
}

impl Fleet {
    /// Takes the lease where it can, and keeps it.
    pub(super) async fn leading(&self, link: &Link) {
        let lasts = Duration::from_secs_f64(self.config.cut_off_after_s * LEASE_SHARE);
        let mut lease = Lease::new(&self.name, lasts);
        let looking = async {
            loop {
                // A server that does not answer is no reason to believe that we still lead.
                match tokio::time::timeout(lasts / LONGEST_LOOK, self.look(link, &mut lease)).await {
                    Ok(Ok(())) => {}
                    Ok(Err(error)) => tracing::debug!(%error, "the lease cannot be looked at"),
                    Err(late) => tracing::debug!(error = %late, "the lease cannot be looked at"),
                }
                self.lead(&lease);
                tokio::time::sleep(lasts / LOOKS).await;
            }
        };
        tokio::join!(looking, self.purging(link), self.measuring(link));
    }

    /// Deletes diagnoses and alarms that every centre has, and of which people are told; samples go when there is no room.
    async fn purging(&self, link: &Link) {
        loop {
            tokio::time::sleep(PURGE).await;
            if self.leads()
                && let Err(error) = self.purge(link).await
            {
                tracing::debug!(%error, "what is done is not deleted yet");
            }
        }
    }

    /// Of alarms nothing goes that a centre has not read. Of diagnoses that goes once there is hardly room: a centre that has
    /// stopped keeps nobody's back from the others.
    async fn purge(&self, link: &Link) -> Result<(), LinkError> {
        let own = reader(&self.name);
        link.purge_done(ALARMS, &[TELLER, &own]).await?;
        link.purge_done(DIAGNOSES, &[&own]).await?;
        for reader in link.make_room(DIAGNOSES, &own).await? {
            tracing::warn!(
                reader,
                "diagnoses are deleted that this centre has not read: their stream is nearly full, and it has stopped or is slow"
            );
        }
        Ok(())
    }

    async fn look(&self, link: &Link, lease: &mut Lease) -> Result<(), LinkError> {
        let last = link.lease().await?;
        self.standing.saw(last.as_ref());
        let now = self.clock.elapsed();
        if let Step::Write { after, epoch } = lease.look(last, now) {
            match link.write_lease(after, Seen::text(&self.name, epoch)).await {
                Ok(sequence) => lease.wrote(sequence, epoch, now),
                Err(LinkError::Overtaken) => tracing::info!("another centre was first"),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Takes over, or stands back.
    fn lead(&self, lease: &Lease) {
        let now = self.clock.elapsed();
        let epoch = lease.epoch(now);
        let until = lease.holds_until().as_millis();
        self.standing.until_ms.store(u64::try_from(until).unwrap_or(0), Relaxed);
        let before = self.standing.epoch.swap(epoch.unwrap_or(0), Relaxed);
        self.outlet.speak(epoch.is_some());
        match (before, epoch) {
            (0, Some(epoch)) => tracing::warn!(epoch, "this centre leads"),
            (1.., None) => tracing::warn!("this centre does not lead any more"),
            _ => {}
        }
    }

    /// Whether we lead now.
    pub(super) fn leads(&self) -> bool {
        self.standing.epoch(self.clock.elapsed()).is_some()
    }

    /// Logs what is not done because the server is away, and waits a little.
    pub(super) async fn rest(&self, error: &LinkError, what: &str) {
        tracing::warn!(%error, "{what}");
        tokio::time::sleep(PAUSE).await;
    }
}

/// What a centre is called where it reads events.
pub(super) fn reader(name: &str) -> String {
    format!("centre_{}", escaped(name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::tests::{centre, edge};
    use crate::serve::{FleetPort, Standby};

    #[test]
    fn a_centre_that_does_not_lead_names_the_one_that_does_and_people_act_everywhere_else() {
        let (fleet, _results) = centre("north:FIC1");
        let leader = |own: &str| Some(Standby { leader: Some(own.to_string()) });
        assert_eq!(fleet.standby(), Some(Standby { leader: None }), "no lease was seen");
        let lease = |holder: &str, sequence| Seen { sequence, holder: holder.into(), epoch: 0 };
        fleet.standing.saw(Some(&lease("c1", 7)));
        assert_eq!(fleet.standby(), leader("c1"));
        // Our own lease has run out.
        fleet.standing.saw(Some(&lease(&fleet.name, 8)));
        assert_eq!(fleet.standby(), Some(Standby { leader: None }));
        let mut own = Lease::new(&fleet.name, Duration::from_secs(60));
        own.wrote(9, 0, fleet.clock.elapsed());
        fleet.lead(&own);
        assert_eq!(fleet.standby(), None, "we lead");
        assert_eq!(edge("FIC1").0.standby(), None);
    }
}
