//! What is right by itself and often meant otherwise.

use super::{Config, LoopConfig, TagConfig, tags};
use crate::collect::{modbus, opcua};
use crate::notify::smtp;
use crate::signal::Role;
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};

/// A range of believable values that is so many times wider than the span belongs to another unit.
const WIDER: f64 = 10.0;
/// So does one that is so many times narrower.
const NARROWER: f64 = 4.0;

/// A first diagnosis that takes longer is told (s).
const LONGEST_START_S: f64 = 86_400.0;
/// A shorter time between two polls is told (ms): most controllers scan no faster.
const SHORTEST_MS: u64 = 50;

impl Config {
    /// What is right by itself and often meant otherwise, each with its loop and tag.
    pub fn remarks(&self) -> Vec<String> {
        let mut out = Vec::new();
        for control_loop in &self.loops {
            for (role, tag) in tags(control_loop) {
                let TagConfig::Modbus(own) = tag else { continue };
                let name = role.map(Role::as_str).or(tag.name()).unwrap_or_default();
                let remark = own.remark(self.address_base(&own.device));
                out.extend(remark.map(|remark| format!("{}.{name}: {remark}", control_loop.id)));
            }
            out.extend(self.written(control_loop));
            out.extend(one_bit(control_loop));
            out.extend(beyond_range(control_loop));
        }
        out.extend(self.of_edge());
        out.extend(self.pace());
        out.extend(self.numbered());
        out.extend(self.copied());
        out.extend(self.subscriptions());
        out.extend(self.polled());
        out.extend(self.in_the_clear());
        out.extend(self.ports_of_tls());
        out.extend(self.doubts());
        out.extend(self.unlikely());
        let (held, wanted) = (self.history.samples_per_tag, self.diagnosis.window_samples);
        if held < wanted {
            out.push(format!(
                "[history] holds {held} samples of a tag, and a diagnosis looks at up to {wanted}: write samples_per_tag = \
                 {wanted} or more"
            ));
        }
        out
    }

    /// What an edge would not start without.
    fn of_edge(&self) -> Option<String> {
        let fleet = self.fleet.as_ref().filter(|_| !self.loops.is_empty())?;
        let needed = [("a site", fleet.site.is_none()), ("a [store]", self.store.is_none())];
        let missing: Vec<&str> =
            needed.iter().filter(|(_, missing)| *missing).map(|(what, _)| *what).collect();
        (!missing.is_empty()).then(|| format!("[fleet]: `stictiond edge` needs {}", missing.join(" and ")))
    }

    /// How long a first diagnosis takes at this time between two polls (s).
    fn first_s(&self, ms: u64) -> f64 {
        ms as f64 / 1000.0 * self.diagnosis.min_samples as f64
    }

    /// Whether the time between two polls (ms) is so long that it is told as such.
    pub(super) fn is_slow(&self, ms: u64) -> bool {
        self.first_s(ms) > LONGEST_START_S
    }

    /// Devices that are polled so slowly, or so often, that another unit may have been meant.
    fn pace(&self) -> Vec<String> {
        let told = |device: &modbus::Config| {
            let (name, ms) = (&device.name, device.poll_ms);
            let first_s = self.first_s(ms);
            if first_s > LONGEST_START_S {
                Some(format!(
                    "{name}: at poll_ms = {ms} the first diagnosis takes {:.0} h: poll_ms is in milliseconds",
                    first_s / 3600.0
                ))
            } else if ms < SHORTEST_MS {
                Some(format!(
                    "{name}: at poll_ms = {ms} it is asked {} times a second: poll_ms is in milliseconds",
                    1000 / ms.max(1)
                ))
            } else {
                None
            }
        };
        self.modbus.iter().filter_map(told).collect()
    }

    /// From which number a device counts its registers.
    fn address_base(&self, device: &str) -> u8 {
        self.modbus.iter().find(|own| own.name == device).map_or(0, |own| own.address_base)
    }

