//! The machines of the fleet, as they say of themselves.

use super::{Fleet, Role, lock};
use crate::fleet::link::Link;
use crate::fleet::message::Pulse;
use crate::fleet::streams::LATEST;
use crate::fleet::subject::{NO_SITE, Subject, What, all};
use crate::fleet::weights;
use crate::serve::{FleetPort, FleetSeen, Machine};
use std::time::Duration;

/// Machines that are taken in one go.
const MOST: usize = 256;
/// Longest wait for the first of them.
const WAIT: Duration = Duration::from_secs(2);
/// Most machines that are remembered.
const MACHINES: usize = 10_000;

impl Fleet {
    /// Hears which machines are there.
    pub(super) async fn watching(&self, link: &Link) {
        loop {
            let mut reading = match link.follow(LATEST, &all(None, What::Pulse)).await {
                Ok(reading) => reading,
                Err(error) => {
                    self.rest(&error, "who is there is not heard").await;
                    continue;
                }
            };
            loop {
                let heard = match reading.next(MOST, WAIT).await {
                    Ok(heard) => heard,
                    Err(error) => break self.rest(&error, "who is there is not heard").await,
                };
                let mut machines = lock(&self.machines);
                for message in heard {
                    let pulse = weights::read::<Pulse>(message.subject(), message.bytes());
                    let Some((own, pulse)) = Subject::read(message.subject()).zip(pulse) else { continue };
                    let heard_at = message.taken_at().unwrap_or_else(|| self.clock.now());
                    let site = Some(own.site).filter(|site| site != NO_SITE).unwrap_or_default();
                    let key = (pulse.role.clone(), site.clone(), own.name.clone());
                    if machines.len() == MACHINES && !machines.contains_key(&key) {
                        continue;
                    }
                    machines.insert(
                        key,
                        Machine {
                            role: pulse.role,
                            site,
                            name: own.name,
                            version: pulse.version,
                            heard_at,
                            clock_offset_s: pulse.at - heard_at,
                            since: pulse.since,
                            lag_s: pulse.lag_s,
                            diagnosed: pulse.diagnosed,
                            loops: pulse.loops,
                            certificate: pulse.certificate.zip(pulse.certificate_until),
                        },
                    );
                }
            }
        }
    }
}

impl FleetPort for Fleet {
    fn seen(&self) -> FleetSeen {
        let machines = lock(&self.machines);
        FleetSeen {
            role: self.role.as_str(),
            name: self.name.clone(),
            connected: self.link.get().is_some_and(Link::is_up),
            tells: self.role == Role::Alone || self.outlet.speaks(),
            machines: machines.values().cloned().collect(),
        }
    }

    fn refused(&self) -> u64 {
        weights::refused()
    }
}
