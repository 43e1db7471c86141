//! The machines of the fleet, as they say of themselves.

use super::claims::{FORGOTTEN_S, Signs};
use super::{Fleet, Role, lock};
use crate::fleet::link::Link;
use crate::fleet::message::Pulse;
use crate::fleet::streams::{LATEST, WINDOWS};
use crate::fleet::subject::{NO_SITE, Subject, What, all};
use crate::fleet::weights;
use crate::serve::{FleetLoad, FleetPort, FleetSeen, Machine, Standby};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

/// Machines that are taken in one go.
const MOST: usize = 256;
/// Longest wait for the first of them.
const WAIT: Duration = Duration::from_secs(2);
/// Most machines that are remembered.
const MACHINES: usize = 10_000;
/// Where no machine was heard for longer (s), ourselves included, the server was away.
const AWAY_S: f64 = 60.0;

/// The machines that were heard of.
#[derive(Default)]
pub(super) struct Machines {
    /// By role, site and name; times are those of the server.
    all: BTreeMap<(String, String, String), Machine>,
    /// When any of them was heard of last (s).
    newest: f64,
    /// When one was heard of again after the server was away (s), and when one was heard of last before that.
    resumed: f64,
    paused: f64,
    /// Number of the last message.
    sequence: u64,
    /// Each was heard of that the stream has.
    are_all: bool,
}

impl Machines {
    /// The stream took the message with this number `at` (s). Where that is well before an earlier message the server's clock was set
    /// back: what was heard is as long ago as before, by the clock as it is now.
    fn follow_clock(&mut self, sequence: u64, at: f64) {
        // What is read again has its number of before.
        let is_new = sequence > self.sequence;
        self.sequence = self.sequence.max(sequence);
        let fall_s = self.newest - at;
        if !is_new || fall_s < AWAY_S {
            return;
        }
        self.all.values_mut().for_each(|own| own.heard_at -= fall_s);
        for stamp in [&mut self.newest, &mut self.resumed, &mut self.paused] {
            *stamp -= fall_s;
        }
    }

    /// A machine says that it is there.
    fn hear(&mut self, own: Machine) {
        let at = own.heard_at;
        if self.are_all && at - self.newest >= AWAY_S {
            (self.paused, self.resumed) = (self.newest, at);
        }
        self.newest = self.newest.max(at);
        let name = (own.role.clone(), own.site.clone(), own.name.clone());
        if self.all.len() >= MACHINES && !self.all.contains_key(&name) {
            let longest =
                self.all.iter().min_by(|(_, one), (_, other)| one.heard_at.total_cmp(&other.heard_at));
            if let Some(name) = longest.map(|(name, _)| name.clone()) {
                self.all.remove(&name);
            }
        }
        self.all.insert(name, own);
    }

    /// Everything was heard that the stream has.
    fn has_all(&mut self) {
        self.are_all = true;
    }

    /// Forgets those that have said nothing for long: most were replaced by one of another name.
    fn forget(&mut self) {
        let (newest, resumed) = (self.newest, self.resumed);
        if self.are_all {
            self.all.retain(|_, own| newest - own.heard_at.max(resumed) < FORGOTTEN_S);
        }
    }

    /// How far the clock of an edge is ahead of the server's (s); 0 where it was not heard of.
    pub(super) fn ahead_s(&self, site: &str, edge: &str) -> f64 {
        let name = (Role::Edge.as_str().to_string(), site.to_string(), edge.to_string());
        self.all.get(&name).map_or(0.0, |own| own.clock_offset_s)
    }

    /// When the edges said last that they are there.
    fn signs(&self) -> Signs {
        let edges = self.all.values().filter(|own| own.role == Role::Edge.as_str());
        Signs {
            heard: edges.map(|own| ((own.site.clone(), own.name.clone()), own.heard_at)).collect(),
            now: self.are_all.then_some(self.newest),
            resumed: self.resumed,
            paused: self.paused,
        }
    }
}

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
                    if let Some(stamp) = message.taken_at() {
                        self.hear_server(stamp);
                    }
                    let pulse = weights::read::<Pulse>(message.subject(), message.bytes());
                    let Some((own, pulse)) = Subject::read(message.subject()).zip(pulse) else { continue };
                    let heard_at = message.taken_at().unwrap_or_else(|| self.server_now());
                    machines.follow_clock(message.sequence(), heard_at);
                    machines.hear(Machine {
                        role: pulse.role,
                        site: Some(own.site).filter(|site| site != NO_SITE).unwrap_or_default(),
                        name: own.name,
                        version: pulse.version,
                        heard_at,
                        clock_offset_s: pulse.at - heard_at,
                        since: pulse.since,
                        lag_s: pulse.lag_s,
                        diagnosed: pulse.diagnosed,
                        loops: pulse.loops,
                        certificate: pulse.certificate.zip(pulse.certificate_until),
                    });
                }
                if reading.has_caught_up() {
                    machines.has_all();
                }
                machines.forget();
            }
        }
    }

    /// When the edges said last that they are there.
    pub(super) fn signs(&self) -> Signs {
        lock(&self.machines).signs()
    }

    /// An edge has just said that it is there, with a clock that is so much ahead of the server's (s).
    #[cfg(test)]
    pub(super) fn machine_is_ahead(&self, site: &str, name: &str, clock_offset_s: f64) {
        let (role, heard_at) = (Role::Edge.as_str().to_string(), self.server_now());
        let (site, name) = (site.to_string(), name.to_string());
        lock(&self.machines).hear(Machine {
            role,
            site,
            name,
            heard_at,
            clock_offset_s,
            ..Machine::default()
        });
    }
}