    /// Registers of write-back that look like 40001 notation.
    fn written(&self, control_loop: &LoopConfig) -> Vec<String> {
        let Some(own) = control_loop.writeback.as_ref().filter(|own| own.enabled) else { return Vec::new() };
        let base = self.address_base(&own.device);
        let told = |(key, address): (&str, i64)| {
            let number = (40_001..50_000).contains(&address).then_some(address - 40_000)?;
            let write = modbus::counted(key, number, base);
            Some(format!(
                "{}.writeback: {key} = {address} is WRITTEN as holding register {address}; where the device's list writes the \
                 kind of register as the first digit, write {write}",
                control_loop.id
            ))
        };
        let keys = [("term_address", own.term_address), ("heartbeat_address", own.heartbeat_address)];
        keys.into_iter().filter_map(told).collect()
    }

    /// Servers whose nodes are named by the number of their namespace, or by none.
    fn numbered(&self) -> Vec<String> {
        let (mut numbered, mut without) = (BTreeMap::<&str, usize>::new(), BTreeMap::<&str, usize>::new());
        for (_, tag) in self.loops.iter().flat_map(tags) {
            let TagConfig::Opcua(own) = tag else { continue };
            let Ok(place) = own.place() else { continue };
            if place.is_numbered() {
                *numbered.entry(own.device.as_str()).or_default() += 1;
            }
            if place.has_no_namespace() {
                *without.entry(own.device.as_str()).or_default() += 1;
            }
        }
        let by_number = numbered.into_iter().map(|(device, tags)| {
            format!(
                "{device}: {} the namespace by its number, which a server may give to another when it starts: \
                 write nsu=URI instead, as stictiond probe shows it",
                tags_name(tags)
            )
        });
        let by_none = without.into_iter().map(|(device, tags)| {
            format!(
                "{device}: {} a node in OPC UA's own namespace (ns=0), where plants have none: write \
                 nsu=URI;s=NAME, as stictiond probe shows it",
                tags_name(tags)
            )
        });
        by_number.chain(by_none).collect()
    }

