//! The fleet as JSON.

use super::{finite, rfc3339};
use crate::serve::{FleetSeen, Machine};
use serde::Serialize;
use utoipa::ToSchema;

/// A machine that has said nothing for longer (s) is silent.
const SILENT_S: f64 = 20.0;

/// The fleet as this machine sees it.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Fleet {
    /// Now, by this machine's clock.
    pub time: Option<String>,
    /// `alone`, `edge`, `worker` or `centre`.
    pub role: &'static str,
    /// What this machine is called.
    pub name: String,
    /// Whether it reaches NATS.
    pub connected: bool,
    /// Whether it is the one that tells people of alarms now.
    pub tells: bool,
    /// Every machine that was heard of, by role, site and name; a centre alone hears of them.
    pub machines: Vec<MachineItem>,
}

/// A machine of the fleet, as it says of itself.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct MachineItem {
    /// `edge`, `worker` or `centre`.
    pub role: String,
    /// The site of an edge; null for others.
    pub site: Option<String>,
    /// What it is called.
    pub name: String,
    /// Version of its program.
    pub version: String,
    /// When it was heard of last.
    pub heard: Option<String>,
    /// How long ago that is (s).
    pub age_s: Option<f64>,
    /// Whether that is so long ago that it is down, or cut off.
    pub silent: bool,
    /// How far its clock is ahead of the NATS server's (s).
    pub clock_offset_s: Option<f64>,
    /// Since when it runs.
    pub since: Option<String>,
    /// Age of the oldest that waits to be forwarded, or to be taken (s).
    pub lag_s: Option<f64>,
    /// Diagnoses that it made, or a centre took, since it runs.
    pub diagnosed: u64,
    /// Loops that it has.
    pub loops: u64,
    /// Which of its certificates ends first: the section, or the device or broker, and the key; null where it has none.
    pub certificate: Option<String>,
    /// When that ends.
    pub certificate_until: Option<String>,
}

impl Fleet {
    /// The fleet at `now` (s).
    pub fn of(seen: FleetSeen, now: f64) -> Self {
        Self {
            time: rfc3339(now),
            role: seen.role,
            name: seen.name,
            connected: seen.connected,
            tells: seen.tells,
            machines: seen.machines.into_iter().map(|own| MachineItem::of(own, now)).collect(),
        }
    }

    /// Of a daemon that is alone.
    pub fn alone(now: f64) -> Self {
        Self::of(FleetSeen { role: "alone", tells: true, ..FleetSeen::default() }, now)
    }
}

impl MachineItem {
    fn of(own: Machine, now: f64) -> Self {
        let age_s = (now - own.heard_at).max(0.0);
        let (certificate, until) = own.certificate.unzip();
        Self {
            role: own.role,
            site: Some(own.site).filter(|site| !site.is_empty()),
            name: own.name,
            version: own.version,
            heard: rfc3339(own.heard_at),
            age_s: finite(age_s),
            silent: age_s > SILENT_S,
            clock_offset_s: finite(own.clock_offset_s),
            since: rfc3339(own.since),
            lag_s: finite(own.lag_s),
            diagnosed: own.diagnosed,
            loops: own.loops,
            certificate,
            certificate_until: until.and_then(rfc3339),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_that_says_nothing_is_silent() {
        let machine =
            Machine { role: "edge".into(), site: "north".into(), heard_at: 100.0, ..Machine::default() };
        let seen = FleetSeen { role: "centre", machines: vec![machine], ..FleetSeen::default() };
        let at = |now| Fleet::of(seen.clone(), now).machines[0].clone();
        assert!(!at(119.0).silent && at(121.0).silent);
        // A server whose clock is ahead of ours.
        assert_eq!(at(90.0).age_s, Some(0.0));
        assert_eq!(Fleet::alone(5.0).role, "alone");
    }
}