impl FleetPort for Fleet {
    fn seen(&self) -> FleetSeen {
        // What the server stamped, by our clock.
        let ahead_s = self.clock.now() - self.server_now();
        let by_our_clock = |own: &Machine| Machine { heard_at: own.heard_at + ahead_s, ..own.clone() };
        FleetSeen {
            role: self.role.as_str(),
            name: self.name.clone(),
            connected: self.link.get().is_some_and(Link::is_up),
            tells: self.role == Role::Alone || self.outlet.speaks(),
            machines: lock(&self.machines).all.values().map(by_our_clock).collect(),
        }
    }

    fn standby(&self) -> Option<Standby> {
        let stands_by = self.role == Role::Centre && !self.leads();
        stands_by.then(|| Standby { leader: self.standing.other_than(&self.name) })
    }

    fn load(&self) -> FleetLoad {
        let streams = lock(&self.streams).clone();
        FleetLoad {
            own: self.machine(),
            windows: match self.role {
                Role::Edge => Some(self.asking.waiting()),
                _ => streams.iter().find(|own| own.name == WINDOWS).map(|own| own.fill.messages),
            },
            streams: streams.iter().filter_map(|own| Some((own.name, own.fill.share()?))).collect(),
        }
    }

    fn refused(&self) -> u64 {
        weights::refused()
    }

    fn left_out(&self) -> u64 {
        self.left_out.load(Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::fleet::tests::centre;

    fn machine(role: &str, name: &str, heard_at: f64) -> Machine {
        let site = if role == "edge" { "north" } else { "" };
        Machine { role: role.into(), site: site.into(), name: name.into(), heard_at, ..Machine::default() }
    }

    fn names(machines: &Machines) -> Vec<&str> {
        machines.all.values().map(|own| own.name.as_str()).collect()
    }

    #[test]
    fn a_machine_that_was_replaced_is_forgotten_and_one_that_could_say_nothing_is_not() {
        let mut machines = Machines::default();
        machines.hear(machine("worker", "w1", 1000.0));
        machines.hear(machine("edge", "e1", 1001.0));
        assert!(machines.signs().now.is_none(), "others may still come");
        machines.hear(machine("centre", "c1", 1000.0 + FORGOTTEN_S));
        machines.forget();
        assert_eq!(machines.all.len(), 3);
        machines.has_all();
        machines.forget();
        assert_eq!(names(&machines), ["c1", "e1"]);
        // The server was away for as long.
        machines.hear(machine("centre", "c1", 1000.0 + 2.0 * FORGOTTEN_S));
        machines.forget();
        assert_eq!(names(&machines), ["c1", "e1"]);
        let signs = machines.signs();
        assert_eq!(
            (signs.now, signs.resumed),
            (Some(1000.0 + 2.0 * FORGOTTEN_S), 1000.0 + 2.0 * FORGOTTEN_S)
        );
        assert_eq!(signs.heard.values().copied().collect::<Vec<f64>>(), [1001.0], "edges alone");
    }

    #[test]
    fn a_server_s_clock_that_was_set_back_makes_no_machine_silent_and_none_that_has_stopped_is_back() {
        let mut machines = Machines::default();
        let mut hear = |sequence, name: &str, at| {
            machines.follow_clock(sequence, at);
            machines.hear(machine("edge", name, at));
            machines.has_all();
            let Signs { heard, now, .. } = machines.signs();
            let now = now.expect("all were heard");
            let key = |name: &str| ("north".to_string(), name.to_string());
            ["e1", "e2"].map(|name| heard.get(&key(name)).map(|at| now - at))
        };
        hear(1, "e2", 9_900.0);
        hear(2, "e1", 9_999.0);
        assert_eq!(hear(3, "e1", 10_000.0), [Some(0.0), Some(100.0)]);
        assert_eq!(hear(4, "e1", 1_000.0), [Some(0.0), Some(100.0)]);
        assert_eq!(hear(5, "e1", 1_005.0), [Some(0.0), Some(105.0)], "it goes on");
        assert_eq!(hear(6, "e1", 1_004.0), [Some(1.0), Some(105.0)], "a message may be late");
    }

    #[test]
    fn where_there_are_too_many_machines_a_new_one_takes_the_place_of_the_one_that_is_silent_for_longest() {
        let mut machines = Machines::default();
        for at in 0..=MACHINES {
            machines.hear(machine("worker", &format!("w{at}"), at as f64));
        }
        let name = |at: usize| ("worker".to_string(), String::new(), format!("w{at}"));
        assert_eq!(machines.all.len(), MACHINES);
        assert!(!machines.all.contains_key(&name(0)) && machines.all.contains_key(&name(MACHINES)));
    }

    #[test]
    fn whether_a_machine_is_silent_does_not_depend_on_our_clock() {
        let (fleet, _results) = centre("north:FIC1");
        // Our clock is an hour ahead of the server's.
        let server = fleet.clock.now() - 3600.0;
        fleet.hear_server(server);
        lock(&fleet.machines).hear(machine("edge", "e1", server - 7.0));
        let seen = fleet.seen();
        let age_s = fleet.clock.now() - seen.machines.first().expect("it was heard of").heard_at;
        assert!((7.0..17.0).contains(&age_s), "{age_s}");
    }
}