    /// All brokers: those that are read, and the one that results are published to.
    fn brokers(&self) -> Vec<Broker<'_>> {
        let read = self.mqtt.iter().map(|own| Broker {
            name: &own.name,
            address: &own.address,
            tls: own.tls || own.ca_file.is_some(),
            has_user: own.user.is_some(),
        });
        let told = self.notify.mqtt.iter().map(|own| Broker {
            name: "[notify.mqtt]",
            address: &own.address,
            tls: own.tls || own.ca_file.is_some(),
            has_user: own.user.is_some(),
        });
        read.chain(told).collect()
    }

    /// Passwords that anybody on the way can read.
    fn in_the_clear(&self) -> Vec<String> {
        let is_clear = |own: &Broker| own.has_user && !own.tls && !is_near(own.address);
        let told = |own: Broker| {
            let Broker { name, address, .. } = own;
            format!("{name}: the password goes to {address} in the clear: write tls = true")
        };
        self.brokers().into_iter().filter(is_clear).map(told).collect()
    }

    /// Ports that go with TLS, or with none, and are used the other way.
    fn ports_of_tls(&self) -> Vec<String> {
        let of_broker = |own: Broker| {
            let said = match (own.address.rsplit_once(':')?.1, own.tls) {
                ("8883", false) => "8883 is the port of brokers that speak TLS: write tls = true",
                ("1883", true) => "1883 is the port of brokers that speak no TLS: theirs for TLS is 8883",
                _ => return None,
            };
            Some(format!("{}: {said}", own.name))
        };
        let of_mail = |own: &smtp::Config| {
            let said = match (own.address.rsplit_once(':')?.1, own.security) {
                ("465", smtp::Security::Starttls) => {
                    "465 speaks TLS from the start: write security = \"tls\""
                }
                ("587", smtp::Security::Tls) => "587 begins without TLS: write security = \"starttls\"",
                _ => return None,
            };
            Some(format!("{}: {said}", own.name))
        };
        let brokers = self.brokers().into_iter().filter_map(of_broker);
        brokers.chain(self.notify.smtp.iter().filter_map(of_mail)).collect()
    }

    /// What servers are asked for that costs samples, or small movements of OP.
    fn subscriptions(&self) -> Vec<String> {
        let servers: HashMap<&str, &opcua::Config> =
            self.opcua.iter().map(|server| (server.name.as_str(), server)).collect();
        let mut out = Vec::new();
        let mut lossy: BTreeMap<(&str, u64, u32), (usize, String)> = BTreeMap::new();
        for control_loop in &self.loops {
            for (role, tag) in tags(control_loop) {
                let TagConfig::Opcua(own) = tag else { continue };
                let Some(server) = servers.get(own.device.as_str()) else { continue };
                if server.mode != opcua::Mode::Subscribe {
                    continue;
                }
                let name = format!(
                    "{}.{}",
                    control_loop.id,
                    role.map(Role::as_str).or(tag.name()).unwrap_or_default()
                );
                let sampling = opcua::Sampling::new(server, own);
                if role == Some(Role::Op) && sampling.deadband != opcua::Deadband::None {
                    out.push(format!(
                        "{name}: a dead band hides small movements of OP, by which friction is seen: leave it out, or write \
                         deadband = 0.0 for this tag"
                    ));
                }
                if server.publishing_ms.div_ceil(sampling.every_ms.max(1)) > u64::from(sampling.queue) {
                    let key = (server.name.as_str(), sampling.every_ms, sampling.queue);
                    lossy.entry(key).or_insert((0, name)).0 += 1;
                }
            }
        }
        out.extend(lossy.into_iter().map(|((device, every_ms, queue), (tags, first))| {
            let publishing_ms = servers[device].publishing_ms;
            let made = publishing_ms.div_ceil(every_ms.max(1));
            let others = if tags > 1 { format!(" and {} others", tags - 1) } else { String::new() };
            format!(
                "{device}: of {first}{others} the server takes {made} samples between two publishes (sampling_ms = {every_ms}, \
                 publishing_ms = {publishing_ms}) and keeps {queue}, the others are lost: write queue_size = {made} or more"
            )
        }));
        out
    }

    /// Servers that are read, and what is said of a subscription that there is none of.
    fn polled(&self) -> Vec<String> {
        let told = |server: &opcua::Config| {
            let of_server = server.of_a_subscription();
            let written: Vec<(String, &'static str)> = self
                .loops
                .iter()
                .flat_map(|own| tags(own).map(move |(role, tag)| (own, role, tag)))
                .filter_map(|(control_loop, role, tag)| {
                    let TagConfig::Opcua(own) = tag else { return None };
                    let key = *own.of_a_subscription().first().filter(|_| own.device == server.name)?;
                    let name = role.map(Role::as_str).or(tag.name()).unwrap_or_default();
                    Some((format!("{}.{name}", control_loop.id), key))
                })
                .collect();
            let of_tag = written.first().map(|(name, key)| {
                let others = match written.len() - 1 {
                    0 => String::new(),
                    1 => " and 1 other".to_string(),
                    more => format!(" and {more} others"),
                };
                format!("{key} of {name}{others}")
            });
            let keys: Vec<String> =
                of_tag.into_iter().chain(of_server.into_iter().map(str::to_string)).collect();
            (!keys.is_empty()).then(|| {
                format!(
                    "{}: in mode = \"poll\" every tag is read every sampling_ms = {} of the server, without use of {}",
                    server.name,
                    server.sampling_ms,
                    keys.join(", ")
                )
            })
        };
        self.opcua.iter().filter(|server| server.mode == opcua::Mode::Poll).filter_map(told).collect()
    }

    /// Loops that read OP where another does.
    fn copied(&self) -> Vec<String> {
        let mut first: HashMap<String, &LoopConfig> = HashMap::new();
        let mut out = Vec::new();
        for own in &self.loops {
            match first.entry(own.op.source()) {
                Entry::Occupied(other) => {
                    let both = other.get().pv.source() == own.pv.source();
                    let what = if both { "OP and PV" } else { "OP" };
                    let other = &other.get().id;
                    out.push(format!(
                        "{}: it reads {what} where {other} does: was its section copied?",
                        own.id
                    ));
                }
                Entry::Vacant(place) => drop(place.insert(own)),
            }
        }
        out
    }
}

/// A broker, as far as who listens on the way is concerned.
struct Broker<'c> {
    name: &'c str,
    address: &'c str,
    tls: bool,
    has_user: bool,
}

/// Whether an address is of this machine.
pub(super) fn is_near(address: &str) -> bool {
    ["127.", "localhost", "[::1]"].iter().any(|own| address.starts_with(own))
}

/// A controller output or process variable that can only be 0 or 1.
fn one_bit(control_loop: &LoopConfig) -> Vec<String> {
    let is_bit = |tag: &TagConfig| {
        tag.as_modbus().is_some_and(|own| own.effective_type() == Some(modbus::ValueType::Bit))
    };
    let both = [("op", &control_loop.op), ("pv", &control_loop.pv)].into_iter();
    let told = |role| {
        format!(
            "{}.{role}: a single bit, 0 or 1, cannot be diagnosed: name the register of the value",
            control_loop.id
        )
    };
    both.filter(|(_, tag)| is_bit(tag)).map(|(role, _)| told(role)).collect()
}

/// Limits and span of OP that its range does not go with.
fn beyond_range(control_loop: &LoopConfig) -> Option<String> {
    let [least, most] = control_loop.op.range()?;
    let id = &control_loop.id;
    if let Some([low, high]) = control_loop.op_limits.filter(|[low, high]| *low < least || *high > most) {
        return Some(format!(
            "{id}.op: op_limits = [{low}, {high}] reach beyond range = [{least}, {most}], and a value out of range is bad: \
             widen range, or correct op_limits"
        ));
    }
    let (span, wide) = (control_loop.op_span?, most - least);
    let than = match wide {
        wide if wide > WIDER * span => "wider",
        wide if NARROWER * wide < span => "narrower",
        _ => return None,
    };
    Some(format!(
        "{id}.op: range = [{least}, {most}] is far {than} than op_span = {span}: both are in OP's own unit, after scaling"
    ))
}

/// `1 tag names`, `5 tags name`.
fn tags_name(count: usize) -> String {
    if count == 1 { "1 tag names".into() } else { format!("{count} tags name") }
}

#[cfg(test)]
mod tests {
    use super::super::parse;

    #[test]
    fn what_only_a_subscription_follows_is_told_of_a_server_that_is_read() {
        let remarks = |server: &str, op: &str, pv: &str| {
            let text = format!(
                "[[opcua]]\nname = 's'\nurl = 'opc.tcp://localhost:4840/'\nsecurity_policy = 'None'\n{server}\n\
                 [[loop]]\nid = 'A'\nop_span = 100.0\n[loop.op]\ndevice = 's'\nnode = 'nsu=urn:p;s=OP'\n{op}\n\
                 [loop.pv]\ndevice = 's'\nnode = 'nsu=urn:p;s=PV'\n{pv}\n"
            );
            let config = parse("f", &text).unwrap_or_else(|errors| panic!("{text}\n{errors:?}"));
            let found = config.remarks();
            found.into_iter().filter(|remark| remark.contains("without use of")).collect::<Vec<_>>()
        };
        let polled = "mode = 'poll'\nsampling_ms = 500";
        assert_eq!(remarks(polled, "", ""), [""; 0]);
        assert_eq!(remarks("publishing_ms = 500", "", "sampling_ms = 500"), [""; 0], "it has a subscription");
        let tags = remarks(polled, "sampling_ms = 200\nqueue_size = 3", "deadband = 0.0");
        assert_eq!(tags.len(), 1, "{tags:?}");
        assert!(
            tags[0].starts_with("s: in mode = \"poll\" every tag is read every sampling_ms = 500"),
            "{tags:?}"
        );
        assert!(tags[0].ends_with("without use of sampling_ms of A.op and 1 other"), "{tags:?}");
        let both = remarks(&format!("{polled}\npublishing_ms = 200\nqueue_size = 3"), "", "queue_size = 3");
        assert_eq!(both.len(), 1, "{both:?}");
        assert!(
            both[0].ends_with("without use of queue_size of A.pv, publishing_ms, queue_size"),
            "{both:?}"
        );
    }
}
